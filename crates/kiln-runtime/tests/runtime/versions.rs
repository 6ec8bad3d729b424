//! Packs of newer versions.

use crate::{exercise::exercise, sample};
use kiln_runtime::{Pack, PackError, SectionKind, write::write};

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

/// What a newer minor version might write of the same data: a longer header, longer entries, records with more fields, and
/// sections of other kinds.
pub(crate) fn newer(old: &[u8]) -> Vec<u8> {
    const HEADER: usize = 96;
    const ENTRY: usize = 48;
    const MORE: usize = 8;
    let count = word(old, 24) as usize;
    let mut sections: Vec<(u32, u32, usize, Vec<u8>)> = vec![(40, 0, 12, vec![7; 24])];
    for entry in (0..count).map(|i| &old[64 + 32 * i..]) {
        let (kind, stride) = (word(entry, 0), word(entry, 28) as usize);
        let start = word(entry, 8) as usize;
        let records = &old[start..start + word(entry, 16) as usize];
        // Single numbers stay what they are.
        let more = if [2, 4, 5, 11].contains(&kind) { 0 } else { MORE };
        let longer = records.chunks(stride).flat_map(|record| record.iter().copied().chain(vec![0xee; more]));
        sections.push((kind, word(entry, 24), stride + more, longer.collect()));
    }
    sections.push((0x8000_0001, 0, 0, Vec::new()));
    let mut pack = old[..64].to_vec();
    pack[10] = 7;
    pack[12] = HEADER as u8;
    pack[24] = sections.len() as u8;
    pack[28] = ENTRY as u8;
    pack.resize(HEADER, 0xdd);
    let mut offset = HEADER + ENTRY * sections.len();
    for (kind, count, stride, bytes) in &sections {
        offset = offset.next_multiple_of(16);
        pack.extend(kind.to_le_bytes());
        pack.extend(0u32.to_le_bytes());
        pack.extend((offset as u64).to_le_bytes());
        pack.extend((bytes.len() as u64).to_le_bytes());
        pack.extend(count.to_le_bytes());
        pack.extend((*stride as u32).to_le_bytes());
        pack.resize(pack.len() + ENTRY - 32, 0xcc);
        offset += bytes.len();
    }
    for (_, _, _, bytes) in sections {
        pack.resize(pack.len().next_multiple_of(16), 0);
        pack.extend(bytes);
    }
    let size = pack.len() as u64;
    pack[16..24].copy_from_slice(&size.to_le_bytes());
    pack
}

#[test]
fn a_newer_minor_version_is_read_as_far_as_it_is_known() {
    let old = write(&sample::all()).unwrap();
    let new = newer(&old);
    let (old, new) = (Pack::new(&old).unwrap(), Pack::new(&new).unwrap());
    assert_eq!((new.minor_version(), new.sizes().count()), (7, old.sizes().count() + 2));
    assert_eq!(new.sizes().next().unwrap().kind, None);
    for kind in SectionKind::ALL {
        assert_eq!(old.count(kind), new.count(kind), "{}", kind.name());
    }
    let point = [1.0, 2.0, 3.0];
    for region in 0..old.region_count() {
        assert_eq!(old.region(region), new.region(region));
        assert_eq!(old.engine_at(region, point), new.engine_at(region, point));
        assert_eq!(old.full_at(region, point, 1), new.full_at(region, point, 1));
    }
    let tree = |pack: &Pack<'_>| pack.tree_instance(12, None).map(|tree| (tree.model, tree.blend()));
    assert_eq!(tree(&old), tree(&new));
    let scalar = |pack: &Pack<'_>| pack.scalar(20, Some(5)).and_then(|scalar| scalar.ao(1));
    assert_eq!(scalar(&old), scalar(&new));
    let vertex = |pack: &Pack<'_>| pack.vertex_set(7, None, 2).and_then(|set| set.values.get(2, 1));
    assert_eq!((vertex(&old), vertex(&new)), (Some(0.125), Some(0.125)));
    assert_eq!(old.meta().remap().apply(0.25), new.meta().remap().apply(0.25));
}

#[test]
fn bytes_after_the_pack_are_nobodys() {
    let mut bytes = write(&sample::all()).unwrap();
    let size = bytes.len();
    bytes.resize(size.next_multiple_of(4096), 0xff);
    assert_eq!(Pack::new(&bytes).unwrap().size_bytes(), size);
    exercise(&bytes).unwrap();
}

#[test]
fn a_section_that_is_required_and_not_known_is_refused() {
    let mut bytes = newer(&write(&sample::all()).unwrap());
    bytes[96 + 4] = 1;
    let error = Pack::new(&bytes).unwrap_err();
    assert_eq!(error, PackError::UnknownRequired { kind: 40 });
    assert!(error.to_string().contains("kind 40"));
}
