//! The GLB container (glTF 2.0, chapter 4): a header of 12 bytes and chunks, the first of which is the JSON and
//! the second, if there is one, the binary buffer. Numbers are little-endian, chunks are padded to 4 bytes.

const MAGIC: [u8; 4] = *b"glTF";
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;
const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");

/// A chunk of a kind that glTF 2.0 doesn't define; it is passed through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OtherChunk<'a> {
    /// The chunk's type.
    pub kind: u32,
    /// Its bytes, with padding.
    pub bytes: &'a [u8],
}

/// The parts of a GLB file, borrowed from its bytes.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Glb<'a> {
    /// The JSON chunk, with padding.
    pub json: &'a [u8],
    /// The binary chunk, with padding.
    pub bin: Option<&'a [u8]>,
    /// Chunks of other kinds, in order.
    pub other: Vec<OtherChunk<'a>>,
    /// Bytes after the length that the header states, which belong to no chunk.
    pub bytes_after_end: usize,
}

/// Bytes that are no GLB file, or parts that can't become one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GlbError {
    /// The file doesn't start with the magic bytes.
    #[error("it doesn't start with the bytes \"glTF\"")]
    Magic,
    /// Another version of the container.
    #[error("it is a GLB container of version {0}, not 2")]
    Version(u32),
    /// The file ends before the header, or the header's length, says.
    #[error("it is truncated: {expected} bytes are expected, {found} are there")]
    Truncated {
        /// Bytes that there should be.
        expected: u64,
        /// Bytes that there are.
        found: u64,
    },
    /// A chunk reaches beyond the end.
    #[error("the chunk at byte {at} is {bytes} bytes long and reaches beyond the end of the file")]
    ChunkTooLong {
        /// Where the chunk's header starts.
        at: usize,
        /// Length that the header states.
        bytes: u32,
    },
    /// Bytes before the end that are too few for a chunk's header.
    #[error("the chunk header at byte {0} is truncated")]
    ChunkHeader(usize),
    /// The first chunk is not the JSON.
    #[error("its first chunk is not the JSON")]
    NoJson,
    /// A second JSON or BIN chunk.
    #[error("it has more than one {0} chunk")]
    Repeated(&'static str),
    /// The parts together are longer than the header can state.
    #[error("the file would be {0} bytes long, and a .glb file can hold at most 4,294,967,295")]
    TooLong(u64),
}

/// Whether bytes start like a GLB file.
pub fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?))
}

impl<'a> Glb<'a> {
    /// Splits a file into its chunks. Never allocates more than a list of the unknown chunks.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, GlbError> {
        if !is_glb(bytes) {
            return Err(GlbError::Magic);
        }
        let truncated = |expected: u64| GlbError::Truncated { expected, found: bytes.len() as u64 };
        let version = u32_at(bytes, 4).ok_or_else(|| truncated(HEADER_BYTES as u64))?;
        if version != VERSION {
            return Err(GlbError::Version(version));
        }
        let length = u32_at(bytes, 8).ok_or_else(|| truncated(HEADER_BYTES as u64))?;
        let body = bytes.get(..length as usize).ok_or_else(|| truncated(u64::from(length)))?;
        let mut glb = Self { bytes_after_end: bytes.len() - body.len(), ..Self::default() };
        let mut at = HEADER_BYTES;
        let mut has_json = false;
        while at < body.len() {
            let (kind, chunk) = chunk_at(body, at)?;
            match kind {
                JSON if has_json => return Err(GlbError::Repeated("JSON")),
                JSON => (has_json, glb.json) = (true, chunk),
                _ if !has_json => return Err(GlbError::NoJson),
                BIN if glb.bin.is_some() => return Err(GlbError::Repeated("BIN")),
                BIN => glb.bin = Some(chunk),
                kind => glb.other.push(OtherChunk { kind, bytes: chunk }),
            }
            at += CHUNK_HEADER_BYTES + chunk.len();
        }
        if has_json { Ok(glb) } else { Err(GlbError::NoJson) }
    }

    /// Writes the file; the JSON is padded with spaces, other chunks with zeros.
    pub fn write(&self) -> Result<Vec<u8>, GlbError> {
        let bin = self.bin.map(|bytes| (BIN, bytes, 0));
        let other = self.other.iter().map(|chunk| (chunk.kind, chunk.bytes, 0));
        let chunks: Vec<(u32, &[u8], u8)> = [(JSON, self.json, b' ')].into_iter().chain(bin).chain(other).collect();
        let chunk_bytes = |bytes: &[u8]| (CHUNK_HEADER_BYTES + bytes.len().next_multiple_of(4)) as u64;
        let total = HEADER_BYTES as u64 + chunks.iter().map(|chunk| chunk_bytes(chunk.1)).sum::<u64>();
        let length = u32::try_from(total).map_err(|_| GlbError::TooLong(total))?;
        let mut file = Vec::with_capacity(length as usize);
        file.extend_from_slice(&MAGIC);
        file.extend_from_slice(&VERSION.to_le_bytes());
        file.extend_from_slice(&length.to_le_bytes());
        for (kind, bytes, padding) in chunks {
            let padded = bytes.len().next_multiple_of(4);
            file.extend_from_slice(&(padded as u32).to_le_bytes());
            file.extend_from_slice(&kind.to_le_bytes());
            file.extend_from_slice(bytes);
            file.resize(file.len() + padded - bytes.len(), padding);
        }
        Ok(file)
    }
}

