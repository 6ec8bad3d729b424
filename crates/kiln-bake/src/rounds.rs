//! Adaptive sampling: more samples where the error is, until it is small enough.
//!
//! # How it works
//! A piece begins with few samples on every face. Then, in rounds, each half of a face's samples is given a count
//! that the *other* half's findings call for ([`Noise`], [`allocate`]), and the missing samples are taken. What a half
//! finds so never decides how many samples it has: given the other half, its count is fixed, so the mean of its samples
//! is unbiased, as it would not be if sampling stopped where the samples happen to agree. Everything is decided inside
//! the piece, from its own moments: no other piece, worker or batch has a say.
//!
//! [`allocate`]: Rounds::allocate

use crate::{noise::Noise, piece::Piece, piece::Sampler};
use glam::Vec3;
use kiln_core::{HalfMoments, Target};
use kiln_trace::TraceError;

/// Error of the values after the solve against that of one face's mean: what neighbours and the regulariser share, what
/// stratification gains, and what a fit loses. Measured: docs/benchmarks/sampling.md.
const SHARED: f64 = 0.7;

/// A class may cap the positions on a face; past the cap they are used again with further directions, so many times.
const RAYS_PAST_CAP: u32 = 16;

/// A round gives a face at most so many times its samples: what few samples say of the noise is itself noisy.
const GROWTH: u32 = 4;

/// More rounds than any cap needs at that growth.
const MOST_ROUNDS: usize = 12;

/// The rounds of one piece.
pub(crate) struct Rounds<'a> {
    target: &'a Target,
    /// Area of each face, square metres.
    areas: Vec<f64>,
    /// Most samples of one half of each face.
    caps: Vec<u32>,
    /// The corners of each face, as vertices of the piece.
    corners: Vec<[u32; 3]>,
    rays_per_position: Vec<u64>,
}

impl<'a> Rounds<'a> {
    pub(crate) fn new(piece: &Piece<'_>, target: &'a Target) -> Self {
        let sampling = piece.sampling;
        let cap = |face: usize| {
            let class = piece.mesh.group(face).max_samples_per_face.unwrap_or(u32::MAX).saturating_mul(RAYS_PAST_CAP);
            class.min(sampling.max_samples_per_face).max(sampling.min_samples_per_face) / 2
        };
        let sides = |face: usize| if piece.mesh.group(face).double_sided { 2 } else { 1 };
        let area = |face: usize| {
            let [a, b, c] = piece.mesh.corners(face).map(Vec3::as_dvec3);
            let matrix = piece.world_from_object.matrix3;
            0.5 * (matrix * (b - a)).cross(matrix * (c - a)).length()
        };
        Self {
            target,
            areas: piece.faces.clone().map(area).collect(),
            caps: piece.faces.clone().map(cap).collect(),
            corners: crate::noise::piece_vertices(piece.mesh, piece.faces.clone()),
            rays_per_position: piece
                .faces
                .clone()
                .map(|face| sides(face) * u64::from(sampling.rays_per_sample))
                .collect(),
        }
    }

    /// Takes samples until the piece has enough.
    pub(crate) fn run(&self, sampler: &mut Sampler<'_>) -> Result<(), TraceError> {
        for _ in 0..MOST_ROUNDS {
            let noise = [0, 1].map(|half| self.noise(&sampler.halves, half));
            let counts = [0, 1].map(|half| self.allocate(&noise[1 - half], &taken(&sampler.halves, half)));
            let wanted: Vec<[u32; 2]> = counts[0].iter().zip(&counts[1]).map(|(a, b)| [*a, *b]).collect();
            let has = sampler.halves.iter().map(|halves| halves.map(|half| half.taken));
            if has.eq(wanted.iter().copied()) {
                break;
            }
            sampler.extend(&wanted)?;
        }
        self.account(sampler);
        Ok(())
    }

    fn noise(&self, halves: &[[HalfMoments; 2]], half: usize) -> Noise {
        let moments: Vec<&HalfMoments> = halves.iter().map(|halves| &halves[half]).collect();
        Noise::new(&moments, &self.corners, &self.areas)
    }

    /// Samples for each face of one half: as few in all as bring the predicted error of the piece down to the target.
    ///
    /// The error of the piece is `Σ A e / n` over its faces, e the variance of a sample and n their number; at a given
    /// sum of n it is least where n goes as `√(A e)`.
    fn allocate(&self, noise: &Noise, taken: &[u32]) -> Vec<u32> {
        let faces = Shares { rounds: self, noise, taken };
        // Each half alone has twice the square of the error that their mean has.
        let relaxed = self.target.relaxed(self.mean_face_area_m2());
        let goal = self.target.goal(faces.deviation());
        let error = 2.0 * (relaxed * goal).powi(2);
        let sampled = taken.iter().filter(|count| **count > 0).count() as f64;
        let per_face = self.target.samples_per_face / relaxed * (self.target.rmse / goal);
        let budget = 0.5 * per_face * sampled;
        let spent = |counts: &[u32]| counts.iter().copied().map(f64::from).sum::<f64>();
        faces.counts(faces.least_scale(|counts| faces.error(counts) <= error || spent(counts) >= budget))
    }

