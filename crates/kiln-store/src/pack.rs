//! The format of packs: many artefacts, and the results that name them, in one file.
//!
//! ```text
//! "KILNPACK"  version u32  table length u32  table  BLAKE3 of all before (32 bytes)  artefacts, one after the other
//! ```
//! Integers are little-endian; the table is postcard. It stands first, so that a pack can be written while an upload
//! comes in, and its digest names the file: equal contents make the same pack.

use kiln_core::{Digest, TaskKey, codec};
use serde::{Deserialize, Serialize};
use std::io::{self, Read};

const MAGIC: &[u8; 8] = b"KILNPACK";
const VERSION: u32 = 1;
const FIXED: usize = 16;
const CHECK: usize = 32;

/// What a pack holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Default)]
pub(crate) struct PackTable {
    /// Digest and size of each artefact, in order.
    pub(crate) entries: Vec<(Digest, u64)>,
    /// Results; their artefacts may be in other packs.
    pub(crate) results: Vec<(TaskKey, Digest)>,
}

/// The first bytes of a pack.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PackHeader {
    /// Names the pack: the digest of the header.
    pub(crate) name: Digest,
    /// The header as it is written.
    pub(crate) bytes: Vec<u8>,
    /// What it says.
    pub(crate) table: PackTable,
}

/// Why a pack's header cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PackError {
    #[error("it is not a pack, or its header is damaged")]
    Damaged,
    #[error("it is of format {0}, which this kiln does not know")]
    Newer(u32),
    #[error("it cannot be read: {0}")]
    Io(#[from] io::Error),
}

impl PackHeader {
    /// The header for a table; none if the table is too long for the format (4 GiB).
    pub(crate) fn new(table: PackTable) -> Option<Self> {
        let encoded = codec::encode(&table);
        let mut bytes = Vec::with_capacity(FIXED + encoded.len() + CHECK);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&u32::try_from(encoded.len()).ok()?.to_le_bytes());
        bytes.extend_from_slice(&encoded);
        let name = Digest::of(&bytes);
        bytes.extend_from_slice(name.as_bytes());
        Some(Self { name, bytes, table })
    }

    /// Reads the header at the start of a file of `file_bytes`; nothing larger than the file is allocated.
    pub(crate) fn read(source: &mut impl Read, file_bytes: u64) -> Result<Self, PackError> {
        let mut bytes = vec![0; FIXED];
        source.read_exact(&mut bytes).map_err(damaged_if_short)?;
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        if &bytes[..8] != MAGIC {
            return Err(PackError::Damaged);
        }
        let (version, rest) = (word(8), word(12) as usize + CHECK);
        if (FIXED + rest) as u64 > file_bytes {
            return Err(PackError::Damaged);
        }
        bytes.resize(FIXED + rest, 0);
        source.read_exact(&mut bytes[FIXED..]).map_err(damaged_if_short)?;
        let (content, check) = bytes.split_at(bytes.len() - CHECK);
        let name = Digest::of(content);
        if name.as_bytes() != check {
            return Err(PackError::Damaged);
        }
        if version != VERSION {
            return Err(PackError::Newer(version));
        }
        let table = codec::decode("a pack's table", &content[FIXED..]).map_err(|_| PackError::Damaged)?;
        Ok(Self { name, bytes, table })
    }

    /// Bytes of the whole pack; none if the sizes add up to more than any file has.
    pub(crate) fn pack_bytes(&self) -> Option<u64> {
        self.table.entries.iter().try_fold(self.bytes.len() as u64, |sum, (_, len)| sum.checked_add(*len))
    }

    /// Digest, offset and size of each artefact that lies within a file of `file_bytes`.
    pub(crate) fn locations(&self, file_bytes: u64) -> impl Iterator<Item = (Digest, u64, u64)> {
        let mut offset = Some(self.bytes.len() as u64);
        self.table.entries.iter().map_while(move |&(digest, len)| {
            let start = offset?;
            offset = start.checked_add(len).filter(|&end| end <= file_bytes);
            offset.map(|_| (digest, start, len))
        })
    }
}

fn damaged_if_short(error: io::Error) -> PackError {
    if error.kind() == io::ErrorKind::UnexpectedEof { PackError::Damaged } else { PackError::Io(error) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn table() -> PackTable {
        let digest = |text: &str| Digest::of(text.as_bytes());
        PackTable {
            entries: vec![(digest("a"), 5), (digest("b"), 0), (digest("c"), 7)],
            results: vec![(TaskKey(digest("key")), digest("a"))],
        }
    }

    #[test]
    fn written_and_read() {
        let header = PackHeader::new(table()).unwrap();
        let mut file = header.bytes.clone();
        file.extend_from_slice(&[0; 12]);
        let back = PackHeader::read(&mut file.as_slice(), file.len() as u64).unwrap();
        assert_eq!(back, header);
        let end = header.pack_bytes().unwrap();
        let start = header.bytes.len() as u64;
        let offsets: Vec<u64> = header.locations(end).map(|(_, offset, _)| offset).collect();
        assert_eq!(offsets, [start, start + 5, start + 5]);
        assert_eq!(header.locations(end - 1).count(), 2, "an artefact beyond the end is not there");
    }

    #[test]
    fn sizes_that_overflow_are_not_believed() {
        let table = PackTable { entries: vec![(Digest::of(b"x"), u64::MAX), (Digest::of(b"y"), 9)], results: vec![] };
        let header = PackHeader::new(table).unwrap();
        assert_eq!(header.pack_bytes(), None);
        assert_eq!(header.locations(1 << 40).count(), 0);
    }

    proptest! {
        #[test]
        fn any_change_is_noticed(at in 0usize..10_000, bit in 0u8..8) {
            let header = PackHeader::new(table()).unwrap();
            let mut bytes = header.bytes.clone();
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            prop_assert!(PackHeader::read(&mut bytes.as_slice(), bytes.len() as u64).is_err());
        }

        #[test]
        fn any_bytes_are_survived(mut bytes in proptest::collection::vec(any::<u8>(), 0..200), claim in 0u64..1000) {
            let _ = PackHeader::read(&mut bytes.as_slice(), claim);
            let head = MAGIC.len().min(bytes.len());
            bytes[..head].copy_from_slice(&MAGIC[..head]);
            let _ = PackHeader::read(&mut bytes.as_slice(), claim);
        }
    }
}
