//! What the journal records of jobs.

use kiln_core::{Digest, JobId, Lane};
use serde::{Deserialize, Serialize};

/// The right to write to the journal: of two coordinators the one with the greater fence has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Fence(pub u64);

/// How a job ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JobOutcome {
    /// With this artefact, an encoded [`kiln_core::Baked`].
    Succeeded {
        /// Its digest.
        baked: Digest,
    },
    /// Not.
    Failed {
        /// Why, in a sentence or a few lines.
        reason: String,
    },
    /// It was told to stop.
    Cancelled,
}

/// A job as it was submitted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SubmittedJob {
    /// Its number.
    pub job: JobId,
    /// The submitter's id of the request: the same id returns the earlier job.
    pub request_id: String,
    /// Digest of all that the request said: the same id with another payload is an error.
    pub payload: Digest,
    /// Digest of the [`kiln_core::SourceManifest`].
    pub source: Digest,
    /// What people call it.
    pub name: String,
    /// Whose it is.
    pub tenant: String,
    /// Greater goes first.
    pub priority: i32,
    /// When, milliseconds since 1970 (UTC).
    pub submitted_unix_ms: u64,
    /// The lane asked for, if one was; else see [`JournalEvent::LaneChosen`].
    pub lane: Option<Lane>,
}

/// A step in the life of a job. New kinds are added at the end; a change to one raises the record's version.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JournalEvent {
    /// A job was accepted.
    JobSubmitted(SubmittedJob),
    /// The lane in which all of a job's tasks run.
    LaneChosen {
        /// The job.
        job: JobId,
        /// Its lane.
        lane: Lane,
    },
    /// A job was paused.
    JobPaused(JobId),
    /// A paused job goes on.
    JobResumed(JobId),
    /// A job ended.
    JobFinished {
        /// The job.
        job: JobId,
        /// How.
        outcome: JobOutcome,
        /// When, milliseconds since 1970 (UTC).
        finished_unix_ms: u64,
    },
    /// A job that ended is no longer remembered, and its artefacts may be collected.
    JobForgotten(JobId),
}

impl JournalEvent {
    /// The job that the event is about.
    pub fn job(&self) -> JobId {
        match self {
            Self::JobSubmitted(submitted) => submitted.job,
            Self::LaneChosen { job, .. }
            | Self::JobPaused(job)
            | Self::JobResumed(job)
            | Self::JobFinished { job, .. }
            | Self::JobForgotten(job) => *job,
        }
    }
}
