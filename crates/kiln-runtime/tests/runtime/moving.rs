//! Regions of points, models at points, and objects that move through them.

use crate::sample;
use kiln_runtime::{
    MovingObject, Pack, TemporalBlend, ao_linear, ao_quadratic,
    format::HARMONICS,
    write::{ModelData, PackData, write},
};
use std::f32::consts::PI;

fn house() -> Vec<u8> {
    let mut data = PackData::new(sample::meta(2));
    data.regions = sample::house();
    write(&data).unwrap()
}

#[test]
fn a_point_is_in_the_smallest_box_wherever_it_comes_from() {
    let bytes = house();
    let pack = Pack::new(&bytes).unwrap();
    let at = |point, hint| {
        let hit = pack.region_at(point, hint).unwrap();
        assert_eq!(hit.distance_m, 0.0);
        pack.region_id(hit.region).unwrap()
    };
    for (x, room) in [(1.0, "hall"), (5.0, "kitchen"), (9.0, "larder"), (-3.0, "outside")] {
        for hint in [None, Some(0), Some(1), Some(2), Some(3), Some(99)] {
            assert_eq!(at([x, 1.0, 1.0], hint), room, "{x} from {hint:?}");
        }
    }
    // On a face that two of the same volume share: the one that it was in, or the first.
    let on_the_face = [None, Some(0), Some(1), Some(2), Some(3)].map(|hint| at([4.0, 1.0, 1.0], hint));
    assert_eq!(on_the_face, ["hall", "hall", "kitchen", "kitchen", "hall"]);
}

#[test]
fn outside_of_all_boxes_the_nearest_is_taken() {
    let bytes = house();
    let pack = Pack::new(&bytes).unwrap();
    let hit = pack.region_at([23.0, 13.0, 0.0], Some(0)).unwrap();
    assert_eq!((hit.region, hit.distance_m), (3, 5.0));
    assert!(pack.region_at([3e38, 3e38, 0.0], None).is_some_and(|hit| hit.distance_m > 3e38));
    for point in [[f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0]] {
        assert!(pack.region_at(point, Some(0)).is_none());
    }
    let empty = write(&PackData::new(sample::meta(2))).unwrap();
    assert!(Pack::new(&empty).unwrap().region_at([0.0; 3], None).is_none());
}

/// Found by the fuzzer: in f32 the volume of such a box is infinity times nothing.
#[test]
fn a_box_without_thickness_and_without_end_has_no_volume() {
    let mut data = PackData::new(sample::meta(2));
    data.regions = sample::house();
    data.regions.regions[3].min = [-f32::MAX, 0.0, 0.0];
    data.regions.regions[3].max = [f32::MAX, 0.0, 4.0];
    let bytes = write(&data).unwrap();
    let pack = Pack::new(&bytes).unwrap();
    assert_eq!(pack.region(3).unwrap().volume(), 0.0);
    assert_eq!(pack.region_at([1.0, 0.0, 1.0], None).map(|hit| hit.region), Some(3));
}

/// A room whose floor is an infinite plane: AO is (1 + n·up) / 2 in both forms, at every point and normal.
#[test]
fn a_plane_is_exact_in_both_forms() {
    let mut coefficients = vec![[0.0; 7]; 2 * HARMONICS];
    for channel in coefficients.chunks_exact_mut(HARMONICS) {
        channel[0][0] = PI.sqrt();
        channel[1][0] = (PI / 3.0).sqrt();
    }
    let mut data = PackData::new(sample::meta(2));
    data.regions = sample::house();
    data.regions.models[0] = ModelData { region: 0, center: [2.0, 1.0, 2.0], coefficients };
    let bytes = write(&data).unwrap();
    let pack = Pack::new(&bytes).unwrap();
    for (point, normal) in
        [([0.5, 0.1, 3.0], [0.0, 1.0, 0.0]), ([9.0, 9.0, 9.0], [0.6, 0.0, 0.8]), ([2.0, 1.0, 2.0], [0.0, -0.8, 0.6])]
    {
        let expected = (1.0 + normal[1]) / 2.0;
        let full = ao_quadratic(pack.full_at(0, point, 1).unwrap(), normal);
        assert!((full - expected).abs() < 1e-6, "{full}");
        // Half floats have eleven binary digits.
        let engine = ao_linear(pack.engine_at(0, point).unwrap(), normal);
        assert!((engine - expected).abs() < 5e-4, "{engine}");
    }
}

