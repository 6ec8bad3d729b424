//! One channel of a model while it is alternated: local AO, the fits of all instances, and what they are off.
//!
//! The state is what is stored: values of L and of y are rounded to f32 before their error is taken, and a step whose
//! error, so taken, is greater is not made. The law that the objective never rises is then true to the bit: an instance's
//! error does not rise, and a sum in a fixed order does not rise with its terms.

use super::{
    alternate::{AlternateParams, HalfStep},
    fit::{TreeFit, fit, global, known, squared_error},
    samples::{ModelSamples, interpolate},
    unknowns::{ModelUnknowns, Row},
};
use rayon::prelude::*;

/// The weights of what keeps L near its start: `α Σ (r·d)² + μ Σ area d²`, with `d = L − L0`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Penalty {
    pub(crate) regularization: f64,
    pub(crate) anchor: f64,
}

/// Values of f of one instance in one channel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Signal<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) channels: usize,
    pub(crate) channel: usize,
}

impl Signal<'_> {
    pub(crate) fn at(&self, sample: usize) -> Option<f64> {
        known(self.values[sample * self.channels + self.channel])
    }
}

/// The state of one channel.
#[derive(Clone, Debug)]
pub(crate) struct ChannelState<'a> {
    pub(crate) samples: &'a ModelSamples,
    pub(crate) unknowns: &'a ModelUnknowns,
    /// The instances, in the order of their keys.
    pub(crate) signals: Vec<Signal<'a>>,
    pub(crate) penalty: Penalty,
    /// L0 at unknowns.
    pub(crate) start: Vec<f64>,
    /// L at unknowns, each an f32.
    pub(crate) local: Vec<f64>,
    /// L at samples.
    pub(crate) at_samples: Vec<f64>,
    /// One for each signal; errors are those with `local`.
    pub(crate) fits: Vec<TreeFit>,
}

impl<'a> ChannelState<'a> {
    /// Fits all instances to the local AO that is given at unknowns.
    pub(crate) fn new(
        samples: &'a ModelSamples,
        unknowns: &'a ModelUnknowns,
        signals: Vec<Signal<'a>>,
        start: Vec<f64>,
        params: &AlternateParams,
    ) -> Self {
        let (at_samples, penalty) = (Vec::new(), Penalty::default());
        let (local, fits) = (start.clone(), Vec::new());
        let mut state = Self { samples, unknowns, signals, penalty, start, local, at_samples, fits };
        state.at_samples = state.sampled(&state.local);
        state.fits = state.fitted();
        let scale = state.mean_square_of_global();
        state.penalty = Penalty { regularization: scale * params.regularization, anchor: scale * params.anchor };
        state
    }

    /// L at the samples.
    pub(crate) fn sampled(&self, local: &[f64]) -> Vec<f64> {
        let corners = self.unknowns.corners.iter().map(|c| c.map(|unknown| local[unknown as usize]));
        corners.zip(&self.samples.phi).map(|(corners, phi)| interpolate(phi, corners)).collect()
    }

    fn fitted(&self) -> Vec<TreeFit> {
        let of = |signal: &Signal<'_>| fit(self.samples, |sample| Some((self.at_samples[sample], signal.at(sample)?)));
        self.signals.par_iter().map(of).collect()
    }

    /// `Σ_j Σ w G_j² / Σ w`: how much more the samples of all instances weigh than those of one whose G is 1.
    fn mean_square_of_global(&self) -> f64 {
        let of = |(signal, fit): (&Signal<'_>, &TreeFit)| {
            let weighed = self.samples.weight.iter().zip(&self.samples.unit).enumerate();
            let valid = weighed.filter(|(sample, _)| signal.at(*sample).is_some());
            valid.map(|(_, (weight, unit))| weight * global(&fit.y, unit).powi(2)).sum::<f64>()
        };
        let squares: Vec<f64> = self.signals.par_iter().zip(&self.fits).map(of).collect();
        let weight: f64 = self.samples.weight.iter().sum();
        if weight > 0.0 { squares.iter().sum::<f64>() / weight } else { 0.0 }
    }

    /// The half-step for y: a new fit for every instance that it makes no worse.
    pub(crate) fn step_fits(&mut self) {
        let fitted = self.fitted();
        for (old, new) in self.fits.iter_mut().zip(fitted) {
            if new.squared_error <= old.squared_error {
                *old = new;
            }
        }
    }

