//! The fit of four numbers: `min_y Σ w (f − G_y L)²`.
//!
//! With weights `W = w L²` this is the regression of `f / L` on u, solved as such: about the W-weighted mean of u, where the
//! constant is the mean of `f / L` and has nothing to do with the slopes, and then by the eigenvectors of the 3×3
//! covariance of u. That reveals the rank in whatever direction it is lost (a billboard need not stand along an axis),
//! needs no allocation, and gives a direction that is missing exactly no gradient, as the shortest solution has.
//!
//! Forming the covariance squares the condition, which is harmless here: u is in [−1, 1]³ by construction, and a direction
//! in which the samples spread by less than a hundredth of the box is dropped because what it would tell is noise times
//! a hundred, long before rounding matters. For the same reason columns are not scaled: scaling would hide it. A
//! QR factorisation of the tall matrix would need room for it, for digits that are then cut off.
//!
//! There is no ridge, so the fit is the least one and exact data come back exactly. What bounds it is [`GLOBAL_BOUND`]: a
//! fit beyond goes back on the line to its own constant until it is within. On that line the error rises steadily, so a bounded
//! fit is never worse than the constant alone.

use super::{eigen::symmetric_eigen, samples::ModelSamples};

/// The greatest `|y0| + |y1| + |y2| + |y3|`, and so the greatest |G| in the model's box. 1 is open, as the model alone is.
pub const GLOBAL_BOUND: f64 = 4.0;

/// What f32 rounding of four numbers cannot take above the bound.
pub(crate) const INNER_BOUND: f64 = GLOBAL_BOUND * (1.0 - 1e-6);

/// A direction has a slope if the W-weighted variance of u along it is above this.
const LEAST_VARIANCE: f64 = 1e-4;

/// Samples with less local AO than this say nothing of G.
const LEAST_LOCAL: f64 = 1e-3;

/// As many samples as unknowns.
const LEAST_USEFUL: usize = 4;

/// The global function of one instance for one channel (or for the blend), and how well it does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeFit {
    /// y0 to y3 of `G = y0 + y1 u_x + y2 u_y + y3 u_z`; their absolute values add up to [`GLOBAL_BOUND`] at most.
    pub y: [f32; 4],
    /// `Σ w (f − G L)²` over the valid samples, of y as it is here.
    pub squared_error: f64,
    /// `Σ w` over the valid samples.
    pub weight: f64,
    /// What the samples determine: 0 nothing, 1 the constant, 4 all.
    pub rank: u8,
    /// Valid samples with weight whose local AO is not next to 0.
    pub useful: usize,
}

impl TreeFit {
    /// The fit to nothing: G is 1.
    pub const NONE: Self = Self { y: [1.0, 0.0, 0.0, 0.0], squared_error: 0.0, weight: 0.0, rank: 0, useful: 0 };

    /// Root of the weighted mean squared error; 0 without samples.
    pub fn rmse(&self) -> f64 {
        rmse(self.squared_error, self.weight)
    }

    /// G at a position in the model's box.
    pub fn global(&self, unit: &[f64; 3]) -> f64 {
        global(&self.y, unit)
    }
}

/// Root of a mean, 0 of nothing.
pub(crate) fn rmse(squared_error: f64, weight: f64) -> f64 {
    if weight > 0.0 { (squared_error / weight).sqrt() } else { 0.0 }
}

/// `y0 + y1 u_x + y2 u_y + y3 u_z`.
pub(crate) fn global(y: &[f32; 4], unit: &[f64; 3]) -> f64 {
    let [y0, y1, y2, y3] = y.map(f64::from);
    y0 + y1 * unit[0] + y2 * unit[1] + y3 * unit[2]
}

/// A value of the signal, clamped to [0, 1]; `None` where it is not finite, which means not valid.
pub(crate) fn known(value: f32) -> Option<f64> {
    value.is_finite().then(|| f64::from(value).clamp(0.0, 1.0))
}

/// One valid sample with weight: its weight, u, L and f.
type Point = (f64, [f64; 3], f64, f64);

/// The valid samples that have weight, where `pair` gives L and f.
fn points<'a>(
    samples: &'a ModelSamples,
    pair: &'a impl Fn(usize) -> Option<(f64, f64)>,
) -> impl Iterator<Item = Point> + 'a {
    let weighed = samples.weight.iter().zip(&samples.unit).enumerate().filter(|(_, (weight, _))| **weight > 0.0);
    weighed.filter_map(|(index, (weight, unit))| pair(index).map(|(local, f)| (*weight, *unit, local, f)))
}

