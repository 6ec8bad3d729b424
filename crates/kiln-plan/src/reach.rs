//! Which instances the rays of a receiver can come to. The rest is no part of what the receiver's tasks depend on, so an
//! edit there redoes nothing here.

use crate::boxes::{BoxTree, gap};
use glam::DVec3;
use kiln_core::{Bounds, Instance, Level};
use std::collections::BTreeMap;

/// Part of all lengths and coordinates that are involved by which the reach is taken to be greater: far more than what
/// the rounding of rays to f32 can add.
const SLACK: f64 = 1e-4;

/// Receivers are grouped by the cells, of a grid with this part of the reach as its pitch, that they lie in: those of a
/// group have the same occluders, however many they are, and small movements change nothing.
const CELL: f64 = 0.25;

/// What can stop the rays of each receiving instance, and of each visibility region.
#[derive(Debug)]
pub struct Reach {
    /// Occluders of each group of receivers, ascending.
    groups: Vec<Vec<u32>>,
    /// The group of each instance that receives.
    group_of: Vec<Option<usize>>,
    /// The group of each visibility region.
    group_of_region: Vec<usize>,
    /// A box around each group's occluders.
    bounds_m: Vec<Bounds>,
}

impl Reach {
    /// Finds the occluders of each receiver and region. `seen_m` has a box for each instance, metres relative to the level's origin,
    /// that holds its surface and the origins of its rays, rounding included; an empty one for an instance that is not
    /// there.
    pub fn new(level: &Level, seen_m: &[Bounds]) -> Self {
        let reach_m = level.sampling.reach_m();
        // Lower levels of detail stop no rays.
        let occluder = |(instance, seen): (&Instance, &Bounds)| if instance.is_lod() { Bounds::EMPTY } else { *seen };
        let occluders: Vec<Bounds> = level.instances.iter().zip(seen_m).map(occluder).collect();
        let tree = BoxTree::new(&occluders);
        let mut groups = Vec::new();
        let mut known: BTreeMap<[u64; 6], usize> = BTreeMap::new();
        let mut group = |seen: &Bounds| {
            let hull = hull(seen, reach_m);
            let corners = [hull.min, hull.max].map(|corner| corner.to_array().map(f64::to_bits));
            *known.entry(std::array::from_fn(|i| corners[i / 3][i % 3])).or_insert_with(|| {
                groups.push(tree.find(|other| is_within(&hull, other, reach_m)));
                groups.len() - 1
            })
        };
        let instances = level.instances.iter().zip(seen_m);
        let group_of = instances.map(|(instance, seen)| instance.receives.then(|| group(seen))).collect();
        let around = |occluders: &Vec<u32>| {
            let mut bounds = Bounds::EMPTY;
            occluders.iter().for_each(|index| bounds.merge(&seen_m[*index as usize]));
            bounds
        };
        let regions = level.regions.regions.iter();
        let group_of_region = regions.map(|region| group(&region.bounds)).collect();
        let bounds_m = groups.iter().map(around).collect();
        Self { groups, group_of, group_of_region, bounds_m }
    }

    /// How many groups of receivers have occluders of their own.
    pub fn group_count(&self) -> usize {
        self.groups.len()
    }

    /// The occluders of a group, as ascending indices of instances.
    pub fn occluders(&self, group: usize) -> &[u32] {
        &self.groups[group]
    }

    /// A box around the occluders of a group, metres relative to the level's origin.
    pub fn bounds_m(&self, group: usize) -> Bounds {
        self.bounds_m[group]
    }

    /// The group of an instance; `None` if it does not receive.
    pub fn group(&self, instance: usize) -> Option<usize> {
        self.group_of.get(instance).copied().flatten()
    }

    /// The group of a visibility region; `None` if there is no such region.
    pub fn group_of_region(&self, region: usize) -> Option<usize> {
        self.group_of_region.get(region).copied()
    }

