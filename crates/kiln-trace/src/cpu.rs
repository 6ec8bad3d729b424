//! The CPU tracer: one ray at a time through both levels, four boxes or triangles at once.

use crate::{
    Hit, KernelRates, Ray, Scene, SurfaceSample, TraceError, Tracer, cosine_direction,
    directions::orthonormal_basis,
    sobol::sobol_point,
    tracer::CosineSums,
    traverse::{SlabRay, traverse},
    triangle::{ShearedRay, TWO_SIDED_BIT, intersect},
};
use rayon::prelude::*;
use std::sync::Arc;

/// Samples that one task of the thread pool gathers: enough to hide its cost, few enough to share the work.
const SAMPLES_PER_TASK: usize = 64;

/// Traces on the threads of the current rayon pool. Results do not depend on their number.
#[derive(Clone, Debug)]
pub struct CpuTracer {
    scene: Arc<Scene>,
}

impl CpuTracer {
    /// A tracer over a scene.
    pub fn new(scene: Arc<Scene>) -> Self {
        Self { scene }
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Closest hit; at equal distances front faces come first, then the lowest instance, then the lowest face.
    pub fn closest_hit(&self, ray: &Ray) -> Hit {
        let scene = &*self.scene;
        let mut best = Hit { t: ray.t_max, ..Hit::MISS };
        traverse(&scene.nodes, &SlabRay::new(ray.origin, ray.direction), ray.t_max, |leaf, _| {
            let instance = &scene.instances[leaf as usize];
            let mesh = &scene.meshes[instance.mesh as usize];
            let (origin, direction) = (instance.point(ray.origin), instance.direction(ray.direction));
            let sheared = ShearedRay::new(origin, direction);
            traverse(&mesh.nodes, &SlabRay::new(origin, direction), best.t, |block, _| {
                let block = &mesh.blocks[block as usize];
                let (t, front, mut mask) = intersect(block, &sheared);
                while mask != 0 {
                    let lane = mask.trailing_zeros() as usize;
                    mask &= mask - 1;
                    let primitive = block.primitives[lane];
                    let back_face = front & (1 << lane) == 0 && primitive & TWO_SIDED_BIT == 0;
                    let hit = Hit { t: t[lane], instance: leaf, primitive: primitive & !TWO_SIDED_BIT, back_face };
                    if precedes(&hit, &best) {
                        best = hit;
                    }
                }
                best.t
            });
            best.t
        });
        if best.instance == u32::MAX { Hit::MISS } else { best }
    }

    fn gather_one(&self, sample: &SurfaceSample, kernel: &KernelRates, rays_per_sample: u32) -> CosineSums {
        let mut sums = CosineSums::default();
        let basis = orthonormal_basis(sample.normal);
        for i in 0..rays_per_sample {
            let point = sobol_point(sample.first_index.wrapping_add(i), sample.scramble);
            let direction = cosine_direction(point, sample.normal, basis);
            if direction.dot(sample.geometric) <= 0.0 {
                continue;
            }
            sums.rays += 1;
            let hit = self.closest_hit(&Ray { origin: sample.origin, direction, t_max: kernel.t_max });
            for channel in 0..kernel.channels {
                sums.values[channel] += if hit.is_hit() { kernel.hit_value(channel, hit.t) } else { crate::ONE };
            }
            sums.back_faces += u32::from(hit.back_face);
        }
        sums
    }
}

/// The tie rule.
fn precedes(hit: &Hit, best: &Hit) -> bool {
    let key = |h: &Hit| (h.back_face, h.instance, h.primitive);
    hit.t < best.t || (hit.t == best.t && key(hit) < key(best))
}

impl Tracer for CpuTracer {
    fn gather_cosine(
        &self,
        samples: &[SurfaceSample],
        kernel: &KernelRates,
        rays_per_sample: u32,
        sums: &mut [CosineSums],
    ) -> Result<(), TraceError> {
        let chunks = samples.par_chunks(SAMPLES_PER_TASK).zip(sums.par_chunks_mut(SAMPLES_PER_TASK));
        chunks.for_each(|(samples, sums)| {
            for (sample, sum) in samples.iter().zip(sums) {
                *sum = self.gather_one(sample, kernel, rays_per_sample);
            }
        });
        Ok(())
    }

    fn trace(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError> {
        rays.par_iter().zip(hits).for_each(|(ray, hit)| *hit = self.closest_hit(ray));
        Ok(())
    }

    fn any_hit(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<(), TraceError> {
        rays.par_iter().zip(blocked).for_each(|(ray, blocked)| *blocked = self.closest_hit(ray).is_hit());
        Ok(())
    }
}
