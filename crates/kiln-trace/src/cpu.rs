//! The CPU tracer: bundles of rays on the threads of a pool.

use crate::{
    CosineSums, Hit, KernelRates, Path, Ray, Scene, SpherePoint, SphereSums, SurfaceSample, TraceError, Tracer,
    levels::Workspace,
    rays::BUNDLE,
    sphere_gather::GatherSphere,
    stream::{Answer, Gather, Trace},
};
use rayon::prelude::*;
use std::{cell::RefCell, slice, sync::Arc};

/// Rays that one task of the thread pool traces, whole bundles: enough to hide its cost, few enough to share the work.
const RAYS_PER_TASK: usize = 16 * BUNDLE;

/// Samples that one task of the thread pool gathers.
const SAMPLES_PER_TASK: usize = 64;

thread_local! {
    static WORKSPACE: RefCell<Box<Workspace>> = RefCell::new(Workspace::new());
}

/// Traces on the threads of the current rayon pool. Results depend neither on their number nor on the processor.
#[derive(Clone, Debug)]
pub struct CpuTracer {
    scene: Arc<Scene>,
    path: Path,
}

impl CpuTracer {
    /// A tracer over a scene, with the fastest instructions that the processor has.
    pub fn new(scene: Arc<Scene>) -> Self {
        Self::with_path(scene, Path::detect())
    }

    /// A tracer that uses given instructions, or portable ones where the processor lacks them.
    pub fn with_path(scene: Arc<Scene>, path: Path) -> Self {
        Self { scene, path }
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Closest hit; at equal distances front faces come first, then the lowest instance, then the lowest face.
    pub fn closest_hit(&self, ray: &Ray) -> Hit {
        let mut hit = Hit::MISS;
        self.run(slice::from_ref(ray), slice::from_mut(&mut hit));
        hit
    }

    /// Traces a run of rays on this thread.
    fn run<A: Answer>(&self, rays: &[Ray], answers: &mut [A]) {
        WORKSPACE.with_borrow_mut(|workspace| self.path.run(Trace { scene: &self.scene, rays, answers, workspace }));
    }

    /// Traces rays on all threads.
    fn run_all<A: Answer + Send>(&self, rays: &[Ray], answers: &mut [A]) {
        let chunks = rays.par_chunks(RAYS_PER_TASK).zip(answers.par_chunks_mut(RAYS_PER_TASK));
        // Each chunk is a task of its own: left to itself rayon makes few tasks, and threads wait for the longest.
        chunks.with_max_len(1).for_each(|(rays, answers)| self.run(rays, answers));
    }
}

impl Tracer for CpuTracer {
    fn gather_cosine(
        &self,
        samples: &[SurfaceSample],
        kernel: &KernelRates,
        rays_per_sample: u32,
        sums: &mut [CosineSums],
    ) -> Result<(), TraceError> {
        let scene = &*self.scene;
        let chunks = samples.par_chunks(SAMPLES_PER_TASK).zip(sums.par_chunks_mut(SAMPLES_PER_TASK));
        chunks.with_max_len(1).for_each(|(samples, sums)| {
            WORKSPACE.with_borrow_mut(|workspace| {
                self.path.run(Gather { scene, kernel, rays_per_sample, samples, sums, workspace });
            });
        });
        Ok(())
    }

    fn gather_sphere(
        &self,
        points: &[SpherePoint],
        kernel: &KernelRates,
        rays_per_point: u32,
        sums: &mut [SphereSums],
    ) -> Result<(), TraceError> {
        let scene = &*self.scene;
        let points_per_task = (RAYS_PER_TASK / rays_per_point.max(1) as usize).max(1);
        let chunks = points.par_chunks(points_per_task).zip(sums.par_chunks_mut(points_per_task));
        chunks.with_max_len(1).for_each(|(points, sums)| {
            WORKSPACE.with_borrow_mut(|workspace| {
                self.path.run(GatherSphere { scene, kernel, rays_per_point, points, sums, workspace });
            });
        });
        Ok(())
    }

    fn trace(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError> {
        self.run_all(rays, hits);
        Ok(())
    }

    fn any_hit(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<(), TraceError> {
        self.run_all(rays, blocked);
        Ok(())
    }
}