    /// For each instance whether some receiver's rays can come to it.
    pub fn is_reached(&self) -> Vec<bool> {
        let mut reached = vec![false; self.group_of.len()];
        self.groups.iter().flatten().for_each(|&index| reached[index as usize] = true);
        reached
    }
}

/// The cells that a box lies in; an empty box stays empty.
fn hull(seen: &Bounds, reach_m: f64) -> Bounds {
    let cell = (reach_m * CELL).log2().floor().exp2();
    if !cell.is_normal() || seen.is_empty() {
        return *seen;
    }
    let snap = |corner: DVec3, round: fn(f64) -> f64| DVec3::from(corner.to_array().map(|x| round(x / cell) * cell));
    Bounds { min: snap(seen.min, f64::floor), max: snap(seen.max, f64::ceil) }
}

/// Whether rays from one box may come to another.
fn is_within(from: &Bounds, to: &Bounds, reach_m: f64) -> bool {
    let largest = |bounds: &Bounds| bounds.min.abs().max(bounds.max.abs()).max_element();
    let slack = SLACK * (reach_m + largest(from) + largest(to));
    // What is not finite is within reach of everything.
    let distance = gap(from, to);
    !to.is_empty() && !from.is_empty() && (distance.is_nan() || distance <= reach_m + slack)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cube(center: [f64; 3], half: f64) -> Bounds {
        let center = DVec3::from(center);
        Bounds { min: center - half, max: center + half }
    }

    proptest! {
        #[test]
        fn nothing_within_reach_is_left_out(
            boxes in prop::collection::vec((prop::array::uniform3(-500.0..500.0f64), 0.0..50.0f64), 1..60),
            half_distance_m in 0.1..60.0f64,
        ) {
            let seen: Vec<Bounds> = boxes.iter().map(|&(center, half)| cube(center, half)).collect();
            let level = crate::tests::level_of(seen.len(), half_distance_m);
            let reach_m = level.sampling.reach_m();
            let reach = Reach::new(&level, &seen);
            for (index, bounds) in seen.iter().enumerate() {
                let occluders = reach.occluders(reach.group(index).unwrap());
                prop_assert!(occluders.is_sorted());
                for (other, to) in seen.iter().enumerate() {
                    let (distance, found) = (gap(bounds, to), occluders.contains(&(other as u32)));
                    prop_assert!(found || distance > reach_m, "{index} {other} {distance} {reach_m}");
                    // The cells add at most their diagonal.
                    prop_assert!(!found || distance < 1.5 * reach_m + 0.5, "{index} {other} {distance} {reach_m}");
                }
            }
        }
    }

    #[test]
    fn without_an_end_rays_reach_everything_that_is_there() {
        let seen = [cube([0.0; 3], 1.0), cube([1e6, 0.0, 0.0], 1.0), Bounds::EMPTY];
        let mut level = crate::tests::level_of(3, 1.0);
        assert_eq!(Reach::new(&level, &seen).is_reached(), [true, true, false]);
        level.instances[1].receives = false;
        let reach = Reach::new(&level, &seen);
        assert_eq!((reach.is_reached(), reach.group(1)), (vec![true, false, false], None));
        level.sampling.no_skip.insert(kiln_core::SkipRule::Reach);
        assert_eq!(Reach::new(&level, &seen).is_reached(), [true, true, false]);
    }

    #[test]
    fn what_is_not_finite_is_within_reach_of_everything() {
        let everywhere = Bounds { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY };
        let seen = [everywhere, cube([1e6, 0.0, 0.0], 1.0), cube([-1e6, 0.0, 0.0], 1.0)];
        let reach = Reach::new(&crate::tests::level_of(3, 1.0), &seen);
        let occluders = |instance| reach.occluders(reach.group(instance).unwrap());
        assert_eq!([occluders(0), occluders(1), occluders(2)], [&[0, 1, 2][..], &[0, 1], &[0, 2]]);
    }
}