/// Kind and bytes of the chunk whose header starts at `at`.
fn chunk_at(body: &[u8], at: usize) -> Result<(u32, &[u8]), GlbError> {
    let (Some(bytes), Some(kind)) = (u32_at(body, at), u32_at(body, at + 4)) else {
        return Err(GlbError::ChunkHeader(at));
    };
    let start = at + CHUNK_HEADER_BYTES;
    let end = start.checked_add(bytes as usize);
    let chunk = end.and_then(|end| body.get(start..end)).ok_or(GlbError::ChunkTooLong { at, bytes })?;
    Ok((kind, chunk))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sample() -> Vec<u8> {
        let other = vec![OtherChunk { kind: 7, bytes: b"what" }];
        Glb { json: b"{}", bin: Some(&[1, 2, 3, 4, 5]), other, bytes_after_end: 0 }.write().unwrap()
    }

    #[test]
    fn what_is_written_is_read() {
        let bytes = sample();
        let glb = Glb::parse(&bytes).unwrap();
        assert_eq!(glb.json, b"{}  ");
        assert_eq!(glb.bin, Some(&[1, 2, 3, 4, 5, 0, 0, 0][..]));
        assert_eq!(glb.other, [OtherChunk { kind: 7, bytes: b"what" }]);
        assert_eq!(glb.write().unwrap(), bytes);
    }

    #[test]
    fn truncation_is_named() {
        let bytes = sample();
        for end in 0..bytes.len() {
            assert!(Glb::parse(&bytes[..end]).is_err(), "{end}");
        }
        let error = Glb::parse(&bytes[..bytes.len() - 1]).unwrap_err();
        assert_eq!(error, GlbError::Truncated { expected: bytes.len() as u64, found: bytes.len() as u64 - 1 });
    }

    #[test]
    fn bytes_after_the_end_are_counted() {
        let mut bytes = sample();
        bytes.extend_from_slice(b"rest");
        assert_eq!(Glb::parse(&bytes).unwrap().bytes_after_end, 4);
    }

    #[test]
    fn order_and_repetition_of_chunks() {
        let mut repeated = sample();
        let bin_again = [4, 0, 0, 0, b'B', b'I', b'N', 0, 9, 9, 9, 9];
        repeated.extend_from_slice(&bin_again);
        let length = (repeated.len() as u32).to_le_bytes();
        repeated[8..12].copy_from_slice(&length);
        assert_eq!(Glb::parse(&repeated), Err(GlbError::Repeated("BIN")));
        let mut first = b"glTF\x02\0\0\0\x18\0\0\0".to_vec();
        first.extend_from_slice(&bin_again);
        assert_eq!(Glb::parse(&first), Err(GlbError::NoJson));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(tail in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut bytes = b"glTF\x02\0\0\0".to_vec();
            bytes.extend(tail);
            if let Ok(glb) = Glb::parse(&bytes) {
                prop_assert!(glb.json.len() <= bytes.len());
            }
        }
    }
}