/// A closed room is brightest in the middle and falls to each wall, and outside its box it is what it is at the wall.
#[test]
fn a_room_falls_to_its_walls_and_no_further() {
    let bytes = house();
    let pack = Pack::new(&bytes).unwrap();
    let ao = |point| ao_linear(pack.engine_at(0, point).unwrap(), [0.0, 0.0, 1.0]);
    let middle = ao([2.0, 1.5, 2.0]);
    for wall in [[0.0, 1.5, 2.0], [4.0, 1.5, 2.0], [2.0, 0.0, 2.0], [2.0, 3.0, 2.0], [2.0, 1.5, 0.0], [2.0, 1.5, 4.0]] {
        assert!(ao(wall) < middle - 0.01, "{wall:?}");
        let beyond = std::array::from_fn(|i| 2.0 + (wall[i] - 2.0) * 1.0 + (wall[i] - [2.0, 1.5, 2.0][i]) * 100.0);
        assert_eq!(ao(beyond), ao(wall));
    }
}

/// Full and engine form say the same but for the quadratic harmonics and the rounding of halves.
#[test]
fn the_forms_agree() {
    let bytes = house();
    let pack = Pack::new(&bytes).unwrap();
    for point in [[0.3, 0.2, 3.1], [2.0, 1.5, 2.0], [3.9, 2.9, 0.2]] {
        let engine = pack.engine_at(0, point).unwrap();
        for (k, coefficient) in engine.into_iter().enumerate() {
            let channels: Vec<f32> = (0..2).map(|channel| pack.full_at(0, point, channel).unwrap()[k]).collect();
            let blend = kiln_runtime::blend_channels(&channels, pack.meta().blend());
            assert!((coefficient - blend).abs() < 2e-3, "{coefficient} {blend}");
        }
    }
    assert!(pack.full_at(0, [0.0; 3], 2).is_none() && pack.engine_at(4, [0.0; 3]).is_none());
}

#[test]
fn crossing_a_boundary_is_not_seen_as_a_jump() {
    let bytes = house();
    let pack = Pack::new(&bytes).unwrap();
    let blend = TemporalBlend::default();
    let ao = |coefficients| ao_linear(coefficients, [0.0, 1.0, 0.0]);
    let mut object = MovingObject::new();
    let before = ao(object.update(&pack, [3.99, 1.0, 2.0], 0.0, blend).unwrap());
    let target = ao(pack.engine_at(1, [4.01, 1.0, 2.0]).unwrap());
    assert!((before - target).abs() > 0.1, "the sample has a jump");
    let mut shown = before;
    for frame in 0..60 {
        let now = ao(object.update(&pack, [4.01, 1.0, 2.0], 1.0 / 60.0, blend).unwrap());
        assert!((now - shown).abs() < 0.11 * (before - target).abs() + 1e-6, "frame {frame}: {shown} to {now}");
        shown = now;
    }
    assert!((shown - target).abs() < 0.002 && object.region() == Some(1));
    assert!(object.update(&pack, [f32::NAN; 3], 0.1, blend).is_none());
    assert_eq!(object.region(), Some(1));
    // Without a half-time it is there at once.
    let instant = TemporalBlend { half_time_secs: 0.0 };
    let now = object.update(&pack, [3.0, 1.0, 2.0], 0.0, instant);
    assert_eq!(now, pack.engine_at(0, [3.0, 1.0, 2.0]));
}
