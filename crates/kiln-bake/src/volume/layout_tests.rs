//! The laws of a layout.

use super::*;
use glam::DVec3;
use kiln_core::{Bounds, codec};
use proptest::prelude::*;

fn bounds(min: [f64; 3], size: [f64; 3]) -> Bounds {
    let min = DVec3::from_array(min);
    Bounds { min, max: min + DVec3::from_array(size) }
}

/// Boxes about the origin and far from it, thin and flat ones among them, some with corners on the lattice.
fn boxes() -> impl Strategy<Value = Vec<Bounds>> {
    let size = prop::array::uniform3(prop_oneof![Just(0.0), 0.01f64..20.0]);
    let at = prop::array::uniform3(prop_oneof![-30f64..30.0, (-20i32..20).prop_map(|i| f64::from(i) + LATTICE_OFFSET)]);
    let far = prop_oneof![3 => Just(0.0), 1 => -1e5f64..1e5];
    prop::collection::vec((at, size, far).prop_map(|(at, size, far)| bounds(at.map(|x| x + far), size)), 0..6)
}

/// Points of the unit box: in it, on its faces, edges and corners.
fn unit_point() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(prop_oneof![Just(0.0), Just(1.0), 0f64..1.0]).prop_map(DVec3::from_array)
}

/// A point of a box, which rounding does not put out of it.
fn inside(bounds: &Bounds, at: DVec3) -> DVec3 {
    let is_end = at.cmpeq(DVec3::ONE);
    let point = bounds.min + at * (bounds.max - bounds.min);
    DVec3::select(is_end, bounds.max, point).clamp(bounds.min, bounds.max)
}

fn has_stencil(layout: &Layout, point: DVec3) -> bool {
    layout.lattice().stencil(point).is_some_and(|stencil| stencil.corners().all(|(v, _)| layout.slot(v).is_some()))
}

proptest! {
    #[test]
    fn every_point_of_every_box_has_its_eight_voxels(
        boxes in boxes(), spacing_m in prop_oneof![Just(1.0), 0.3f64..3.0], points in prop::collection::vec(unit_point(), 40),
    ) {
        let settings = LayoutSettings { spacing_m, ..LayoutSettings::default() };
        let layout = Layout::new(&boxes, &settings).unwrap();
        for bounds in &boxes {
            for at in &points {
                let point = inside(bounds, *at);
                prop_assert!(has_stencil(&layout, point), "{point} of {bounds:?}");
                // The nearest sides of bricks, exactly where a voxel of the next brick lies.
                let brick = (point / (8.0 * spacing_m)).floor();
                let side = ((brick * 8.0 + LATTICE_OFFSET) * spacing_m).clamp(bounds.min, bounds.max);
                prop_assert!(has_stencil(&layout, side), "{side} of {bounds:?}");
            }
        }
        // None is needed that no point of a box can ask for.
        for voxel in layout.bricks().iter().flat_map(Brick::voxels) {
            let at = (DVec3::from_array(voxel.map(f64::from)) + LATTICE_OFFSET) * spacing_m;
            let reach = DVec3::splat(spacing_m * (1.0 + 1e-9));
            let asks = |b: &Bounds| (b.min - reach).cmple(at).all() && (b.max + reach).cmpge(at).all();
            prop_assert!(boxes.iter().any(asks), "{voxel:?}");
        }
    }

    #[test]
    fn voxels_are_counted_in_their_order(boxes in boxes(), per_batch in 0usize..2000) {
        let layout = Layout::new(&boxes, &LayoutSettings::default()).unwrap();
        prop_assert!(layout.bricks().is_sorted_by(|a, b| a.coordinates < b.coordinates));
        let voxels: Vec<[i32; 3]> = layout.bricks().iter().flat_map(Brick::voxels).collect();
        prop_assert_eq!(voxels.len(), layout.voxel_count());
        for (slot, voxel) in voxels.iter().enumerate() {
            prop_assert_eq!(layout.slot(*voxel), Some(slot));
        }
        let batches = layout.batches(per_batch);
        let all: Vec<usize> = batches.iter().cloned().flatten().collect();
        prop_assert_eq!(all, (0..layout.bricks().len()).collect::<Vec<_>>());
        for batch in batches {
            let count: usize = layout.bricks()[batch.clone()].iter().map(Brick::voxel_count).sum();
            prop_assert!(batch.len() == 1 || count <= per_batch, "{batch:?} has {count}");
        }
    }

    #[test]
    fn other_boxes_neither_move_a_voxel_nor_their_order_anything(boxes in boxes(), other in boxes()) {
        let settings = LayoutSettings::default();
        let alone = Layout::new(&boxes, &settings).unwrap();
        let mut all: Vec<Bounds> = boxes.iter().chain(&other).copied().collect();
        let both = Layout::new(&all, &settings).unwrap();
        for voxel in alone.bricks().iter().flat_map(Brick::voxels) {
            prop_assert!(both.slot(voxel).is_some());
        }
        all.reverse();
        prop_assert_eq!(Layout::new(&all, &settings).unwrap(), both);
    }

    #[test]
    fn layouts_are_read_as_they_were_written(boxes in boxes()) {
        let layout = Layout::new(&boxes, &LayoutSettings::default()).unwrap();
        let read: Layout = codec::decode("a layout", &codec::encode(&layout)).unwrap();
        prop_assert_eq!(read, layout);
    }
}

