//! How a store is opened.

use crate::FaultPoint;

/// Limits and aids of a store.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// Most bytes of packs and uploads together; writes beyond it are refused. `None`: the disk is the limit.
    pub quota_bytes: Option<u64>,
    /// Largest artefact of an upload.
    pub max_artefact_bytes: u64,
    /// Largest sum of the artefacts of an upload.
    pub max_upload_bytes: u64,
    /// Most artefacts of an upload.
    pub max_upload_artefacts: usize,
    /// Most uploads under way at once.
    pub max_uploads: usize,
    /// A pack used within this time is not collected, so that what was just reported as present stays a while.
    pub garbage_grace_secs: u64,
    /// Memory that the index may use to keep records at hand.
    pub index_cache_bytes: u64,
    /// A segment of the journal ends at this size.
    pub journal_segment_bytes: u64,
    /// Where to fail on purpose; by default what the variable `KILN_FAILPOINT` says. See [`FaultPoint`].
    pub fault: Option<FaultPoint>,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            quota_bytes: None,
            max_artefact_bytes: 8 << 30,
            max_upload_bytes: 16 << 30,
            max_upload_artefacts: 1 << 20,
            max_uploads: 1024,
            garbage_grace_secs: 60,
            index_cache_bytes: 64 << 20,
            journal_segment_bytes: 8 << 20,
            fault: FaultPoint::from_environment(),
        }
    }
}
