//! Boxes of fog that overlap: each is thinned by what it shares, so that equal boxes in one place are as dense as one.

use glam::{DAffine3, DMat3, DVec3};
use kiln_core::Bounds;
use rayon::prelude::*;

/// Points along each edge of a box by which the part of it that is in a turned box is estimated.
const POINTS: u32 = 8;

/// A box whose sides may be turned.
#[derive(Clone, Copy, Debug)]
pub struct OrientedBox {
    /// From the cube [−1, 1]³.
    world_from_cube: DAffine3,
    cube_from_world: DAffine3,
    /// An upright box around it.
    around: Bounds,
}

impl OrientedBox {
    /// An object-space box under a transform.
    pub fn new(bounds: &Bounds, world_from_object: &DAffine3) -> Self {
        let half = 0.5 * (bounds.max - bounds.min);
        let world_from_cube = *world_from_object
            * DAffine3::from_scale_rotation_translation(half, glam::DQuat::IDENTITY, bounds.center());
        let m = world_from_cube.matrix3;
        let reach = m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs();
        let center = world_from_cube.translation;
        Self {
            world_from_cube,
            cube_from_world: world_from_cube.inverse(),
            around: Bounds { min: center - reach, max: center + reach },
        }
    }

    fn has_volume(&self) -> bool {
        let volume = self.world_from_cube.matrix3.determinant();
        self.cube_from_world.is_finite() && volume.is_finite() && volume != 0.0
    }

    /// The part of this box that is in another, 0 to 1: exact where their sides are parallel, else by points.
    fn part_in(&self, other: &Self) -> f64 {
        let between = other.cube_from_world * self.world_from_cube;
        match upright(&between.matrix3) {
            Some(half) => {
                // This box as the other's cube sees it.
                let (low, high) = (between.translation - half, between.translation + half);
                let shared = (high.min(DVec3::ONE) - low.max(DVec3::NEG_ONE)).max(DVec3::ZERO);
                (shared / (2.0 * half)).element_product()
            }
            None => {
                let at = |i: u32| (f64::from(2 * i + 1) / f64::from(POINTS)) - 1.0;
                let points = (0..POINTS.pow(3))
                    .map(|i| DVec3::new(at(i % POINTS), at(i / POINTS % POINTS), at(i / POINTS / POINTS)));
                let inside = points.filter(|point| between.transform_point3(*point).abs().max_element() <= 1.0).count();
                inside as f64 / f64::from(POINTS.pow(3))
            }
        }
    }
}

/// Half the sides of an upright box that a matrix makes of the cube; `None` if it turns it.
fn upright(m: &DMat3) -> Option<DVec3> {
    let columns = [m.x_axis, m.y_axis, m.z_axis];
    let half = columns.iter().fold(DVec3::ZERO, |sum, column| sum + column.abs());
    // Of an upright box each column has one entry that counts, and each row gets one.
    let has_one_entry = |column: &DVec3| column.abs().max_element() > (1.0 - 1e-9) * column.abs().element_sum();
    let is_upright = columns.iter().all(has_one_entry) && half.min_element() > 0.0;
    let fills_rows = (0..3).all(|row| {
        let entries = columns.map(|column| column[row].abs());
        entries.into_iter().fold(0.0, f64::max) > (1.0 - 1e-9) * half[row]
    });
    (is_upright && fills_rows).then_some(half)
}

