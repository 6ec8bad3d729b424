//! Digests, settings and the plain data types that every Kiln crate shares.
//!
//! Nothing here does I/O or knows of async: a [`Level`] is what was imported, a [`TaskGraph`] is what must be
//! done to bake it, [`FaceMoments`] is what tracing brings back and [`Solution`] what solving does. Artefacts
//! travel and are stored in the encoding of [`codec`].

pub mod codec;
mod cutout;
mod digest;
mod foliage;
mod geometry;
mod graph;
mod graph_check;
mod kind;
mod level;
mod mesh_form;
mod moments;
mod region;
mod settings;
mod skip;
mod solution;
mod summary;
mod task;
mod work;

pub use cutout::{CutoutFace, Cutouts, Mask, Wrap};
pub use digest::{Digest, DigestBuilder, DigestStream, ParseDigestError};
pub use foliage::{InstanceNumbers, PointValues, TreeErrors, TreeFits};
pub use geometry::{Bounds, Class, Density, FaceGroup, Fog, Foliage, Mesh, OpticalDepth};
pub use graph::{MAX_INPUTS, PlannedTask, TaskGraph};
pub use graph_check::{GraphError, GraphProblem};
pub use kind::{Lane, LanePart, MIXED_LANE, TaskKind};
pub use level::{Gets, Instance, Level, LevelCounts, MeshEntry, VertexBlock, Warning};
pub use moments::{FaceMoments, HalfMoments, MomentsError, TraceSummary};
pub use region::{
    CANDIDATES, CANDIDATES_PER_AXIS, CandidateBits, REGION_HARMONICS, REGION_PARAMETERS, Region, RegionEdge,
    RegionErrors, RegionModel, RegionModels, RegionSamples, RegionSettings, RegionSummary, Regions,
};
pub use settings::{
    Attribute, BakeSettings, ColorMode, DEFAULT_REGULARIZATION, FoliageMode, Kernel, MAX_CHANNELS, OutputSettings,
    Quality, Remap, Sampling, SolveSettings, Target, TreeValues, ValueFormat,
};
pub use skip::{REACH_EPSILON, SkipRule};
pub use solution::{CoarseFace, CoarseFaces, ComponentMethod, ErrorEstimate, ErrorHistogram, Solution, SolveSummary};
pub use summary::{
    BakeSummary, Baked, BeyondReach, FoliageSummary, LodSummary, MeshSummary, ModelSummary, NodeErrors, PackFile,
};
pub use task::{ExportSpec, JobId, PlanSpec, SourceFile, SourceManifest, TaskKey, TaskSpec, WorkSpec};
pub use work::{
    FitWork, ModelWork, Output, PointsWork, RAYS_PER_VOXEL, ReadWork, RegionsWork, ResampleWork, ResultError,
    SolveWork, TraceWork, VolumeWork, Work, WorkError, rays_per_point,
};
