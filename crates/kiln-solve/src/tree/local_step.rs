//! The half-step for L: least squares over all instances, given their y, with every value in [0, 1].
//!
//! `min_L Σ_j Σ_i w (f − G_j L)² + α Σ (r·d)² + μ Σ area d²`, `d = L − L0`, is quadratic with bounds: a few steps of the
//! projected Newton method (Bertsekas 1982, SIAM J. Control Optim. 20(2)). Values at a bound that the gradient pushes further out
//! are held, the solvers of whole instances find the step of the others, the result is clamped, and if the objective does
//! not fall the step is halved; in the end L stays as it was.

use super::channel::ChannelState;
use super::fit::global;
use crate::{chain::SolverParams, matrix::LowerCsc, parallel::solve_all, system::ComponentSystem};
use rayon::prelude::*;
use std::borrow::Cow;

/// Newton steps of one half-step: the first reaches the least value where no bound is met.
const NEWTON_STEPS: usize = 3;

/// Times that a step is halved before it is given up.
const HALVINGS: i32 = 4;

/// What all instances together say at one sample.
#[derive(Clone, Copy, Debug, Default)]
struct Pull {
    /// `w Σ_j G_j²`.
    weight: f64,
    /// `w Σ_j G_j f_j`.
    target: f64,
}

impl ChannelState<'_> {
    /// Makes the half-step for L; the objective falls or stays.
    pub(crate) fn step_local(&mut self) {
        let pulls = self.pulls();
        let matrix = self.matrix(&pulls);
        for _ in 0..NEWTON_STEPS {
            if !self.newton_step(&matrix, &pulls) {
                break;
            }
        }
    }

    /// Sums over instances, each sample's in the order of their keys.
    fn pulls(&self) -> Vec<Pull> {
        let at = |sample: usize| {
            let mut pull = Pull::default();
            for (signal, fit) in self.signals.iter().zip(&self.fits) {
                let Some(f) = signal.at(sample) else { continue };
                let global = global(&fit.y, &self.samples.unit[sample]);
                pull.weight += global * global;
                pull.target += global * f;
            }
            let weight = self.samples.weight[sample];
            Pull { weight: weight * pull.weight, target: weight * pull.target }
        };
        (0..self.samples.len()).into_par_iter().map(at).collect()
    }

    /// Half the second derivative of the objective. Unknowns that nothing touches get a 1, so that they stay.
    fn matrix(&self, pulls: &[Pull]) -> LowerCsc {
        let mut matrix = self.unknowns.pattern.clone();
        for ((corners, phi), pull) in self.unknowns.corners.iter().zip(&self.samples.phi).zip(pulls) {
            add_square(&mut matrix, corners, phi, pull.weight);
        }
        for (unknowns, row) in &self.unknowns.rows {
            add_square(&mut matrix, unknowns, row, self.penalty.regularization);
        }
        for (unknown, area) in self.unknowns.area.iter().enumerate() {
            matrix.add_diagonal(unknown, self.penalty.anchor * area);
            if matrix.diagonal(unknown) <= 0.0 {
                matrix.add_diagonal(unknown, 1.0);
            }
        }
        matrix
    }

    /// Half the negative gradient.
    fn descent(&self, pulls: &[Pull]) -> Vec<f64> {
        let mut descent: Vec<f64> = self.unknowns.area.iter().map(|area| -self.penalty.anchor * area).collect();
        let difference: Vec<f64> = self.local.iter().zip(&self.start).map(|(local, start)| local - start).collect();
        descent.iter_mut().zip(&difference).for_each(|(sum, difference)| *sum *= difference);
        for (at, row) in &self.unknowns.rows {
            let jump: f64 = (0..4).map(|k| row[k] * difference[at[k] as usize]).sum();
            (0..4).for_each(|k| descent[at[k] as usize] -= self.penalty.regularization * row[k] * jump);
        }
        let sampled = self.unknowns.corners.iter().zip(&self.samples.phi).zip(pulls).zip(&self.at_samples);
        for (((corners, phi), pull), local) in sampled {
            let misfit = pull.target - pull.weight * local;
            (0..3).for_each(|k| descent[corners[k] as usize] += phi[k] * misfit);
        }
        descent
    }

    /// One projected Newton step; whether the objective fell.
    #[expect(clippy::cast_possible_truncation, reason = "f32 is the precision of the values")]
    fn newton_step(&mut self, matrix: &LowerCsc, pulls: &[Pull]) -> bool {
        let mut rhs = self.descent(pulls);
        let is_held = |(local, push): (&f64, &f64)| (*local <= 0.0 && *push < 0.0) || (*local >= 1.0 && *push > 0.0);
        let held: Vec<bool> = self.local.iter().zip(&rhs).map(is_held).collect();
        rhs.iter_mut().zip(&held).filter(|(_, held)| **held).for_each(|(push, _)| *push = 0.0);
        let step = self.solve(&without(matrix, &held), rhs);
        let globals = self.globals();
        for halving in 0..=HALVINGS {
            let part = 0.5f64.powi(halving);
            let moved = |(local, step): (&f64, &f64)| f64::from((local + part * step).clamp(0.0, 1.0) as f32);
            let candidate: Vec<f64> = self.local.iter().zip(&step).map(moved).collect();
            if self.accept(candidate, &globals) {
                return true;
            }
        }
        false
    }

    /// The step by the solvers of whole instances, component by component; 0 where none of them succeeds.
    fn solve(&self, matrix: &LowerCsc, rhs: Vec<f64>) -> Vec<f64> {
        let (unknowns, components) = (self.unknowns, &self.unknowns.components);
        let anchor = unknowns.area.iter().map(|area| self.penalty.anchor * area).collect();
        let system = ComponentSystem {
            matrix: Cow::Borrowed(matrix),
            anchor: Cow::Owned(anchor),
            rhs: Cow::Owned(rhs),
            columns: 1,
            hole_ring: Cow::Owned(vec![0; unknowns.count]),
        };
        let mut step = vec![0.0; unknowns.count];
        let all = (0..components.count()).collect();
        for (component, answer) in solve_all(all, components, &system, &SolverParams::default()) {
            for (unknown, correction) in components.unknowns(component).iter().zip(answer.correction) {
                step[*unknown as usize] = if correction.is_finite() { correction } else { 0.0 };
            }
        }
        step
    }
}

