//! The values of the full mesh near points of a LOD.

use super::{
    baked::BakedSurface,
    distance::{Distances, PROBES},
    sphere::{Reach, Reading, Sphere, SphereReader},
};
use kiln_trace::{SurfaceSample, TraceError, Tracer};

/// Radius of a point's sphere, in local distances between the LOD and the full mesh.
const DISTANCES: f64 = 2.0;

/// What was read near points.
pub(crate) struct NearReadings {
    /// What each point read.
    pub(crate) readings: Vec<Reading>,
    /// Rays traced, those that measure distances included.
    pub(crate) rays: u64,
}

/// Reads a sphere around each point, twice as large as the point is far from the surface that it stands for: fronts alone,
/// whose normals are within 90° of the point's. A point without such a surface reads nothing.
pub(crate) fn read_near(
    tracer: &dyn Tracer,
    baked: &BakedSurface<'_>,
    points: &[SurfaceSample],
    directions: u32,
) -> Result<NearReadings, TraceError> {
    let directions = directions.max(1);
    let distances = Distances::new(tracer, baked).measure(points)?;
    let sphere = |(point, distance): (&SurfaceSample, &Option<f64>)| {
        distance.map(|distance| Sphere {
            center_m: point.origin.as_dvec3(),
            radius_m: DISTANCES * distance,
            reach: Reach::Through(point.normal),
            scramble: point.scramble,
            first_index: point.first_index,
        })
    };
    let spheres: Vec<Sphere> = points.iter().zip(&distances).filter_map(sphere).collect();
    let mut found = SphereReader { tracer, baked, directions }.read(&spheres)?.into_iter();
    let reading = |distance: &Option<f64>| distance.and_then(|_| found.next()).unwrap_or_default();
    let rays = (points.len() * PROBES) as u64 + spheres.len() as u64 * u64::from(directions);
    Ok(NearReadings { readings: distances.iter().map(reading).collect(), rays })
}
