//! What the valid points of regions see.

use super::valid::{sphere, valid};
use crate::volume::COSINE_BANDS;
use glam::DVec3;
use kiln_core::{CandidateBits, MAX_CHANNELS, Region, RegionSamples};
use kiln_trace::{HARMONICS, KernelRates, SpherePoint, SphereSums, TraceError, Tracer};

/// How points of regions are traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionGather {
    /// The value of a ray.
    pub kernel: KernelRates,
    /// Directions over the sphere, a power of two up to [`kiln_trace::MAX_RAYS_PER_SAMPLE`]; 1,024 in the paper.
    pub rays_per_point: u32,
    /// A point is left out if more of its rays than this fraction see the back of a face.
    pub back_face_limit: f64,
    /// Of all directions.
    pub seed: u64,
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
    tracer.gather_sphere(&points, &settings.kernel, settings.rays_per_point, &mut sums)?;
    let mut kept = CandidateBits::default();
    for (index, sum) in candidates.iter().zip(&sums) {
        samples.rays += u64::from(sum.rays);
        if sum.back_face_fraction() <= settings.back_face_limit {
            kept.insert(*index);
            (0..samples.channels as usize).for_each(|channel| samples.values.extend(convolved(sum, channel)));
        }
    }
    samples.dropped.push((candidates.len() - kept.count()) as u32);
    samples.valid.push(kept);
    Ok(())
}

/// AO as a function of the normal at given points, metres relative to the level's origin, for each channel; none is left
/// out, whatever it sees.
pub fn gather_points(
    tracer: &dyn Tracer,
    points: &[DVec3],
    settings: &RegionGather,
) -> Result<Vec<Vec<[f32; HARMONICS]>>, TraceError> {
    let spheres: Vec<SpherePoint> = points.iter().map(|point| sphere(*point, settings.seed)).collect();
    let mut sums = vec![SphereSums::default(); spheres.len()];
    tracer.gather_sphere(&spheres, &settings.kernel, settings.rays_per_point, &mut sums)?;
    let channels = settings.kernel.channels.clamp(1, MAX_CHANNELS);
    Ok(sums.iter().map(|sum| (0..channels).map(|channel| convolved(sum, channel)).collect()).collect())
}

/// AO as a function of the normal.
#[expect(clippy::cast_possible_truncation, reason = "f32 is the stored precision")]
fn convolved(sum: &SphereSums, channel: usize) -> [f32; HARMONICS] {
    let seen = sum.coefficients(channel);
    std::array::from_fn(|i| (COSINE_BANDS[i] * seen[i]) as f32)
}
