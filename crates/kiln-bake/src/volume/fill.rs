//! Values for voxels that lie inside of something.
//!
//! A voxel that sees many backs of faces is in a wall or under the ground: what it sees says nothing of the outside. It takes
//! the mean of the valid voxels around it, a few times over, each time from the values before (Sloan et al. 2013 leave
//! open how; a zero would darken every point beside it).

use super::{Brick, Layout, VolumeCounts};
use kiln_trace::HARMONICS;

/// Times that values are handed on: as many voxels deep they go.
const ROUNDS: usize = 4;

/// A voxel without a value, and the weights of its neighbours.
struct Hole {
    slot: usize,
    neighbours: Vec<(usize, f64)>,
}

/// Gives every voxel that is not valid a value. `coefficients` has `stride` for each voxel, [`HARMONICS`] a channel.
pub(crate) fn fill(layout: &Layout, stride: usize, is_valid: &[bool], coefficients: &mut [f32]) -> VolumeCounts {
    let valid = is_valid.iter().filter(|valid| **valid).count();
    let mut counts = VolumeCounts { valid, ..VolumeCounts::default() };
    let mut holes = holes(layout, is_valid);
    let mut is_known = is_valid.to_vec();
    for _ in 0..ROUNDS {
        // All from the values before the round.
        let mean = |hole: &Hole| mean_of_known(hole, stride, &is_known, coefficients);
        let found: Vec<Option<Vec<f32>>> = holes.iter().map(mean).collect();
        for (hole, mean) in holes.iter().zip(&found) {
            if let Some(mean) = mean {
                coefficients[hole.slot * stride..][..stride].copy_from_slice(mean);
                is_known[hole.slot] = true;
                counts.filled += 1;
            }
        }
        holes.retain(|hole| !is_known[hole.slot]);
    }
    let rest = if valid > 0 { mean_of_valid(stride, is_valid, coefficients) } else { open_sky(stride) };
    for hole in &holes {
        coefficients[hole.slot * stride..][..stride].copy_from_slice(&rest);
    }
    *(if valid > 0 { &mut counts.averaged } else { &mut counts.opened }) = holes.len();
    counts
}

/// Voxels that are not valid, in the order of all voxels.
fn holes(layout: &Layout, is_valid: &[bool]) -> Vec<Hole> {
    let voxels = layout.bricks().iter().flat_map(Brick::voxels).enumerate();
    let hole = |(slot, voxel)| Hole { slot, neighbours: neighbours(layout, voxel) };
    voxels.filter(|(slot, _)| !is_valid[*slot]).map(hole).collect()
}

/// The up to 26 voxels around one, in a fixed order, by one over their distance.
fn neighbours(layout: &Layout, voxel: [i32; 3]) -> Vec<(usize, f64)> {
    let around = (0..27).filter(|i| *i != 13).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
    let neighbour = |offset: [i32; 3]| {
        let slot = layout.slot(std::array::from_fn(|axis| voxel[axis] + offset[axis]))?;
        let steps = offset.iter().filter(|x| **x != 0).count() as f64;
        Some((slot, 1.0 / steps.sqrt()))
    };
    around.filter_map(neighbour).collect()
}

fn mean_of_known(hole: &Hole, stride: usize, is_known: &[bool], coefficients: &[f32]) -> Option<Vec<f32>> {
    let known = hole.neighbours.iter().filter(|(slot, _)| is_known[*slot]);
    weighted_mean(stride, known.copied(), coefficients)
}

fn mean_of_valid(stride: usize, is_valid: &[bool], coefficients: &[f32]) -> Vec<f32> {
    let valid = is_valid.iter().enumerate().filter(|(_, valid)| **valid).map(|(slot, _)| (slot, 1.0));
    weighted_mean(stride, valid, coefficients).unwrap_or_else(|| open_sky(stride))
}

