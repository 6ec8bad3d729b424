//! Values of vertices.

use super::{Pack, sections::Sections};
use crate::{
    bytes::{f32_at, u16_at, u32_at, u64_at},
    format::{NONE, SectionKind, VALUES_ARE_F32, VALUES_ARE_U16, vertex_set},
    remap::unit,
};

/// Values of some vertices: vertex by vertex, in it channel by channel, in the order of the source's POSITION accessor.
#[derive(Clone, Copy, Debug)]
pub struct Values<'a> {
    bytes: &'a [u8],
    channels: usize,
    is_f32: bool,
}

impl<'a> Values<'a> {
    /// Number of vertices.
    pub const fn vertex_count(&self) -> usize {
        self.bytes.len() / (self.channels * if self.is_f32 { 4 } else { 2 })
    }

    /// Whether they are 32-bit floats; else normalised 16-bit integers, of which 65,535 is 1.
    pub const fn is_f32(&self) -> bool {
        self.is_f32
    }

    /// As they are stored, for a vertex buffer.
    pub const fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// AO of a vertex in a channel, 0 to 1. A float that is not a number is 0.
    #[inline]
    pub fn get(&self, vertex: usize, channel: usize) -> Option<f32> {
        if channel >= self.channels || vertex >= self.vertex_count() {
            return None;
        }
        let index = vertex * self.channels + channel;
        let value = if self.is_f32 {
            f32_at(self.bytes, 4 * index)
        } else {
            f32::from(u16_at(self.bytes, 2 * index)) / f32::from(u16::MAX)
        };
        Some(unit(value))
    }

    /// From a record's fields: index of the first number, number of vertices, format.
    pub(super) fn find(
        sections: &Sections<'a>,
        first: u64,
        vertex_count: u32,
        format: u32,
        channels: usize,
    ) -> Option<Self> {
        let (kind, size) = match format {
            VALUES_ARE_F32 => (SectionKind::ValuesF32, 4),
            VALUES_ARE_U16 => (SectionKind::ValuesU16, 2),
            _ => return None,
        };
        let start = usize::try_from(first).ok()?.checked_mul(size)?;
        let length = (vertex_count as usize).checked_mul(channels * size)?;
        let bytes = sections.get(kind).bytes().get(start..)?.get(..length)?;
        Some(Self { bytes, channels, is_f32: size == 4 })
    }
}

/// A primitive's vertices on one node, or on one instance of EXT_mesh_gpu_instancing, and their values. Lower levels of
/// detail are such too.
#[derive(Clone, Copy, Debug)]
pub struct VertexSet<'a> {
    /// Index of the node in the source's glTF.
    pub node: u32,
    /// Index within the node's EXT_mesh_gpu_instancing, if it has one.
    pub gpu_instance: Option<u32>,
    /// Index of the primitive in the node's mesh. Primitives that share an accessor share values.
    pub primitive: u32,
    /// AO of its vertices.
    pub values: Values<'a>,
}

impl<'a> VertexSet<'a> {
    /// From a record; none if it is wrong.
    pub(super) fn parse(sections: &Sections<'a>, record: &[u8], channels: usize) -> Option<Self> {
        let [count, format] = [vertex_set::VERTEX_COUNT, vertex_set::FORMAT].map(|at| u32_at(record, at));
        Some(Self {
            node: u32_at(record, vertex_set::NODE),
            gpu_instance: optional(u32_at(record, vertex_set::GPU_INSTANCE)),
            primitive: u32_at(record, vertex_set::PRIMITIVE),
            values: Values::find(sections, u64_at(record, vertex_set::FIRST), count, format, channels)?,
        })
    }
}

impl<'a> Pack<'a> {
    /// A vertex set by its index; they are in the order of nodes, instances and primitives.
    pub fn vertex_set_at(&self, index: u32) -> Option<VertexSet<'a>> {
        let record = self.sections.get(SectionKind::VertexSets).record(index)?;
        VertexSet::parse(&self.sections, record, self.channels())
    }

    /// The vertex set of a primitive, in a time that grows with the logarithm of their number.
    pub fn vertex_set(&self, node: u32, gpu_instance: Option<u32>, primitive: u32) -> Option<VertexSet<'a>> {
        let wanted = [node, gpu_instance.unwrap_or(NONE), primitive];
        let found = self.sections.get(SectionKind::VertexSets).search(|record| key(record).cmp(&wanted))?;
        self.vertex_set_at(found)
    }
}

/// By what vertex sets are ordered; trees and scalars by the first two.
pub(super) fn key<const N: usize>(record: &[u8]) -> [u32; N] {
    core::array::from_fn(|i| u32_at(record, 4 * i))
}

pub(super) const fn optional(index: u32) -> Option<u32> {
    if index == NONE { None } else { Some(index) }
}
