//! What a bake did and how well: the part of a report that the result alone decides.

use crate::{Digest, ErrorEstimate, LevelCounts, Sampling, SolveSummary, TraceSummary, Warning};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What an export task gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Baked {
    /// Digest of the baked .glb.
    pub file: Digest,
    /// Its size.
    pub bytes: u64,
    /// The pack that an engine loads, where it was asked for, or the level has visibility regions.
    pub pack: Option<PackFile>,
    /// What the bake did and how well.
    pub summary: BakeSummary,
}

impl Baked {
    /// Digests of the files that it names.
    pub fn files(&self) -> impl Iterator<Item = Digest> {
        std::iter::once(self.file).chain(self.pack.as_ref().map(|pack| pack.digest))
    }
}

/// A pack (`docs/pack-format.md`).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PackFile {
    /// Digest of the file.
    pub digest: Digest,
    /// Its size.
    pub bytes: u64,
    /// Bytes by what they are, in the order of the file.
    pub sizes: Vec<(String, u64)>,
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
    /// What happened in each instance that has values of its own.
    pub meshes: Vec<MeshSummary>,
    /// What happened to foliage.
    pub foliage: FoliageSummary,
    /// What happened to lower levels of detail.
    pub lods: LodSummary,
    /// What happened in visibility regions; nothing without any.
    pub regions: Option<crate::RegionSummary>,
    /// Import's and export's warnings.
    pub warnings: Vec<Warning>,
}

/// What became of trees, shrubs and decorators.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct FoliageSummary {
    /// Models of trees, without lower levels of detail.
    pub models: Vec<ModelSummary>,
    /// Models that are lower levels of detail of these, and have what these have.
    pub lod_models: u64,
    /// Voxels around them that were traced.
    pub voxels: u64,
    /// Shrubs and decorators with one number.
    pub scalars: u64,
    /// Of these, those around which nothing has values: they are open.
    pub open_scalars: u64,
    /// What a game loads for all of these: models' own AO once, and the numbers of instances, bytes.
    pub bytes: u64,
    /// What values at the vertices of every instance would be, bytes.
    pub bytes_at_vertices: u64,
}

/// What became of lower levels of detail that have values at their vertices.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub struct LodSummary {
    /// Instances.
    pub instances: u64,
    /// Their vertices.
    pub vertices: u64,
    /// Their faces.
    pub faces: u64,
    /// Points at which the full detail was read.
    pub samples: u64,
    /// Of these, those that found nothing to read.
    pub invalid: u64,
    /// Rays that read.
    pub rays: u64,
}

/// One model of trees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelSummary {
    /// Name of the mesh.
    pub mesh: String,
    /// Its instances that have numbers.
    pub instances: u64,
    /// They were fitted to what was traced at points on their own surface, not to the volume around them.
    pub traced: bool,
    /// Errors against what they were fitted to, for each channel.
    pub errors: Vec<crate::TreeErrors>,
    /// The same for each instance, by the name of its node.
    pub nodes: Vec<NodeErrors>,
}

/// Errors of one instance of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeErrors {
    /// Name of the node.
    pub node: String,
    /// For each channel.
    pub errors: Vec<crate::TreeErrors>,
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
