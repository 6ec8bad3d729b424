//! The plain ways to bake that least squares is compared with: AO at the vertices, and averages around them.

use super::{
    bake::{self, Solved},
    errors::Values,
    random::Stream,
    scene::{BenchScene, Receiver},
};
use crate::{
    BenchError,
    clock::{Cost, Stopwatch},
};
use glam::{DMat3, DVec3, Vec3};
use kiln_core::{FaceMoments, Mesh, Solution, SolveSummary};
use kiln_solve::{fill::fill_unknowns, frame::Frame, samples::FaceSamples, surface::Surface, weld::Weld};
use kiln_trace::{CosineSums, KernelRates, SobolScramble, SurfaceSample};
use rayon::prelude::*;

/// How far rays start from a vertex, as a fraction of the level's diagonal: what tools without a bound on their rounding
/// errors need.
const VERTEX_OFFSET: f64 = 1e-4;

/// Vertex values, the rays they took and the cost.
pub(super) struct AtVertices {
    pub(super) values: Values,
    pub(super) rays: u64,
    pub(super) samples: u64,
    pub(super) cost: Cost,
}

/// AO at every unknown with its normal, as most tools bake: no validity, no geometric normal; but with the same good
/// directions as Kiln's.
pub(super) fn at_vertices(scene: &BenchScene, rays: u32, seed: u64) -> Result<AtVertices, BenchError> {
    let watch = Stopwatch::start();
    let welds: Vec<Weld> = scene.receivers.par_iter().map(|receiver| weld(scene, receiver)).collect();
    let offset_m = VERTEX_OFFSET * scene.level.level.bounds.diagonal();
    let stream = Stream::new(seed, 4);
    let of_receiver = |(receiver, weld): (&Receiver, &Weld)| vertex_samples(receiver, weld, offset_m);
    let mut samples: Vec<SurfaceSample> = scene.receivers.par_iter().zip(&welds).flat_map_iter(of_receiver).collect();
    for (at, sample) in samples.iter_mut().enumerate() {
        let bits = |counter: u64| (stream.unit(counter) * 4_294_967_296.0) as u32;
        sample.scramble = SobolScramble([bits(2 * at as u64), bits(2 * at as u64 + 1)]);
    }
    let mut sums = vec![CosineSums::default(); samples.len()];
    let failed = |error: kiln_trace::TraceError| BenchError::Failed { step: "tracing", reason: error.to_string() };
    scene.tracer().gather_cosine(&samples, &KernelRates::new(scene.kernel()), rays, &mut sums).map_err(failed)?;
    let mut first = 0;
    let of_weld = |weld: &Weld| {
        let of_unknown = &sums[first..first + weld.unknown_count()];
        first += weld.unknown_count();
        spread(weld, scene.channels(), |unknown, channel| of_unknown[unknown].ao(channel))
    };
    let values = welds.iter().map(of_weld).collect();
    let samples = samples.len() as u64;
    Ok(AtVertices { values, rays: samples * u64::from(rays), samples, cost: watch.read() })
}

/// The unknowns that a solve has.
fn weld(scene: &BenchScene, receiver: &Receiver) -> Weld {
    let degrees = scene.solve_settings().weld_degrees;
    match Frame::new(&receiver.mesh, &receiver.world_from_object) {
        Some(frame) => Weld::new(&receiver.mesh, &frame, degrees),
        None => {
            let all: Vec<u32> = (0..receiver.mesh.positions.len() as u32).collect();
            Weld { unknown_of_vertex: all.clone(), first_vertex: all }
        }
    }
}

fn vertex_samples(receiver: &Receiver, weld: &Weld, offset_m: f64) -> Vec<SurfaceSample> {
    let (mesh, world) = (&receiver.mesh, &receiver.world_from_object);
    let m = world.matrix3;
    let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    let normals = vertex_normals(mesh);
    let sample = |&vertex: &u32| {
        let normal = cofactor * normals[vertex as usize] * m.determinant().signum();
        let normal = normal.try_normalize().unwrap_or(DVec3::Y);
        let position = world.transform_point3(Vec3::from_array(mesh.positions[vertex as usize]).as_dvec3());
        let (origin, normal) = ((position + normal * offset_m).as_vec3(), normal.as_vec3());
        SurfaceSample { origin, normal, geometric: normal, scramble: SobolScramble([0; 2]), first_index: 0 }
    };
    weld.first_vertex.iter().map(sample).collect()
}

