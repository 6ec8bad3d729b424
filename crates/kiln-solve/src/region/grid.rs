//! The valid points of one region as sums over its grid, and lengths relative to a box.

use super::harmonics::{NORMALS, at_axes};
use glam::DVec3;
use kiln_core::{Bounds, CANDIDATES_PER_AXIS, CandidateBits, REGION_HARMONICS, Region};

/// Slabs of a grid along each axis.
pub(crate) const SLABS: usize = CANDIDATES_PER_AXIS;

/// Pairs of different axes.
pub(crate) const PAIRS: [[usize; 2]; 3] = [[0, 1], [0, 2], [1, 2]];

/// AO for each normal along an axis, the least and the greatest.
pub(crate) type Range = [[f64; 2]; NORMALS];

/// The range of nothing.
const NO_RANGE: Range = [[f64::INFINITY, f64::NEG_INFINITY]; NORMALS];

/// What a region's points add to the normal equations, whatever the centre. K is the number of harmonics of all
/// channels.
#[derive(Clone, Debug)]
pub(crate) struct Grid {
    /// The region's box, metres.
    pub(crate) bounds: Bounds,
    /// Number of points.
    pub(crate) count: f64,
    /// Points of each slab, for each axis.
    pub(crate) slab_counts: [[f64; SLABS]; 3],
    /// Points of each pair of slabs, for each of [`PAIRS`].
    pub(crate) pair_counts: [[[f64; SLABS]; SLABS]; 3],
    /// The mean of each harmonic, K; an open sky's where there is no point.
    pub(crate) mean: Vec<f64>,
    /// Sums of squares about the mean, K.
    pub(crate) squares: Vec<f64>,
    /// Sums about the mean over each slab, `3 axes × 8 slabs × K`.
    pub(crate) slab_values: Vec<f64>,
    /// The range over the points, for each channel.
    pub(crate) ranges: Vec<Range>,
}

impl Grid {
    /// Takes the values of a region's valid points in order, `points × channels × harmonics`, whose number is right.
    pub(crate) fn new(region: &Region, valid: &CandidateBits, values: &[f32], channels: usize) -> Self {
        let width = channels * REGION_HARMONICS;
        let mut grid = Self {
            bounds: region.bounds,
            count: valid.count() as f64,
            slab_counts: [[0.0; SLABS]; 3],
            pair_counts: [[[0.0; SLABS]; SLABS]; 3],
            mean: mean(values, width),
            squares: vec![0.0; width],
            slab_values: vec![0.0; 3 * SLABS * width],
            ranges: vec![NO_RANGE; channels],
        };
        for (index, values) in valid.iter().zip(values.chunks_exact(width)) {
            grid.add([index % 8, index / 8 % 8, index / 64], values);
        }
        grid
    }

    fn add(&mut self, cell: [usize; 3], values: &[f32]) {
        (0..3).for_each(|axis| self.slab_counts[axis][cell[axis]] += 1.0);
        for (counts, [a, b]) in self.pair_counts.iter_mut().zip(PAIRS) {
            counts[cell[a]][cell[b]] += 1.0;
        }
        for (range, values) in self.ranges.iter_mut().zip(values.chunks_exact(REGION_HARMONICS)) {
            widen(range, &at_axes(|k| f64::from(values[k])).map(|ao| [ao, ao]));
        }
        let width = self.mean.len();
        for (k, value) in values.iter().enumerate() {
            let offset = f64::from(*value) - self.mean[k];
            self.squares[k] += offset * offset;
            (0..3).for_each(|axis| self.slab_values[(axis * SLABS + cell[axis]) * width + k] += offset);
        }
    }

    /// Sums about the mean over a slab, K.
    pub(crate) fn slab(&self, axis: usize, slab: usize) -> &[f64] {
        let width = self.mean.len();
        &self.slab_values[(axis * SLABS + slab) * width..][..width]
    }

    /// Where a slab's points are along its axis, metres, as [`Region::candidate`] has it.
    pub(crate) fn coordinate(&self, axis: usize, slab: usize) -> f64 {
        let [min, max] = [self.bounds.min[axis], self.bounds.max[axis]];
        min + (max - min) * ((slab as f64 + 0.5) / SLABS as f64)
    }
}

