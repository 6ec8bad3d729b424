//! The life of a job, one type for each state.
//!
//! ```text
//!  Waiting ──lane──▶ Answering ──known before──────────────────────────────────┐
//!                        │ not known                                           ▼
//!                        ▼                                                  Ending ──durable──▶ Ended
//!                    Importing ──level──▶ Planning ──graph──▶ Baking           ▲
//!                                                               │ all outputs  │
//!                                                               ▼              │
//!                                                           Exporting ──baked──┘
//! ```
//!
//! From every state but the last two a failure or a cancellation leads to `Ending`. Within `Baking` stages overlap:
//! each task of the graph is run as soon as all that it takes is there.

use super::Baking;
use kiln_core::{Baked, Digest};
use kiln_proto::v1;

/// Waits for a worker that decides the lane.
#[derive(Debug, Default)]
pub(crate) struct Waiting {
    /// Since when workers are there and none of them fits, milliseconds of the coordinator's clock.
    pub(crate) unfit_since_ms: Option<u64>,
}

/// Its tasks between import and plan run.
#[derive(Debug)]
pub(crate) struct Planning {
    pub(crate) level: Digest,
}

/// The file is written.
#[derive(Debug)]
pub(crate) struct Exporting {
    pub(crate) level: Digest,
    /// Digest of the encoded list of outputs.
    pub(crate) outputs: Digest,
}

/// How a job ends.
#[derive(Clone, Debug)]
pub(crate) enum Outcome {
    Succeeded(Box<Success>),
    Failed(v1::BakeFailure),
    Cancelled,
}

/// What came out.
#[derive(Clone, Debug)]
pub(crate) struct Success {
    /// Digest of the encoded [`Baked`].
    pub(crate) digest: Digest,
    pub(crate) baked: Baked,
    /// The whole answer was known before.
    pub(crate) from_store: bool,
}

/// The outcome is decided and not yet durable.
#[derive(Debug)]
pub(crate) struct Ending {
    pub(crate) outcome: Outcome,
    /// The state that is shown until it is durable.
    pub(crate) shown: v1::BakeState,
    /// When to try again to make it durable, after the store failed.
    pub(crate) retry_at_ms: Option<u64>,
}

/// Over.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) outcome: Outcome,
    /// Milliseconds since 1970.
    pub(crate) at_unix_ms: u64,
}

/// Where a job is.
#[derive(Debug)]
pub(crate) enum Phase {
    Waiting(Waiting),
    /// The store is asked for the whole answer.
    Answering,
    Importing,
    Planning(Planning),
    Baking(Box<Baking>),
    Exporting(Exporting),
    Ending(Ending),
    Ended(Ended),
}

impl Phase {
    /// The state as shown to clients.
    pub(crate) fn shown(&self) -> v1::BakeState {
        match self {
            Self::Waiting(_) | Self::Answering => v1::BakeState::Submitted,
            Self::Importing => v1::BakeState::Importing,
            Self::Planning(_) => v1::BakeState::Planning,
            Self::Baking(_) => v1::BakeState::Baking,
            Self::Exporting(_) => v1::BakeState::Exporting,
            Self::Ending(ending) => ending.shown,
            Self::Ended(ended) => match ended.outcome {
                Outcome::Succeeded(_) => v1::BakeState::Succeeded,
                Outcome::Failed(_) => v1::BakeState::Failed,
                Outcome::Cancelled => v1::BakeState::Cancelled,
            },
        }
    }
}
