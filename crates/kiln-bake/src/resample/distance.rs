//! How far points of a LOD are from the surface of the full mesh that they stand for.
//!
//! # How it works
//! From each point rays go along its normal, against it, and at 45° to both; the least distance counts of those whose hit
//! is on a face that faces the point's way, seen from either side. The nearest of several hits is never nearer than the
//! nearest point of the surface, so the sphere of twice the distance reaches it. One ray alone errs where it matters: past
//! a ridge it goes on to something far behind. Faces that face away do not count, since they are another surface: the
//! other side of a wall.

use super::baked::BakedSurface;
use glam::DVec3;
use kiln_trace::{Hit, Ray, SurfaceSample, TraceError, Tracer, orthonormal_basis};
use rayon::prelude::*;

/// Rays of one point.
pub(crate) const PROBES: usize = 6;

/// Points whose rays are traced in one call of the tracer.
const POINTS_PER_CALL: usize = (1 << 20) / PROBES;

/// The least distance, as a part of the full mesh's diagonal.
const LEAST: f64 = 1.0 / 8192.0;

/// The least distance, as a part of the greatest coordinate: some times what rounding may move a ray or a surface by there
/// ([`kiln_trace::PositionError`]).
const ROUNDING: f64 = 1.0 / 262_144.0;

/// What is farther than this part of the diagonal is not what a point stands for.
const REACH: f64 = 0.5;

/// Measures distances to the surfaces of one scene.
pub(crate) struct Distances<'a> {
    tracer: &'a dyn Tracer,
    baked: &'a BakedSurface<'a>,
    least_m: f64,
    reach_m: f64,
}

impl<'a> Distances<'a> {
    pub(crate) fn new(tracer: &'a dyn Tracer, baked: &'a BakedSurface<'a>) -> Self {
        let bounds = baked.bounds_m();
        let (diagonal, furthest) = (bounds.diagonal(), bounds.min.abs().max(bounds.max.abs()).max_element());
        // Without a surface there is no furthest coordinate, and nothing to hit either.
        let least_m = if bounds.is_empty() { 0.0 } else { (LEAST * diagonal).max(ROUNDING * furthest) };
        Self { tracer, baked, least_m, reach_m: REACH * diagonal }
    }

    /// The distance of each point, metres, at least the least; nothing where no surface is within reach.
    pub(crate) fn measure(&self, points: &[SurfaceSample]) -> Result<Vec<Option<f64>>, TraceError> {
        let mut distances = Vec::with_capacity(points.len());
        for points in points.chunks(POINTS_PER_CALL) {
            let rays: Vec<Ray> = points.par_iter().flat_map_iter(|point| self.rays(point)).collect();
            let mut hits = vec![Hit::MISS; rays.len()];
            self.tracer.trace(&rays, &mut hits)?;
            let probes = rays.par_chunks(PROBES).zip(hits.par_chunks(PROBES));
            let nearest = points.par_iter().zip(probes).map(|(point, (rays, hits))| self.nearest(point, rays, hits));
            distances.par_extend(nearest);
        }
        Ok(distances)
    }

    /// Rays through a point. They begin the least distance before it, so that rounding has no say in whether a surface
    /// through the point is met.
    fn rays(&self, point: &SurfaceSample) -> [Ray; PROBES] {
        let normal = point.normal;
        let (u, v) = orthonormal_basis(normal);
        let slanted = [normal + u, normal - u, v - normal, -v - normal].map(|d| d * std::f32::consts::FRAC_1_SQRT_2);
        let [a, b, c, d] = slanted;
        [normal, -normal, a, b, c, d].map(|direction| {
            let origin = (point.origin.as_dvec3() - self.least_m * direction.as_dvec3()).as_vec3();
            Ray { origin, direction, t_max: (self.least_m + self.reach_m) as f32 }
        })
    }

    fn nearest(&self, point: &SurfaceSample, rays: &[Ray], hits: &[Hit]) -> Option<f64> {
        let normal: DVec3 = point.normal.as_dvec3();
        let faces_alike =
            |(ray, hit): &(&Ray, &Hit)| self.baked.read(ray, hit).is_some_and(|found| found.normal.dot(normal) > 0.0);
        let distance = |(_, hit): (&Ray, &Hit)| (f64::from(hit.t) - self.least_m).abs().max(self.least_m);
        rays.iter().zip(hits).filter(faces_alike).map(distance).reduce(f64::min)
    }
}
