//! The layout of a pack: docs/pack-format.md in numbers. The reader and the writer have it from here.

/// First bytes of a pack: like PNG's, they tell a copy in text mode from a damaged file.
pub const SIGNATURE: [u8; 8] = *b"\x89KILN\r\n\x1a";

/// Packs of another major version are refused.
pub const MAJOR: u16 = 1;

/// Newer minor versions append fields and add kinds of sections, which older readers pass over.
pub const MINOR: u16 = 0;

/// Size of the header; a newer one may be larger.
pub const HEADER_BYTES: usize = 64;

/// Size of an entry of the section table; a newer one may be larger.
pub const ENTRY_BYTES: usize = 32;

/// Sections begin at multiples of this.
pub const ALIGNMENT: usize = 16;

/// Sections at most.
pub const MAX_SECTIONS: u32 = 1024;

/// Channels (half-distances) at most.
pub const MAX_CHANNELS: usize = 4;

/// Points of a remap's curve at most.
pub const MAX_CURVE_POINTS: usize = 4096;

/// Coefficients of the quadratic spherical harmonics.
pub const HARMONICS: usize = 9;

/// Parameters of a model for each coefficient: the value at the centre, and slopes to +x, −x, +y, −y, +z and −z.
pub const PARAMETERS: usize = 7;

/// Index of what is not there: `gpu_instance` of a node without instances.
pub const NONE: u32 = u32::MAX;

/// Flag of a section: a reader that does not know its kind must refuse the pack.
pub const FLAG_REQUIRED: u32 = 1;

/// Values of vertices as 32-bit floats.
pub const VALUES_ARE_F32: u32 = 0;

/// Values of vertices as normalised 16-bit integers: 65,535 is 1.
pub const VALUES_ARE_U16: u32 = 1;

/// Kinds of sections that this version knows. Others are passed over: 32 to 47 are kept for fields, 48 to 63 for decals,
/// 64 to 79 for textures, from 2³¹ on for anybody's own use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum SectionKind {
    /// What was baked, and how: one record.
    Meta = 1,
    /// UTF-8 text that records refer to.
    Strings = 2,
    /// Which vertices have values, by node, instance and primitive.
    VertexSets = 3,
    /// Values of vertices, 32-bit floats.
    ValuesF32 = 4,
    /// Values of vertices, normalised 16-bit integers.
    ValuesU16 = 5,
    /// Models of trees and instanced objects.
    TreeModels = 6,
    /// Local AO of the models' primitives.
    TreeBlocks = 7,
    /// Four numbers for each channel of each instance of a model.
    TreeInstances = 8,
    /// One number for each channel of each shrub or decorator.
    Scalars = 9,
    /// Boxes of the visibility regions.
    Regions = 10,
    /// Regions beside each region.
    RegionNeighbours = 11,
    /// Boundaries of regions.
    RegionEdges = 12,
    /// Models of regions, all channels and harmonics.
    ModelsFull = 13,
    /// Models of regions, one function in linear harmonics, half floats.
    ModelsEngine = 14,
    /// Points of the remap's curve.
    RemapCurve = 15,
}

impl SectionKind {
    /// All of them, ascending.
    pub const ALL: [Self; 15] = [
        Self::Meta,
        Self::Strings,
        Self::VertexSets,
        Self::ValuesF32,
        Self::ValuesU16,
        Self::TreeModels,
        Self::TreeBlocks,
        Self::TreeInstances,
        Self::Scalars,
        Self::Regions,
        Self::RegionNeighbours,
        Self::RegionEdges,
        Self::ModelsFull,
        Self::ModelsEngine,
        Self::RemapCurve,
    ];

    /// The kind with a number, if this version knows it.
    pub fn of(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u32 == number)
    }

    /// What a person calls it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Meta => "meta",
            Self::Strings => "strings",
            Self::VertexSets => "vertex sets",
            Self::ValuesF32 => "values (f32)",
            Self::ValuesU16 => "values (u16)",
            Self::TreeModels => "tree models",
            Self::TreeBlocks => "tree blocks",
            Self::TreeInstances => "tree instances",
            Self::Scalars => "scalars",
            Self::Regions => "regions",
            Self::RegionNeighbours => "region neighbours",
            Self::RegionEdges => "region edges",
            Self::ModelsFull => "region models (full)",
            Self::ModelsEngine => "region models (engine)",
            Self::RemapCurve => "remap curve",
        }
    }

    /// Size of a record that has all fields this version knows, for so many channels.
    pub const fn record_bytes(self, channels: usize) -> usize {
        match self {
            Self::Meta => meta::BYTES,
            Self::Strings => 1,
            Self::VertexSets => vertex_set::BYTES,
            Self::ValuesF32 | Self::RegionNeighbours => 4,
            Self::ValuesU16 => 2,
            Self::TreeModels => tree_model::BYTES,
            Self::TreeBlocks => tree_block::BYTES,
            Self::TreeInstances => tree_instance::NUMBERS + 16 * (channels + 1),
            Self::Scalars => scalar::VALUES + 4 * channels,
            Self::Regions => region::BYTES,
            Self::RegionEdges => region_edge::BYTES,
            Self::ModelsFull => model_full::PARAMETERS + 4 * PARAMETERS * HARMONICS * channels,
            Self::ModelsEngine => model_engine::BYTES,
            Self::RemapCurve => 8,
        }
    }

    /// Whether its records are single numbers or bytes, whose size is fixed for good.
    pub(crate) const fn is_array(self) -> bool {
        matches!(self, Self::Strings | Self::ValuesF32 | Self::ValuesU16 | Self::RegionNeighbours)
    }
}