/// Fits one signal; `pair` gives L and f of a sample, both in [0, 1], or nothing where it is not valid.
///
/// Without a valid sample y is 1, 0, 0, 0. Where L is next to 0 everywhere, y0 is the mean of f. With fewer than four
/// useful samples y0 is the best constant. Otherwise directions without spread have no gradient.
#[expect(clippy::cast_possible_truncation, reason = "f32 is what an engine gets")]
pub(crate) fn fit(samples: &ModelSamples, pair: impl Fn(usize) -> Option<(f64, f64)>) -> TreeFit {
    let sums = Sums::new(points(samples, &pair));
    let (y, rank) = sums.solve(|| points(samples, &pair));
    let y = y.map(|y| y as f32);
    TreeFit { y, squared_error: squared_error(samples, &y, &pair), weight: sums.weight, rank, useful: sums.useful }
}

/// `Σ w (f − G L)²` over the valid samples, in their order.
pub(crate) fn squared_error(samples: &ModelSamples, y: &[f32; 4], pair: &impl Fn(usize) -> Option<(f64, f64)>) -> f64 {
    points(samples, pair).map(|(weight, unit, local, f)| weight * (f - global(y, &unit) * local).powi(2)).sum()
}

/// What a first pass over the samples tells.
#[derive(Default)]
struct Sums {
    /// `Σ w`.
    weight: f64,
    /// `Σ w f`.
    signal: f64,
    /// `Σ w L²`.
    energy: f64,
    /// `Σ w L f`.
    product: f64,
    /// `Σ w L² u`.
    moment: [f64; 3],
    useful: usize,
}

impl Sums {
    fn new(points: impl Iterator<Item = Point>) -> Self {
        let mut sums = Self::default();
        for (weight, unit, local, f) in points {
            let energy = weight * local * local;
            sums.weight += weight;
            sums.signal += weight * f;
            sums.energy += energy;
            sums.product += weight * local * f;
            sums.moment.iter_mut().zip(unit).for_each(|(sum, u)| *sum += energy * u);
            sums.useful += usize::from(local >= LEAST_LOCAL);
        }
        sums
    }

    /// y and the rank.
    fn solve<I: Iterator<Item = Point>>(&self, points: impl FnOnce() -> I) -> ([f64; 4], u8) {
        if self.weight <= 0.0 {
            return ([1.0, 0.0, 0.0, 0.0], 0);
        }
        if self.energy <= LEAST_LOCAL * LEAST_LOCAL * self.weight {
            return ([self.signal / self.weight, 0.0, 0.0, 0.0], 0);
        }
        let constant = self.product / self.energy;
        let center = self.moment.map(|sum| sum / self.energy);
        let enough = self.useful >= LEAST_USEFUL;
        let (slope, rank) = if enough { self.slope(points(), constant, center) } else { ([0.0; 3], 0) };
        (bounded(constant, slope, center), rank + 1)
    }

    /// The gradient by a second pass about the centre, and in how many directions there is one.
    fn slope(&self, points: impl Iterator<Item = Point>, constant: f64, center: [f64; 3]) -> ([f64; 3], u8) {
        let (mut covariance, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
        for (weight, unit, local, f) in points {
            let offset: [f64; 3] = std::array::from_fn(|k| unit[k] - center[k]);
            for i in 0..3 {
                right[i] += weight * local * offset[i] * (f - constant * local);
                (0..3).for_each(|j| covariance[i][j] += weight * local * local * offset[i] * offset[j]);
            }
        }
        let (mut slope, mut rank) = ([0.0; 3], 0);
        for (value, direction) in symmetric_eigen(covariance) {
            if value > LEAST_VARIANCE * self.energy {
                let along = direction.iter().zip(right).map(|(d, r)| d * r).sum::<f64>() / value;
                slope.iter_mut().zip(direction).for_each(|(s, d)| *s += along * d);
                rank += 1;
            }
        }
        (slope, rank)
    }
}

/// The four numbers of `constant + slope · (u − center)`, with as much of the slope as the bound allows. The constant is
/// not negative, because f and L are not.
fn bounded(constant: f64, slope: [f64; 3], center: [f64; 3]) -> [f64; 4] {
    let constant = constant.clamp(0.0, INNER_BOUND);
    let shift: f64 = slope.iter().zip(center).map(|(s, c)| s * c).sum();
    let steepness: f64 = slope.iter().map(|s| s.abs()).sum();
    // |constant − t shift| + t steepness ≤ bound, by the two signs of what is within.
    let mut part = 1.0f64;
    for (room, growth) in [(INNER_BOUND - constant, steepness - shift), (INNER_BOUND + constant, steepness + shift)] {
        if growth > 0.0 {
            part = part.min(room / growth);
        }
    }
    [constant - part * shift, part * slope[0], part * slope[1], part * slope[2]]
}
