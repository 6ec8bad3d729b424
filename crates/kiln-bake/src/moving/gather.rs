//! What the valid points of regions see.

use super::valid::{sphere, valid};
use crate::volume::COSINE_BANDS;
use glam::DVec3;
use kiln_core::{CandidateBits, Level, MAX_CHANNELS, Region, RegionSamples, RegionSettings, SkipRule};
use kiln_trace::{HARMONICS, KernelRates, SpherePoint, SphereSums, TraceError, Tracer};

/// How points of regions are traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionGather {
    /// The value of a ray.
    pub kernel: KernelRates,
    /// Directions over the sphere, powers of two up to [`kiln_trace::MAX_RAYS_PER_SAMPLE`], and by what a point is left out.
    pub settings: RegionSettings,
    /// Where a region has many points each has fewer rays.
    pub is_adaptive: bool,
    /// Of all directions.
    pub seed: u64,
}

impl RegionGather {
    /// How a level's regions are traced.
    pub fn of(level: &Level) -> Self {
        Self {
            kernel: KernelRates::of(&level.sampling),
            settings: level.regions.settings,
            is_adaptive: !level.sampling.no_skip.contains(&SkipRule::Adaptive),
            seed: level.sampling.seed,
        }
    }
}

/// Traces the valid points of some regions. What comes back for a region depends on nothing but its box and validity,
/// the settings and what the tracer's scene has around it.
pub fn gather_regions(
    tracer: &dyn Tracer,
    regions: &[Region],
    settings: &RegionGather,
) -> Result<RegionSamples, TraceError> {
    let mut samples = RegionSamples {
        channels: settings.kernel.channels.clamp(1, MAX_CHANNELS) as u32,
        valid: Vec::with_capacity(regions.len()),
        values: Vec::new(),
        dropped: Vec::with_capacity(regions.len()),
        rays: 0,
    };
    for region in regions {
        gather(tracer, region, settings, &mut samples)?;
    }
    Ok(samples)
}

fn gather(
    tracer: &dyn Tracer,
    region: &Region,
    settings: &RegionGather,
    samples: &mut RegionSamples,
) -> Result<(), TraceError> {
    let candidates: Vec<usize> = valid(tracer, region, settings)?.iter().collect();
    let points: Vec<SpherePoint> = candidates.iter().map(|i| sphere(region.candidate(*i), settings.seed)).collect();
    let mut sums = vec![SphereSums::default(); points.len()];
    let rays = settings.settings.rays_of_each(points.len(), settings.is_adaptive);
    tracer.gather_sphere(&points, &settings.kernel, rays, &mut sums)?;
    let mut kept = CandidateBits::default();
    for (index, sum) in candidates.iter().zip(&sums) {
        samples.rays += u64::from(sum.rays);
        if sum.back_face_fraction() <= settings.settings.back_face_limit {
            kept.insert(*index);
            (0..samples.channels as usize).for_each(|channel| samples.values.extend(convolved(sum, channel)));
        }
    }
    samples.dropped.push((candidates.len() - kept.count()) as u32);
    samples.valid.push(kept);
    Ok(())
}

/// AO as a function of the normal at given points, metres relative to the level's origin, for each channel; none is left
/// out, whatever it sees. `rays_per_point` is a power of two up to [`kiln_trace::MAX_RAYS_PER_SAMPLE`].
pub fn gather_points(
    tracer: &dyn Tracer,
    points: &[DVec3],
    (kernel, rays_per_point, seed): (&KernelRates, u32, u64),
) -> Result<Vec<Vec<[f32; HARMONICS]>>, TraceError> {
    let spheres: Vec<SpherePoint> = points.iter().map(|point| sphere(*point, seed)).collect();
    let mut sums = vec![SphereSums::default(); spheres.len()];
    tracer.gather_sphere(&spheres, kernel, rays_per_point, &mut sums)?;
    let channels = kernel.channels.clamp(1, MAX_CHANNELS);
    Ok(sums.iter().map(|sum| (0..channels).map(|channel| convolved(sum, channel)).collect()).collect())
}

/// AO as a function of the normal.
#[expect(clippy::cast_possible_truncation, reason = "f32 is the stored precision")]
fn convolved(sum: &SphereSums, channel: usize) -> [f32; HARMONICS] {
    let seen = sum.coefficients(channel);
    std::array::from_fn(|i| (COSINE_BANDS[i] * seen[i]) as f32)
}
