//! AO at given points, for spot checks against other tools.

use glam::DVec3;
use kiln_core::Kernel;
use kiln_trace::{CosineSums, KernelRates, MAX_RAYS_PER_SAMPLE, SobolScramble, SurfaceSample, TraceError, Tracer};

/// A point to probe, used as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbePoint {
    /// Metres relative to the level's origin.
    pub position: DVec3,
    /// Direction of the hemisphere; need not be of unit length, but not zero.
    pub normal: DVec3,
    /// Normal of the surface, if it is another: directions below it are left out. Not zero.
    pub geometric: Option<DVec3>,
}

/// What a probe finds.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeResult {
    /// AO for each channel.
    pub ao: Vec<f64>,
    /// Fraction of rays whose closest hit is a back face.
    pub back_face_fraction: f64,
}

/// Gathers `rays` rays (rounded up to a power of two) at each point. The scramble depends on the seed alone, so that
/// two levels are probed with the same directions.
pub fn probe(
    tracer: &dyn Tracer,
    points: &[ProbePoint],
    kernel: &Kernel,
    rays: u32,
    seed: u32,
) -> Result<Vec<ProbeResult>, TraceError> {
    let rates = KernelRates::new(kernel);
    let rays = rays.clamp(1, 1 << 30).next_power_of_two();
    let rays_per_sample = rays.min(MAX_RAYS_PER_SAMPLE);
    let blocks = (rays / rays_per_sample) as usize;
    let mut samples = Vec::with_capacity(points.len() * blocks);
    for point in points {
        let normal = point.normal.normalize_or(DVec3::Y).as_vec3();
        let geometric = point.geometric.map_or(normal, |geometric| geometric.normalize_or(point.normal).as_vec3());
        let origin = point.position.as_vec3();
        samples.extend((0..blocks as u32).map(|block| SurfaceSample {
            origin,
            normal,
            geometric,
            scramble: SobolScramble([seed.wrapping_mul(0x9e37_79b9) ^ 0x2545_f491, seed ^ 0x6a09_e667]),
            first_index: block * rays_per_sample,
        }));
    }
    let mut sums = vec![CosineSums::default(); samples.len()];
    tracer.gather_cosine(&samples, &rates, rays_per_sample, &mut sums)?;
    Ok(sums.chunks_exact(blocks).map(|sums| result(sums, rates.channels)).collect())
}

fn result(sums: &[CosineSums], channels: usize) -> ProbeResult {
    let total = |of: &dyn Fn(&CosineSums) -> u32| sums.iter().map(|s| f64::from(of(s))).sum::<f64>();
    let rays = total(&|s| s.rays).max(1.0);
    let ao = (0..channels).map(|channel| total(&|s| s.values[channel]) / (65536.0 * rays)).collect();
    ProbeResult { ao, back_face_fraction: total(&|s| s.back_faces) / rays }
}
