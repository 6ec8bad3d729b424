//! An imported level: a manifest of mesh digests, the instance table and the resolved settings.

use crate::{Bounds, Class, Digest, Fog, OutputSettings, Regions, Sampling, SolveSettings};
use glam::{DAffine3, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A level as imported. Its digest names everything that the bake depends on, but for the lane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// World position of the local origin, metres, each coordinate a multiple of 1,024 m. Instance
    /// transforms lead to coordinates relative to it.
    pub origin_m: DVec3,
    /// Bounds of all that occludes or receives, relative to the origin.
    pub bounds: Bounds,
    /// The distinct meshes, by digest.
    pub meshes: Vec<MeshEntry>,
    /// The instance table, in the order of the node hierarchy.
    pub instances: Vec<Instance>,
    /// Where moving objects are lit.
    pub regions: Regions,
    /// How samples are made and traced.
    pub sampling: Sampling,
    /// How vertex values are found.
    pub solve: SolveSettings,
    /// What is written.
    pub output: OutputSettings,
    /// What import found worth saying, with counts.
    pub warnings: Vec<Warning>,
    /// Totals for reports.
    pub counts: LevelCounts,
}

/// One distinct mesh of a level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeshEntry {
    /// Digest of the encoded [`crate::Mesh`].
    pub digest: Digest,
    /// Name in the source, or `mesh N`.
    pub name: String,
    /// Vertices of the mesh.
    pub vertex_count: u32,
    /// Faces after cleaning.
    pub face_count: u32,
    /// Faces that cleaning left out because they repeat others.
    pub duplicate_faces: u32,
    /// Object-space bounds.
    pub bounds: Bounds,
    /// Where the origin of Kiln's object space is in the file's.
    pub center: DVec3,
    /// Index of the mesh in the source file.
    pub source_mesh: u32,
    /// Where each block of vertices comes from.
    pub blocks: Vec<VertexBlock>,
}

/// A run of vertices that comes from one POSITION accessor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VertexBlock {
    /// First vertex of the block in [`crate::Mesh::positions`].
    pub first_vertex: u32,
    /// Number of vertices.
    pub vertex_count: u32,
    /// Indices of the source mesh's primitives that use the accessor and get the block's values.
    pub primitives: Vec<u32>,
}

/// One placement of a mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// Name of the node, or `node N`; with `[i]` for an instance of EXT_mesh_gpu_instancing.
    pub name: String,
    /// Index into [`Level::meshes`].
    pub mesh: u32,
    /// Index of the node in the source file.
    pub node: u32,
    /// Index within the node's EXT_mesh_gpu_instancing, if it has one.
    pub gpu_instance: Option<u32>,
    /// From object space to metres relative to the level's origin.
    pub world_from_object: DAffine3,
    /// Whether the instance gets values of its own (`--only` may leave it out; it still occludes).
    pub receives: bool,
    /// What it gets, if it receives.
    pub gets: Gets,
    /// The fog that stands for its shrub, if it has one.
    pub fog: Option<Fog>,
    /// If it is a lower level of detail, the instances of the full detail that it stands for, ascending; else none. It is
    /// drawn in their place only: it stops no rays, and nothing is traced for it.
    pub lod_of: Vec<u32>,
}

/// What an instance gets from a bake.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub enum Gets {
    /// Values at its own vertices.
    #[default]
    Vertices,
    /// Numbers of its own by which the local AO of its model is multiplied: it has a tree. They are fitted to the volume
    /// around trees.
    Global,
    /// Likewise, but fitted to what is traced at points on its own surface.
    GlobalTraced,
    /// One number: it is made of shrubs and decorators only.
    Scalar,
}

impl Gets {
    /// Whether it is numbers by which the local AO of the model is multiplied.
    pub const fn is_global(self) -> bool {
        matches!(self, Self::Global | Self::GlobalTraced)
    }
}

impl Instance {
    /// Whether it is a lower level of detail of others.
    pub fn is_lod(&self) -> bool {
        !self.lod_of.is_empty()
    }

    /// Whether the transform mirrors, and so turns the winding of faces.
    pub fn is_mirrored(&self) -> bool {
        self.world_from_object.matrix3.determinant() < 0.0
    }

    /// Whether the transform flattens the mesh to a plane, a line or a point: it then has no surface that
    /// could be sampled or hit.
    pub fn is_flat(&self) -> bool {
        let m = self.world_from_object.matrix3;
        let scale = m.x_axis.length().max(m.y_axis.length()).max(m.z_axis.length());
        !self.world_from_object.is_finite() || m.determinant().abs() <= 1e-15 * scale.powi(3) || scale == 0.0
    }
}

/// Something worth saying that does not stop the bake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Stable identifier, such as `degenerate_faces`.
    pub code: String,
    /// What it is about: a file, node, mesh or material.
    pub subject: String,
    /// The sentence for a person, with the count and what follows.
    pub message: String,
    /// How many times.
    pub count: u64,
}

/// Totals of a level.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub struct LevelCounts {
    /// Distinct meshes.
    pub meshes: u64,
    /// Instances.
    pub instances: u64,
    /// Vertices over all instances.
    pub vertices: u64,
    /// Faces over all instances, after cleaning.
    pub faces: u64,
    /// Faces over distinct meshes, after cleaning.
    pub unique_faces: u64,
    /// Faces over all instances for each class.
    pub classes: BTreeMap<Class, u64>,
    /// Instances that are lower levels of detail, which count nowhere else.
    pub lod_instances: u64,
    /// Their vertices.
    pub lod_vertices: u64,
    /// Their faces.
    pub lod_faces: u64,
}
