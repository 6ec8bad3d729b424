//! The GPU as a [`Tracer`].

use crate::{
    GpuDevice, GpuError, Visits, any_hit,
    budget::Budget,
    device::{CompiledKernel, lock},
    foliage::FoliageShape,
    gather::Gather,
    shader::Entry,
    trace,
    traverse::SceneBuffers,
    values, visits,
};
use glam::Vec3;
use kiln_trace::{
    CosineSums, FoliageView, Hit, KernelRates, MAX_RAYS_PER_SAMPLE, Ray, RayValue, Scene, SpherePoint, SphereSums,
    SurfaceSample, TraceError, Tracer, gather_sphere_by_rays, gather_sphere_by_values,
};
use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

/// Traces on a device, over a scene that was sent there. It does not keep the [`Scene`].
///
/// Calls may come from several threads. Two dispatches of some 20 to 50 ms each are in flight at a time, so that the
/// device need not wait for the host.
#[derive(Debug)]
pub struct GpuTracer {
    gpu: Arc<GpuDevice>,
    scene: SceneBuffers,
    budget: Mutex<Budget>,
}

impl GpuTracer {
    /// Sends a scene to a device.
    ///
    /// Fails with [`TraceError::TooLarge`] where the scene exceeds the device's limits or memory.
    pub fn new(gpu: Arc<GpuDevice>, scene: &Scene) -> Result<Self, GpuError> {
        Self::with_binding_bytes(gpu, scene, u64::MAX)
    }

    /// As [`GpuTracer::new`], by the software traversal on any device: what ray queries are compared with.
    pub fn without_ray_queries(gpu: Arc<GpuDevice>, scene: &Scene) -> Result<Self, GpuError> {
        Self::of(gpu, scene, u64::MAX, false)
    }

    /// As [`GpuTracer::new`], with a lower limit than the device's own to the bytes of one storage binding: tests
    /// use it to spread a small scene over several.
    pub fn with_binding_bytes(gpu: Arc<GpuDevice>, scene: &Scene, binding_bytes: u64) -> Result<Self, GpuError> {
        let ray_queries = gpu.has_ray_queries();
        Self::of(gpu, scene, binding_bytes, ray_queries)
    }

    fn of(gpu: Arc<GpuDevice>, scene: &Scene, binding_bytes: u64, ray_queries: bool) -> Result<Self, GpuError> {
        let scene = SceneBuffers::upload(&gpu, scene, binding_bytes, ray_queries)?;
        // Compiled here, so that a driver that cannot is known before there is work.
        gpu.kernel(Entry::Gather, &scene.shape)?;
        Ok(Self { gpu, scene, budget: Mutex::new(Budget::new()) })
    }

    /// Whether this tracer knows all that rays go through in a scene; else only the processor's does.
    pub fn knows(scene: &Scene) -> bool {
        let is_known = |leaf| match leaf {
            FoliageView::Crossings { mesh, .. } => !mesh.has_holes(),
            FoliageView::Fog { .. } | FoliageView::Shrubs(_) => true,
        };
        !scene.has_cutouts() && scene.foliage().is_none_or(|foliage| foliage.leaves().all(is_known))
    }

    /// The device.
    pub fn gpu(&self) -> &GpuDevice {
        &self.gpu
    }

    /// The scene's size in the device's memory, bytes; with ray queries without the driver's own structures.
    pub fn memory_bytes(&self) -> u64 {
        self.scene.memory_bytes
    }

    /// Storage bindings that the scene is spread over.
    pub fn binding_count(&self) -> u32 {
        self.scene.shape.bindings
    }

    /// Whether it traces by hardware ray queries.
    pub fn has_ray_queries(&self) -> bool {
        self.scene.shape.ray_queries
    }

    /// Counts what the closest hits of rays cost on this device. With ray queries, nodes are boxes that were proposed.
    pub fn visits(&self, rays: &[Ray]) -> Result<Visits, TraceError> {
        visits::run(self, rays)
    }

    /// Refuses origins for which ray queries are not known to be right; the software traversal takes all.
    pub(crate) fn check_origins(&self, origins: impl Iterator<Item = Vec3>) -> Result<(), TraceError> {
        let reach_m = self.scene.origin_reach;
        // What is no number meets nothing, wherever it starts.
        let mut distances = origins.map(|origin| origin.abs().max_element());
        let far = if reach_m.is_finite() { distances.find(|distance| *distance > reach_m) } else { None };
        far.map_or(Ok(()), |distance_m| Err(TraceError::OutOfReach { distance_m, reach_m }))
    }

    pub(crate) fn scene_group(&self) -> &wgpu::BindGroup {
        &self.scene.group
    }

    pub(crate) fn kernel(&self, entry: Entry) -> Result<Arc<CompiledKernel>, TraceError> {
        self.gpu.kernel(entry, &self.scene.shape).map_err(|error| match error {
            GpuError::Trace(error) => error,
            other => self.gpu.lost(other.to_string()),
        })
    }

    pub(crate) fn ray_budget(&self) -> u64 {
        lock(&self.budget).rays()
    }

    pub(crate) fn observe(&self, rays: u64, elapsed: Duration) {
        lock(&self.budget).observe(rays, elapsed);
    }
}

impl Tracer for GpuTracer {
    fn gather_cosine(
        &self,
        samples: &[SurfaceSample],
        kernel: &KernelRates,
        rays_per_sample: u32,
        sums: &mut [CosineSums],
    ) -> Result<(), TraceError> {
        assert!(
            rays_per_sample.is_power_of_two() && rays_per_sample <= MAX_RAYS_PER_SAMPLE,
            "{rays_per_sample} rays per sample is no power of two up to {MAX_RAYS_PER_SAMPLE}"
        );
        assert_eq!(samples.len(), sums.len(), "one sum for each sample");
        debug_assert!(samples.iter().all(|sample| sample.first_index.is_multiple_of(rays_per_sample)));
        Gather::new(self, kernel, rays_per_sample, samples.len()).run(samples, sums)
    }

    fn gather_sphere(
        &self,
        points: &[SpherePoint],
        kernel: &KernelRates,
        rays_per_point: u32,
        sums: &mut [SphereSums],
    ) -> Result<(), TraceError> {
        assert_eq!(points.len(), sums.len(), "one sum for each point");
        // There is no kernel for it yet (docs/gpu.md).
        if self.scene.shape.foliage == FoliageShape::Nothing {
            return gather_sphere_by_rays(self, points, kernel, rays_per_point, sums);
        }
        let trace = |rays: &[Ray], found: &mut [RayValue]| values::run(self, kernel, rays, found);
        gather_sphere_by_values(points, kernel, rays_per_point, sums, trace)
    }

    fn trace(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError> {
        assert_eq!(rays.len(), hits.len(), "one hit for each ray");
        trace::run(self, rays, hits)
    }

    fn any_hit(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<(), TraceError> {
        assert_eq!(rays.len(), blocked.len(), "one answer for each ray");
        any_hit::run(self, rays, blocked)
    }
}
