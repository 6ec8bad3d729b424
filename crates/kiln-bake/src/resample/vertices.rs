//! The same reading at the vertices alone: what least squares is compared with.

use super::{baked::BakedSurface, near::read_near};
use crate::{
    samples::normal_matrix,
    scramble::{InstanceKey, Stream},
};
use glam::{DAffine3, DVec3, Vec3};
use kiln_core::Mesh;
use kiln_trace::{SurfaceSample, TraceError, Tracer};

/// What the vertices of a LOD read.
#[derive(Clone, Debug, PartialEq)]
pub struct VertexReadings {
    /// `vertices × channels` values in [0, 1]; 1 at vertices that read nothing.
    pub values: Vec<f32>,
    /// Rays that read a value at each vertex.
    pub hits: Vec<u32>,
}

/// Reads, at each vertex of a LOD, a sphere as [`crate::resample_lod`] does at each sample, with as many directions.
///
/// `tracer` traces the full-detail mesh alone and `baked` has its values. A vertex has its own normal, or where that is zero
/// the area-weighted mean of its faces'; a vertex with neither reads nothing.
pub fn read_at_vertices(
    tracer: &dyn Tracer,
    baked: &BakedSurface<'_>,
    mesh: &Mesh,
    world_from_object: &DAffine3,
    directions: u32,
    seed: u64,
) -> Result<VertexReadings, TraceError> {
    let key = InstanceKey::new(world_from_object, seed);
    let normals = world_normals(mesh, world_from_object);
    let point = |(position, normal): (&[f32; 3], &DVec3)| {
        let position = Vec3::from_array(*position);
        SurfaceSample {
            origin: world_from_object.transform_point3(position.as_dvec3()).as_vec3(),
            normal: normal.as_vec3(),
            geometric: normal.as_vec3(),
            scramble: key.vertex(position).scramble(0, Stream::FrontDirections),
            first_index: 0,
        }
    };
    let points: Vec<SurfaceSample> = mesh.positions.iter().zip(&normals).map(point).collect();
    let readings = read_near(tracer, baked, &points, directions)?.readings;
    let channels = baked.channel_count();
    let values = readings.iter().flat_map(|reading| {
        let ao = if reading.hits > 0 { reading.ao } else { [1.0; _] };
        ao.into_iter().take(channels).map(|value| value as f32)
    });
    Ok(VertexReadings { values: values.collect(), hits: readings.iter().map(|reading| reading.hits).collect() })
}

/// Unit normals of the vertices in world space; zero where a vertex has none and no face with area.
fn world_normals(mesh: &Mesh, world_from_object: &DAffine3) -> Vec<DVec3> {
    let normal_matrix = normal_matrix(world_from_object);
    let mut of_faces = vec![DVec3::ZERO; mesh.positions.len()];
    for face in 0..mesh.faces.len() {
        let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
        mesh.faces[face].iter().for_each(|vertex| of_faces[*vertex as usize] += (b - a).cross(c - a));
    }
    let own = mesh.normals.iter().map(|normal| Vec3::from_array(*normal).as_dvec3());
    let object = own.zip(of_faces).map(|(own, of_faces)| if own == DVec3::ZERO { of_faces } else { own });
    object.map(|normal| (normal_matrix * normal).normalize_or_zero()).collect()
}
