//! Why bytes are no pack.

use crate::format::{MAJOR, SectionKind};

/// Why [`crate::Pack::new`] refused bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PackError {
    /// They do not begin as a pack does.
    #[error(
        "this is no Kiln pack: it does not begin with a pack's signature; give the .kiln file of a bake, copied in binary mode"
    )]
    NotAPack,
    /// The pack is of a format that this reader does not know.
    #[error(
        "the pack has format version {major}.{minor}, and this runtime reads {MAJOR}.x: build the engine with the runtime of the \
         Kiln that baked, or bake with the Kiln of this runtime"
    )]
    Version {
        /// Its major version.
        major: u16,
        /// Its minor version.
        minor: u16,
    },
    /// There are fewer bytes than there should be.
    #[error("the pack is cut off: {actual} bytes of {stated}; copy or bake it again")]
    CutOff {
        /// Bytes that it says it has, or that a header takes.
        stated: u64,
        /// Bytes that there are.
        actual: u64,
    },
    /// A number in the header cannot be.
    #[error("the pack is damaged: its header's {field} is {value}; copy or bake it again")]
    Header {
        /// What the number is.
        field: &'static str,
        /// The number.
        value: u64,
    },
    /// A section cannot be where or what it says it is.
    #[error("the pack is damaged: its section {index} (kind {kind}) {problem}; copy or bake it again")]
    Section {
        /// Index in the section table.
        index: u32,
        /// Number of its kind.
        kind: u32,
        /// What is wrong.
        problem: &'static str,
    },
    /// The pack cannot be understood without a section that this reader does not know.
    #[error(
        "the pack needs sections of kind {kind}, which this runtime (format {MAJOR}.{}) does not know: build the engine with the \
         runtime of the Kiln that baked",
        crate::format::MINOR
    )]
    UnknownRequired {
        /// Number of the kind.
        kind: u32,
    },
    /// A section that must be there is not.
    #[error("the pack is damaged: it has no section {:?}; copy or bake it again", kind.name())]
    Missing {
        /// Its kind.
        kind: SectionKind,
    },
    /// A record holds what cannot be.
    #[error("the pack is damaged: record {index} of its section {:?} has {problem}; copy or bake it again", kind.name())]
    Record {
        /// Kind of its section.
        kind: SectionKind,
        /// Index of the record.
        index: u32,
        /// What it has.
        problem: &'static str,
    },
}
