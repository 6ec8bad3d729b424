//! Tasks: pure functions of the digests of their inputs, keyed by all that they depend on.

use crate::{
    BakeSettings, Digest, DigestBuilder, ErrorEstimate, LevelCounts, Sampling, SolveSummary, TraceSummary, Warning,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

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

/// The kinds of task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TaskKind {
    /// Source files to a level.
    Import,
    /// A level to its task graph.
    Plan,
    /// A piece of an instance to per-face moments.
    Trace,
    /// An instance's moments to vertex values.
    Solve,
    /// All vertex values to the baked file.
    Export,
}

impl TaskKind {
    /// Every kind, in the order of the data path.
    pub const ALL: [Self; 5] = [Self::Import, Self::Plan, Self::Trace, Self::Solve, Self::Export];

    /// Revision of the kind's code: raised whenever its output changes for some input, so that results of
    /// other revisions are never taken for its own. A golden test in the kind's crate fails otherwise.
    pub const fn kernel_rev(self) -> u32 {
        match self {
            Self::Import | Self::Plan => 3,
            Self::Solve | Self::Export => 4,
            Self::Trace => 7,
        }
    }

    /// The name in messages and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Import => "import",
            Self::Plan => "plan",
            Self::Trace => "trace",
            Self::Solve => "solve",
            Self::Export => "export",
        }
    }
}

/// The trace lane of bakes whose pieces are traced in whatever lane there is. Their keys are made for it, so that their
/// results never pass for those of one lane.
pub const MIXED_LANE: &str = "mixed";

/// Where a task's arithmetic runs. Results are bit for bit the same within a lane, not across lanes, but for
/// [`MIXED_LANE`], which promises the error bound only.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Lane {
    /// `cpu`, `gpu:ADAPTER:DRIVER`, or [`MIXED_LANE`].
    pub trace: String,
    /// The instruction set of solves, such as `x86_64+avx2`.
    pub solve: String,
}

impl Lane {
    /// Whether pieces are traced in any lane.
    pub fn is_mixed(&self) -> bool {
        self.trace == MIXED_LANE
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
    /// Gives an encoded [`TaskGraph`].
    Plan(PlanSpec),
    /// Gives encoded [`crate::FaceMoments`].
    Trace {
        /// Digest of the level.
        level: Digest,
        /// The piece.
        task: TraceTask,
    },
    /// Gives an encoded [`crate::Solution`].
    Solve {
        /// Digest of the level.
        level: Digest,
        /// Index of the instance.
        instance: u32,
        /// Digests of the moments of its pieces, in order.
        moments: Vec<Digest>,
    },
    /// Gives an encoded [`Baked`] and stores the file.
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

/// An export task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportSpec {
    /// Digest of the [`SourceManifest`].
    pub source: Digest,
    /// Digest of the level.
    pub level: Digest,
    /// Digest of an encoded `Vec<(u32, Digest)>`: each receiving instance and its solution.
    pub solutions: Digest,
}

impl TaskSpec {
    /// The task's kind.
    pub fn kind(&self) -> TaskKind {
        match self {
            Self::Import { .. } => TaskKind::Import,
            Self::Plan(_) => TaskKind::Plan,
            Self::Trace { .. } => TaskKind::Trace,
            Self::Solve { .. } => TaskKind::Solve,
            Self::Export(_) => TaskKind::Export,
        }
    }

    /// The key of every kind but trace and solve, whose keys the plan makes ([`TraceTask::key`], [`SolveTask::key`]).
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

/// One piece of an instance to be traced: a run of its faces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TraceTask {
    /// H(family, occluder root): see [`Digest`] of what the piece depends on.
    pub key: TaskKey,
    /// H(receiver piece, settings, kernel revision, lane), without the occluders: for later reuse within an error bound.
    pub family: Digest,
    /// Index of the instance.
    pub instance: u32,
    /// First face of the piece.
    pub first_face: u32,
    /// Faces of the piece.
    pub face_count: u32,
    /// Samples per square metre of the instance.
    pub density_per_m2: f64,
    /// Rays that the piece will need at most: the cost by which leases are filled.
    pub ray_count: u64,
}

/// The solve of one instance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SolveTask {
    /// H(mesh, transform, settings, kernel revision, lane), to which the inputs' digests are added.
    pub family: Digest,
    /// Index of the instance.
    pub instance: u32,
    /// First of its pieces in [`TaskGraph::trace`].
    pub first_trace: u32,
    /// Number of its pieces.
    pub trace_count: u32,
    /// Vertices: the cost by which leases are filled.
    pub vertex_count: u32,
}

impl SolveTask {
    /// The key, once the digests of the moments of its pieces are known.
    pub fn key(&self, moments: &[Digest]) -> TaskKey {
        let mut builder = DigestBuilder::new("kiln solve");
        builder.digest(&self.family);
        moments.iter().for_each(|digest| {
            builder.digest(digest);
        });
        TaskKey(builder.finish())
    }
}

/// All tasks of a level between plan and export. Tasks that a level does not need are not there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskGraph {
    /// Digest of the level.
    pub level: Digest,
    /// Pieces, grouped by instance.
    pub trace: Vec<TraceTask>,
    /// One for each receiving instance.
    pub solve: Vec<SolveTask>,
    /// How samples are made, for reports.
    pub sampling: Sampling,
    /// Totals of the level, for reports.
    pub counts: LevelCounts,
    /// What import found worth saying.
    pub warnings: Vec<Warning>,
}

/// What an export task gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Baked {
    /// Digest of the baked .glb.
    pub file: Digest,
    /// Its size.
    pub bytes: u64,
    /// What the bake did and how well.
    pub summary: BakeSummary,
}

/// The part of the report that depends on the result alone, not on when and where it was computed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakeSummary {
    /// Digest of the level.
    pub level: Digest,
    /// Totals of the level.
    pub counts: LevelCounts,
    /// How samples were made.
    pub sampling: Sampling,
    /// Totals of tracing.
    pub trace: TraceSummary,
    /// The lanes that traced it.
    pub trace_lanes: BTreeSet<String>,
    /// What the reach of rays left out.
    pub beyond_reach: BeyondReach,
    /// Estimated error over the level for each channel.
    pub error: Vec<ErrorEstimate>,
    /// What happened in each instance.
    pub meshes: Vec<MeshSummary>,
    /// Import's and export's warnings.
    pub warnings: Vec<Warning>,
}

/// What lies beyond the reach of rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub struct BeyondReach {
    /// Instances that no receiving instance's rays can come to: they are neither loaded nor traced.
    pub instances: u64,
    /// Their faces.
    pub faces: u64,
    /// Rays that end at their reach although something lies beyond: of samples whose reach does not cover the level.
    pub rays_cut: u64,
}

/// What happened in one instance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeshSummary {
    /// Name of the node.
    pub node: String,
    /// Name of the mesh.
    pub mesh: String,
    /// How it was solved, and its samples.
    pub solve: SolveSummary,
    /// Centres in world space, metres, of the faces that [`crate::CoarseFaces::worst`] lists.
    pub coarse_centers_m: Vec<[f64; 3]>,
}
