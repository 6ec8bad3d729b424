//! docs/pack-format.md by hand: a pack that is put together byte by byte, and what is read from it.

use kiln_runtime::{Kernel, Pack, Remap};

fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn words(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn meta() -> Vec<u8> {
    let mut meta = vec![0xab; 32];
    [10.0f64, 20.0, 30.0].iter().for_each(|x| meta.extend(x.to_le_bytes()));
    meta.extend(words(&[1, 0]));
    meta.extend(floats(&[300.0, 0.0, 0.0, 0.0]));
    meta.extend(floats(&[2.0, 0.0, 0.0, 0.0]));
    // The version is bytes 4 to 6 of the strings; remapped by a gamma of 2.
    meta.extend(words(&[4, 3, 1]));
    meta.extend(floats(&[2.0]));
    assert_eq!(meta.len(), 112);
    meta
}

fn region() -> Vec<u8> {
    let mut region = floats(&[-1.0, -2.0, -3.0]);
    region.extend(words(&[0]));
    region.extend(floats(&[1.0, 2.0, 3.0]));
    region.extend(words(&[0, 4, 0, 0, 0]));
    assert_eq!(region.len(), 48);
    region
}

/// Mean 1, 2, 3, 4; slope to −y of ½ for all four.
fn engine_model() -> Vec<u8> {
    let mut model = floats(&[0.0, 0.5, 0.0]);
    let mut halves = [0u16; 28];
    halves[..4].copy_from_slice(&[0x3c00, 0x4000, 0x4200, 0x4400]);
    halves[16..20].copy_from_slice(&[0x3800; 4]);
    model.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
    assert_eq!(model.len(), 68);
    model
}

fn pack() -> Vec<u8> {
    let sections = [(1, 1, meta()), (2, 7, b"hall9.9".to_vec()), (10, 1, region()), (14, 1, engine_model())];
    let mut pack = b"\x89KILN\r\n\x1a".to_vec();
    pack.extend([1, 0, 0, 0]);
    pack.extend(words(&[64, 0, 0, 4, 32]));
    pack.resize(64, 0);
    let mut offset = 64 + 4 * 32;
    for (kind, count, bytes) in &sections {
        pack.extend(words(&[*kind, 0, offset, 0, bytes.len() as u32, 0, *count, bytes.len() as u32 / count]));
        offset = (offset + bytes.len() as u32).next_multiple_of(16);
    }
    for (_, _, bytes) in &sections {
        pack.resize(pack.len().next_multiple_of(16), 0);
        pack.extend(bytes);
    }
    let size = pack.len() as u32;
    pack[16..20].copy_from_slice(&size.to_le_bytes());
    pack
}

#[test]
fn the_layout_is_as_documented() {
    let bytes = pack();
    let pack = Pack::new(&bytes).unwrap();
    let meta = pack.meta();
    assert_eq!((meta.level_digest(), meta.origin(), meta.version()), (&[0xab; 32], [10.0, 20.0, 30.0], "9.9"));
    assert_eq!((meta.kernel(), meta.half_distances(), meta.blend()), (Kernel::Obscurance, &[300.0][..], &[1.0][..]));
    assert_eq!((meta.remap(), meta.local([11.0, 20.0, 29.0])), (Remap::Gamma(2.0), [1.0, 0.0, -1.0]));
    let region = pack.region(0).unwrap();
    assert_eq!((region.min, region.max, pack.region_id(0)), ([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0], Some("hall")));
    assert_eq!(pack.engine_at(0, [0.25, 0.5, 9.0]), Some([1.0, 2.0, 3.0, 4.0]));
    assert_eq!(pack.engine_at(0, [0.25, -0.5, 9.0]), Some([0.5, 1.5, 2.5, 3.5]));
    assert!(pack.full_model(0).is_none() && pack.region_with_id("hall") == Some(0));
}