/// Adds `weight · row rowᵀ`. Two corners may be one unknown.
fn add_square<const N: usize>(matrix: &mut LowerCsc, unknowns: &[u32; N], row: &[f64; N], weight: f64) {
    for i in 0..N {
        matrix.add_diagonal(unknowns[i] as usize, weight * row[i] * row[i]);
        for j in 0..i {
            let twice = if unknowns[i] == unknowns[j] { 2.0 } else { 1.0 };
            matrix.add(unknowns[i], unknowns[j], twice * weight * row[i] * row[j]);
        }
    }
}

/// The matrix with the rows and columns of what is held cut off from the others.
fn without<'a>(matrix: &'a LowerCsc, held: &[bool]) -> Cow<'a, LowerCsc> {
    if !held.contains(&true) {
        return Cow::Borrowed(matrix);
    }
    let mut cut = matrix.clone();
    for column in 0..cut.len() {
        let range = cut.column_start[column] as usize + 1..cut.column_start[column + 1] as usize;
        for (row, value) in cut.row[range.clone()].iter().zip(&mut cut.value[range]) {
            if held[column] || held[*row as usize] {
                *value = 0.0;
            }
        }
    }
    Cow::Owned(cut)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::{
        alternate::AlternateParams,
        channel::{Signal, tests::sheet},
        unknowns::ModelUnknowns,
    };

    #[test]
    fn the_least_value_within_the_bounds_is_found() {
        let (mesh, samples) = sheet();
        for regularization in [0.0, 0.02] {
            let params = AlternateParams { regularization, ..AlternateParams::default() };
            let unknowns = ModelUnknowns::new(&mesh, &samples, &params);
            // Bright and dark stripes beyond what values in [0, 1] can make of them.
            let stripe = |u: &[f64; 3]| if (5.0 * u[0] + 3.0 * u[1]).rem_euclid(2.0) < 1.0 { 1.0 } else { 0.0 };
            let values: Vec<f32> = samples.unit.iter().map(stripe).collect();
            let signals = vec![Signal { values: &values, channels: 1, channel: 0 }];
            let mut state = ChannelState::new(&samples, &unknowns, signals, vec![0.8; 25], &params);
            (0..5).for_each(|_| state.step_local());
            let slope = state.descent(&state.pulls());
            for (local, push) in state.local.iter().zip(&slope) {
                let least = if *local <= 0.0 {
                    *push <= 0.0
                } else if *local >= 1.0 {
                    *push >= 0.0
                } else {
                    push.abs() <= 1e-6
                };
                assert!(least, "{local} is pushed by {push}");
            }
            let at_bounds = state.local.iter().filter(|local| **local <= 0.0 || **local >= 1.0).count();
            assert!((3..20).contains(&at_bounds), "{at_bounds} at bounds");
        }
    }

    #[test]
    fn squares_of_rows_with_repeated_unknowns() {
        let mut matrix = LowerCsc::with_pattern(2, || [[0, 1]].into_iter());
        add_square(&mut matrix, &[0, 1, 0], &[1.0, 10.0, 2.0], 2.0);
        // 2 (3 x0 + 10 x1)².
        assert_eq!(matrix.value, [18.0, 60.0, 200.0]);
    }

    #[test]
    fn the_matrix_and_the_descent_are_derivatives_of_the_objective() {
        let (mesh, samples) = sheet();
        let params = AlternateParams { regularization: 0.3, anchor: 0.1, ..AlternateParams::default() };
        let unknowns = ModelUnknowns::new(&mesh, &samples, &params);
        let values: Vec<f32> = (0..2 * samples.len()).map(|i| (i * 37 % 11) as f32 / 11.0).collect();
        let signals = values.chunks(samples.len()).map(|values| Signal { values, channels: 1, channel: 0 }).collect();
        let mut state = ChannelState::new(&samples, &unknowns, signals, vec![0.5; 25], &params);
        state.step_local();
        let pulls = state.pulls();
        let (matrix, descent, y) = (state.matrix(&pulls), state.descent(&pulls), state.globals());
        let direction: Vec<f64> = (0..25).map(|v| 0.01 * f64::from(v * 7 % 5 - 2)).collect();
        let along: f64 = descent.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let product = matrix.residual(1, &direction, &[0.0; 25]);
        let curvature: f64 = -product.iter().zip(&direction).map(|(p, d)| p * d).sum::<f64>();
        let before = state.step().objective;
        let moved: Vec<f64> = state.local.iter().zip(&direction).map(|(l, d)| l + d).collect();
        assert!(moved.iter().all(|l| (0.0..=1.0).contains(l)), "no bound is met");
        // The objective is quadratic: two terms are all of it.
        let mut other = state.clone();
        other.fits.iter_mut().for_each(|fit| fit.squared_error = f64::INFINITY);
        assert!(other.accept(moved, &y));
        let rise = other.step().objective - before;
        assert!((rise - (curvature - 2.0 * along)).abs() <= 1e-12, "{rise} {curvature} {along}");
        assert!(along.abs() > 1e-9 || curvature > 1e-6);
    }
}
