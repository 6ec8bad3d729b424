//! A better centre than the mean of the points or the middle of the box: the first along each axis by trial, then by
//! Gauss–Newton steps.
//!
//! The error of the best slopes about a centre is a function of the centre alone (variable projection, Golub and
//! Pereyra 1973; here with Kaufman's approximation of 1975). When the centre moves along an axis, the model changes by
//! the jump of its slope times `d ≥ 0` but for what other columns can say; so a step needs only covariances that the
//! fit has anyway. A step counts only if the error falls.

use super::{
    cholesky::Cholesky,
    moments::{Moments, SIDES},
    points::RegionPoints,
    ridge::{Square, apply, dot, doubled, inverse},
};

/// Between the slabs of a grid, scaled.
const TRIALS: [f64; 7] = [-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75];

const MOST_STEPS: usize = 24;

/// How often a step that gains nothing is halved.
const MOST_HALVINGS: usize = 4;

/// A step that takes less than this part of the error is the last.
const LEAST_GAIN: f64 = 1e-3;

/// The longest step along an axis, scaled.
const LONGEST: f64 = 0.5;

/// The best slopes about a centre.
struct Trial {
    center: [f64; 3],
    moments: Moments,
    inverse: Square<SIDES>,
    /// Mean over the points of the squared error, summed over harmonics and channels.
    error: f64,
}

impl Trial {
    fn new(points: &RegionPoints, center: [f64; 3]) -> Self {
        let moments = Moments::new(points, &points.scale, center);
        let covariance = moments.covariance();
        let inverse = inverse(&covariance);
        let gain = doubled(&covariance, &inverse);
        let of_harmonic = |k: usize| {
            let right = moments.right(k);
            points.variance[k] - dot(&right, &apply(&gain, &right))
        };
        let error = (0..points.mean.len()).map(of_harmonic).sum();
        Self { center, moments, inverse, error }
    }

    /// The step that would be best if the slopes' jumps stayed as they are.
    fn step(&self, points: &RegionPoints) -> [f64; 3] {
        let steps = [0, 1, 2].map(|axis| self.moments.step_columns(axis));
        let (mut jumps, mut gradient) = ([[0.0; 3]; 3], [0.0; 3]);
        for k in 0..points.mean.len() {
            let slopes = apply(&self.inverse, &self.moments.right(k));
            let jump: [f64; 3] = std::array::from_fn(|axis| slopes[2 * axis] - slopes[2 * axis + 1]);
            for a in 0..3 {
                gradient[a] -= jump[a] * (self.moments.step_right(a, k) - dot(&steps[a], &slopes));
                (0..3).for_each(|b| jumps[a][b] += jump[a] * jump[b]);
            }
        }
        let hessian = std::array::from_fn(|a| {
            std::array::from_fn(|b| {
                let free = self.moments.step_pair(a, b) - dot(&steps[a], &apply(&self.inverse, &steps[b]));
                jumps[a][b] * free
            })
        });
        Cholesky::<3>::new(&hessian).solve(gradient).map(|step| step.clamp(-LONGEST, LONGEST))
    }
}

/// A centre, scaled to the box and in it, about which the slopes do at least as well as about `start`.
pub(crate) fn search(points: &RegionPoints, start: [f64; 3]) -> [f64; 3] {
    let mut best = along_axes(points, Trial::new(points, start));
    for _ in 0..MOST_STEPS {
        let step = best.step(points);
        let Some(better) = descend(points, &best, step) else { break };
        let is_last = better.error > (1.0 - LEAST_GAIN) * best.error;
        best = better;
        if is_last {
            break;
        }
    }
    best.center
}

/// The best of the trials along each axis in turn.
fn along_axes(points: &RegionPoints, mut best: Trial) -> Trial {
    for axis in 0..3 {
        for place in TRIALS {
            let mut center = best.center;
            center[axis] = place;
            let trial = Trial::new(points, center);
            if trial.error < best.error {
                best = trial;
            }
        }
    }
    best
}

/// The first of a step, its half and so on that lowers the error.
fn descend(points: &RegionPoints, from: &Trial, step: [f64; 3]) -> Option<Trial> {
    let at = |part: f64| std::array::from_fn(|axis| (from.center[axis] + part * step[axis]).clamp(-1.0, 1.0));
    let parts = (0..=MOST_HALVINGS as i32).map(|halvings| 0.5f64.powi(halvings));
    parts.map(|part| Trial::new(points, at(part))).find(|trial| trial.error < from.error)
}
