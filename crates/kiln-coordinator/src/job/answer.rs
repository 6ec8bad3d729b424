//! The whole answer of a bake, kept under a key of its own, so that the same source in the same lane is answered
//! at once.

use super::progress::Progress;
use kiln_core::{Digest, DigestBuilder, JobId, Lane, TaskKey, TaskKind};
use serde::{Deserialize, Serialize};

/// What a finished bake was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Answer {
    /// Digest of the encoded [`kiln_core::Baked`].
    pub(crate) baked: Digest,
    /// Tasks of each kind and the rays they may take: what a later bake is spared.
    pub(crate) tasks: Vec<(TaskKind, u64, u64)>,
}

impl Answer {
    pub(crate) fn new(baked: Digest, progress: &Progress) -> Self {
        Self { baked, tasks: progress.totals() }
    }
}

/// The key of the whole answer: the source, the lane, and the revision of everything that runs in between.
pub(crate) fn answer_key(source: Digest, lane: &Lane) -> TaskKey {
    let mut key = DigestBuilder::new("kiln bake");
    key.digest(&source).text(&lane.trace).text(&lane.solve);
    for kind in TaskKind::ALL {
        key.integer(u64::from(kind.kernel_rev()));
    }
    TaskKey(key.finish())
}

/// The key under which the details of a failure are kept, for a coordinator that is started later.
pub(crate) fn failure_key(job: JobId, payload: Digest) -> TaskKey {
    TaskKey(DigestBuilder::new("kiln bake failure").integer(job.0).digest(&payload).finish())
}
