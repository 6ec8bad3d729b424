//! A tracer whose samples have independent cosine-distributed directions instead of a low-discrepancy set.
//!
//! All else of a bake stays as it is: positions, validity, moments. What it costs is what the rays cost and a few
//! multiplications for each random number.

use super::random::Stream;
use kiln_trace::{
    CosineSums, Hit, KernelRates, ONE, Ray, SpherePoint, SphereSums, SurfaceSample, TraceError, Tracer,
    cosine_direction, orthonormal_basis,
};
use rayon::prelude::*;

/// Samples whose rays are made and traced together.
const SAMPLES_PER_BATCH: usize = 16;

/// Wraps a tracer.
pub(super) struct RandomRays<'a> {
    pub(super) inner: &'a dyn Tracer,
    pub(super) seed: u64,
}

impl RandomRays<'_> {
    fn batch(
        &self,
        samples: &[SurfaceSample],
        kernel: &KernelRates,
        rays: u32,
        sums: &mut [CosineSums],
    ) -> Result<(), TraceError> {
        let mut batch = Vec::with_capacity(samples.len() * rays as usize);
        for (sample, sum) in samples.iter().zip(&mut *sums) {
            let before = batch.len();
            batch.extend(self.rays(sample, kernel.t_max, rays));
            *sum = CosineSums { rays: (batch.len() - before) as u32, ..CosineSums::default() };
        }
        let mut hits = vec![Hit::MISS; batch.len()];
        self.inner.trace(&batch, &mut hits)?;
        let mut hits = hits.iter();
        for sum in sums {
            for hit in hits.by_ref().take(sum.rays as usize) {
                for channel in 0..kernel.channels {
                    sum.values[channel] += if hit.is_hit() { kernel.hit_value(channel, hit.t) } else { ONE };
                }
                sum.back_faces += u32::from(hit.back_face);
            }
        }
        Ok(())
    }

    /// The rays of a sample that leave its surface.
    fn rays(&self, sample: &SurfaceSample, t_max: f32, rays: u32) -> impl Iterator<Item = Ray> {
        let [low, high] = sample.scramble.0.map(u64::from);
        let stream = Stream::new(self.seed ^ (high << 32 | low), 3);
        let (normal, geometric, origin) = (sample.normal, sample.geometric, sample.origin);
        let basis = orthonormal_basis(normal);
        let first = u64::from(sample.first_index);
        let direction = move |i: u64| {
            #[expect(clippy::cast_possible_truncation, reason = "the ray path is f32")]
            let point = [2 * i, 2 * i + 1].map(|counter| stream.unit(counter) as f32);
            cosine_direction(point, normal, basis)
        };
        let above = (first..first + u64::from(rays)).map(direction).filter(move |d| d.dot(geometric) > 0.0);
        above.map(move |direction| Ray { origin, direction, t_max })
    }
}

impl Tracer for RandomRays<'_> {
    fn gather_cosine(
        &self,
        samples: &[SurfaceSample],
        kernel: &KernelRates,
        rays_per_sample: u32,
        sums: &mut [CosineSums],
    ) -> Result<(), TraceError> {
        let batches = samples.par_chunks(SAMPLES_PER_BATCH).zip(sums.par_chunks_mut(SAMPLES_PER_BATCH));
        batches.map(|(samples, sums)| self.batch(samples, kernel, rays_per_sample, sums)).collect()
    }

    fn gather_sphere(
        &self,
        points: &[SpherePoint],
        kernel: &KernelRates,
        rays_per_point: u32,
        sums: &mut [SphereSums],
    ) -> Result<(), TraceError> {
        self.inner.gather_sphere(points, kernel, rays_per_point, sums)
    }

    fn trace(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError> {
        self.inner.trace(rays, hits)
    }

    fn any_hit(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<(), TraceError> {
        self.inner.any_hit(rays, blocked)
    }
}
