//! Rays of a scene's own: points on its surfaces by area, cosine-distributed directions at each.

use super::files::RaySet;
use glam::{DVec3, Vec3};
use kiln_core::{Bounds, Mesh};
use kiln_trace::{
    PositionError, SceneObject, SobolScramble, cosine_direction, orthonormal_basis, owen_scramble, sobol_point,
};
use std::sync::Arc;

/// The most points that are expected on one face, so that a huge one does not get most of them.
const MOST_PER_FACE: f64 = 64.0;

/// Places of meshes, by the indices that objects name.
#[derive(Clone, Copy)]
pub(super) struct Surfaces<'a> {
    pub(super) meshes: &'a [Arc<Mesh>],
    pub(super) objects: &'a [SceneObject],
}

/// A point on a surface.
struct Point {
    origin: Vec3,
    normal: Vec3,
}

impl Surfaces<'_> {
    /// About `count` points on faces that receive, in Morton order, with `per_point` rays each. None where nothing
    /// receives.
    pub(super) fn rays(&self, count: usize, per_point: usize) -> RaySet {
        let mut points = self.points(count);
        let mut bounds = Bounds::EMPTY;
        points.iter().for_each(|point| bounds.add(point.origin.as_dvec3()));
        points.sort_by_cached_key(|point| morton(point.origin, &bounds));
        let directions = points.iter().zip(0..).flat_map(|(point, index)| {
            let (basis, scramble) = (orthonormal_basis(point.normal), scramble(index));
            (0..per_point as u32).map(move |ray| cosine_direction(sobol_point(ray, scramble), point.normal, basis))
        });
        RaySet {
            per_point,
            diagonal_m: self.bounds().diagonal() as f32,
            directions: directions.map(|direction| direction.to_array()).collect(),
            origins: points.iter().map(|point| point.origin.to_array()).collect(),
            normals: points.iter().map(|point| point.normal.to_array()).collect(),
        }
    }

    /// Of the boxes around all objects.
    pub(super) fn bounds(&self) -> Bounds {
        let boxes: Vec<Bounds> = self.meshes.iter().map(|mesh| mesh.bounds()).collect();
        let mut bounds = Bounds::EMPTY;
        for object in self.objects.iter().filter(|object| !boxes[object.mesh].is_empty()) {
            let Bounds { min, max } = boxes[object.mesh];
            for corner in 0..8u32 {
                let pick = |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
                bounds.add(object.world_from_object.transform_point3(DVec3::new(pick(0), pick(1), pick(2))));
            }
        }
        bounds
    }

    /// Systematic sampling: the faces' expected numbers of points on one line, a point at every whole number and a half.
    /// Levels with many instances have too many faces for a list of areas, so they are walked.
    fn points(&self, count: usize) -> Vec<Point> {
        let mut area = 0.0;
        self.for_each_face(|_, _, face_area| area += face_area);
        let expected = |face_area: f64| (face_area / area * count as f64).min(MOST_PER_FACE);
        let mut sum = 0.0;
        self.for_each_face(|_, _, face_area| sum += expected(face_area));
        let (mut points, mut walked) = (Vec::with_capacity(count), 0.0);
        self.for_each_face(|object, face, face_area| {
            walked += expected(face_area);
            while points.len() < count && (points.len() as f64 + 0.5) * sum < walked * count as f64 {
                points.push(self.point(object, face, points.len() as u32));
            }
        });
        points
    }

    /// Calls with object, face and area of each face that receives.
    fn for_each_face(&self, mut call: impl FnMut(&SceneObject, usize, f64)) {
        for object in self.objects {
            let mesh = &self.meshes[object.mesh];
            for face in (0..mesh.faces.len()).filter(|face| mesh.group(*face).receives) {
                let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
                let matrix = object.world_from_object.matrix3;
                let area = 0.5 * (matrix * (b - a)).cross(matrix * (c - a)).length();
                if area.is_finite() && area > 0.0 {
                    call(object, face, area);
                }
            }
        }
    }

    /// A point on the front of a face, moved off it by the rounding error of rays that start there.
    fn point(&self, object: &SceneObject, face: usize, index: u32) -> Point {
        let mesh = &self.meshes[object.mesh];
        let corners = mesh.corners(face).map(Vec3::as_dvec3);
        let world = &object.world_from_object;
        let [a, b, c] = corners.map(|corner| world.transform_point3(corner));
        let normal = (b - a).cross(c - a).normalize_or(DVec3::Y) * world.matrix3.determinant().signum();
        let [u, v] = sobol_point(index, SobolScramble([0x2545_f491, 0x9e37_79b9])).map(f64::from);
        // Uniform on a triangle (Turk 1990).
        let root = u.sqrt();
        let point = a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v);
        let [ab, bc, ca] = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (corners[j] - corners[i]).length());
        let offset_m = PositionError::new(world).bound(point, ab.max(bc).max(ca)).dot(normal.abs());
        Point { origin: (point + normal * offset_m).as_vec3(), normal: normal.as_vec3() }
    }
}

