//! What a ball should be lit by: the sphere about it, traced through the baked file.

use super::Light;
use crate::{
    failure::Failure,
    half_distances::kernel_of,
    one_mesh::{one_mesh, scene_of},
};
use glam::DVec3;
use kiln_bake::gather_points;
use kiln_runtime::Meta;
use kiln_scene::BakedScene;
use kiln_trace::{CpuTracer, KernelRates};

/// Directions about each place.
const RAYS: u32 = 4096;

/// All geometry of a baked file, and what a ray is worth.
pub(crate) struct BallTracer {
    tracer: CpuTracer,
    origin: DVec3,
    kernel: KernelRates,
    /// Of each channel.
    weights: Vec<f32>,
}

impl BallTracer {
    /// Near an origin; rays are worth what they were in the bake of a pack.
    pub(crate) fn new(scene: &BakedScene, origin: DVec3, meta: &Meta<'_>) -> Self {
        let tracer = CpuTracer::new(scene_of(&one_mesh(scene, origin, |_| true)));
        Self { tracer, origin, kernel: KernelRates::new(&kernel_of(meta)), weights: meta.blend().to_vec() }
    }

    /// The tracer, and where its space begins.
    pub(super) fn space(&self) -> (&CpuTracer, DVec3) {
        (&self.tracer, self.origin)
    }

    /// AO as a function of the normal at each place, world space, metres.
    pub(super) fn lights(&self, places: &[DVec3]) -> Result<Vec<Light>, Failure> {
        let points: Vec<DVec3> = places.iter().map(|place| *place - self.origin).collect();
        let found = gather_points(&self.tracer, &points, (&self.kernel, RAYS, 0)).map_err(anyhow::Error::from)?;
        let blend = |channels: &Vec<Light>| {
            let mut light = Light::default();
            for (channel, weight) in channels.iter().zip(&self.weights) {
                light.iter_mut().zip(channel).for_each(|(sum, value)| *sum += weight * value);
            }
            light
        };
        Ok(found.iter().map(blend).collect())
    }
}
