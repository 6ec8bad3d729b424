//! Trees and instanced objects, four numbers for each channel; shrubs and decorators, one.

use super::{
    Pack, Values,
    vertices::{key, optional},
};
use crate::{
    bytes::{f32_at, floats_at, u32_at, u64_at},
    format::{NONE, SectionKind, scalar, tree_block, tree_instance, tree_model},
    remap::unit,
};

/// AO of a vertex of a tree, 0 to 1: its local AO times `y0 + y1 u + y2 v + y3 w` (Sloan et al. 2013, section 2.2). `place` is
/// [`TreeModel::place`].
#[inline]
pub fn tree_ao(local: f32, [y0, y1, y2, y3]: [f32; 4], [u, v, w]: [f32; 3]) -> f32 {
    unit(local * (y0 + y1 * u + y2 * v + y3 * w))
}

/// A model that trees or instanced objects share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeModel {
    /// Index of the mesh in the source's glTF.
    pub mesh: u32,
    /// Centre of the box that places are in, metres in the mesh's own space.
    pub center: [f32; 3],
    /// Half of the box's size, likewise.
    pub half_extent: [f32; 3],
    first_block: u32,
    block_count: u32,
}

impl TreeModel {
    /// Where a vertex is in the box, from −1 to 1 along each axis; 0 along one without extent. Metres in the mesh's space.
    #[inline]
    pub fn place(&self, position: [f32; 3]) -> [f32; 3] {
        core::array::from_fn(|i| {
            let half = self.half_extent[i];
            if half > 0.0 { ((position[i] - self.center[i]) / half).clamp(-1.0, 1.0) } else { 0.0 }
        })
    }

    /// How many primitives have local AO.
    pub const fn block_count(&self) -> u32 {
        self.block_count
    }

    /// Indices of the first block and of the one after the last.
    pub(super) fn blocks(&self) -> (u64, u64) {
        (u64::from(self.first_block), u64::from(self.first_block) + u64::from(self.block_count))
    }

    pub(super) fn parse(record: &[u8]) -> Self {
        Self {
            mesh: u32_at(record, tree_model::MESH),
            center: floats_at(record, tree_model::CENTER),
            half_extent: floats_at(record, tree_model::HALF_EXTENT),
            first_block: u32_at(record, tree_model::FIRST_BLOCK),
            block_count: u32_at(record, tree_model::BLOCK_COUNT),
        }
    }
}

/// Local AO of a primitive of a model.
#[derive(Clone, Copy, Debug)]
pub struct TreeBlock<'a> {
    /// Index of the primitive in the model's mesh.
    pub primitive: u32,
    /// Local AO of its vertices.
    pub values: Values<'a>,
}

/// One instance of a model.
#[derive(Clone, Copy, Debug)]
pub struct TreeInstance<'a> {
    /// Index of the node in the source's glTF.
    pub node: u32,
    /// Index within the node's EXT_mesh_gpu_instancing, if it has one.
    pub gpu_instance: Option<u32>,
    /// Index of its model.
    pub model: u32,
    /// Numbers of the channels and of their blend.
    numbers: &'a [u8],
    channels: usize,
}

impl<'a> TreeInstance<'a> {
    /// The four numbers of a channel.
    #[inline]
    pub fn numbers(&self, channel: usize) -> Option<[f32; 4]> {
        (channel < self.channels).then(|| floats_at(self.numbers, 16 * channel))
    }

    /// The four numbers that were fitted to the blend of the channels.
    #[inline]
    pub fn blend(&self) -> [f32; 4] {
        floats_at(self.numbers, 16 * self.channels)
    }

    pub(super) fn parse(record: &'a [u8], channels: usize) -> Self {
        Self {
            node: u32_at(record, tree_instance::NODE),
            gpu_instance: optional(u32_at(record, tree_instance::GPU_INSTANCE)),
            model: u32_at(record, tree_instance::MODEL),
            numbers: record.get(tree_instance::NUMBERS..).unwrap_or_default(),
            channels,
        }
    }
}

