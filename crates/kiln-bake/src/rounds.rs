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

use crate::{density::receiving_area_m2, noise::Noise, piece::Piece, piece::Sampler};
use kiln_core::{HalfMoments, SkipRule, Target};
use kiln_trace::TraceError;

/// The square of a fit's error is `FITTED · leverage · variance / n^FALL` for n samples of a half on every face: they are
/// stratified in position and direction, so it falls faster than 1 / n. Measured: docs/benchmarks/sampling.md.
const FITTED: f64 = 0.9;

/// See [`FITTED`].
const FALL: f64 = 1.25;

/// A class's cap counts samples of so many rays (Sloan et al. 2013): of fewer rays, as many more.
const RAYS_OF_CAPPED_SAMPLE: u32 = 256;

/// A round gives a face at most so many times its samples: what few samples say of the noise is itself noisy.
const GROWTH: u32 = 4;

/// More rounds than any cap needs at that growth.
const MOST_ROUNDS: usize = 12;

/// The rounds of one piece.
pub(crate) struct Rounds<'a> {
    target: &'a Target,
    /// Area of each face, square metres.
    areas: Vec<f64>,
    /// How much of the noise of its own samples a face's values keep: [`leverage`].
    leverage: Vec<f64>,
    /// Most samples of one half of each face.
    caps: Vec<u32>,
    /// The corners of each face, as vertices of the piece.
    corners: Vec<[u32; 3]>,
    rays_per_position: Vec<u64>,
    /// The power of [`FALL`] of 2ᵏ, for each k.
    powers: [f64; u32::BITS as usize],
    /// Faces whose samples are all hidden are given up.
    skips_buried: bool,
}

impl<'a> Rounds<'a> {
    pub(crate) fn new(piece: &Piece<'_>, target: &'a Target) -> Self {
        let sampling = piece.sampling;
        let more = (RAYS_OF_CAPPED_SAMPLE / sampling.rays_per_sample).max(1);
        let cap = |face: usize| {
            let class = piece.mesh.group(face).max_samples_per_face.unwrap_or(u32::MAX).saturating_mul(more);
            class.min(sampling.max_samples_per_face).max(sampling.min_samples_per_face) / 2
        };
        let sides = |face: usize| if piece.mesh.group(face).double_sided { 2 } else { 1 };
        let area = |face: usize| receiving_area_m2(piece.mesh, piece.world_from_object, face);
        let areas: Vec<f64> = piece.faces.clone().map(area).collect();
        let corners = crate::noise::piece_vertices(piece.mesh, piece.faces.clone());
        Self {
            target,
            leverage: leverage(&corners, &areas),
            caps: piece.faces.clone().map(cap).collect(),
            areas,
            corners,
            rays_per_position: piece
                .faces
                .clone()
                .map(|face| sides(face) * u64::from(sampling.rays_per_sample))
                .collect(),
            powers: std::array::from_fn(|k| libm::pow(f64::from(1u32 << k), FALL)),
            skips_buried: sampling.skips(SkipRule::Buried),
        }
    }

    /// `n` to the power of [`FALL`].
    fn power(&self, n: u32) -> f64 {
        if n.is_power_of_two() { self.powers[n.trailing_zeros() as usize] } else { libm::pow(f64::from(n), FALL) }
    }

    /// Takes samples until the piece has enough.
    pub(crate) fn run(&self, sampler: &mut Sampler<'_>) -> Result<(), TraceError> {
        let mut noise = self.noises(&sampler.halves);
        for _ in 0..MOST_ROUNDS {
            let counts = [0, 1].map(|half| self.allocate(&noise[1 - half], &taken(&sampler.halves, half)));
            let wanted: Vec<[u32; 2]> = counts[0].iter().zip(&counts[1]).map(|(a, b)| [*a, *b]).collect();
            let has = sampler.halves.iter().map(|halves| halves.map(|half| half.taken));
            if has.eq(wanted.iter().copied()) {
                break;
            }
            sampler.extend(&wanted)?;
            noise = self.noises(&sampler.halves);
        }
        self.account(sampler, &noise);
        Ok(())
    }

    fn noises(&self, halves: &[[HalfMoments; 2]]) -> [Noise; 2] {
        [0, 1].map(|half| self.noise(halves, half))
    }

    fn noise(&self, halves: &[[HalfMoments; 2]], half: usize) -> Noise {
        let moments: Vec<&HalfMoments> = halves.iter().map(|halves| &halves[half]).collect();
        let mut noise = Noise::new(&moments, &self.corners, &self.areas);
        if !self.skips_buried {
            noise.see_hidden(&moments);
        }
        noise
    }