/// The scramble of a point's directions.
pub(super) fn scramble(point: u32) -> SobolScramble {
    SobolScramble([owen_scramble(point, 0x68bc_21eb), owen_scramble(point, 0x02e5_be93)])
}

/// Morton code of a point in a box, 21 bits for each axis, cubic cells.
fn morton(point: Vec3, bounds: &Bounds) -> u64 {
    let size = (bounds.max - bounds.min).max_element().max(f64::MIN_POSITIVE);
    let cells = ((point.as_dvec3() - bounds.min) / size * f64::from((1 << 21) - 1)).to_array().map(|x| x as u64);
    let bit = |i: u32, axis: usize| (cells[axis] >> i & 1) << (3 * i + axis as u32);
    (0..21).map(|i| bit(i, 0) | bit(i, 1) | bit(i, 2)).fold(0, |code, bits| code | bits)
}

#[cfg(test)]
mod tests {
    use super::{super::files::group, *};
    use glam::DAffine3;

    /// Two triangles in the plane y = 0 of areas 1 and 3.
    fn plane() -> Mesh {
        Mesh {
            positions: [[0.0, 0.0], [0.0, 1.0], [2.0, 0.0], [10.0, 0.0], [10.0, 3.0], [12.0, 0.0]]
                .map(|[x, z]| [x, 0.0, z])
                .to_vec(),
            normals: vec![[0.0; 3]; 6],
            faces: vec![[0, 1, 2], [3, 4, 5]],
            face_group: vec![0, 0],
            groups: vec![group(false)],
            ..Mesh::default()
        }
    }

    fn rays(count: usize, world_from_object: DAffine3) -> RaySet {
        let object = SceneObject { mesh: 0, world_from_object };
        Surfaces { meshes: &[Arc::new(plane())], objects: &[object] }.rays(count, 16)
    }

    #[test]
    fn points_are_by_area_and_lie_off_the_surface() {
        let rays = rays(40, DAffine3::IDENTITY);
        assert_eq!((rays.origins.len(), rays.directions.len()), (40, 640));
        assert_eq!(rays.origins.iter().filter(|origin| origin[0] > 5.0).count(), 30);
        assert!(rays.origins.iter().all(|origin| origin[1] > 0.0 && origin[1] < 1e-4));
        assert!(rays.normals.iter().all(|normal| *normal == [0.0, 1.0, 0.0]));
        assert!(rays.directions.iter().all(|direction| direction[1] >= 0.0));
        assert!((rays.diagonal_m - (153f32).sqrt()).abs() < 1e-4);
    }

    #[test]
    fn a_huge_face_does_not_get_most_points() {
        let large = rays(1000, DAffine3::IDENTITY);
        let share = large.origins.iter().filter(|origin| origin[0] > 5.0).count();
        assert_eq!(share, 500);
    }

    #[test]
    fn fronts_of_mirrored_objects_stay_fronts() {
        let mirrored = rays(10, DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)));
        assert!(mirrored.normals.iter().all(|normal| *normal == [0.0, 1.0, 0.0]), "{:?}", mirrored.normals);
    }

    #[test]
    fn near_points_have_near_codes() {
        let bounds = Bounds { min: DVec3::ZERO, max: DVec3::ONE };
        let code = |x: f32, y: f32, z: f32| morton(Vec3::new(x, y, z), &bounds);
        assert_eq!((code(0.0, 0.0, 0.0), code(1.0, 1.0, 1.0)), (0, (1 << 63) - 1));
        assert!(code(0.1, 0.1, 0.1) < code(0.2, 0.1, 0.1) && code(0.4, 0.4, 0.4) < code(0.6, 0.0, 0.0));
    }
}
