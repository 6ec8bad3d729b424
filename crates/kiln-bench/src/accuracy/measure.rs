//! Measuring one scene: reference, points, then every method with every seed.

use super::{
    bake::{self, Traced},
    errors::{ErrorStats, Reference, Values, surface},
    plain, points,
    random_rays::RandomRays,
    scene::BenchScene,
    settings,
    truth::{self, TruePoint},
    variant::{Family, Method, methods},
};
use crate::{BenchError, clock::Cost};
use kiln_core::Sampling;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// How thoroughly a scene is measured.
pub(super) struct Plan {
    pub(super) families: BTreeSet<Family>,
    pub(super) seeds: u64,
    pub(super) points: usize,
    pub(super) truth_rays: u32,
    pub(super) reference_rays_per_face: u32,
    pub(super) most_rays: u64,
}

/// One run of one way to bake.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Run {
    /// The seed.
    pub(super) seed: u64,
    /// Tracing.
    pub(super) trace: Cost,
    /// Solving, or what stands in its place.
    pub(super) solve: Cost,
    /// Rays traced.
    pub(super) rays: u64,
    /// Sample points, both sides of double-sided faces.
    pub(super) samples: u64,
    /// Estimation error of each channel.
    pub(super) estimation: Vec<ErrorStats>,
    /// Surface error of each channel.
    pub(super) surface: Vec<ErrorStats>,
    /// RMSE that the bake itself reports, for each channel; none where the method has no estimate.
    pub(super) reported_rmse: Vec<f64>,
}

/// All runs of one way to bake.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Row {
    /// Its family.
    pub(super) family: Family,
    /// Its numbers.
    pub(super) label: String,
    /// One for each seed.
    pub(super) runs: Vec<Run>,
}

/// What was measured on one scene.
#[derive(Clone, Debug, Serialize)]
pub(super) struct SceneResult {
    /// The scene's name.
    pub(super) scene: String,
    /// Half-distance of each channel, metres.
    pub(super) half_distances_m: Vec<f64>,
    /// Faces in the level.
    pub(super) faces: u64,
    /// Faces that were baked: whole pieces, spread evenly; the whole level occludes.
    pub(super) baked_faces: u64,
    /// Points at which the signal is known.
    pub(super) points: usize,
    /// Mean signal at the points, for each channel.
    pub(super) mean_ao: Vec<f64>,
    /// Rays of the reference.
    pub(super) reference_rays: u64,
    /// Its own estimate of its error.
    pub(super) reference_rmse: Vec<f64>,
    /// Its surface error: near the least that its unknowns permit.
    pub(super) reference_surface: Vec<ErrorStats>,
    /// Methods that would have taken too many rays.
    pub(super) left_out: Vec<String>,
    /// Every way to bake.
    pub(super) rows: Vec<Row>,
}

/// The converged solutions that estimation errors are measured against.
struct Converged {
    reference: Reference,
    /// The same samples solved with the α of these families: α is part of the estimator, not of its error.
    with_alpha: BTreeMap<Family, Reference>,
    rays: u64,
    /// Its own estimate of its error, for each channel.
    rmse: Vec<f64>,
}

impl Converged {
    fn new(scene: &BenchScene, families: &BTreeSet<Family>, rays_per_face: u32) -> Result<Self, BenchError> {
        let sampling = settings::reference(scene, rays_per_face);
        let traced = bake::trace_uncapped(scene, &sampling)?;
        let solve = |alpha| bake::solve(scene, &traced.moments, &settings::solve(scene, alpha));
        let solved = solve(None)?;
        let mut with_alpha = BTreeMap::new();
        for (family, alpha) in [(Family::Alpha0, 0.0), (Family::Alpha1, 1.0)] {
            if families.contains(&family) {
                with_alpha.insert(family, Reference::new(scene, solve(Some(alpha))?.values, &traced.moments));
            }
        }
        let reference = Reference::new(scene, solved.values, &traced.moments);
        Ok(Self { reference, with_alpha, rays: traced.summary.rays, rmse: solved.reported_rmse })
    }

    fn of(&self, family: Family) -> &Reference {
        self.with_alpha.get(&family).unwrap_or(&self.reference)
    }
}

/// A scene's reference, points and what was measured so far.
struct Measurement<'a> {
    scene: &'a BenchScene,
    plan: &'a Plan,
    converged: Converged,
    points: Vec<TruePoint>,
    rows: Vec<Row>,
}

/// The points of a scene and the signal there.
pub(super) fn true_points(scene: &BenchScene, plan: &Plan) -> Result<Vec<TruePoint>, BenchError> {
    truth::trace(scene, points::pick(scene, plan.points, 20_261_123), plan.truth_rays, 20_261_124)
}

