//! The pack: bytes that were checked once, and views of what is in them.

mod check;
mod meta;
mod regions;
mod sections;
mod trees;
mod vertices;

pub use meta::{Kernel, Meta};
#[cfg(feature = "write")]
pub(crate) use regions::volume;
pub use regions::{Region, RegionEdge};
pub use sections::SectionSize;
pub use trees::{Scalar, TreeBlock, TreeInstance, TreeModel, tree_ao};
pub use vertices::{Values, VertexSet};

use crate::{PackError, format::MAX_CHANNELS, format::SectionKind};
use sections::Sections;

/// A pack's bytes, checked. Views of what is in it borrow the bytes, not the pack.
///
/// Checking reads all of it but values of vertices, which go to the graphics card as they are. Nothing is allocated, and
/// afterwards nothing fails: indices of what is not there give `None`.
#[derive(Clone, Debug)]
pub struct Pack<'a> {
    sections: Sections<'a>,
    strings: &'a str,
    meta: Meta<'a>,
}

impl<'a> Pack<'a> {
    /// Checks the bytes of a pack. They may go on beyond its end.
    ///
    /// # Errors
    /// [`PackError`]: they are no pack, one that this reader cannot read, or a damaged one.
    pub fn new(bytes: &'a [u8]) -> Result<Self, PackError> {
        let sections = Sections::parse(bytes)?;
        let strings = check::strings(&sections)?;
        let meta = Meta::parse(&sections, strings)?;
        let pack = Self { sections, strings, meta };
        pack.check()?;
        Ok(pack)
    }

    /// What was baked, and how.
    pub const fn meta(&self) -> &Meta<'a> {
        &self.meta
    }

    /// Number of channels (half-distances), 1 to [`MAX_CHANNELS`].
    pub const fn channels(&self) -> usize {
        self.meta.channels()
    }

    /// Minor version of the format that it was written in.
    pub const fn minor_version(&self) -> u16 {
        self.sections.minor
    }

    /// Size, bytes.
    pub const fn size_bytes(&self) -> usize {
        self.sections.bytes.len()
    }

    /// What it holds, and how large that is, in the order in which it is there; kinds that this version does not know too.
    pub fn sizes(&self) -> impl Iterator<Item = SectionSize> + use<'a> {
        self.sections.sizes()
    }

    /// Records of a kind.
    pub fn count(&self, kind: SectionKind) -> usize {
        self.sections.get(kind).count()
    }

    /// All bytes of a kind's records, and the size of each, for an engine that uploads them as they are.
    pub fn records(&self, kind: SectionKind) -> (&'a [u8], usize) {
        let table = self.sections.get(kind);
        (table.bytes(), table.stride())
    }
}

/// One value of a value for each channel, by weights whose sum is 1 ([`Meta::blend`]).
#[inline]
pub fn blend_channels(values: &[f32], weights: &[f32]) -> f32 {
    values.iter().zip(weights).map(|(value, weight)| value * weight).sum()
}

/// Numbers for each channel, without an allocation.
pub(crate) type Channels = [f32; MAX_CHANNELS];
