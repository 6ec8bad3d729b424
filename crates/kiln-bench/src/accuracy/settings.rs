//! The settings that variants are baked with, each kind made in one place.

use super::scene::BenchScene;
use kiln_core::{Quality, Sampling, SolveSettings};

/// What a person asks a bake for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Goal {
    /// `--quality`.
    Quality(Quality),
    /// `--target-rmse`.
    Target(f64),
}

impl Goal {
    /// The row's label in tables.
    pub(super) fn label(&self) -> String {
        match self {
            Self::Quality(quality) => format!("{quality:?}").to_lowercase(),
            Self::Target(rmse) => format!("target {rmse}"),
        }
    }
}

/// The qualities, and targets around and between them, for a curve of error against time.
pub(super) const GOALS: [Goal; 9] = [
    Goal::Quality(Quality::Low),
    Goal::Quality(Quality::Medium),
    Goal::Quality(Quality::High),
    Goal::Target(0.064),
    Goal::Target(0.032),
    Goal::Target(0.012),
    Goal::Target(0.0085),
    Goal::Target(0.0042),
    Goal::Target(0.002),
];

/// As `kiln bake` samples to reach a goal.
pub(super) fn adaptive(scene: &BenchScene, goal: &Goal, seed: u64) -> Sampling {
    Sampling { seed, ..scene.sampling(goal).clone() }
}

/// The same numbers of samples and rays whatever they find: on average `samples` per face (the least is 2, one for each
/// half).
pub(super) fn fixed(scene: &BenchScene, samples: u32, rays: u32, seed: u64) -> Sampling {
    // Where a few huge faces would get nearly all, they get 16 times the mean.
    let most = 16 * samples.max(2);
    Sampling {
        rays_per_sample: rays,
        mean_samples_per_face: f64::from(samples.max(2)),
        density_per_m2: None,
        min_samples_per_face: 2,
        max_samples_per_face: most,
        seed,
        target: None,
        ..scene.level.level.sampling.clone()
    }
}

/// Rays per sample of a reference. What is left of its error is in the positions, so it spends its rays on them.
pub(super) const REFERENCE_RAYS_PER_SAMPLE: u32 = 16;

/// The converged reference: `rays_per_face` on average, at least a quarter of that, spread over as many positions as they
/// allow, and none of them used by any other variant.
pub(super) fn reference(scene: &BenchScene, rays_per_face: u32) -> Sampling {
    let samples = (rays_per_face / REFERENCE_RAYS_PER_SAMPLE).max(8);
    Sampling {
        min_samples_per_face: (samples / 4).next_multiple_of(2),
        ..fixed(scene, samples, REFERENCE_RAYS_PER_SAMPLE, u64::MAX)
    }
}

/// With another weight of the regulariser than the default, or with that.
pub(super) fn solve(scene: &BenchScene, regularization: Option<f64>) -> SolveSettings {
    let default = scene.solve_settings().clone();
    match regularization {
        Some(regularization) => SolveSettings { regularization, ..default },
        None => default,
    }
}
