//! A tracer whose time is told apart from that of the tasks that call it.

use crate::account::{Part, part};
use kiln_trace::{CosineSums, Hit, KernelRates, Ray, SpherePoint, SphereSums, SurfaceSample, TraceError, Tracer};

/// The same answers; the time that they take is charged to [`Part::Tracing`].
pub(super) struct Counted<'a>(pub(super) &'a dyn Tracer);

impl Tracer for Counted<'_> {
    fn gather_cosine(
        &self,
        samples: &[SurfaceSample],
        kernel: &KernelRates,
        rays_per_sample: u32,
        sums: &mut [CosineSums],
    ) -> Result<(), TraceError> {
        part(Part::Tracing, || self.0.gather_cosine(samples, kernel, rays_per_sample, sums))
    }

    fn gather_sphere(
        &self,
        points: &[SpherePoint],
        kernel: &KernelRates,
        rays_per_point: u32,
        sums: &mut [SphereSums],
    ) -> Result<(), TraceError> {
        part(Part::Tracing, || self.0.gather_sphere(points, kernel, rays_per_point, sums))
    }

    fn trace(&self, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError> {
        part(Part::Tracing, || self.0.trace(rays, hits))
    }

    fn any_hit(&self, rays: &[Ray], blocked: &mut [bool]) -> Result<(), TraceError> {
        part(Part::Tracing, || self.0.any_hit(rays, blocked))
    }
}
