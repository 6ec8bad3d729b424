//! A trace task: samples of a run of faces in, per-face moments out.

use crate::{
    density::{receiving_area_m2, sample_count},
    samples::{Position, SampleMaker},
};
use glam::DAffine3;
use kiln_core::{FaceMoments, HalfMoments, Mesh, Sampling, TraceSummary};
use kiln_trace::{CosineSums, KernelRates, Scene, SurfaceSample, TraceError, Tracer, is_open_above};
use rayon::prelude::*;
use std::ops::Range;

/// A run of faces of one instance, and how to sample it.
pub struct Piece<'a> {
    /// The instance's mesh.
    pub mesh: &'a Mesh,
    /// The instance's transform.
    pub world_from_object: &'a DAffine3,
    /// The faces.
    pub faces: Range<usize>,
    /// Samples per square metre.
    pub density_per_m2: f64,
    /// How samples are made.
    pub sampling: &'a Sampling,
}

/// Traces a piece. `scene` is what the tracer traces, for the test that leaves out samples that see nothing.
///
/// A sample is valid if it has a ray above its surface and at most `back_face_limit` of its rays hit back faces
/// (Sloan et al. 2013, section 2.1). A position on a double-sided face has the mean of its valid sides.
pub fn trace_piece(tracer: &dyn Tracer, scene: &Scene, piece: &Piece<'_>) -> Result<FaceMoments, TraceError> {
    let sampling = piece.sampling;
    let kernel = KernelRates::new(&sampling.kernel);
    let halves = positions(piece);
    let samples: Vec<SurfaceSample> =
        halves.iter().flatten().flat_map(|position| position.sides.iter().flatten().copied()).collect();
    let (sums, summary) = gather(tracer, scene, &kernel, sampling, &samples)?;

    let mut moments = FaceMoments::new(kernel.channels);
    moments.summary = summary;
    let mut sums = sums.iter();
    for face in halves.chunks_exact(2) {
        let mut pair = [HalfMoments::default(); 2];
        for (half, positions) in pair.iter_mut().zip(face) {
            for position in positions {
                let sides = sums.by_ref().take(position.sides.iter().flatten().count());
                add_position(half, position, sides, &kernel, sampling, &mut moments.summary);
            }
        }
        moments.push(&pair);
    }
    Ok(moments)
}

/// Positions of each half of each face: face 0 half 0, face 0 half 1, face 1 half 0, …
fn positions(piece: &Piece<'_>) -> Vec<Vec<Position>> {
    let sampling = piece.sampling;
    let maker = SampleMaker::new(piece.mesh, piece.world_from_object, sampling.seed, sampling.rays_per_sample);
    let face = |face: usize| {
        let area = receiving_area_m2(piece.mesh, piece.world_from_object, face);
        let cap = piece.mesh.group(face).max_samples_per_face;
        let count = sample_count(area, cap, piece.density_per_m2, sampling);
        [maker.half(face, 0, count / 2), maker.half(face, 1, count / 2)]
    };
    piece.faces.clone().into_par_iter().flat_map_iter(face).collect()
}

/// Gathers the samples that may see something; the others are open without a ray.
fn gather(
    tracer: &dyn Tracer,
    scene: &Scene,
    kernel: &KernelRates,
    sampling: &Sampling,
    samples: &[SurfaceSample],
) -> Result<(Vec<CosineSums>, TraceSummary), TraceError> {
    let rays = sampling.rays_per_sample;
    let open = |sample: &SurfaceSample| is_open_above(scene, sample.origin, sample.geometric, kernel.t_max);
    let is_open: Vec<bool> = samples.par_iter().with_min_len(64).map(open).collect();
    let closed: Vec<SurfaceSample> =
        samples.iter().zip(&is_open).filter(|&(_, &open)| !open).map(|(&sample, _)| sample).collect();
    let mut gathered = vec![CosineSums::default(); closed.len()];
    tracer.gather_cosine(&closed, kernel, rays, &mut gathered)?;

    let open_sums = CosineSums { values: [kiln_trace::ONE * rays; 4], rays, back_faces: 0 };
    let mut gathered = gathered.into_iter();
    let sums = is_open.iter().map(|&open| if open { open_sums } else { gathered.next().unwrap_or_default() }).collect();
    let skipped = (samples.len() - closed.len()) as u64;
    let summary = TraceSummary {
        samples: samples.len() as u64,
        invalid: 0,
        rays: closed.len() as u64 * u64::from(rays),
        rays_skipped_empty: skipped * u64::from(rays),
    };
    Ok((sums, summary))
}

/// Adds the mean of a position's valid sides to its half's moments.
fn add_position<'s>(
    half: &mut HalfMoments,
    position: &Position,
    sides: impl Iterator<Item = &'s CosineSums>,
    kernel: &KernelRates,
    sampling: &Sampling,
    summary: &mut TraceSummary,
) {
    let (mut values, mut valid) = ([0.0; 4], 0);
    for sums in sides {
        if sums.rays == 0 || sums.back_face_fraction() > sampling.back_face_limit {
            summary.invalid += 1;
            continue;
        }
        valid += 1;
        for (channel, value) in values.iter_mut().enumerate().take(kernel.channels) {
            *value += sums.ao(channel);
        }
    }
    if valid == 0 {
        half.add_invalid();
        return;
    }
    let values = values.map(|value| value / f64::from(valid));
    half.add(position.phi, &values[..kernel.channels]);
}
