//! Where a worker's bytes come from and go to.

use crate::{LocalCache, recent::Recent};
use bytes::Bytes;
use kiln_core::Digest;
use kiln_proto::client::{ClientError, Farm};
use kiln_store::{Store, StoreError};
use rayon::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
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

    /// Several artefacts that nobody here will want again, in the order asked for.
    fn get_once(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
        self.get_many(digests)
    }

    /// Stores artefacts together; durable on return. Their digests are returned in order.
    fn store(&self, artefacts: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError>;

    /// Where to keep on this machine what can be made again; none where there is no such place.
    fn local_cache(&self) -> Option<LocalCache> {
        None
    }

    /// One artefact.
    fn get(&self, digest: Digest) -> Result<Bytes, ArtefactError> {
        self.get_many(&[digest])?.pop().ok_or(ArtefactError::Missing { digest })
    }
}

/// Artefacts that one thread reads, of many.
const READ_TOGETHER: usize = 16;

/// The coordinator's own store, for a worker in the same process.
#[derive(Clone)]
pub struct LocalArtefacts(pub Arc<Store>);

impl Artefacts for LocalArtefacts {
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
        let one =
            |digest: &Digest| self.0.get(digest)?.map(Bytes::from).ok_or(ArtefactError::Missing { digest: *digest });
        digests.par_iter().with_min_len(READ_TOGETHER).map(one).collect()
    }

    fn store(&self, artefacts: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError> {
        Ok(self.0.put(&artefacts)?)
    }

    fn local_cache(&self) -> Option<LocalCache> {
        // The coordinator collects what is too much of all.
        Some(LocalCache::new(Arc::clone(&self.0), None))
    }
}

/// The farm's artefacts over a connection of their own, with a store on this machine as cache. Small ones, a worker's own
/// results too, are in memory for a while as well: its next tasks want them.
pub struct RemoteArtefacts {
    farm: Farm,
    cache: Arc<Store>,
    local: LocalCache,
    recent: Mutex<Recent>,
    runtime: Handle,
}

impl RemoteArtefacts {
    /// `farm` should be a connection apart from the session's, so that bulk data can't delay heartbeats. The cache is
    /// kept to about `cache_bytes`.
    pub fn new(farm: Farm, cache: Arc<Store>, cache_bytes: u64, runtime: Handle) -> Self {
        let local = LocalCache::new(Arc::clone(&cache), Some(cache_bytes));
        Self { farm, cache, local, recent: Mutex::default(), runtime }
    }

    fn recent(&self) -> MutexGuard<'_, Recent> {
        self.recent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn find(&self, digest: &Digest) -> Result<Option<Bytes>, ArtefactError> {
        match self.recent().get(digest) {
            Some(bytes) => Ok(Some(bytes)),
            None => Ok(self.cache.get(digest)?.map(Bytes::from)),
        }
    }

    /// Artefacts in the order asked for; those that had to be downloaded are shown to `keep`.
    fn have(
        &self,
        digests: &[Digest],
        keep: impl FnOnce(&[Digest], &[Bytes]) -> Result<(), ArtefactError>,
    ) -> Result<Vec<Bytes>, ArtefactError> {
        let mut found = Vec::with_capacity(digests.len());
        for digest in digests {
            found.push(self.find(digest)?);
        }
        let absent: Vec<Digest> =
            digests.iter().zip(&found).filter(|(_, bytes)| bytes.is_none()).map(|(&digest, _)| digest).collect();
        if !absent.is_empty() {
            let downloaded = self.runtime.block_on(self.farm.download_all(&absent)).map_err(|error| match error {
                ClientError::Missing { digest } => ArtefactError::Missing { digest },
                other => ArtefactError::Farm(other),
            })?;
            keep(&absent, &downloaded)?;
            let mut downloaded = downloaded.into_iter();
            found.iter_mut().filter(|bytes| bytes.is_none()).for_each(|bytes| *bytes = downloaded.next());
        }
        found.into_iter().zip(digests).map(|(bytes, &digest)| bytes.ok_or(ArtefactError::Missing { digest })).collect()
    }

    fn keep(&self, digests: &[Digest], artefacts: &[Bytes]) -> Result<(), ArtefactError> {
        let mut recent = self.recent();
        digests.iter().zip(artefacts).for_each(|(digest, artefact)| recent.add(*digest, artefact));
        drop(recent);
        self.cache.put(artefacts)?;
        Ok(self.local.trim()?)
    }
}

impl Artefacts for RemoteArtefacts {
    fn get_many(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
        self.have(digests, |absent, downloaded| self.keep(absent, downloaded))
    }

    fn get_once(&self, digests: &[Digest]) -> Result<Vec<Bytes>, ArtefactError> {
        self.have(digests, |_, _| Ok(()))
    }

    fn store(&self, artefacts: Vec<Bytes>) -> Result<Vec<Digest>, ArtefactError> {
        let digests = self.runtime.block_on(self.farm.upload(&artefacts)).map_err(ArtefactError::Farm)?;
        let mut recent = self.recent();
        digests.iter().zip(&artefacts).for_each(|(digest, artefact)| recent.add(*digest, artefact));
        Ok(digests)
    }

    fn local_cache(&self) -> Option<LocalCache> {
        Some(self.local.clone())
    }
}
