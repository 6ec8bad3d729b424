//! A trace task: samples of a run of faces in, per-face moments out.

use crate::{
    density::{receiving_area_m2, sample_count},
    rounds::Rounds,
    samples::{Batch, Position, SampleMaker},
};
use glam::{DAffine3, Vec3};
use kiln_core::{Bounds, FaceMoments, HalfMoments, MAX_CHANNELS, Mesh, Sampling, SkipRule, TraceSummary};
use kiln_trace::{CosineSums, KernelRates, Scene, SurfaceSample, TraceError, Tracer, is_open_above, open_sums};
use rayon::prelude::*;
use std::{borrow::Cow, ops::Range};

/// Faces whose positions one task makes.
pub(crate) const FACES_PER_BATCH: usize = 256;

/// One of so many samples is asked first whether it is open.
const PROBE_STEP: usize = 16;

/// A run of faces of one instance, and how to sample it.
pub struct Piece<'a> {
    /// The instance's mesh.
    pub mesh: &'a Mesh,
    /// The instance's transform.
    pub world_from_object: &'a DAffine3,
    /// The faces.
    pub faces: Range<usize>,
    /// Samples per square metre; those to begin with where sampling is adaptive.
    pub density_per_m2: f64,
    /// How samples are made.
    pub sampling: &'a Sampling,
    /// A box around all that the rays may come to, metres, to count those that end before they have crossed it; empty if
    /// nobody wants to know.
    pub occluders_m: Bounds,
}

/// Traces a piece. `scene` is what the tracer traces, for the test that leaves out samples that see nothing.
///
/// A sample is valid if it has a ray above its surface and at most `back_face_limit` of its rays hit back faces
/// (Sloan et al. 2013, section 2.1). A position on a double-sided face has the mean of its valid sides. With a target,
/// samples are added in rounds until what the piece has found says that its error is small enough.
pub fn trace_piece(tracer: &dyn Tracer, scene: &Scene, piece: &Piece<'_>) -> Result<FaceMoments, TraceError> {
    let mut sampler = Sampler::new(tracer, scene, piece);
    sampler.extend(&piece.first_counts())?;
    if let Some(target) = &piece.sampling.target {
        Rounds::new(piece, target).run(&mut sampler)?;
    }
    let mut moments = FaceMoments::new(sampler.kernel.channels);
    sampler.halves.iter().for_each(|halves| moments.push(halves));
    moments.summary = sampler.summary;
    Ok(moments)
}

impl Piece<'_> {
    /// Samples of each half of each face to begin with.
    pub(crate) fn first_counts(&self) -> Vec<[u32; 2]> {
        let count = |face: usize| {
            let area = receiving_area_m2(self.mesh, self.world_from_object, face);
            let cap = self.mesh.group(face).max_samples_per_face;
            sample_count(area, cap, self.density_per_m2, self.sampling) / 2
        };
        self.faces.clone().into_par_iter().map(count).map(|count| [count; 2]).collect()
    }
}

/// Takes samples of a piece's faces, and keeps what they found.
pub(crate) struct Sampler<'a> {
    tracer: &'a dyn Tracer,
    scene: &'a Scene,
    piece: &'a Piece<'a>,
    maker: SampleMaker<'a>,
    kernel: KernelRates,
    /// The two halves of each face; [`HalfMoments::taken`] is where the next round goes on.
    pub(crate) halves: Vec<[HalfMoments; 2]>,
    pub(crate) summary: TraceSummary,
}

impl<'a> Sampler<'a> {
    fn new(tracer: &'a dyn Tracer, scene: &'a Scene, piece: &'a Piece<'a>) -> Self {
        let sampling = piece.sampling;
        Self {
            tracer,
            scene,
            piece,
            maker: SampleMaker::new(piece.mesh, piece.world_from_object, sampling.seed, sampling.rays_per_sample),
            kernel: KernelRates::of(sampling),
            halves: vec![[HalfMoments::default(); 2]; piece.faces.len()],
            summary: TraceSummary::default(),
        }
    }

    /// Takes more samples, until each half of each face has as many as wanted.
    pub(crate) fn extend(&mut self, wanted: &[[u32; 2]]) -> Result<(), TraceError> {
        let mut batches = self.batches(wanted);
        let samples = match batches.as_mut_slice() {
            [only] => std::mem::take(&mut only.samples),
            _ => batches.iter().flat_map(|batch| &batch.samples).copied().collect(),
        };
        let sums = self.gather(&samples)?;
        let (mut sums, mut halves) = (sums.as_slice(), self.halves.iter_mut().flatten());
        for batch in &batches {
            let mut positions = batch.positions.iter();
            for (count, half) in batch.counts.iter().zip(&mut halves) {
                for position in positions.by_ref().take(*count) {
                    let (sides, rest) = sums.split_at(position.sides);
                    sums = rest;
                    add_position(half, position, sides, &self.kernel, self.piece.sampling, &mut self.summary);
                }
            }
        }
        Ok(())
    }

