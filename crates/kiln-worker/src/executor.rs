//! What runs tasks.

use crate::{ArtefactError, Artefacts};
use kiln_core::TaskSpec;
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// Lanes that an executor works in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lanes {
    /// Lanes of trace tasks, the preferred first.
    pub trace: Vec<String>,
    /// The lane of solves.
    pub solve: String,
}

/// What a task gives.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TaskOutput {
    /// The result: the artefact that the task's key maps to.
    pub result: Vec<u8>,
    /// Further artefacts that the result names.
    pub attachments: Vec<Vec<u8>>,
    /// Rays traced.
    pub rays: u64,
}

/// A task could not be done.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// The input is to blame: trying again gives the same.
    #[error("{reason}")]
    Refused {
        /// What is wrong, where, and what to do.
        reason: String,
    },
    /// It failed here; another attempt may not.
    #[error("{reason}")]
    Failed {
        /// What went wrong.
        reason: String,
    },
    /// An artefact that it needs could not be had.
    #[error(transparent)]
    Artefact(#[from] ArtefactError),
    /// The device that traces went away. The task may be tried elsewhere at once; this worker can do no more of its kind.
    #[error("{reason}")]
    DeviceLost {
        /// Which device, and what its driver said.
        reason: String,
    },
    /// It was told to stop.
    #[error("the task was cancelled")]
    Cancelled,
}

/// Tells a running task that nobody wants its result any more.
#[derive(Clone, Debug, Default)]
pub struct CancelFlag(Arc<AtomicBool>);

impl CancelFlag {
    /// Asks the task to stop at its next look.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it was asked to.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Runs tasks. Called from several of the worker's threads at once, none of which is rayon's: a task may wait for
/// another one's work, and may use rayon for its own.
pub trait Executor: Send + Sync + 'static {
    /// The lanes that it works in.
    fn lanes(&self) -> Lanes;

    /// Runs one task of a bake whose trace lane is `lane`. `progress` is told of rays as they are traced.
    fn run(
        &self,
        spec: &TaskSpec,
        lane: &str,
        artefacts: &dyn Artefacts,
        cancel: &CancelFlag,
        progress: &dyn Fn(u64),
    ) -> Result<TaskOutput, TaskError>;
}