/// By how much the density of each box is reduced: `V_k / (V_k + Σ_j V_{k∩j})`, over all others. Boxes without volume are not
/// reduced, and reduce none.
pub fn thinned(boxes: &[OrientedBox]) -> Vec<f64> {
    let mut order: Vec<u32> = (0..boxes.len() as u32).filter(|&i| boxes[i as usize].has_volume()).collect();
    let least = |index: u32| boxes[index as usize].around.min.x;
    order.sort_by(|a, b| least(*a).total_cmp(&least(*b)));
    let widest = order.iter().map(|&i| boxes[i as usize].around.max.x - least(i)).fold(0.0, f64::max);
    let part = |index: usize| {
        let this = &boxes[index];
        if !this.has_volume() {
            return 1.0;
        }
        let first = order.partition_point(|&other| least(other) < this.around.min.x - widest);
        let near = order[first..].iter().take_while(|&&other| least(other) <= this.around.max.x);
        let overlaps =
            |other: &&u32| **other as usize != index && do_overlap(&this.around, &boxes[**other as usize].around);
        let mut parts: Vec<f64> = near.filter(overlaps).map(|&other| this.part_in(&boxes[other as usize])).collect();
        // In an order that is not that of the instances.
        parts.sort_by(f64::total_cmp);
        1.0 / (1.0 + parts.iter().sum::<f64>())
    };
    (0..boxes.len()).into_par_iter().map(part).collect()
}

fn do_overlap(a: &Bounds, b: &Bounds) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    fn unit(world_from_object: DAffine3) -> OrientedBox {
        OrientedBox::new(&Bounds { min: DVec3::splat(-0.5), max: DVec3::splat(0.5) }, &world_from_object)
    }

    fn at(x: f64) -> DAffine3 {
        DAffine3::from_translation(DVec3::X * x)
    }

    #[test]
    fn equal_boxes_in_one_place_are_as_one() {
        for turn in [0.0, 0.7] {
            let place = DAffine3::from_rotation_y(turn);
            for count in 1..6 {
                let parts = thinned(&vec![unit(place); count]);
                assert!(parts.iter().all(|part| (part - 1.0 / count as f64).abs() < 1e-12), "{parts:?}");
            }
        }
    }

    #[test]
    fn what_is_shared_counts_by_its_volume() {
        let parts = thinned(&[unit(at(0.0)), unit(at(0.75)), unit(at(5.0))]);
        assert!((parts[0] - 1.0 / 1.25).abs() < 1e-12 && (parts[1] - parts[0]).abs() < 1e-12 && parts[2] == 1.0);
        // A small box in a large one: all of it is shared, little of the large one.
        let parts = thinned(&[unit(DAffine3::from_scale(DVec3::splat(2.0))), unit(at(0.3))]);
        assert!((parts[0] - 1.0 / 1.125).abs() < 1e-12 && (parts[1] - 0.5).abs() < 1e-12);
        // Turned by a right angle it is still exact.
        let turned = at(0.75) * DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2);
        assert!((thinned(&[unit(at(0.0)), unit(turned)])[0] - 0.8).abs() < 1e-9);
    }

    #[test]
    fn turned_boxes_are_estimated() {
        // A cube turned by 45° about an axis shares 2 (√2 − 1) of its volume with an upright one.
        let turned = unit(DAffine3::from_rotation_y(std::f64::consts::FRAC_PI_4));
        let part = unit(at(0.0)).part_in(&turned);
        assert!((part - 2.0 * (2f64.sqrt() - 1.0)).abs() < 0.05, "{part}");
    }

    #[test]
    fn boxes_without_volume_are_left_alone() {
        let flat = unit(DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)));
        assert_eq!(thinned(&[flat, unit(at(0.0)), flat]), [1.0, 1.0, 1.0]);
    }

    proptest! {
        /// Whatever the order, and no denser than alone.
        #[test]
        fn order_changes_no_bit(places in prop::collection::vec((prop::array::uniform3(-2.0f64..2.0), 0.0f64..6.0, 0.2f64..3.0), 1..20)) {
            let boxes: Vec<OrientedBox> = places.iter().map(|(at, turn, scale)| {
                unit(DAffine3::from_scale_rotation_translation(DVec3::splat(*scale), DQuat::from_rotation_y(*turn), DVec3::from(*at)))
            }).collect();
            let parts = thinned(&boxes);
            let reversed: Vec<OrientedBox> = boxes.iter().rev().copied().collect();
            let mut back = thinned(&reversed);
            back.reverse();
            prop_assert!(parts.iter().all(|part| *part > 0.0 && *part <= 1.0));
            prop_assert_eq!(parts, back);
        }
    }
}