    /// New positions, some faces in each batch.
    fn batches(&self, wanted: &[[u32; 2]]) -> Vec<Batch> {
        let batch = |(index, wanted): (usize, &[[u32; 2]])| {
            let mut batch = Batch::default();
            for (face, wanted) in wanted.iter().enumerate().map(|(at, wanted)| (index * FACES_PER_BATCH + at, wanted)) {
                for (half, wanted) in wanted.iter().enumerate() {
                    let before = batch.positions.len();
                    let taken = self.halves[face][half].taken;
                    self.maker.half(self.piece.faces.start + face, half, taken..(*wanted).max(taken), &mut batch);
                    batch.counts.push(batch.positions.len() - before);
                }
            }
            batch
        };
        wanted.par_chunks(FACES_PER_BATCH).enumerate().map(batch).collect()
    }

    /// Whether rays from a point may end before they have crossed all that there is.
    fn is_cut(&self, origin: Vec3) -> bool {
        let Bounds { min, max } = &self.piece.occluders_m;
        let origin = origin.as_dvec3();
        let furthest = (origin - *min).abs().max((*max - origin).abs());
        !self.piece.occluders_m.is_empty() && furthest.length() > f64::from(self.kernel.t_max)
    }

    /// Gathers the samples that may see something; the others are open without a ray.
    fn gather(&mut self, samples: &[SurfaceSample]) -> Result<Vec<CosineSums>, TraceError> {
        let rays = self.piece.sampling.rays_per_sample;
        let known = self.known(samples);
        let is_closed = |index: &usize| known.get(*index).is_none_or(Option::is_none);
        let closed: Cow<'_, [SurfaceSample]> = if known.iter().any(Option::is_some) {
            (0..samples.len()).filter(is_closed).map(|index| samples[index]).collect()
        } else {
            samples.into()
        };
        let mut gathered = vec![CosineSums::default(); closed.len()];
        self.tracer.gather_cosine(&closed, &self.kernel, rays, &mut gathered)?;

        self.summary.samples += samples.len() as u64;
        self.summary.rays += closed.len() as u64 * u64::from(rays);
        let cut = closed.iter().filter(|sample| self.is_cut(sample.origin)).count() as u64;
        self.summary.rays_cut += cut * u64::from(rays);
        self.summary.rays_skipped_empty += (samples.len() - closed.len()) as u64 * u64::from(rays);
        if closed.len() == samples.len() {
            return Ok(gathered);
        }
        let mut gathered = gathered.into_iter();
        let sums = known.into_iter().map(|known| known.or_else(|| gathered.next()).unwrap_or_default());
        Ok(sums.collect())
    }

    /// What is known of each sample without a ray; empty if nothing is. All are asked only if one of some is open, since most
    /// pieces are covered by something everywhere.
    fn known(&self, samples: &[SurfaceSample]) -> Vec<Option<CosineSums>> {
        let is_open =
            |sample: &SurfaceSample| is_open_above(self.scene, sample.origin, sample.geometric, self.kernel.t_max);
        let rays = self.piece.sampling.rays_per_sample;
        if !self.piece.sampling.skips(SkipRule::Empty) || !samples.iter().step_by(PROBE_STEP).any(is_open) {
            return Vec::new();
        }
        let known = |sample: &SurfaceSample| is_open(sample).then(|| open_sums(sample, rays));
        samples.par_iter().with_min_len(64).map(known).collect()
    }
}

/// Adds what gathering found at a position to its half's moments.
fn add_position(
    half: &mut HalfMoments,
    position: &Position,
    sides: &[CosineSums],
    kernel: &KernelRates,
    sampling: &Sampling,
    summary: &mut TraceSummary,
) {
    let values = sides.iter().map(|sums| valid_ao(sums, sampling));
    summary.invalid += add_sides(half, position, values, kernel.channels);
}

/// AO of a sample, unless it is invalid.
pub(crate) fn valid_ao(sums: &CosineSums, sampling: &Sampling) -> Option<[f64; MAX_CHANNELS]> {
    let is_valid = sums.rays > 0 && sums.back_face_fraction() <= sampling.back_face_limit;
    is_valid.then(|| std::array::from_fn(|channel| sums.ao(channel)))
}

/// Adds the mean of a position's valid sides to its half's moments, and gives the number of those that are not valid.
pub(crate) fn add_sides(
    half: &mut HalfMoments,
    position: &Position,
    sides: impl Iterator<Item = Option<[f64; MAX_CHANNELS]>>,
    channels: usize,
) -> u64 {
    let (mut sum, mut valid, mut invalid) = ([0.0; MAX_CHANNELS], 0, 0);
    for side in sides {
        let Some(values) = side else {
            invalid += 1;
            continue;
        };
        valid += 1;
        sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    if valid == 0 {
        half.add_invalid();
    } else {
        let mean = sum.map(|sum| sum / f64::from(valid));
        half.add(position.phi, &mean[..channels]);
    }
    invalid
}