    fn mean_face_area_m2(&self) -> f64 {
        self.areas.iter().sum::<f64>() / self.areas.len().max(1) as f64
    }

    /// Counts the rays that were not needed.
    fn account(&self, sampler: &mut Sampler<'_>) {
        let noise = [0, 1].map(|half| self.noise(&sampler.halves, half));
        let is_buried = |halves: &[HalfMoments; 2]| halves.iter().all(|half| half.valid == 0);
        let buried: Vec<bool> = sampler.halves.iter().map(is_buried).collect();
        for (half, noise) in noise.iter().enumerate() {
            let taken = taken(&sampler.halves, half);
            let shares = Shares { rounds: self, noise, taken: &taken };
            let sampled = taken.iter().zip(&self.rays_per_position).filter(|(count, _)| **count > 0);
            let (rays, each) = sampled.fold((0.0, 0.0), |(rays, each), (count, per)| {
                (rays + f64::from(*count) * *per as f64, each + *per as f64)
            });
            let uniform = shares.uniform_count() * each;
            sampler.summary.rays_saved_adaptive += (uniform - rays).max(0.0).round() as u64;
            let mean = rays / each.max(1.0);
            for (face, count) in taken.iter().enumerate().filter(|(_, count)| **count > 0) {
                if buried[face] {
                    let missing = (mean - f64::from(*count)).max(0.0) * self.rays_per_position[face] as f64;
                    sampler.summary.rays_skipped_buried += missing.round() as u64;
                }
            }
        }
    }
}

fn taken(halves: &[[HalfMoments; 2]], half: usize) -> Vec<u32> {
    halves.iter().map(|halves| halves[half].taken).collect()
}

/// One half's faces, sharing samples.
struct Shares<'a> {
    rounds: &'a Rounds<'a>,
    noise: &'a Noise,
    taken: &'a [u32],
}

impl Shares<'_> {
    fn visible_area(&self, face: usize) -> f64 {
        self.rounds.areas[face] * self.noise.visible[face]
    }

    /// The counts at a scale: powers of two, which the sequences are best at, within what a round may add.
    #[expect(clippy::cast_possible_truncation, reason = "clamped to 32 powers of two")]
    fn counts(&self, scale: f64) -> Vec<u32> {
        let count = |(face, &taken): (usize, &u32)| {
            let wanted = scale * (self.visible_area(face) * self.noise.variance[face]).sqrt();
            let rounded = 1u32 << wanted.log2().round().clamp(0.0, 30.0) as u32;
            let most = self.rounds.caps[face].min(taken.saturating_mul(GROWTH)).max(taken);
            if taken == 0 { 0 } else { rounded.clamp(taken, most) }
        };
        self.taken.iter().enumerate().map(count).collect()
    }

    /// The predicted square of the half's error.
    fn error(&self, counts: &[u32]) -> f64 {
        let sampled = || counts.iter().enumerate().filter(|(_, count)| **count > 0);
        let area: f64 = sampled().map(|(face, _)| self.visible_area(face)).sum();
        let terms = sampled().map(|(face, &n)| self.visible_area(face) * self.noise.variance[face] / f64::from(n));
        if area > 0.0 { SHARED * terms.sum::<f64>() / area } else { 0.0 }
    }

    /// Standard deviation of a sample, by area.
    fn deviation(&self) -> f64 {
        let (area, variance) = (0..self.taken.len()).fold((0.0, 0.0), |(area, variance), face| {
            let visible = self.visible_area(face);
            (area + visible, variance + visible * self.noise.variance[face])
        });
        if area > 0.0 { (variance / area).sqrt() } else { 0.0 }
    }

    /// Samples on every face that have the same predicted error.
    fn uniform_count(&self) -> f64 {
        let error = self.error(self.taken);
        if error > 0.0 { SHARED * self.deviation().powi(2) / error } else { 0.0 }
    }

    /// The least scale at which the counts are enough; the largest tried if none is.
    fn least_scale(&self, enough: impl Fn(&[u32]) -> bool) -> f64 {
        let largest = (0..self.taken.len()).map(|face| self.visible_area(face) * self.noise.variance[face]);
        let Some(unit) = largest.filter(|share| *share > 0.0).reduce(f64::max).map(|share| 1.0 / share.sqrt()) else {
            return 0.0;
        };
        if enough(&self.counts(0.0)) {
            return 0.0;
        }
        // From one sample on the noisiest face to 2³⁰, in steps of a sixteenth of an octave.
        let (mut low, mut high) = (0u32, 30 * 16);
        while low < high {
            let middle = (low + high) / 2;
            let scale = unit * (f64::from(middle) / 16.0).exp2();
            if enough(&self.counts(scale)) { high = middle } else { low = middle + 1 }
        }
        unit * (f64::from(low) / 16.0).exp2()
    }
}
