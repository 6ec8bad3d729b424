//! The steps of a bake in this process: pieces are traced and instances solved as tasks of a worker do it.

use super::{
    errors::Values,
    scene::{BenchScene, Receiver},
};
use crate::{
    BenchError,
    clock::{Cost, Stopwatch},
};
use kiln_bake::{FaceAreas, Piece, density, trace_piece};
use kiln_core::{FaceMoments, Sampling, Solution, SolveSettings, SolveSummary, TraceSummary};
use kiln_solve::{LevelInstance, SolveInput, fill_unsampled};
use kiln_trace::Tracer;
use rayon::prelude::*;

/// Moments of every receiver, and what they took.
pub(super) struct Traced {
    pub(super) moments: Vec<FaceMoments>,
    pub(super) summary: TraceSummary,
    pub(super) cost: Cost,
}

/// Vertex values of every receiver, and what they took.
pub(super) struct Solved {
    pub(super) values: Values,
    pub(super) cost: Cost,
    /// The RMSE that the bake itself estimates, for each channel; none where the method has no estimate.
    pub(super) reported_rmse: Vec<f64>,
}

/// Traces all pieces of all receivers.
pub(super) fn trace(scene: &BenchScene, tracer: &dyn Tracer, sampling: &Sampling) -> Result<Traced, BenchError> {
    trace_receivers(scene, &scene.receivers, tracer, sampling)
}

/// Traces all pieces without the caps on samples that classes set, which would keep a few huge faces from converging.
pub(super) fn trace_uncapped(scene: &BenchScene, sampling: &Sampling) -> Result<Traced, BenchError> {
    let receivers: Vec<Receiver> = scene.receivers.iter().map(Receiver::without_caps).collect();
    trace_receivers(scene, &receivers, scene.tracer(), sampling)
}

fn trace_receivers(
    scene: &BenchScene,
    receivers: &[Receiver],
    tracer: &dyn Tracer,
    sampling: &Sampling,
) -> Result<Traced, BenchError> {
    let watch = Stopwatch::start();
    let densities: Vec<f64> = receivers
        .par_iter()
        .map(|receiver| density(&FaceAreas::new(&receiver.mesh, &receiver.world_from_object), sampling))
        .collect();
    let pieces: Vec<(usize, Piece<'_>)> = receivers
        .iter()
        .zip(densities)
        .enumerate()
        .flat_map(|(at, (receiver, density_per_m2))| pieces(receiver, density_per_m2, sampling).map(move |p| (at, p)))
        .collect();
    let failed = |error: kiln_trace::TraceError| BenchError::Failed { step: "tracing", reason: error.to_string() };
    let traced: Vec<(usize, FaceMoments)> = pieces
        .par_iter()
        .with_max_len(1)
        .map(|(at, piece)| Ok((*at, trace_piece(tracer, scene.scene(), piece).map_err(failed)?)))
        .collect::<Result<_, BenchError>>()?;
    let mut moments = vec![FaceMoments::new(scene.channels()); scene.receivers.len()];
    traced.iter().for_each(|(at, piece)| moments[*at].append(piece));
    let mut summary = TraceSummary::default();
    moments.iter().for_each(|moments| summary.merge(&moments.summary));
    Ok(Traced { moments, summary, cost: watch.read() })
}

fn pieces<'a>(receiver: &'a Receiver, density_per_m2: f64, sampling: &'a Sampling) -> impl Iterator<Item = Piece<'a>> {
    kiln_plan::pieces(receiver.mesh.faces.len() as u32).map(move |faces| Piece {
        mesh: &receiver.mesh,
        world_from_object: &receiver.world_from_object,
        faces: faces.start as usize..faces.end as usize,
        density_per_m2,
        sampling,
        occluders_m: kiln_core::Bounds::EMPTY,
    })
}

/// Solves all receivers, and fills those without a valid sample from the others.
pub(super) fn solve(
    scene: &BenchScene,
    moments: &[FaceMoments],
    settings: &SolveSettings,
) -> Result<Solved, BenchError> {
    let watch = Stopwatch::start();
    let failed = |error: kiln_solve::SolveError| BenchError::Failed { step: "solving", reason: error.to_string() };
    let one = |(receiver, moments): (&Receiver, &FaceMoments)| {
        let world_from_object = receiver.world_from_object;
        kiln_solve::solve(&SolveInput { mesh: &receiver.mesh, world_from_object, moments, settings }).map_err(failed)
    };
    let mut solutions: Vec<Solution> =
        scene.receivers.par_iter().zip(moments).with_max_len(1).map(one).collect::<Result<_, _>>()?;
    let reported_rmse = (0..scene.channels()).map(|channel| level_rmse(&solutions, channel)).collect();
    fill(scene, &mut solutions);
    let values = solutions.into_iter().map(|solution| solution.values).collect();
    Ok(Solved { values, cost: watch.read(), reported_rmse })
}

/// Gives receivers without a valid sample the values of the nearest surface that has some.
pub(super) fn fill(scene: &BenchScene, solutions: &mut [Solution]) {
    let instance = |(receiver, solution)| {
        let Receiver { mesh, world_from_object, .. }: &Receiver = receiver;
        LevelInstance { mesh, world_from_object: *world_from_object, solution }
    };
    let mut instances: Vec<LevelInstance<'_>> = scene.receivers.iter().zip(solutions).map(instance).collect();
    fill_unsampled(&mut instances);
}

/// The RMSE over all receivers as the report of a bake has it: they weigh by their visible area.
fn level_rmse(solutions: &[Solution], channel: usize) -> f64 {
    let summaries = || solutions.iter().map(|solution| &solution.summary);
    let area: f64 = summaries().map(|summary| summary.visible_area_m2).sum();
    let square = |summary: &SolveSummary| {
        let rmse = summary.error.get(channel).map_or(0.0, |error| error.rmse);
        summary.visible_area_m2 * rmse * rmse
    };
    if area > 0.0 { (summaries().map(square).sum::<f64>() / area).sqrt() } else { 0.0 }
}
