//! Which region a point is in, against looking at all of them by the definition.

use crate::sample;
use kiln_runtime::{
    Pack, Region,
    write::{EdgeData, PackData, RegionData, write},
};
use proptest::{collection::vec, prelude::*};

type Box3 = ([f32; 3], [f32; 3]);

/// A pack of boxes; those that touch or overlap are neighbours.
fn pack_of(boxes: &[Box3]) -> Vec<u8> {
    let mut data = PackData::new(sample::meta(2));
    data.regions = sample::house();
    let region = |&(min, size): &Box3| RegionData {
        id: String::new(),
        min,
        max: std::array::from_fn(|i| min[i] + size[i]),
        model: 0,
    };
    let regions: Vec<RegionData> = boxes.iter().map(region).collect();
    let touch = |a: &RegionData, b: &RegionData| (0..3).all(|i| a.min[i] <= b.max[i] && b.min[i] <= a.max[i]);
    let pairs = (0..regions.len()).flat_map(|i| (i + 1..regions.len()).map(move |j| [i, j]));
    let beside = pairs.filter(|&[i, j]| touch(&regions[i], &regions[j]));
    let edge = |pair: [usize; 2]| EdgeData { regions: pair.map(|i| i as u32), area_m2: 1.0, center: [0.0; 3] };
    data.regions.edges = beside.map(edge).collect();
    data.regions.models.truncate(1);
    data.regions.regions = regions;
    write(&data).unwrap()
}

fn distance(region: &Region, point: [f32; 3]) -> f64 {
    let clamped = region.clamp(point);
    (0..3).map(|i| f64::from(point[i] - clamped[i]).powi(2)).sum::<f64>().sqrt()
}

/// The smallest box that contains the point, and how far away the nearest is.
fn by_definition(pack: &Pack<'_>, point: [f32; 3]) -> (Option<u32>, f64) {
    let regions: Vec<Region> = (0..pack.region_count()).map(|index| pack.region(index).unwrap()).collect();
    let containing = (0u32..).zip(&regions).filter(|(_, region)| region.contains(point));
    let smallest = containing.min_by(|(_, a), (_, b)| a.volume().total_cmp(&b.volume())).map(|(index, _)| index);
    (smallest, regions.iter().map(|region| distance(region, point)).fold(f64::INFINITY, f64::min))
}

proptest! {
    #[test]
    fn hints_do_not_matter(
        boxes in vec(([-20.0..20.0f32, -5.0..5.0, -20.0..20.0], [0.5..25.0f32, 0.5..6.0, 0.5..25.0]), 1..14),
        points in vec([-25.0..45.0f32, -7.0..12.0, -25.0..45.0], 20),
    ) {
        let bytes = pack_of(&boxes);
        let pack = Pack::new(&bytes).unwrap();
        for point in points {
            let (smallest, least) = by_definition(&pack, point);
            for hint in (0..boxes.len() as u32).map(Some).chain([None]) {
                let hit = pack.region_at(point, hint).unwrap();
                match smallest {
                    Some(region) => prop_assert_eq!((hit.region, hit.distance_m), (region, 0.0)),
                    None => prop_assert!((f64::from(hit.distance_m) - least).abs() < 1e-4 && hit.distance_m > 0.0),
                }
            }
        }
    }
}
