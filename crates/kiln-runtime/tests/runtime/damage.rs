//! Damaged packs are refused, or what is in them can be read: no panic, nothing out of bounds, no allocation.

use crate::{allocations::allocations, corpus, exercise::exercise, sample};
use kiln_runtime::{Pack, PackError, write::write};
use proptest::prelude::*;

/// Words that sizes and indices are likely to go wrong with.
const ODD: [u32; 12] = [0, 1, 2, 15, 16, 64, 255, 0x7fff_ffff, 0x8000_0000, 0xffff_fff0, u32::MAX, 0x7fc0_0000];

/// Xorshift (Marsaglia 2003), so that a failure comes again.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 16) as usize % sides.max(1)
    }
}

fn put(bytes: &mut [u8], at: usize, word: u32) {
    if let Some(place) = bytes.get_mut(at..at + 4) {
        place.copy_from_slice(&word.to_le_bytes());
    }
}

/// One thing that can happen to a file.
fn mutate(bytes: &mut Vec<u8>, other: &[u8], dice: &mut Dice) {
    let size = bytes.len();
    match dice.roll(7) {
        0 => (0..=dice.roll(8)).for_each(|_| {
            let at = dice.roll(size);
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << dice.roll(8);
            }
        }),
        1 => bytes.truncate(dice.roll(size)),
        2 => put(bytes, dice.roll(size / 4) * 4, ODD[dice.roll(ODD.len())]),
        // Sizes, places and counts are in the first few hundred bytes.
        3 => put(bytes, dice.roll(140) * 4, ODD[dice.roll(ODD.len())]),
        4 => {
            let at = dice.roll(140) * 4;
            let word = bytes.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            put(bytes, at, word.wrapping_add(dice.roll(65) as u32).wrapping_sub(32));
        }
        5 => {
            let (from, to, length) = (dice.roll(other.len()), dice.roll(size), dice.roll(200));
            let piece = &other[from..(from + length).min(other.len())];
            let end = (to + piece.len()).min(size);
            bytes[to.min(end)..end].copy_from_slice(&piece[..end - to.min(end)]);
        }
        _ => {
            let at = dice.roll(size);
            let piece = other[..dice.roll(other.len())].to_vec();
            bytes.splice(at.min(size)..at.min(size), piece);
        }
    }
    // A length that fits, so that what comes after it is reached.
    if dice.roll(4) > 0 {
        let size = bytes.len() as u64;
        if let Some(place) = bytes.get_mut(16..24) {
            place.copy_from_slice(&size.to_le_bytes());
        }
    }
}

/// Takes bytes without a panic (which the test would show) and without an allocation.
fn survives(bytes: &[u8]) -> Result<f64, PackError> {
    let (count, result) = allocations(|| exercise(bytes));
    assert_eq!(count, 0, "{result:?}");
    result
}

#[test]
fn thousands_of_mutations() {
    let seeds = corpus::made();
    let mut dice = Dice(0x9e37_79b9_7f4a_7c15);
    let (mut refused, mut read) = (0, 0);
    for round in 0..30_000 {
        let mut bytes = seeds[round % seeds.len()].1.clone();
        let other = &seeds[dice.roll(seeds.len())].1;
        (0..=dice.roll(3)).for_each(|_| mutate(&mut bytes, other, &mut dice));
        match survives(&bytes) {
            Ok(_) => read += 1,
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 5_000 && read > 1_000, "mutations go deep enough: {refused} refused, {read} read");
}

#[test]
fn every_word_of_header_and_table_set_to_odd_values() {
    for (name, bytes) in corpus::made() {
        for at in (0..bytes.len().min(64 + 40 * 16)).step_by(4) {
            for word in ODD {
                let mut damaged = bytes.clone();
                put(&mut damaged, at, word);
                let _ = survives(&damaged);
            }
        }
        for size in 0..bytes.len() {
            assert!(survives(&bytes[..size]).is_err(), "{name} cut to {size} bytes");
        }
    }
}

#[test]
fn each_refusal_says_what_is_wrong_and_what_to_do() {
    let good = write(&sample::all()).unwrap();
    let refusal = |at: usize, new: &[u8]| {
        let mut bytes = good.clone();
        bytes[at..at + new.len()].copy_from_slice(new);
        Pack::new(&bytes).unwrap_err()
    };
    assert_eq!(Pack::new(b"glTF").unwrap_err(), PackError::NotAPack);
    assert_eq!(Pack::new(&good[..20]).unwrap_err(), PackError::CutOff { stated: 64, actual: 20 });
    let newer = refusal(8, &[2, 0, 3, 0]);
    assert_eq!(newer, PackError::Version { major: 2, minor: 3 });
    assert!(newer.to_string().contains("2.3") && newer.to_string().contains("build the engine with the runtime"));
    assert!(matches!(refusal(16, &[255; 8]), PackError::CutOff { stated: u64::MAX, .. }));
    assert_eq!(refusal(24, &[0, 16, 0, 0]), PackError::Header { field: "number of sections", value: 4096 });
    assert!(matches!(refusal(12, &[8, 0, 0, 0]), PackError::Header { field: "size", value: 8 }));
    assert!(matches!(
        refusal(64 + 8, &[1]),
        PackError::Section { index: 0, kind: 1, problem: "is not aligned to 16 bytes" }
    ));
    let text = refusal(64 + 28, &[113]).to_string();
    assert!(text.contains("section 0 (kind 1)") && text.contains("copy or bake it again"), "{text}");
    // The second section becomes another meta.
    assert!(matches!(refusal(96, &[1, 0, 0, 0]), PackError::Section { problem: "is the second of its kind", .. }));
    assert_eq!(refusal(64, &[200]), PackError::Missing { kind: kiln_runtime::SectionKind::Meta });
}

proptest! {
    #[test]
    fn any_bytes_behind_a_good_header(tail in proptest::collection::vec(any::<u8>(), 0..600), sections in 0u32..12) {
        let mut bytes = write(&sample::all()).unwrap()[..64].to_vec();
        bytes.extend(tail);
        put(&mut bytes, 24, sections);
        let size = bytes.len() as u64;
        bytes[16..24].copy_from_slice(&size.to_le_bytes());
        let _ = survives(&bytes);
    }

    #[test]
    fn any_data_with_any_bytes_changed(data in sample::any_data(), changes in proptest::collection::vec((any::<u16>(), any::<u8>()), 1..6)) {
        let mut bytes = write(&data).unwrap();
        for (at, byte) in changes {
            let at = usize::from(at) % bytes.len();
            bytes[at] = byte;
        }
        let _ = survives(&bytes);
    }
}