/// Measures a scene. `progress` is told what is being done.
pub(super) fn measure(
    scene: &BenchScene,
    plan: &Plan,
    points: Vec<TruePoint>,
    progress: &mut dyn FnMut(&str),
) -> Result<SceneResult, BenchError> {
    progress("reference");
    let converged = Converged::new(scene, &plan.families, plan.reference_rays_per_face)?;
    let mut result = SceneResult {
        scene: scene.name.clone(),
        half_distances_m: scene.half_distances_m().to_vec(),
        faces: scene.face_count,
        baked_faces: scene.baked_faces(),
        points: points.len(),
        mean_ao: (0..scene.channels()).map(|c| mean(points.iter().map(|point| point.ao[c]))).collect(),
        reference_rays: converged.rays,
        reference_rmse: converged.rmse.clone(),
        reference_surface: surface(scene, &converged.reference.values, &points),
        left_out: Vec::new(),
        rows: Vec::new(),
    };
    let (methods, left_out) = methods(&plan.families, scene.baked_faces(), plan.most_rays);
    let mut measurement = Measurement { scene, plan, converged, points, rows: Vec::new() };
    // Seeds outside, methods inside: what slows the machine for a while slows all of them.
    for seed in 0..plan.seeds {
        for method in &methods {
            progress(&format!("seed {} of {}: {} {}", seed + 1, plan.seeds, method.family(), method.label()));
            measurement.run(method, seed)?;
        }
    }
    result.left_out = left_out;
    result.rows = measurement.rows;
    result.rows.sort_by_key(|row| row.family);
    Ok(result)
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

impl Measurement<'_> {
    fn run(&mut self, method: &Method, seed: u64) -> Result<(), BenchError> {
        let scene = self.scene;
        match *method {
            Method::Adaptive(goal) => self.least_squares(method, &settings::adaptive(scene, &goal, seed), seed),
            Method::Fixed { samples, rays } => {
                self.least_squares(method, &settings::fixed(scene, samples, rays, seed), seed)
            }
            Method::Random { samples, rays } => {
                let tracer = RandomRays { inner: scene.tracer(), seed };
                let traced = bake::trace(scene, &tracer, &settings::fixed(scene, samples, rays, seed))?;
                self.solve(method, Family::Random, &traced, seed)
            }
            Method::Vertices { rays } => {
                let baked = plain::at_vertices(scene, rays, seed)?;
                let run = Run {
                    seed,
                    trace: baked.cost,
                    rays: baked.rays,
                    samples: baked.samples,
                    ..self.judge(Family::Vertices, &baked.values)
                };
                self.keep(method, Family::Vertices, run);
                Ok(())
            }
        }
    }

    /// Traces once and solves in every way that is asked for.
    fn least_squares(&mut self, method: &Method, sampling: &Sampling, seed: u64) -> Result<(), BenchError> {
        let traced = bake::trace(self.scene, self.scene.tracer(), sampling)?;
        let family = method.family();
        let on_samples = [Family::Average, Family::Alpha0, Family::Alpha1];
        let others = on_samples.into_iter().filter(|_| family == Family::Fixed);
        for family in [family].into_iter().chain(others) {
            if self.plan.families.contains(&family) {
                self.solve(method, family, &traced, seed)?;
            }
        }
        Ok(())
    }

    fn solve(&mut self, method: &Method, family: Family, traced: &Traced, seed: u64) -> Result<(), BenchError> {
        let with = |alpha| bake::solve(self.scene, &traced.moments, &settings::solve(self.scene, alpha));
        let solved = match family {
            Family::Average => plain::averages(self.scene, &traced.moments),
            Family::Alpha0 => with(Some(0.0))?,
            Family::Alpha1 => with(Some(1.0))?,
            _ => with(None)?,
        };
        let run = Run {
            seed,
            trace: traced.cost,
            solve: solved.cost,
            rays: traced.summary.rays,
            samples: traced.summary.samples,
            reported_rmse: solved.reported_rmse,
            ..self.judge(family, &solved.values)
        };
        self.keep(method, family, run);
        Ok(())
    }

    /// A run with its errors only.
    fn judge(&self, family: Family, values: &Values) -> Run {
        let reference = self.converged.of(family);
        Run {
            seed: 0,
            trace: Cost::default(),
            solve: Cost::default(),
            rays: 0,
            samples: 0,
            estimation: reference.compare(self.scene, values),
            surface: surface(self.scene, values, &self.points),
            reported_rmse: Vec::new(),
        }
    }

    fn keep(&mut self, method: &Method, family: Family, run: Run) {
        let label = method.label();
        match self.rows.iter_mut().find(|row| row.family == family && row.label == label) {
            Some(row) => row.runs.push(run),
            None => self.rows.push(Row { family, label, runs: vec![run] }),
        }
    }
}
