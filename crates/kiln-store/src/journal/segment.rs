//! The format of the journal's files.
//!
//! ```text
//! header: "KILNJRNL"  version u32  kind u32  first sequence u64  records u64  check (16 bytes)
//! record: "KREC"  payload length u32  sequence u64  fence u64  check (16 bytes)  payload
//! ```
//! Integers are little-endian; checks are the first half of BLAKE3, a record's over its numbers and payload. A payload
//! is a version byte and the postcard of a list of events: what one append wrote, which counts whole or not at all.
//! The mark before each record lets a reader find the next good one behind a damaged place.

use super::{Fence, JournalEvent};
use kiln_core::{Digest, DigestStream, codec};

pub(super) const VERSION: u32 = 1;
pub(super) const HEADER: usize = 48;
/// The largest payload: what is larger is refused when written, and damage when read.
pub(super) const MAX_PAYLOAD: usize = 64 << 20;

const MAGIC: &[u8; 8] = b"KILNJRNL";
const MARK: &[u8; 4] = b"KREC";
const RECORD: usize = 40;
const PAYLOAD_VERSION: u8 = 1;

/// What a file of the journal is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SegmentKind {
    /// Appends, from its first sequence number on.
    Log,
    /// What all appends before its first sequence number amount to.
    Snapshot,
}

/// A file's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SegmentHeader {
    pub(super) kind: SegmentKind,
    /// The first sequence number of a log; the one after the last that went into a snapshot.
    pub(super) sequence: u64,
    /// Records of a snapshot; 0 for a log.
    pub(super) records: u64,
}

/// What one append wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Append {
    pub(super) sequence: u64,
    pub(super) fence: Fence,
    pub(super) events: Vec<JournalEvent>,
}

/// A file of the journal as it was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Scan {
    /// None where the header is damaged.
    pub(super) header: Option<SegmentHeader>,
    /// Every append that can be read, in order of the file.
    pub(super) appends: Vec<Append>,
    /// Bytes up to the end of the last of them.
    pub(super) good_bytes: usize,
    /// Something before that cannot be read.
    pub(super) damaged: bool,
    /// Something after that cannot: what an interrupted append leaves behind, at the end of the last log.
    pub(super) torn: bool,
}

/// A format of a later version of Kiln.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Newer(pub(super) u32);

fn check(parts: &[&[u8]]) -> [u8; 16] {
    let mut stream = DigestStream::default();
    parts.iter().for_each(|part| stream.update(part));
    let Digest(bytes) = stream.finish();
    let mut half = [0; 16];
    half.copy_from_slice(&bytes[..16]);
    half
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes)
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    bytes.get(at..at + 8)?.try_into().ok().map(u64::from_le_bytes)
}

/// A header as it is written.
pub(super) fn encode_header(header: &SegmentHeader) -> Vec<u8> {
    let kind = match header.kind {
        SegmentKind::Log => 0u32,
        SegmentKind::Snapshot => 1,
    };
    let mut bytes = MAGIC.to_vec();
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    bytes.extend_from_slice(&kind.to_le_bytes());
    bytes.extend_from_slice(&header.sequence.to_le_bytes());
    bytes.extend_from_slice(&header.records.to_le_bytes());
    let sum = check(&[&bytes]);
    bytes.extend_from_slice(&sum);
    bytes
}

/// Events as a record holds them.
#[derive(Debug)]
pub(super) struct Payload {
    bytes: Vec<u8>,
    length: u32,
}

impl Payload {
    /// None if the events are too many for one record.
    pub(super) fn new(events: &[JournalEvent]) -> Option<Self> {
        let mut bytes = vec![PAYLOAD_VERSION];
        bytes.extend_from_slice(&codec::encode(events));
        let length = u32::try_from(bytes.len()).ok().filter(|_| bytes.len() <= MAX_PAYLOAD)?;
        Some(Self { bytes, length })
    }

    /// Bytes of the record.
    pub(super) fn record_bytes(&self) -> u64 {
        (RECORD + self.bytes.len()) as u64
    }
}

/// A record as it is written.
pub(super) fn encode_append(sequence: u64, fence: Fence, payload: &Payload) -> Vec<u8> {
    let mut numbers = payload.length.to_le_bytes().to_vec();
    numbers.extend_from_slice(&sequence.to_le_bytes());
    numbers.extend_from_slice(&fence.0.to_le_bytes());
    let mut bytes = MARK.to_vec();
    bytes.extend_from_slice(&numbers);
    bytes.extend_from_slice(&check(&[&numbers, &payload.bytes]));
    bytes.extend_from_slice(&payload.bytes);
    bytes
}

fn decode_header(bytes: &[u8]) -> Result<Option<SegmentHeader>, Newer> {
    let Some(bytes) = bytes.get(..HEADER) else { return Ok(None) };
    let good = bytes.starts_with(MAGIC) && check(&[&bytes[..HEADER - 16]]) == bytes[HEADER - 16..];
    let (true, Some(version), Some(kind)) = (good, u32_at(bytes, 8), u32_at(bytes, 12)) else { return Ok(None) };
    let kind = match (version, kind) {
        (VERSION, 0) => SegmentKind::Log,
        (VERSION, 1) => SegmentKind::Snapshot,
        _ => return Err(Newer(version.max(VERSION + 1))),
    };
    Ok(u64_at(bytes, 16).zip(u64_at(bytes, 24)).map(|(sequence, records)| SegmentHeader { kind, sequence, records }))
}

