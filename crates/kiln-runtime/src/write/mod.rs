//! Writing packs: plain data in, bytes out, the same bytes for the same data.

mod data;
mod records;
mod sections;

pub use data::{
    EdgeData, MetaData, ModelData, ModelForms, PackData, RegionData, RegionsData, RemapData, ScalarData, TreeBlockData,
    TreeInstanceData, TreeModelData, ValueData, VertexSetData,
};

use crate::{Pack, PackError, SectionKind, format::MAX_CHANNELS};
use alloc::vec::Vec;

/// Why data cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// There are no channels, or more than a pack holds.
    #[error("a pack holds 1 to {MAX_CHANNELS} channels, not {channels}")]
    Channels {
        /// How many there are.
        channels: usize,
    },
    /// A list has another length than it must.
    #[error("{what} {index} has {found} numbers in place of {expected}")]
    Size {
        /// What has it.
        what: &'static str,
        /// Its index in its list.
        index: usize,
        /// How many numbers there are.
        found: usize,
        /// How many there must be.
        expected: usize,
    },
    /// A coefficient is too large for half floats.
    #[error(
        "region model {model} has a coefficient beyond ±65504, which half floats cannot hold; write it in full form alone"
    )]
    Half {
        /// Index of the model.
        model: usize,
    },
    /// A list is too long for 32-bit indices.
    #[error("the pack would have more than 2³² {}", kind.name())]
    TooMany {
        /// Kind of the records.
        kind: SectionKind,
    },
    /// What was written is no pack that a reader takes: numbers are not finite, indices do not exist, or things come twice.
    #[error("what would be written is not what a reader takes: {0}")]
    Refused(PackError),
}

/// The bytes of a pack.
///
/// Vertex sets, instances of trees and scalars may come in any order; they are sorted. Everything else keeps its order, so
/// that indices hold.
///
/// # Errors
/// [`WriteError`].
pub fn write(data: &PackData<'_>) -> Result<Vec<u8>, WriteError> {
    let bytes = sections::assemble(records::sections(data)?)?;
    Pack::new(&bytes).map_err(WriteError::Refused)?;
    Ok(bytes)
}
