//! The true signal at points of the surface, by rays of its own: `Tracer::trace`, shifted Hammersley sets, and the
//! kernel in f64 without a reach.

use super::{
    points::{Side, SurfacePoint},
    random::Stream,
    scene::BenchScene,
};
use crate::BenchError;
use glam::DVec3;
use kiln_trace::{Hit, Ray};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// A point with the signal there.
#[derive(Clone, Debug)]
pub(super) struct TruePoint {
    pub(super) point: SurfacePoint,
    /// AO of each channel: the mean of the valid sides.
    pub(super) ao: Vec<f64>,
    /// What was found on each side.
    pub(super) sides: Vec<SideTruth>,
}

/// The signal on one side of a point.
#[derive(Clone, Debug)]
pub(super) struct SideTruth {
    pub(super) ao: Vec<f64>,
    /// Fraction of rays above the surface whose closest hit is a back face.
    pub(super) back_face_fraction: f64,
    pub(super) is_valid: bool,
}

/// Traces `rays` rays on each side of each point, and leaves out points without a valid side.
pub(super) fn trace(
    scene: &BenchScene,
    points: Vec<SurfacePoint>,
    rays: u32,
    seed: u64,
) -> Result<Vec<TruePoint>, BenchError> {
    let stream = Stream::new(seed, 2);
    let of = |(index, point): (usize, SurfacePoint)| -> Result<Option<TruePoint>, BenchError> {
        let side = |(at, side): (usize, &Side)| {
            let counter = 4 * index as u64 + 2 * at as u64;
            gather(scene, side, rays, [stream.unit(counter), stream.unit(counter + 1)])
        };
        let sides: Vec<SideTruth> = point.sides.iter().enumerate().map(side).collect::<Result<_, _>>()?;
        let valid = || sides.iter().filter(|side| side.is_valid);
        let count = valid().count();
        if count == 0 {
            return Ok(None);
        }
        let mean = |channel: usize| valid().map(|side| side.ao[channel]).sum::<f64>() / count as f64;
        let ao = (0..scene.channels()).map(mean).collect();
        Ok(Some(TruePoint { point, ao, sides }))
    };
    let found: Vec<Option<TruePoint>> = points.into_par_iter().enumerate().map(of).collect::<Result<_, _>>()?;
    Ok(found.into_iter().flatten().collect())
}

/// The hemisphere above one side of a point.
fn gather(scene: &BenchScene, side: &Side, rays: u32, shift: [f64; 2]) -> Result<SideTruth, BenchError> {
    let [t, b] = basis(side.normal);
    let direction = |i: u32| {
        let u = (f64::from(i) / f64::from(rays) + shift[0]).fract();
        let v = (f64::from(i.reverse_bits()) / 4_294_967_296.0 + shift[1]).fract();
        let (radius, (sine, cosine)) = (u.sqrt(), (TAU * v).sin_cos());
        t * (radius * cosine) + b * (radius * sine) + side.normal * (1.0 - u).sqrt()
    };
    let above = (0..rays).map(direction).filter(|d| d.dot(side.geometric) > 0.0);
    let batch: Vec<Ray> = above.map(|d| Ray { origin: side.origin, direction: d.as_vec3(), t_max: f32::MAX }).collect();
    let mut hits = vec![Hit::MISS; batch.len()];
    let failed =
        |error: kiln_trace::TraceError| BenchError::Failed { step: "tracing points", reason: error.to_string() };
    scene.tracer().trace(&batch, &mut hits).map_err(failed)?;
    let count = (hits.len() as f64).max(1.0);
    let value = |hit: &Hit, d: f64| if hit.is_hit() { 1.0 - (-f64::from(hit.t) / d).exp2() } else { 1.0 };
    let ao = |d: &f64| hits.iter().map(|hit| value(hit, *d)).sum::<f64>() / count;
    let back_face_fraction = hits.iter().filter(|hit| hit.back_face).count() as f64 / count;
    let limit = scene.level.level.sampling.back_face_limit;
    let is_valid = !hits.is_empty() && back_face_fraction <= limit;
    Ok(SideTruth { ao: scene.half_distances_m().iter().map(ao).collect(), back_face_fraction, is_valid })
}

/// Two unit vectors that are perpendicular to a unit vector and to each other.
fn basis(n: DVec3) -> [DVec3; 2] {
    let t = n.cross(if n.x.abs() < 0.9 { DVec3::X } else { DVec3::Y }).normalize();
    [t, n.cross(t)]
}