/// A shrub or a decorator.
#[derive(Clone, Copy, Debug)]
pub struct Scalar<'a> {
    /// Index of the node in the source's glTF.
    pub node: u32,
    /// Index within the node's EXT_mesh_gpu_instancing, if it has one.
    pub gpu_instance: Option<u32>,
    values: &'a [u8],
    channels: usize,
}

impl<'a> Scalar<'a> {
    /// Its AO in a channel, 0 to 1.
    #[inline]
    pub fn ao(&self, channel: usize) -> Option<f32> {
        (channel < self.channels).then(|| unit(f32_at(self.values, 4 * channel)))
    }

    /// The blend of its channels, by weights whose sum is 1.
    pub fn blend(&self, weights: &[f32]) -> f32 {
        let blend: f32 = weights.iter().enumerate().filter_map(|(i, weight)| Some(weight * self.ao(i)?)).sum();
        unit(blend)
    }

    pub(super) fn parse(record: &'a [u8], channels: usize) -> Self {
        Self {
            node: u32_at(record, scalar::NODE),
            gpu_instance: optional(u32_at(record, scalar::GPU_INSTANCE)),
            values: record.get(scalar::VALUES..).unwrap_or_default(),
            channels,
        }
    }
}

impl<'a> Pack<'a> {
    /// A model of trees by its index.
    pub fn tree_model(&self, index: u32) -> Option<TreeModel> {
        self.sections.get(SectionKind::TreeModels).record(index).map(TreeModel::parse)
    }

    /// Local AO of a model's primitive: the `index`-th that has some.
    pub fn tree_block(&self, model: &TreeModel, index: u32) -> Option<TreeBlock<'a>> {
        let index = (index < model.block_count).then(|| model.first_block.checked_add(index))??;
        self.tree_block_at(index)
    }

    pub(super) fn tree_block_at(&self, index: u32) -> Option<TreeBlock<'a>> {
        let record = self.sections.get(SectionKind::TreeBlocks).record(index)?;
        let [count, format] = [tree_block::VERTEX_COUNT, tree_block::FORMAT].map(|at| u32_at(record, at));
        let values = Values::find(&self.sections, u64_at(record, tree_block::FIRST), count, format, self.channels())?;
        Some(TreeBlock { primitive: u32_at(record, tree_block::PRIMITIVE), values })
    }

    /// An instance of a model by its index; they are in the order of nodes and instances.
    pub fn tree_instance_at(&self, index: u32) -> Option<TreeInstance<'a>> {
        let record = self.sections.get(SectionKind::TreeInstances).record(index)?;
        Some(TreeInstance::parse(record, self.channels()))
    }

    /// The instance of a model at a node, in a time that grows with the logarithm of their number.
    pub fn tree_instance(&self, node: u32, gpu_instance: Option<u32>) -> Option<TreeInstance<'a>> {
        self.tree_instance_at(self.find(SectionKind::TreeInstances, node, gpu_instance)?)
    }

    /// A shrub or decorator by its index; they are in the order of nodes and instances.
    pub fn scalar_at(&self, index: u32) -> Option<Scalar<'a>> {
        let record = self.sections.get(SectionKind::Scalars).record(index)?;
        Some(Scalar::parse(record, self.channels()))
    }

    /// The shrub or decorator at a node, in a time that grows with the logarithm of their number.
    pub fn scalar(&self, node: u32, gpu_instance: Option<u32>) -> Option<Scalar<'a>> {
        self.scalar_at(self.find(SectionKind::Scalars, node, gpu_instance)?)
    }

    fn find(&self, kind: SectionKind, node: u32, gpu_instance: Option<u32>) -> Option<u32> {
        let wanted = [node, gpu_instance.unwrap_or(NONE)];
        self.sections.get(kind).search(|record| key(record).cmp(&wanted))
    }
}
