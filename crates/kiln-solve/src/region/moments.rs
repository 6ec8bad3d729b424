//! Means and covariances of the columns of the design about a centre, from sums over grids.
//!
//! The columns of the slopes along an axis, `max(d, 0)` and `min(d, 0)` with d the offset from the centre, depend on
//! one coordinate. So does `d ≥ 0`, along which the model changes when the centre moves. Sums of products of two
//! columns are then sums over a grid's slabs, or over pairs of slabs of two axes: some hundred products where 512
//! points would take twenty thousand.

use super::{
    grid::{Grid, PAIRS, SLABS, Scale},
    points::RegionPoints,
    ridge::{RIDGE, Square, frozen},
};
use kiln_core::REGION_PARAMETERS;

/// Columns of the slopes: +x, −x, +y, −y, +z and −z.
pub(crate) const SIDES: usize = 6;

/// With `d ≥ 0` for each axis after them.
const COLUMNS: usize = SIDES + 3;

/// The three columns of an axis at an offset.
fn columns(offset: f64) -> [f64; 3] {
    [offset.max(0.0), offset.min(0.0), f64::from(u8::from(offset >= 0.0))]
}

/// Where the three columns of an axis are among all.
fn place(axis: usize, part: usize) -> usize {
    if part < 2 { 2 * axis + part } else { SIDES + axis }
}

/// The six columns at an offset from the centre.
pub(crate) fn sides(offset: [f64; 3]) -> [f64; SIDES] {
    std::array::from_fn(|i| if i % 2 == 0 { offset[i / 2].max(0.0) } else { offset[i / 2].min(0.0) })
}

/// What normal equations are made of. All are divided by the number of points; without points all are 0.
#[derive(Clone, Debug)]
pub(crate) struct Moments {
    mean: [f64; COLUMNS],
    gram: Square<COLUMNS>,
    /// Covariances with the values, `columns × K`.
    right: Vec<f64>,
    width: usize,
}

impl Moments {
    /// About a centre in the box of `scale`, scaled to it, which need not be the points' own.
    pub(crate) fn new(points: &RegionPoints, scale: &Scale, center: [f64; 3]) -> Self {
        let width = points.mean.len();
        let mut moments =
            Self { mean: [0.0; COLUMNS], gram: [[0.0; COLUMNS]; COLUMNS], right: vec![0.0; COLUMNS * width], width };
        for grid in &points.grids {
            moments.add(grid, &points.mean, scale, center);
        }
        moments.center(points.len().max(1) as f64);
        moments
    }

    fn add(&mut self, grid: &Grid, mean: &[f64], scale: &Scale, center: [f64; 3]) {
        let table: [[[f64; 3]; SLABS]; 3] = std::array::from_fn(|axis| {
            std::array::from_fn(|i| columns(scale.coordinate(axis, grid.coordinate(axis, i)) - center[axis]))
        });
        (0..3).for_each(|axis| self.add_axis(grid, mean, axis, &table[axis]));
        for (counts, [a, b]) in grid.pair_counts.iter().zip(PAIRS) {
            self.add_pair([a, b], counts, &table[a], &table[b]);
        }
    }

    fn add_axis(&mut self, grid: &Grid, mean: &[f64], axis: usize, table: &[[f64; 3]; SLABS]) {
        for part in 0..3 {
            let (row, mut sum) = (place(axis, part), 0.0);
            let right = &mut self.right[row * self.width..][..self.width];
            for (i, count) in grid.slab_counts[axis].iter().enumerate() {
                let column = table[i][part];
                if *count > 0.0 && column != 0.0 {
                    sum += count * column;
                    right.iter_mut().zip(grid.slab(axis, i)).for_each(|(right, value)| *right += column * value);
                    (0..3).for_each(|other| self.gram[row][place(axis, other)] += count * column * table[i][other]);
                }
            }
            self.mean[row] += sum;
            right
                .iter_mut()
                .zip(grid.mean.iter().zip(mean))
                .for_each(|(right, (own, all))| *right += sum * (own - all));
        }
    }

    fn add_pair(
        &mut self,
        [a, b]: [usize; 2],
        counts: &[[f64; SLABS]; SLABS],
        of_a: &[[f64; 3]; SLABS],
        of_b: &[[f64; 3]; SLABS],
    ) {
        for (row, first) in counts.iter().zip(of_a) {
            let mut sums = [0.0; 3];
            for (count, second) in row.iter().zip(of_b) {
                (0..3).for_each(|part| sums[part] += count * second[part]);
            }
            for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                self.gram[place(a, i)][place(b, j)] += first[i] * sums[j];
            }
        }
    }

    /// From sums to means and covariances.
    fn center(&mut self, count: f64) {
        for (a, b) in PAIRS.into_iter().map(|[a, b]| (a, b)) {
            for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (place(a, i), place(b, j)))) {
                self.gram[j][i] = self.gram[i][j];
            }
        }
        self.mean.iter_mut().for_each(|mean| *mean /= count);
        self.right.iter_mut().for_each(|right| *right /= count);
        for (i, row) in self.gram.iter_mut().enumerate() {
            row.iter_mut().zip(self.mean).for_each(|(gram, mean)| *gram = *gram / count - self.mean[i] * mean);
        }
    }

    /// Means of the columns of the slopes.
    pub(crate) fn means(&self) -> [f64; SIDES] {
        std::array::from_fn(|i| self.mean[i])
    }

    /// Covariances of the columns of the slopes.
    pub(crate) fn covariance(&self) -> Square<SIDES> {
        std::array::from_fn(|i| std::array::from_fn(|j| self.gram[i][j]))
    }

    /// Means over the points of products of 1 and the columns of the slopes, with the ridge on slopes. Frozen columns
    /// are 0.
    pub(crate) fn mean_squares(&self) -> Square<REGION_PARAMETERS> {
        let frozen = frozen(&self.covariance());
        let entry = |i: usize, j: usize| match (i, j) {
            (0, 0) => 1.0,
            (0, k) | (k, 0) => {
                if frozen[k - 1] {
                    0.0
                } else {
                    self.mean[k - 1]
                }
            }
            _ if frozen[i - 1] || frozen[j - 1] => 0.0,
            _ => self.gram[i - 1][j - 1] + self.mean[i - 1] * self.mean[j - 1] + if i == j { RIDGE } else { 0.0 },
        };
        std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
    }

    /// Covariances of the columns of the slopes with a harmonic.
    pub(crate) fn right(&self, k: usize) -> [f64; SIDES] {
        std::array::from_fn(|i| self.right[i * self.width + k])
    }

    /// Covariances of an axis' `d ≥ 0` with the columns of the slopes.
    pub(crate) fn step_columns(&self, axis: usize) -> [f64; SIDES] {
        std::array::from_fn(|i| self.gram[SIDES + axis][i])
    }

    /// The covariance of two axes' `d ≥ 0`.
    pub(crate) fn step_pair(&self, a: usize, b: usize) -> f64 {
        self.gram[SIDES + a][SIDES + b]
    }

    /// The covariance of an axis' `d ≥ 0` with a harmonic.
    pub(crate) fn step_right(&self, axis: usize, k: usize) -> f64 {
        self.right[(SIDES + axis) * self.width + k]
    }
}
