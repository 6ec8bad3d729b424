//! Digests, settings and the plain data types that every Kiln crate shares.
//!
//! Nothing here does I/O or knows of async: a [`Level`] is what was imported, a [`TaskGraph`] is what must be
//! done to bake it, [`FaceMoments`] is what tracing brings back and [`Solution`] what solving does. Artefacts
//! travel and are stored in the encoding of [`codec`].

pub mod codec;
mod digest;
mod geometry;
mod level;
mod moments;
mod settings;
mod skip;
mod solution;
mod task;

pub use digest::{Digest, DigestBuilder, DigestStream, ParseDigestError};
pub use geometry::{Bounds, Class, FaceGroup, Mesh};
pub use level::{Instance, Level, LevelCounts, MeshEntry, VertexBlock, Warning};
pub use moments::{FaceMoments, HalfMoments, MomentsError, TraceSummary};
pub use settings::{
    Attribute, BakeSettings, ColorMode, DEFAULT_REGULARIZATION, Kernel, MAX_CHANNELS, OutputSettings, Quality, Remap,
    Sampling, SolveSettings, Target, ValueFormat,
};
pub use skip::{REACH_EPSILON, SkipRule};
pub use solution::{CoarseFace, CoarseFaces, ComponentMethod, ErrorEstimate, ErrorHistogram, Solution, SolveSummary};
pub use task::{
    BakeSummary, Baked, BeyondReach, ExportSpec, JobId, Lane, MIXED_LANE, MeshSummary, PlanSpec, SolveTask, SourceFile,
    SourceManifest, TaskGraph, TaskKey, TaskKind, TaskSpec, TraceTask,
};