#[test]
fn a_small_box_takes_eight_voxels() {
    let settings = LayoutSettings::default();
    let layout = Layout::new(&[bounds([0.5; 3], [0.5; 3]), Bounds::EMPTY], &settings).unwrap();
    assert_eq!((layout.voxel_count(), layout.bricks().len()), (8, 1));
    // Across the corner of eight bricks: as many voxels.
    let layout = Layout::new(&[bounds([-0.5; 3], [0.5; 3])], &settings).unwrap();
    assert_eq!((layout.voxel_count(), layout.bricks().len()), (8, 8));
    assert_eq!(Layout::new(&[], &settings).unwrap().batches(100), []);
}

#[test]
fn what_is_too_large_is_refused_before_it_is_made() {
    let refused =
        |size: f64, settings: LayoutSettings| Layout::new(&[bounds([0.5; 3], [size; 3])], &settings).unwrap_err();
    let error = refused(1e6, LayoutSettings::default());
    assert!(matches!(error, VolumeError::TooManyBricks { needed: 1_900_000_000_000_000.., .. }), "{error}");
    let error = refused(20.0, LayoutSettings { max_bricks: 26, ..LayoutSettings::default() });
    assert!(matches!(error, VolumeError::TooManyBricks { needed: 27, limit: 26, .. }), "{error}");
    assert!(matches!(refused(2e6, LayoutSettings::default()), VolumeError::OutOfRange { .. }));
    assert!(matches!(refused(f64::INFINITY, LayoutSettings::default()), VolumeError::OutOfRange { .. }));
    // One by one they are few.
    let row: Vec<Bounds> = (0..5).map(|i| bounds([8.0 * f64::from(i) + 2.0, 2.0, 2.0], [1.0; 3])).collect();
    let settings = LayoutSettings { max_bricks: 4, ..LayoutSettings::default() };
    assert!(matches!(Layout::new(&row, &settings), Err(VolumeError::TooManyBricks { needed: 5, .. })));
    assert!(Layout::new(&row[..4], &settings).is_ok());
}

#[test]
fn layouts_that_are_none_are_refused() {
    let brick = |x: i32| Brick { coordinates: [x, 0, 0], needed: [1; 8] };
    let reason = |spacing_m: f64, bricks: &[Brick]| {
        let bytes = codec::encode(&(spacing_m, bricks));
        codec::decode::<Layout>("a layout", &bytes).map_err(|error| error.to_string()).err()
    };
    assert_eq!(reason(1.0, &[brick(-1), brick(0)]), None);
    let far = Brick { coordinates: [0, i32::MIN, 0], ..brick(0) };
    let empty = Brick { needed: [0; 8], ..brick(0) };
    for (spacing, bricks) in [
        (0.0, vec![brick(0)]),
        (f64::NAN, vec![brick(0)]),
        (1.0, vec![brick(1), brick(0)]),
        (1.0, vec![brick(1), brick(1)]),
        (1.0, vec![far]),
        (1.0, vec![empty]),
    ] {
        assert!(reason(spacing, &bricks).is_some(), "{spacing} {bricks:?}");
    }
}