    /// Takes another local AO, and other y with it, if the objective falls.
    pub(crate) fn accept(&mut self, local: Vec<f64>, y: &[[f32; 4]]) -> bool {
        let at_samples = self.sampled(&local);
        let error = |(signal, y): (&Signal<'_>, &[f32; 4])| {
            squared_error(self.samples, y, &|sample| Some((at_samples[sample], signal.at(sample)?)))
        };
        let errors: Vec<f64> = self.signals.par_iter().zip(y).map(error).collect();
        let falls = errors.iter().sum::<f64>() + self.penalty_of(&local) < self.step().objective;
        if falls {
            for ((fit, y), error) in self.fits.iter_mut().zip(y).zip(errors) {
                (fit.y, fit.squared_error) = (*y, error);
            }
            (self.local, self.at_samples) = (local, at_samples);
        }
        falls
    }

    /// The y of all fits.
    pub(crate) fn globals(&self) -> Vec<[f32; 4]> {
        self.fits.iter().map(|fit| fit.y).collect()
    }

    /// What the objective is now.
    pub(crate) fn step(&self) -> HalfStep {
        let squared_error: f64 = self.fits.iter().map(|fit| fit.squared_error).sum();
        HalfStep { objective: squared_error + self.penalty_of(&self.local), squared_error }
    }

    fn penalty_of(&self, local: &[f64]) -> f64 {
        let difference: Vec<f64> = local.iter().zip(&self.start).map(|(local, start)| local - start).collect();
        self.penalty_product(&difference, &difference)
    }

    /// `aᵀ K b`, where the penalty is `dᵀ K d`.
    pub(crate) fn penalty_product(&self, a: &[f64], b: &[f64]) -> f64 {
        let jump = |x: &[f64], (at, row): &Row| (0..4).map(|k| row[k] * x[at[k] as usize]).sum::<f64>();
        let jumps: f64 = self.unknowns.rows.iter().map(|row| jump(a, row) * jump(b, row)).sum();
        let squares: f64 = self.unknowns.area.iter().zip(a.iter().zip(b)).map(|(area, (a, b))| area * a * b).sum();
        self.penalty.regularization * jumps + self.penalty.anchor * squares
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::tree::samples::ModelSample;
    use glam::{DVec3, Vec3};
    use kiln_core::{Class, FaceGroup, Mesh};

    /// A sheet of 5 × 5 vertices with a fold, and samples on it.
    pub(crate) fn sheet() -> (Mesh, ModelSamples) {
        let place = |v: u32| [v / 5, v % 5].map(|k| k as f32);
        let positions: Vec<_> = (0..25).map(place).map(|[x, y]| [x, y, (x - 2.0).abs()]).collect();
        let quads = (0..20u32).filter(|v| v % 5 < 4);
        let faces: Vec<_> = quads.flat_map(|v| [[v, v + 5, v + 1], [v + 1, v + 5, v + 6]]).collect();
        let group = FaceGroup { class: Class::Tree, double_sided: true, ..FaceGroup::PLAIN };
        let (normals, face_group) = (vec![[0.0; 3]; 25], vec![0; faces.len()]);
        let mesh = Mesh { positions, normals, faces, face_group, groups: vec![group], ..Mesh::default() };
        let on_face = |face: u32| {
            let corners = mesh.corners(face as usize).map(Vec3::as_dvec3);
            [[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6], [0.1, 0.4, 0.5]].map(|phi| {
                let position: DVec3 = corners.iter().zip(phi).map(|(c, p)| *c * p).sum();
                ModelSample { face, phi, position, weight: 0.2 }
            })
        };
        let samples: Vec<_> = (0..mesh.faces.len() as u32).flat_map(on_face).collect();
        let samples = ModelSamples::new(&mesh, &samples).unwrap();
        (mesh, samples)
    }

    #[test]
    fn the_start_has_no_penalty_and_only_what_is_better_is_taken() {
        let (mesh, samples) = sheet();
        let params = AlternateParams::default();
        let unknowns = ModelUnknowns::new(&mesh, &samples, &params);
        let values: Vec<f32> = (0..samples.len()).map(|i| (i * 37 % 11) as f32 / 11.0).collect();
        let signals = vec![Signal { values: &values, channels: 1, channel: 0 }];
        let mut state = ChannelState::new(&samples, &unknowns, signals, vec![0.5; 25], &params);
        let (before, y) = (state.step(), state.globals());
        assert!(before.objective == before.squared_error && before.objective > 0.0);
        assert!(!state.accept(vec![0.0; 25], &y) && !state.accept(vec![0.5; 25], &y));
        assert_eq!((state.step(), &state.local), (before, &vec![0.5; 25]));
        state.step_local();
        assert!(state.step().objective < before.objective && state.step().objective > state.step().squared_error);
    }
}
