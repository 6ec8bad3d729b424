//! Sample points of a face: low-discrepancy positions, robust origins, shading normals.

use crate::scramble::{InstanceKey, Stream};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use kiln_core::Mesh;
use kiln_trace::{PositionError, SurfaceSample, sobol_point};
use std::ops::Range;

/// Makes the samples of one instance's faces.
pub(crate) struct SampleMaker<'a> {
    mesh: &'a Mesh,
    world_from_object: &'a DAffine3,
    /// Takes object-space normals to world space, up to length.
    normal_matrix: DMat3,
    /// −1 for a mirroring transform.
    orientation: f64,
    error: PositionError,
    key: InstanceKey,
    rays_per_sample: u32,
}

/// One position on a face: one sample for each side that receives.
pub(crate) struct Position {
    /// Barycentric coordinates.
    pub(crate) phi: [f64; 3],
    /// Front, and back for a double-sided face.
    pub(crate) sides: [Option<SurfaceSample>; 2],
}

impl<'a> SampleMaker<'a> {
    pub(crate) fn new(mesh: &'a Mesh, world_from_object: &'a DAffine3, seed: u64, rays_per_sample: u32) -> Self {
        let m = world_from_object.matrix3;
        let orientation = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
        // The cofactor matrix, det · inverse transpose, exists for every transform.
        let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
        let error = PositionError::new(world_from_object);
        let key = InstanceKey::new(world_from_object, seed);
        Self {
            mesh,
            world_from_object,
            normal_matrix: cofactor * orientation,
            orientation,
            error,
            key,
            rays_per_sample,
        }
    }

    /// Positions of one half of a face's samples, by their indices in its sequence; none if the face has no area in
    /// world space. Past the cap of its class come further directions at the same positions.
    pub(crate) fn half(&self, face: usize, half: usize, indices: Range<u32>) -> Vec<Position> {
        let object = self.mesh.corners(face);
        let world = object.map(|c| self.world_from_object.transform_point3(c.as_dvec3()));
        let cross = (world[1] - world[0]).cross(world[2] - world[0]);
        let geometric = (cross * self.orientation).normalize_or_zero();
        if geometric == DVec3::ZERO {
            return Vec::new();
        }
        let [a, b, c] = object.map(Vec3::as_dvec3);
        let extent = (b - a).length().max((c - b).length()).max((a - c).length());
        let key = self.key.face(object);
        let positions = key.scramble(half, Stream::Positions);
        let positions_kept = self.mesh.group(face).max_samples_per_face.map_or(u32::MAX, |cap| (cap / 2).max(1));
        let is_double_sided = self.mesh.group(face).double_sided;
        let position = |index: u32| {
            let phi = barycentric(sobol_point(index % positions_kept, positions).map(f64::from));
            let point = world[0] * phi[0] + world[1] * phi[1] + world[2] * phi[2];
            let offset = self.error.bound(point, extent).dot(geometric.abs());
            let shading = self.shading_normal(face, phi, geometric);
            let side = |sign: f64, stream: Stream| SurfaceSample {
                origin: (point + geometric * (sign * offset)).as_vec3(),
                normal: (shading * sign).as_vec3(),
                geometric: (geometric * sign).as_vec3(),
                scramble: key.scramble(half, stream),
                first_index: index * self.rays_per_sample,
            };
            let back = is_double_sided.then(|| side(-1.0, Stream::BackDirections));
            Position { phi, sides: [Some(side(1.0, Stream::FrontDirections)), back] }
        };
        indices.map(position).collect()
    }

    /// The interpolated normal where all three corners have one and it is on the geometric normal's side.
    fn shading_normal(&self, face: usize, phi: [f64; 3], geometric: DVec3) -> DVec3 {
        let normals = self.mesh.faces[face].map(|v| Vec3::from_array(self.mesh.normals[v as usize]).as_dvec3());
        if normals.contains(&DVec3::ZERO) {
            return geometric;
        }
        let normal = normals[0] * phi[0] + normals[1] * phi[1] + normals[2] * phi[2];
        let normal = (self.normal_matrix * normal).normalize_or_zero();
        if normal.dot(geometric) > 0.0 { normal } else { geometric }
    }
}

/// Area-preserving map from the unit square to barycentric coordinates with little distortion (Heitz 2019, "A
/// low-distortion map between triangle and square").
fn barycentric([x, y]: [f64; 2]) -> [f64; 3] {
    let (u, v) = if y > x { (0.5 * x, y - 0.5 * x) } else { (x - 0.5 * y, 0.5 * y) };
    [u, v, 1.0 - u - v]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn barycentric_coordinates_are_uniform() {
        // Over a triangle: E[φ_i] = 1/3, E[φ_i²] = 1/6, E[φ_i φ_j] = 1/12.
        let n = 400;
        let mut sums = [0.0; 6];
        for i in 0..n * n {
            let phi = barycentric([(f64::from(i % n) + 0.5) / f64::from(n), (f64::from(i / n) + 0.5) / f64::from(n)]);
            assert!(phi.iter().all(|p| (0.0..=1.0).contains(p)));
            let products = [phi[0], phi[1], phi[2], phi[0] * phi[0], phi[2] * phi[2], phi[0] * phi[1]];
            sums.iter_mut().zip(products).for_each(|(sum, p)| *sum += p / f64::from(n * n));
        }
        for (sum, expected) in sums.iter().zip([1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 12.0]) {
            assert!((sum - expected).abs() < 1e-5, "{sums:?}");
        }
    }
}
