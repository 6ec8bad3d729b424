//! Tasks: pure functions of the digests of their inputs, keyed by all that they depend on.

use crate::{BakeSettings, Digest, DigestBuilder, Lane, TaskKind, Work};
use serde::{Deserialize, Serialize};

/// The key of a task: a digest of its inputs, settings, kernel revision and lane. Equal keys mean equal results.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Debug)]
pub struct TaskKey(pub Digest);

/// The number of a job, given by the coordinator in order of submission and never used again.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Debug)]
pub struct JobId(pub u64);

impl std::fmt::Display for JobId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// A file of the source, by its path relative to the level's folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SourceFile {
    /// Path with forward slashes, as the level refers to it.
    pub path: String,
    /// Digest of its bytes.
    pub digest: Digest,
}

/// What is baked: the files and the settings. An artefact; its digest starts every key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceManifest {
    /// The level file first, then the files that it refers to.
    pub files: Vec<SourceFile>,
    /// The sidecar's text, if there is one.
    pub sidecar: Option<SourceFile>,
    /// What the person asked for.
    pub settings: BakeSettings,
}

/// A task as a worker gets it: everything by digest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum TaskSpec {
    /// Reads, checks and cleans; gives an encoded [`crate::Level`] and stores its meshes.
    Import {
        /// Digest of the [`SourceManifest`].
        source: Digest,
    },
    /// Gives an encoded [`crate::TaskGraph`].
    Plan(PlanSpec),
    /// A task of the graph; gives what its [`Work`] says.
    Work(WorkSpec),
    /// Gives an encoded [`crate::Baked`] and stores the file.
    Export(ExportSpec),
}

/// A plan task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanSpec {
    /// Digest of the level.
    pub level: Digest,
    /// The lane that keys are made for.
    pub lane: Lane,
}

/// A task of a task graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorkSpec {
    /// Digest of the level.
    pub level: Digest,
    /// What is to be done.
    pub work: Work,
    /// Results of the tasks that it depends on, in the order of the graph.
    pub inputs: Vec<Digest>,
}

/// An export task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportSpec {
    /// Digest of the [`SourceManifest`].
    pub source: Digest,
    /// Digest of the level.
    pub level: Digest,
    /// Digest of an encoded `Vec<(Output, Digest)>`: each [`crate::Output`] of the graph and its artefact.
    pub outputs: Digest,
}

impl TaskSpec {
    /// The task's kind.
    pub fn kind(&self) -> TaskKind {
        match self {
            Self::Import { .. } => TaskKind::Import,
            Self::Plan(_) => TaskKind::Plan,
            Self::Work(spec) => spec.work.kind(),
            Self::Export(_) => TaskKind::Export,
        }
    }

    /// The key of a task outside of the graph; those within have keys of their own ([`crate::TaskGraph::key`]).
    pub fn whole_key(&self) -> TaskKey {
        let kind = self.kind();
        let key = DigestBuilder::new("kiln task")
            .text(kind.name())
            .integer(u64::from(kind.kernel_rev()))
            .value(self)
            .finish();
        TaskKey(key)
    }
}
