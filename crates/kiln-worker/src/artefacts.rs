//! Where a worker's bytes come from and go to.

use bytes::Bytes;
use kiln_core::Digest;
use kiln_proto::client::{ClientError, Farm};
use kiln_store::{Store, StoreError};
use std::{collections::BTreeSet, sync::Arc};
use tokio::runtime::Handle;

/// An artefact could not be had or stored.
#[derive(Debug, thiserror::Error)]
pub enum ArtefactError {
    /// Nobody has it.
    #[error("the artefact {digest} is missing; it is computed again")]
    Missing {
        /// The artefact.
        digest: Digest,
    },
    /// The store on this machine failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The farm could not be asked.
    #[error(transparent)]
    Farm(ClientError),
}

/// Reads and writes artefacts, verified by digest. Calls block: they are for the worker's own threads.
pub trait Artefacts: Send + Sync + 'static {
    /// Several artefacts, in the order asked for.
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError>;

    /// Stores artefacts together; durable on return. Their digests are returned in order.
    fn store(&self, artefacts: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError>;

    /// One artefact.
    fn get(&self, digest: Digest) -> Result<Bytes, ArtefactError> {
        self.get_many(&[digest])?.pop().ok_or(ArtefactError::Missing { digest })
    }
}

/// The coordinator's own store, for a worker in the same process.
#[derive(Clone)]
pub struct LocalArtefacts(pub Arc<Store>);

impl Artefacts for LocalArtefacts {
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
        let one =
            |digest: &Digest| self.0.get(digest)?.map(Bytes::from).ok_or(ArtefactError::Missing { digest: *digest });
        digests.iter().map(one).collect()
    }

    fn store(&self, artefacts: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError> {
        Ok(self.0.put(&artefacts)?)
    }
}

/// The farm's artefacts over a connection of their own, with a store on this machine as cache.
pub struct RemoteArtefacts {
    farm: Farm,
    cache: Arc<Store>,
    cache_bytes: u64,
    runtime: Handle,
}

impl RemoteArtefacts {
    /// `farm` should be a connection apart from the session's, so that bulk data can't delay heartbeats. The cache is
    /// kept to about `cache_bytes`.
    pub fn new(farm: Farm, cache: Arc<Store>, cache_bytes: u64, runtime: Handle) -> Self {
        Self { farm, cache, cache_bytes, runtime }
    }

    fn keep(&self, artefacts: &[Bytes]) -> Result<(), ArtefactError> {
        self.cache.put(artefacts)?;
        let usage = self.cache.usage()?;
        if usage.pack_bytes + usage.index_bytes > self.cache_bytes {
            self.cache.collect_garbage(&BTreeSet::new(), self.cache_bytes / 4 * 3)?;
        }
        Ok(())
    }
}

impl Artefacts for RemoteArtefacts {
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
        let mut found = Vec::with_capacity(digests.len());
        for digest in digests {
            found.push(self.cache.get(digest)?.map(Bytes::from));
        }
        let absent: Vec<Digest> =
            digests.iter().zip(&found).filter(|(_, bytes)| bytes.is_none()).map(|(&digest, _)| digest).collect();
        if !absent.is_empty() {
            let downloaded = self.runtime.block_on(self.farm.download_all(&absent)).map_err(|error| match error {
                ClientError::Missing { digest } => ArtefactError::Missing { digest },
                other => ArtefactError::Farm(other),
            })?;
            self.keep(&downloaded)?;
            let mut downloaded = downloaded.into_iter();
            found.iter_mut().filter(|bytes| bytes.is_none()).for_each(|bytes| *bytes = downloaded.next());
        }
        found.into_iter().zip(digests).map(|(bytes, &digest)| bytes.ok_or(ArtefactError::Missing { digest })).collect()
    }

    fn store(&self, artefacts: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError> {
        self.runtime.block_on(self.farm.upload(&artefacts)).map_err(ArtefactError::Farm)
    }
}