    /// Samples for each face of one half: as few in all as bring the predicted error of the piece down to the target.
    ///
    /// The error of the piece is `Σ A h e / n^FALL` over its faces, h the leverage, e the variance of a sample and n their
    /// number; at a given sum of n it is least where n goes as the (1 + FALL)th root of `A h e`.
    fn allocate(&self, noise: &Noise, taken: &[u32]) -> Vec<u32> {
        let faces = Shares::new(self, noise, taken);
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
    fn account(&self, sampler: &mut Sampler<'_>, noise: &[Noise; 2]) {
        let is_buried = |halves: &[HalfMoments; 2]| halves.iter().all(|half| half.valid == 0);
        let buried: Vec<bool> = sampler.halves.iter().map(is_buried).collect();
        for (half, noise) in noise.iter().enumerate() {
            let taken = taken(&sampler.halves, half);
            let shares = Shares::new(self, noise, &taken);
            let sampled = taken.iter().zip(&self.rays_per_position).filter(|(count, _)| **count > 0);
            let (rays, each) = sampled.fold((0.0, 0.0), |(rays, each), (count, per)| {
                (rays + f64::from(*count) * *per as f64, each + *per as f64)
            });
            let uniform = shares.uniform_count() * each;
            sampler.summary.rays_saved_adaptive += (uniform - rays).max(0.0).round() as u64;
            let mean = rays / each.max(1.0);
            for (face, count) in taken.iter().enumerate().filter(|(_, count)| **count > 0) {
                if buried[face] && self.skips_buried {
                    let missing = (mean - f64::from(*count)).max(0.0) * self.rays_per_position[face] as f64;
                    sampler.summary.rays_skipped_buried += missing.round() as u64;
                }
            }
        }
    }
}

/// The part of the noise of a face's samples that is left in values fitted to them and to those of its neighbours: a face
/// alone has three values of its own, a face of a large smooth mesh half a value. A fit's variance is the noise's times
/// values by samples; the share of a corner's value that a face has is its share of the area around it.
fn leverage(corners: &[[u32; 3]], areas: &[f64]) -> Vec<f64> {
    let mut around = vec![0.0; corners.iter().flatten().max().map_or(0, |last| *last as usize + 1)];
    for (corners, area) in corners.iter().zip(areas) {
        corners.iter().for_each(|vertex| around[*vertex as usize] += area);
    }
    let share = |vertex: u32, area: f64| if area > 0.0 { area / around[vertex as usize] } else { 0.0 };
    let of_face = |(corners, area): (&[u32; 3], &f64)| corners.iter().map(|vertex| share(*vertex, *area)).sum();
    corners.iter().zip(areas).map(of_face).collect()
}

fn taken(halves: &[[HalfMoments; 2]], half: usize) -> Vec<u32> {
    halves.iter().map(|halves| halves[half].taken).collect()
}

/// One half's faces, sharing samples.
struct Shares<'a> {
    rounds: &'a Rounds<'a>,
    noise: &'a Noise,
    taken: &'a [u32],
    /// What each face adds to the square of the error, times the visible area and but for the number of its samples.
    share: Vec<f64>,
    /// Its binary logarithm.
    log_share: Vec<f64>,
    /// Visible area of the faces that have samples.
    sampled_area: f64,
}

impl<'a> Shares<'a> {
    fn new(rounds: &'a Rounds<'a>, noise: &'a Noise, taken: &'a [u32]) -> Self {
        let visible = |face: usize| visible_area(rounds, noise, face);
        let share = |face: usize| visible(face) * rounds.leverage[face] * noise.variance[face];
        let share: Vec<f64> = (0..taken.len()).map(share).collect();
        let log_share = share.iter().map(|share| libm::log2(*share)).collect();
        let sampled_area = (0..taken.len()).filter(|face| taken[*face] > 0).map(visible).sum();
        Self { rounds, noise, taken, share, log_share, sampled_area }
    }

    /// The counts at a scale of the shares, of which the binary logarithm is given: powers of two, which the sequences are best
    /// at, within what a round may add.
    #[expect(clippy::cast_possible_truncation, reason = "clamped to 32 powers of two")]
    fn counts(&self, log_scale: f64) -> Vec<u32> {
        let count = |(face, &taken): (usize, &u32)| {
            let wanted = (log_scale + self.log_share[face]) / (1.0 + FALL);
            let rounded = 1u32 << wanted.round().clamp(0.0, 30.0) as u32;
            let most = self.rounds.caps[face].min(taken.saturating_mul(GROWTH)).max(taken);
            if taken == 0 { 0 } else { rounded.clamp(taken, most) }
        };
        self.taken.iter().enumerate().map(count).collect()
    }

    /// The predicted square of the half's error. Faces have samples where they have had some.
    fn error(&self, counts: &[u32]) -> f64 {
        let sampled = self.share.iter().zip(counts).filter(|(_, count)| **count > 0);
        let terms = sampled.map(|(share, &n)| share / self.rounds.power(n));
        if self.sampled_area > 0.0 { FITTED * terms.sum::<f64>() / self.sampled_area } else { 0.0 }
    }

    /// Standard deviation of a sample, by area.
    fn deviation(&self) -> f64 {
        let (area, variance) = (0..self.taken.len()).fold((0.0, 0.0), |(area, variance), face| {
            let visible = visible_area(self.rounds, self.noise, face);
            (area + visible, variance + visible * self.noise.variance[face])
        });
        if area > 0.0 { (variance / area).sqrt() } else { 0.0 }
    }

    /// Samples on every face that have the same predicted error.
    fn uniform_count(&self) -> f64 {
        let error = self.error(self.taken);
        let single: Vec<u32> = self.taken.iter().map(|count| (*count).min(1)).collect();
        if error > 0.0 { libm::pow(self.error(&single) / error, 1.0 / FALL) } else { 0.0 }
    }

    /// The least scale at which the counts are enough, as its binary logarithm; the largest tried if none is.
    fn least_scale(&self, enough: impl Fn(&[u32]) -> bool) -> f64 {
        let largest = self.log_share.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if largest == f64::NEG_INFINITY || enough(&self.counts(f64::NEG_INFINITY)) {
            return f64::NEG_INFINITY;
        }
        // From one sample on the noisiest face to 2³⁰, in steps of a sixteenth of an octave.
        let scale = |step: u32| f64::from(step) / 16.0 * (1.0 + FALL) - largest;
        let (mut low, mut high) = (0u32, 30 * 16);
        while low < high {
            let middle = (low + high) / 2;
            if enough(&self.counts(scale(middle))) { high = middle } else { low = middle + 1 }
        }
        scale(low)
    }
}

fn visible_area(rounds: &Rounds<'_>, noise: &Noise, face: usize) -> f64 {
    rounds.areas[face] * noise.visible[face]
}