/// Object-space normals of vertices: their own, else the area-weighted one of their faces.
fn vertex_normals(mesh: &Mesh) -> Vec<DVec3> {
    let mut of_faces = vec![DVec3::ZERO; mesh.positions.len()];
    for (face, corners) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
        corners.iter().for_each(|&v| of_faces[v as usize] += (b - a).cross(c - a));
    }
    let own = mesh.normals.iter().map(|normal| DVec3::from(normal.map(f64::from)));
    own.zip(of_faces).map(|(own, faces)| if own == DVec3::ZERO { faces } else { own }).collect()
}

/// Values of unknowns as values of vertices.
#[expect(clippy::cast_possible_truncation, reason = "f32 is the precision of the output")]
fn spread(weld: &Weld, channels: usize, value: impl Fn(usize, usize) -> f64) -> Vec<f32> {
    let vertex = |&unknown: &u32| (0..channels).map(move |channel| (unknown as usize, channel));
    let clamped = |(unknown, channel)| value(unknown, channel).clamp(0.0, 1.0) as f32;
    weld.unknown_of_vertex.iter().flat_map(vertex).map(clamped).collect()
}

/// Averages of the samples around each unknown, weighted by its hat function: where least squares starts from.
pub(super) fn averages(scene: &BenchScene, moments: &[FaceMoments]) -> Solved {
    let watch = Stopwatch::start();
    let one = |(receiver, moments): (&Receiver, &FaceMoments)| {
        let vertices = receiver.mesh.positions.len();
        let channels = scene.channels();
        let averaged = averages_of(scene, receiver, moments);
        let unsampled = averaged.is_none();
        let values = averaged.unwrap_or_else(|| vec![1.0; vertices * channels]);
        let residuals = vec![0.0; values.len()];
        Solution { channels: channels as u32, values, residuals, unsampled, summary: SolveSummary::default() }
    };
    let mut solutions: Vec<Solution> = scene.receivers.par_iter().zip(moments).map(one).collect();
    bake::fill(scene, &mut solutions);
    let values = solutions.into_iter().map(|solution| solution.values).collect();
    Solved { values, cost: watch.read(), reported_rmse: Vec::new() }
}

/// Averages of one receiver; nothing if it has no valid sample.
fn averages_of(scene: &BenchScene, receiver: &Receiver, moments: &FaceMoments) -> Option<Vec<f32>> {
    let channels = scene.channels();
    let frame = Frame::new(&receiver.mesh, &receiver.world_from_object)?;
    let weld = Weld::new(&receiver.mesh, &frame, scene.solve_settings().weld_degrees);
    let surface = Surface::new(&receiver.mesh, &frame, &weld);
    let mut weights = vec![0.0; surface.unknown_count()];
    let mut sums = vec![0.0; surface.unknown_count() * channels];
    for (at, corners) in surface.corners.iter().enumerate() {
        let halves = moments.face(surface.mesh_face[at] as usize);
        let Some(samples) = FaceSamples::new(&halves, channels, surface.areas[at]) else { continue };
        let phi = samples.mean.phi();
        for (i, unknown) in corners.map(|u| u as usize).into_iter().enumerate() {
            weights[unknown] += phi[i];
            (0..channels).for_each(|c| sums[unknown * channels + c] += samples.mean.phi_f[c][i]);
        }
    }
    let valid: Vec<bool> = weights.iter().map(|weight| *weight > 0.0).collect();
    for (sums, weight) in sums.chunks_exact_mut(channels).zip(&weights).filter(|(_, weight)| **weight > 0.0) {
        sums.iter_mut().for_each(|sum| *sum /= weight);
    }
    let filled = fill_unknowns(&surface.points, &valid, &mut sums, channels);
    filled.then(|| spread(&weld, channels, |unknown, channel| sums[unknown * channels + channel]))
}
