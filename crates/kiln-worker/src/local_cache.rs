//! What a worker keeps on its own machine because it can make it again, only slower.

use kiln_core::{Digest, TaskKey};
use kiln_store::{Store, StoreError};
use std::{collections::BTreeSet, sync::Arc};

/// Derived data by key, in the store of this machine: never uploaded, and collected with all else there that was not
/// used for long. What fails is told in the log and costs no more than making the thing anew.
#[derive(Clone, Debug)]
pub struct LocalCache {
    store: Arc<Store>,
    /// Beyond so many bytes of the store the least used goes; none where somebody else sees to that.
    max_bytes: Option<u64>,
}

impl LocalCache {
    /// In a store that `max_bytes` is to be kept to; none if its owner collects.
    pub fn new(store: Arc<Store>, max_bytes: Option<u64>) -> Self {
        Self { store, max_bytes }
    }

    /// What is kept under a key, whole.
    pub(crate) fn get(&self, key: TaskKey) -> Option<Vec<u8>> {
        let get = || {
            Ok::<_, StoreError>(self.store.result(key)?.map(|digest| self.store.get(&digest)).transpose()?.flatten())
        };
        get().inspect_err(|error| tracing::warn!(%error, "the local cache cannot be read")).ok().flatten()
    }

    /// Keeps things together, in one file.
    pub(crate) fn put(&self, things: &[(TaskKey, Vec<u8>)]) {
        let put = || {
            let bytes: Vec<&[u8]> = things.iter().map(|(_, bytes)| bytes.as_slice()).collect();
            let results: Vec<_> = things.iter().map(|(key, bytes)| (*key, Digest::of(bytes))).collect();
            // Where a key has another value already, which was of no use, that one stays, and is of no use again: only a
            // bug makes such a value, and its remedy is a raised revision.
            self.store.put_results(&bytes, &results)?;
            self.trim()
        };
        let _ = put().inspect_err(|error: &StoreError| tracing::warn!(%error, "the local cache cannot be written"));
    }

    /// Brings the store down to its size.
    pub(crate) fn trim(&self) -> Result<(), StoreError> {
        let Some(max_bytes) = self.max_bytes else { return Ok(()) };
        if self.store.pack_bytes() > max_bytes {
            self.store.collect_garbage(&BTreeSet::new(), max_bytes / 4 * 3)?;
        }
        Ok(())
    }
}