/// The record at a place, and where it ends.
fn decode_append(bytes: &[u8], at: usize) -> Result<Option<(Append, usize)>, Newer> {
    let Some(head) = bytes.get(at..at + RECORD).filter(|head| head.starts_with(MARK)) else { return Ok(None) };
    let (Some(length), Some(sequence), Some(fence)) = (u32_at(head, 4), u64_at(head, 8), u64_at(head, 16)) else {
        return Ok(None);
    };
    let end = at + RECORD + length as usize;
    let Some(payload) = bytes.get(at + RECORD..end).filter(|payload| payload.len() <= MAX_PAYLOAD) else {
        return Ok(None);
    };
    if check(&[&head[4..24], payload]) != head[24..] {
        return Ok(None);
    }
    let events = match payload.split_first() {
        Some((&PAYLOAD_VERSION, events)) => codec::decode("a record of the journal", events),
        Some((&version, _)) if version > PAYLOAD_VERSION => return Err(Newer(u32::from(version))),
        _ => return Ok(None),
    };
    Ok(events.ok().map(|events| (Append { sequence, fence: Fence(fence), events }, end)))
}

/// Reads what can be read of a file.
///
/// # Errors
/// Where it is whole and of a later version: to pass over that would lose what it says.
pub(super) fn scan(bytes: &[u8]) -> Result<Scan, Newer> {
    let header = decode_header(bytes)?;
    let mut at = if header.is_some() { HEADER } else { 0 };
    let mut found = Scan { header, appends: Vec::new(), good_bytes: at, damaged: header.is_none(), torn: false };
    while at < bytes.len() {
        if let Some((append, end)) = decode_append(bytes, at)? {
            found.damaged |= at != found.good_bytes;
            found.appends.push(append);
            found.good_bytes = end;
            at = end;
        } else {
            at = next_mark(bytes, at + 1);
        }
    }
    found.torn = found.good_bytes < bytes.len();
    if let Some(SegmentHeader { kind: SegmentKind::Snapshot, records, .. }) = header {
        found.damaged |= found.torn || found.appends.len() as u64 != records;
    }
    Ok(found)
}

fn next_mark(bytes: &[u8], from: usize) -> usize {
    let Some(rest) = bytes.get(from..) else { return bytes.len() };
    rest.windows(MARK.len()).position(|window| window == MARK).map_or(bytes.len(), |at| from + at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::JobId;
    use proptest::prelude::*;

    fn log(appends: u64) -> (Vec<u8>, Vec<Append>, Vec<usize>) {
        let mut bytes = encode_header(&SegmentHeader { kind: SegmentKind::Log, sequence: 5, records: 0 });
        let (mut written, mut ends) = (Vec::new(), vec![bytes.len()]);
        for sequence in 5..5 + appends {
            let events = vec![JournalEvent::JobPaused(JobId(sequence)); (sequence % 3) as usize];
            bytes.extend(encode_append(sequence, Fence(2), &Payload::new(&events).unwrap()));
            ends.push(bytes.len());
            written.push(Append { sequence, fence: Fence(2), events });
        }
        (bytes, written, ends)
    }

    #[test]
    fn written_and_read() {
        let (bytes, written, _) = log(9);
        let scan = scan(&bytes).unwrap();
        assert_eq!(scan.appends, written);
        assert!(!scan.damaged && !scan.torn && scan.good_bytes == bytes.len());
    }

    #[test]
    fn a_torn_tail_is_found_at_every_length() {
        let (bytes, written, ends) = log(6);
        for length in HEADER..bytes.len() {
            let scan = scan(&bytes[..length]).unwrap();
            let whole = ends.iter().filter(|&&end| end <= length).count() - 1;
            assert_eq!(scan.appends, written[..whole]);
            assert!(!scan.damaged);
            assert_eq!((scan.torn, scan.good_bytes), (ends[whole] < length, ends[whole]));
        }
    }

    #[test]
    fn later_versions_are_refused() {
        let mut header = encode_header(&SegmentHeader { kind: SegmentKind::Log, sequence: 0, records: 0 });
        header[8] = 2;
        assert!(scan(&header).unwrap().damaged, "a changed header without its check is damage");
        let sum = check(&[&header[..HEADER - 16]]);
        header[HEADER - 16..].copy_from_slice(&sum);
        assert_eq!(scan(&header), Err(Newer(2)));
    }

    proptest! {
        #[test]
        fn one_flipped_bit_costs_one_append_at_most(at in any::<proptest::sample::Index>(), bit in 0u8..8) {
            let (mut bytes, written, ends) = log(8);
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
            let scan = scan(&bytes).unwrap();
            let hit = ends.iter().filter(|&&end| end <= at).count();
            let rest: Vec<_> =
                written.iter().enumerate().filter(|(i, _)| i + 1 != hit).map(|(_, append)| append.clone()).collect();
            prop_assert_eq!(scan.appends, rest);
            prop_assert!(scan.damaged || scan.torn);
        }

        #[test]
        fn mutations_never_panic_nor_invent(
            cuts in proptest::collection::vec((any::<proptest::sample::Index>(), 0usize..40, any::<u8>()), 1..6),
        ) {
            let (mut bytes, written, _) = log(8);
            for (at, length, fill) in cuts {
                let at = at.index(bytes.len());
                let end = (at + length).min(bytes.len());
                match fill % 3 {
                    0 => drop(bytes.drain(at..end)),
                    1 => bytes[at..end].fill(fill),
                    _ => drop(bytes.splice(at..at, vec![fill; length])),
                }
                if bytes.is_empty() {
                    break;
                }
            }
            for append in scan(&bytes).unwrap().appends {
                prop_assert!(written.contains(&append));
            }
        }
    }
}