/// The mean of each column; an open sky's without rows.
fn mean(values: &[f32], width: usize) -> Vec<f64> {
    if values.is_empty() {
        let open = |k: usize| if k.is_multiple_of(REGION_HARMONICS) { super::OPEN_SKY } else { 0.0 };
        return (0..width).map(open).collect();
    }
    let mut sums = vec![0.0; width];
    for row in values.chunks_exact(width) {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += f64::from(*value));
    }
    let count = (values.len() / width) as f64;
    sums.into_iter().map(|sum| sum / count).collect()
}

/// Makes a range contain another.
pub(crate) fn widen(range: &mut Range, other: &Range) {
    for ([low, high], [other_low, other_high]) in range.iter_mut().zip(other) {
        (*low, *high) = (low.min(*other_low), high.max(*other_high));
    }
}

/// A box's middle and half-extents: lengths in the box are scaled to [−1, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    /// Metres.
    pub(crate) middle: DVec3,
    /// Metres; 0 along axes without extent.
    pub(crate) half: DVec3,
}

/// An axis of less half-extent has none, metres: slopes per metre must fit in f32.
const LEAST_HALF: f64 = 1e-30;

impl Scale {
    pub(crate) fn new(bounds: &Bounds) -> Self {
        let half = 0.5 * (bounds.max - bounds.min);
        let kept = |half: f64| if half >= LEAST_HALF { half } else { 0.0 };
        Self { middle: bounds.center(), half: DVec3::new(kept(half.x), kept(half.y), kept(half.z)) }
    }

    /// A slope per metre from one per half-extent, or a scaled length from metres: 0 along axes without extent.
    pub(crate) fn divide(&self, axis: usize, value: f64) -> f64 {
        if self.half[axis] > 0.0 { value / self.half[axis] } else { 0.0 }
    }

    /// A scaled coordinate from metres.
    pub(crate) fn coordinate(&self, axis: usize, position: f64) -> f64 {
        self.divide(axis, position - self.middle[axis])
    }

    /// Metres from scaled coordinates.
    pub(crate) fn position(&self, scaled: [f64; 3]) -> DVec3 {
        self.middle + self.half * DVec3::from_array(scaled)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region() -> Region {
        let bounds = Bounds { min: DVec3::new(1.0, -2.0, 5.0), max: DVec3::new(2.0, 6.0, 5.0) };
        Region { id: "flat".into(), bounds, valid: None }
    }

    #[test]
    fn sums_are_those_of_the_points() {
        let mut valid = CandidateBits::default();
        [1 + 8 * 2 + 64 * 3, 1 + 8 * 5 + 64 * 3].into_iter().for_each(|index| valid.insert(index));
        let values: Vec<f32> = (0..18).map(|i| i as f32).collect();
        let grid = Grid::new(&region(), &valid, &values, 1);
        assert_eq!((grid.count, grid.mean[2], grid.squares[2]), (2.0, 6.5, 40.5));
        assert_eq!((grid.slab_counts[0][1], grid.slab_counts[1][5], grid.pair_counts[0][1][2]), (2.0, 1.0, 1.0));
        assert_eq!((grid.slab(0, 1)[2], grid.slab(1, 2)[2], grid.slab(1, 5)[2]), (0.0, -4.5, 4.5));
        let [low, high] = grid.ranges[0][4];
        assert!((high - low - at_axes(|_| 9.0)[4]).abs() < 1e-12);
        for index in valid.iter() {
            let point = region().candidate(index);
            assert_eq!(point.y, grid.coordinate(1, index / 8 % 8));
        }
    }

    #[test]
    fn lengths_are_relative_to_the_box() {
        let scale = Scale::new(&region().bounds);
        assert_eq!((scale.coordinate(0, 2.0), scale.coordinate(1, 0.0), scale.coordinate(2, 9.0)), (1.0, -0.5, 0.0));
        assert_eq!(scale.position([1.0, -0.5, 0.7]), DVec3::new(2.0, 0.0, 5.0));
    }
}