/// `None` of nothing.
#[expect(clippy::cast_possible_truncation, reason = "f32 is the stored precision")]
fn weighted_mean(stride: usize, voxels: impl Iterator<Item = (usize, f64)>, coefficients: &[f32]) -> Option<Vec<f32>> {
    let (mut sums, mut total) = (vec![0.0; stride], 0.0);
    for (slot, weight) in voxels {
        total += weight;
        for (sum, c) in sums.iter_mut().zip(&coefficients[slot * stride..][..stride]) {
            *sum += weight * f64::from(*c);
        }
    }
    (total > 0.0).then(|| sums.iter().map(|sum| (sum / total) as f32).collect())
}

/// Values of 1 in every direction and channel.
#[expect(clippy::cast_possible_truncation, reason = "f32 is the stored precision")]
fn open_sky(stride: usize) -> Vec<f32> {
    let constant = (4.0 * std::f64::consts::PI).sqrt() as f32;
    (0..stride).map(|i| if i % HARMONICS == 0 { constant } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::LayoutSettings;
    use glam::DVec3;
    use kiln_core::Bounds;

    /// A row of voxels along x, four thick, with a value for each: its x coordinate, in the first coefficient.
    fn row(length: f64) -> (Layout, Vec<i32>, Vec<f32>) {
        let bounds = Bounds { min: DVec3::splat(0.5), max: DVec3::new(length, 2.9, 2.9) };
        let layout = Layout::new(&[bounds], &LayoutSettings::default()).unwrap();
        let xs: Vec<i32> = layout.bricks().iter().flat_map(Brick::voxels).map(|voxel| voxel[0]).collect();
        let values = xs.iter().flat_map(|x| (0..HARMONICS).map(|i| if i == 0 { *x as f32 } else { 0.5 })).collect();
        (layout, xs, values)
    }

    #[test]
    fn holes_take_the_mean_of_what_is_around_them() {
        let (layout, xs, mut values) = row(12.0);
        let before = values.clone();
        let hole = layout.slot([5, 1, 1]).unwrap();
        let is_valid: Vec<bool> = (0..xs.len()).map(|slot| slot != hole).collect();
        values[hole * HARMONICS] = -1e6;
        let counts = fill(&layout, HARMONICS, &is_valid, &mut values);
        assert_eq!((counts.valid, counts.filled, counts.averaged), (xs.len() - 1, 1, 0));
        // Its neighbours are symmetric about it, and no other voxel is touched.
        assert!(values.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn values_go_one_voxel_a_round_and_the_rest_takes_the_mean() {
        let (layout, xs, mut values) = row(12.0);
        // Only the first two sheets of voxels are valid: 0 and 1 on average .5.
        let is_valid: Vec<bool> = xs.iter().map(|x| *x <= 1).collect();
        let counts = fill(&layout, HARMONICS, &is_valid, &mut values);
        let sheet = xs.iter().filter(|x| **x == 0).count();
        assert_eq!((counts.valid, counts.filled), (2 * sheet, ROUNDS * sheet));
        assert_eq!(counts.averaged, xs.len() - (2 + ROUNDS) * sheet);
        for (x, values) in xs.iter().zip(values.chunks(HARMONICS)) {
            let expected = if *x == 0 {
                0.0
            } else if *x as usize <= 1 + ROUNDS {
                1.0
            } else {
                0.5
            };
            assert!((values[0] - expected).abs() < 1e-6 && (values[8] - 0.5).abs() < 1e-6, "{x}: {values:?}");
        }
    }

    #[test]
    fn where_nothing_is_valid_the_sky_is_open() {
        let (layout, xs, mut values) = row(3.0);
        let counts = fill(&layout, HARMONICS, &vec![false; xs.len()], &mut values);
        assert_eq!(counts, VolumeCounts { opened: xs.len(), ..VolumeCounts::default() });
        assert!(values.chunks(HARMONICS).all(|v| (v[0] - 3.544_907_7).abs() < 1e-6 && v[1..] == [0.0; 8]));
    }
}