/// Offsets in the header.
pub mod header {
    /// u16.
    pub const MAJOR: usize = 8;
    /// u16.
    pub const MINOR: usize = 10;
    /// u32: where the section table begins.
    pub const HEADER_BYTES: usize = 12;
    /// u64: size of the pack.
    pub const PACK_BYTES: usize = 16;
    /// u32.
    pub const SECTION_COUNT: usize = 24;
    /// u32: size of an entry of the section table.
    pub const ENTRY_BYTES: usize = 28;
}

/// Offsets in an entry of the section table.
pub mod entry {
    /// u32.
    pub const KIND: usize = 0;
    /// u32.
    pub const FLAGS: usize = 4;
    /// u64: from the start of the pack.
    pub const OFFSET: usize = 8;
    /// u64: size of the section.
    pub const BYTES: usize = 16;
    /// u32: number of records.
    pub const COUNT: usize = 24;
    /// u32: size of a record.
    pub const STRIDE: usize = 28;
}

/// Offsets in the record of [`SectionKind::Meta`].
pub mod meta {
    /// 32 bytes.
    pub const LEVEL_DIGEST: usize = 0;
    /// f64 × 3.
    pub const ORIGIN: usize = 32;
    /// u32.
    pub const CHANNELS: usize = 56;
    /// u32: 0 obscurance, 1 occlusion.
    pub const KERNEL: usize = 60;
    /// f32 × 4.
    pub const HALF_DISTANCES: usize = 64;
    /// f32 × 4.
    pub const BLEND: usize = 80;
    /// u32 offset, u32 bytes in the strings.
    pub const VERSION: usize = 96;
    /// u32: 0 none, 1 gamma, 2 curve.
    pub const REMAP: usize = 104;
    /// f32.
    pub const GAMMA: usize = 108;
    /// Size.
    pub const BYTES: usize = 112;
}

/// Offsets in a record of [`SectionKind::VertexSets`].
pub mod vertex_set {
    /// u32.
    pub const NODE: usize = 0;
    /// u32.
    pub const GPU_INSTANCE: usize = 4;
    /// u32.
    pub const PRIMITIVE: usize = 8;
    /// u32.
    pub const VERTEX_COUNT: usize = 12;
    /// u64: index of the first number.
    pub const FIRST: usize = 16;
    /// u32.
    pub const FORMAT: usize = 24;
    /// Size.
    pub const BYTES: usize = 32;
}

/// Offsets in a record of [`SectionKind::TreeModels`].
pub mod tree_model {
    /// u32.
    pub const MESH: usize = 0;
    /// u32.
    pub const FIRST_BLOCK: usize = 4;
    /// u32.
    pub const BLOCK_COUNT: usize = 8;
    /// f32 × 3.
    pub const CENTER: usize = 16;
    /// f32 × 3.
    pub const HALF_EXTENT: usize = 32;
    /// Size.
    pub const BYTES: usize = 48;
}

/// Offsets in a record of [`SectionKind::TreeBlocks`].
pub mod tree_block {
    /// u32.
    pub const PRIMITIVE: usize = 0;
    /// u32.
    pub const VERTEX_COUNT: usize = 4;
    /// u64: index of the first number.
    pub const FIRST: usize = 8;
    /// u32.
    pub const FORMAT: usize = 16;
    /// Size.
    pub const BYTES: usize = 24;
}

/// Offsets in a record of [`SectionKind::TreeInstances`].
pub mod tree_instance {
    /// u32.
    pub const NODE: usize = 0;
    /// u32.
    pub const GPU_INSTANCE: usize = 4;
    /// u32.
    pub const MODEL: usize = 8;
    /// f32 × 4 for each channel, and for their blend.
    pub const NUMBERS: usize = 16;
}

/// Offsets in a record of [`SectionKind::Scalars`].
pub mod scalar {
    /// u32.
    pub const NODE: usize = 0;
    /// u32.
    pub const GPU_INSTANCE: usize = 4;
    /// f32 for each channel.
    pub const VALUES: usize = 8;
}

/// Offsets in a record of [`SectionKind::Regions`].
pub mod region {
    /// f32 × 3.
    pub const MIN: usize = 0;
    /// u32.
    pub const MODEL: usize = 12;
    /// f32 × 3.
    pub const MAX: usize = 16;
    /// u32 offset, u32 bytes in the strings.
    pub const ID: usize = 28;
    /// u32: index of the first neighbour.
    pub const FIRST_NEIGHBOUR: usize = 36;
    /// u32.
    pub const NEIGHBOUR_COUNT: usize = 40;
    /// u32: how many of the first neighbours overlap it and are smaller.
    pub const INNER_COUNT: usize = 44;
    /// Size.
    pub const BYTES: usize = 48;
}

/// Offsets in a record of [`SectionKind::RegionEdges`].
pub mod region_edge {
    /// u32 × 2.
    pub const REGIONS: usize = 0;
    /// f32.
    pub const AREA: usize = 8;
    /// f32 × 3.
    pub const CENTER: usize = 12;
    /// Size.
    pub const BYTES: usize = 24;
}

/// Offsets in a record of [`SectionKind::ModelsFull`].
pub mod model_full {
    /// f32 × 3.
    pub const CENTER: usize = 0;
    /// u32.
    pub const REGION: usize = 12;
    /// f32: parameter by parameter, in it channel by channel, in it harmonic by harmonic.
    pub const PARAMETERS: usize = 16;
}

/// Offsets in a record of [`SectionKind::ModelsEngine`].
pub mod model_engine {
    /// f32 × 3.
    pub const CENTER: usize = 0;
    /// f16: parameter by parameter, in it harmonic by harmonic.
    pub const PARAMETERS: usize = 12;
    /// Size.
    pub const BYTES: usize = 68;
}
