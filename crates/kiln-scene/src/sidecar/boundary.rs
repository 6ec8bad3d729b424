//! Where boxes of regions meet: area and centre of the boundary of two, and which of many have one.

use kiln_core::{Bounds, Region, RegionEdge};
use rstar::{
    AABB, RTree,
    primitives::{GeomWithData, Rectangle},
};

/// Faces that are no farther apart touch, metres: exporters round what they write. What two boxes share must be longer and
/// wider than this to be a boundary.
const TOUCH_M: f64 = 1e-3;

/// More of a level's boxes meet than may.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct TooManyPairs;

/// Boundary of two boxes: their overlap's largest face, which is what they share if they only touch. `None` if they do
/// neither, or share no area.
pub(super) fn boundary(regions: &[Region], pair: [u32; 2]) -> Option<RegionEdge> {
    let [a, b] = pair.map(|index| regions[index as usize].bounds);
    let overlap = Bounds { min: a.min.max(b.min), max: a.max.min(b.max) };
    let extents = overlap.max - overlap.min;
    if extents.min_element() < -TOUCH_M {
        return None;
    }
    let thinnest = (0..3).min_by(|a, b| extents[*a].total_cmp(&extents[*b]))?;
    let sides = [extents[(thinnest + 1) % 3], extents[(thinnest + 2) % 3]];
    let has_area = sides.iter().all(|side| *side > TOUCH_M);
    let center = 0.5 * (overlap.min + overlap.max);
    has_area.then(|| RegionEdge { regions: pair, area_m2: sides[0] * sides[1], center })
}

/// Every pair of regions that share a boundary, in the order of their indices. No more than `most_pairs` of boxes are looked
/// at, each from both sides and with itself.
pub(super) fn boundaries(regions: &[Region], most_pairs: usize) -> Result<Vec<RegionEdge>, TooManyPairs> {
    let boxed = |(index, region): (u32, &Region)| {
        let Bounds { min, max } = region.bounds;
        GeomWithData::new(Rectangle::from_corners(min.to_array(), max.to_array()), index)
    };
    let tree = RTree::bulk_load((0u32..).zip(regions).map(boxed).collect());
    let (mut edges, mut pairs) = (Vec::new(), 0);
    for (index, region) in (0u32..).zip(regions) {
        let Bounds { min, max } = region.bounds;
        let reach = AABB::from_corners((min - TOUCH_M).to_array(), (max + TOUCH_M).to_array());
        for other in tree.locate_in_envelope_intersecting(&reach).map(|entry| entry.data) {
            pairs += 1;
            if pairs > most_pairs {
                return Err(TooManyPairs);
            }
            if other > index {
                edges.extend(boundary(regions, [index, other]));
            }
        }
    }
    edges.sort_unstable_by_key(|edge| edge.regions);
    Ok(edges)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn region(min: [f64; 3], max: [f64; 3]) -> Region {
        Region { id: String::new(), bounds: Bounds { min: min.into(), max: max.into() }, valid: None }
    }

    fn meet(a: [[f64; 3]; 2], b: [[f64; 3]; 2]) -> Option<(f64, DVec3)> {
        let regions = [region(a[0], a[1]), region(b[0], b[1])];
        boundary(&regions, [0, 1]).map(|edge| (edge.area_m2, edge.center))
    }

    const HALL: [[f64; 3]; 2] = [[0.0, 0.0, 0.0], [8.0, 4.0, 12.0]];

    #[test]
    fn boxes_that_touch_share_a_face() {
        assert_eq!(meet(HALL, [[8.0, 0.0, 2.0], [9.0, 2.0, 5.0]]), Some((6.0, DVec3::new(8.0, 1.0, 3.5))));
        // Rounded by half a millimetre.
        assert!(meet(HALL, [[8.0005, 0.0, 2.0], [9.0, 2.0, 5.0]]).is_some());
        assert!(meet(HALL, [[8.01, 0.0, 2.0], [9.0, 2.0, 5.0]]).is_none());
        // Along an edge, and at a corner.
        assert!(meet(HALL, [[8.0, 4.0, 0.0], [9.0, 5.0, 12.0]]).is_none());
        assert!(meet(HALL, [[8.0, 4.0, 12.0], [9.0, 5.0, 13.0]]).is_none());
    }

    #[test]
    fn boxes_that_overlap_have_the_largest_face_of_the_overlap() {
        assert_eq!(meet(HALL, [[7.0, 1.0, 2.0], [9.0, 9.0, 6.0]]), Some((12.0, DVec3::new(7.5, 2.5, 4.0))));
        assert_eq!(meet(HALL, [[1.0, 1.0, 1.0], [2.0, 2.0, 4.0]]), Some((3.0, DVec3::new(1.5, 1.5, 2.5))));
    }

    #[test]
    fn heaps_of_boxes_are_refused() {
        let heap = vec![region(HALL[0], HALL[1]); 100];
        assert_eq!(boundaries(&heap, 9999), Err(TooManyPairs));
        assert_eq!(boundaries(&heap, 10_000).unwrap().len(), 4950);
    }

    #[test]
    fn many_boxes_are_met_in_time() {
        // 46 layers of 46 × 46 boxes in a lattice: 97,336 boxes, each with a face to each of its neighbours.
        let at = |i: u32| DVec3::new(f64::from(i % 46), f64::from(i / 46 % 46), f64::from(i / (46 * 46)));
        let regions: Vec<Region> =
            (0..46u32.pow(3)).map(|i| region(at(i).to_array(), (at(i) + 1.0).to_array())).collect();
        assert_eq!(boundaries(&regions, usize::MAX).unwrap().len(), 3 * 45 * 46 * 46);
    }

    proptest! {
        #[test]
        fn pairs_are_those_of_brute_force(
            boxes in proptest::collection::vec((prop::array::uniform3(0i8..6), prop::array::uniform3(1i8..4)), 0..24)
        ) {
            let regions: Vec<Region> = boxes.iter().map(|(min, size)| {
                let min = DVec3::from(min.map(f64::from));
                region(min.to_array(), (min + DVec3::from(size.map(f64::from))).to_array())
            }).collect();
            let count = regions.len() as u32;
            let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b]));
            let expected: Vec<RegionEdge> = pairs.filter_map(|pair| boundary(&regions, pair)).collect();
            prop_assert_eq!(boundaries(&regions, usize::MAX).unwrap(), expected);
        }
    }
}
