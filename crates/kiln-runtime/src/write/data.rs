//! What is written, as plain data.

use crate::{Kernel, format::PARAMETERS};
use alloc::{borrow::Cow, string::String, vec::Vec};

/// Everything that a bake makes. Metres are relative to the level's origin, AO is from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct PackData<'a> {
    /// What was baked, and how.
    pub meta: MetaData,
    /// Values of vertices, of lower levels of detail too.
    pub vertex_sets: Vec<VertexSetData<'a>>,
    /// Models of trees and instanced objects.
    pub tree_models: Vec<TreeModelData<'a>>,
    /// Their instances.
    pub tree_instances: Vec<TreeInstanceData>,
    /// Shrubs and decorators.
    pub scalars: Vec<ScalarData>,
    /// Visibility regions; empty in a level without.
    pub regions: RegionsData,
}

impl PackData<'_> {
    /// A pack of nothing.
    pub const fn new(meta: MetaData) -> Self {
        let regions = RegionsData {
            regions: Vec::new(),
            edges: Vec::new(),
            models: Vec::new(),
            forms: ModelForms { full: true, engine: true },
        };
        Self {
            meta,
            vertex_sets: Vec::new(),
            tree_models: Vec::new(),
            tree_instances: Vec::new(),
            scalars: Vec::new(),
            regions,
        }
    }
}

/// What was baked, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct MetaData {
    /// Digest of the level as imported.
    pub level_digest: [u8; 32],
    /// Version of the Kiln that baked.
    pub version: String,
    /// Where points are relative to, metres in the level's own coordinates.
    pub origin: [f64; 3],
    /// What a ray is worth.
    pub kernel: Kernel,
    /// Half-distance of each channel, metres, 1 to 4; of [`Kernel::Occlusion`] the one distance.
    pub half_distances: Vec<f32>,
    /// Weight of each channel in the blend, from 0; their sum need not be 1.
    pub blend: Vec<f32>,
    /// The curve over the blend.
    pub remap: RemapData,
}

/// A curve over AO.
#[derive(Clone, Debug, PartialEq, Default)]
pub enum RemapData {
    /// None.
    #[default]
    None,
    /// `ao^gamma`.
    Gamma(f32),
    /// Piecewise linear through (input, output) points with rising inputs, 1 to 4,096.
    Curve(Vec<[f32; 2]>),
}

/// Numbers of vertices, `vertices × channels`.
#[derive(Clone, Debug, PartialEq)]
pub enum ValueData<'a> {
    /// 32-bit floats.
    F32(Cow<'a, [f32]>),
    /// Normalised 16-bit integers: 65,535 is 1.
    U16(Cow<'a, [u16]>),
}

impl ValueData<'_> {
    /// As normalised 16-bit integers, the nearest. What is not from 0 to 1 is at its end, NaN is 0.
    pub fn normalised(values: &[f32]) -> Self {
        let scaled = |value: &f32| libm::roundf(value.clamp(0.0, 1.0) * f32::from(u16::MAX)) as u16;
        Self::U16(Cow::Owned(values.iter().map(scaled).collect()))
    }

    /// How many numbers.
    pub fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::U16(values) => values.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Values of the vertices of one POSITION accessor on one instance.
#[derive(Clone, Debug, PartialEq)]
pub struct VertexSetData<'a> {
    /// Index of the node in the source.
    pub node: u32,
    /// Index within the node's EXT_mesh_gpu_instancing, if it has one.
    pub gpu_instance: Option<u32>,
    /// Indices of the mesh's primitives that use the accessor.
    pub primitives: Vec<u32>,
    /// Their values.
    pub values: ValueData<'a>,
}

/// A model of trees or instanced objects.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeModelData<'a> {
    /// Index of the mesh in the source.
    pub mesh: u32,
    /// Centre of its box, metres in the mesh's own space.
    pub center: [f32; 3],
    /// Half of the box's size, likewise.
    pub half_extent: [f32; 3],
    /// Local AO, accessor by accessor.
    pub blocks: Vec<TreeBlockData<'a>>,
}

/// Local AO of the vertices of one POSITION accessor.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeBlockData<'a> {
    /// Indices of the mesh's primitives that use the accessor.
    pub primitives: Vec<u32>,
    /// Their values.
    pub values: ValueData<'a>,
}

/// An instance of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeInstanceData {
    /// Index of the node in the source.
    pub node: u32,
    /// Index within the node's EXT_mesh_gpu_instancing, if it has one.
    pub gpu_instance: Option<u32>,
    /// Index into [`PackData::tree_models`].
    pub model: u32,
    /// Four numbers for each channel.
    pub numbers: Vec<[f32; 4]>,
    /// Those that were fitted to the blend.
    pub blend: [f32; 4],
}

/// A shrub or decorator.
#[derive(Clone, Debug, PartialEq)]
pub struct ScalarData {
    /// Index of the node in the source.
    pub node: u32,
    /// Index within the node's EXT_mesh_gpu_instancing, if it has one.
    pub gpu_instance: Option<u32>,
    /// AO in each channel.
    pub values: Vec<f32>,
}

/// Visibility regions and their models.
#[derive(Clone, Debug, PartialEq)]
pub struct RegionsData {
    /// All regions of the level, absorbed ones too.
    pub regions: Vec<RegionData>,
    /// Which of them touch, each pair once.
    pub edges: Vec<EdgeData>,
    /// The models.
    pub models: Vec<ModelData>,
    /// In which forms the models are written.
    pub forms: ModelForms,
}

/// In which forms models are written: at least one where there are models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelForms {
    /// Quadratic harmonics of all channels, floats: 16 + 252 bytes for each channel.
    pub full: bool,
    /// Linear harmonics of the blend, half floats: 68 bytes.
    pub engine: bool,
}

/// A region.
#[derive(Clone, Debug, PartialEq)]
pub struct RegionData {
    /// What the level's author calls it.
    pub id: String,
    /// Its box's lowest corner.
    pub min: [f32; 3],
    /// Its box's highest corner.
    pub max: [f32; 3],
    /// Index into [`RegionsData::models`]: its own model's, or that of the neighbour that absorbed it.
    pub model: u32,
}

/// Two regions that touch or overlap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeData {
    /// Indices into [`RegionsData::regions`].
    pub regions: [u32; 2],
    /// Area of their boundary, square metres.
    pub area_m2: f32,
    /// Its centre.
    pub center: [f32; 3],
}

/// A region's model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelData {
    /// Index into [`RegionsData::regions`] of the region that it was fitted to.
    pub region: u32,
    /// c.
    pub center: [f32; 3],
    /// For each channel and harmonic (nine a channel): the mean, then slopes per metre to +x, −x, +y, −y, +z and −z.
    pub coefficients: Vec<[f32; PARAMETERS]>,
}
