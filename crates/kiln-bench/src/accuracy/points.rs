//! Independent points of the surface, where a result is compared with the true signal.

use super::{
    random::Stream,
    scene::{BenchScene, Receiver},
};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use kiln_core::Mesh;
use kiln_trace::PositionError;

/// One side of a point that receives, moved off the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Side {
    /// Metres relative to the level's origin.
    pub(super) origin: Vec3,
    /// The shading normal, unit length.
    pub(super) normal: DVec3,
    /// The face's normal on this side, unit length.
    pub(super) geometric: DVec3,
}

/// A point of the surface.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SurfacePoint {
    /// Index of the receiver.
    pub(super) receiver: usize,
    /// Face of the receiver's mesh.
    pub(super) face: usize,
    /// Barycentric coordinates.
    pub(super) phi: [f64; 3],
    /// Front, and back on a double-sided face.
    pub(super) sides: Vec<Side>,
}

/// The most points that are expected on one face, so that a huge face does not get most of them.
const MOST_PER_FACE: f64 = 64.0;

/// Picks points in proportion to area, at most [`MOST_PER_FACE`] expected on one face.
pub(super) fn pick(scene: &BenchScene, count: usize, seed: u64) -> Vec<SurfacePoint> {
    let faces: Vec<(usize, usize)> = (0..scene.receivers.len())
        .flat_map(|receiver| (0..scene.receivers[receiver].mesh.faces.len()).map(move |face| (receiver, face)))
        .collect();
    let areas: Vec<f64> = faces.iter().map(|&(r, face)| area_m2(&scene.receivers[r], face)).collect();
    let stream = Stream::new(seed, 1);
    let locate = |index: usize, face: usize| {
        let (receiver, face) = faces[face];
        let random = |dimension: u64| stream.unit(4 * index as u64 + dimension);
        let phi = barycentric(random(1), random(2));
        let sides = sides(&scene.receivers[receiver], face, phi);
        (!sides.is_empty()).then_some(SurfacePoint { receiver, face, phi, sides })
    };
    let chosen = choose(&areas, count, |index| stream.unit(4 * index as u64));
    chosen.into_iter().enumerate().filter_map(|(index, face)| locate(index, face)).collect()
}

/// Indices with probabilities in proportion to areas, the greatest ones held down.
fn choose(areas: &[f64], count: usize, random: impl Fn(usize) -> f64) -> Vec<usize> {
    let total: f64 = areas.iter().sum();
    if total <= 0.0 {
        return Vec::new();
    }
    let mut sum = 0.0;
    let cumulative: Vec<f64> = areas
        .iter()
        .map(|area| {
            sum += (area / total * count as f64).min(MOST_PER_FACE);
            sum
        })
        .collect();
    (0..count)
        .map(|index| cumulative.partition_point(|&upper| upper <= random(index) * sum).min(areas.len() - 1))
        .collect()
}

/// Uniform on a triangle (Turk 1990, "Generating random points in triangles").
fn barycentric(u: f64, v: f64) -> [f64; 3] {
    let root = u.sqrt();
    [1.0 - root, root * (1.0 - v), root * v]
}

fn world_corners(mesh: &Mesh, world_from_object: &DAffine3, face: usize) -> [DVec3; 3] {
    mesh.corners(face).map(|corner| world_from_object.transform_point3(corner.as_dvec3()))
}

/// World-space area of a face that receives; 0 for one that does not.
pub(super) fn area_m2(receiver: &Receiver, face: usize) -> f64 {
    let [a, b, c] = world_corners(&receiver.mesh, &receiver.world_from_object, face);
    let area = 0.5 * (b - a).cross(c - a).length();
    if receiver.mesh.group(face).receives && area.is_finite() { area } else { 0.0 }
}

/// The sides of a point that receive; none on a face without area.
fn sides(receiver: &Receiver, face: usize, phi: [f64; 3]) -> Vec<Side> {
    let (mesh, world) = (&receiver.mesh, &receiver.world_from_object);
    let [a, b, c] = world_corners(mesh, world, face);
    let orientation = if world.matrix3.determinant() < 0.0 { -1.0 } else { 1.0 };
    let Some(geometric) = ((b - a).cross(c - a) * orientation).try_normalize() else { return Vec::new() };
    let [oa, ob, oc] = mesh.corners(face).map(Vec3::as_dvec3);
    let extent = (ob - oa).length().max((oc - ob).length()).max((oa - oc).length());
    let point = a * phi[0] + b * phi[1] + c * phi[2];
    let offset = PositionError::new(world).bound(point, extent).dot(geometric.abs());
    let shading = shading_normal(receiver, face, phi, geometric);
    let side = |sign: f64| Side {
        origin: (point + geometric * (sign * offset)).as_vec3(),
        normal: shading * sign,
        geometric: geometric * sign,
    };
    if mesh.group(face).double_sided { vec![side(1.0), side(-1.0)] } else { vec![side(1.0)] }
}

/// The interpolated normal where the corners have normals and it is on the face's side, else the face's.
fn shading_normal(receiver: &Receiver, face: usize, phi: [f64; 3], geometric: DVec3) -> DVec3 {
    let mesh = &receiver.mesh;
    let corners = mesh.faces[face].map(|v| DVec3::from(mesh.normals[v as usize].map(f64::from)));
    let m = receiver.world_from_object.matrix3;
    let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    let interpolated = corners[0] * phi[0] + corners[1] * phi[1] + corners[2] * phi[2];
    let normal = (cofactor * interpolated * m.determinant().signum()).normalize_or_zero();
    if corners.contains(&DVec3::ZERO) || normal.dot(geometric) <= 0.0 { geometric } else { normal }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_on_a_face_are_uniform() {
        // Over a triangle: E[φ_i] = 1/3, E[φ_i²] = 1/6, E[φ_i φ_j] = 1/12.
        let stream = Stream::new(1, 1);
        let n = 200_000u64;
        let mut sums = [0.0; 5];
        for i in 0..n {
            let [a, b, c] = barycentric(stream.unit(2 * i), stream.unit(2 * i + 1));
            assert!(a >= 0.0 && b >= 0.0 && c >= 0.0 && (a + b + c - 1.0).abs() < 1e-12);
            sums.iter_mut().zip([a, b, a * a, c * c, a * b]).for_each(|(sum, v)| *sum += v / n as f64);
        }
        for (sum, expected) in sums.iter().zip([1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 12.0]) {
            assert!((sum - expected).abs() < 3e-3, "{sums:?}");
        }
    }

    #[test]
    fn faces_are_chosen_by_area_up_to_the_limit() {
        let stream = Stream::new(2, 1);
        let areas = [1.0, 0.0, 3.0];
        let chosen = choose(&areas, 100, |i| stream.unit(i as u64));
        assert_eq!(chosen.len(), 100);
        assert!(!chosen.contains(&1), "a face without area has no point");
        // 25 and 75 are expected, but the limit is 64.
        let count = |face| chosen.iter().filter(|&&f| f == face).count() as f64;
        assert!((count(2) / 100.0 - 64.0 / 89.0).abs() < 0.15, "{chosen:?}");
        assert!(choose(&[0.0; 3], 10, |_| 0.5).is_empty());
    }
}
