//! The nearest point of a mesh, found by asking every face: slow, and a second way to what is read.

use glam::{DVec3, Vec3};
use kiln_core::Mesh;

/// A mesh whose nearest points are asked for.
pub(crate) struct Nearest<'a> {
    mesh: &'a Mesh,
    /// One value for each vertex.
    values: &'a [f32],
    /// A ball around each face.
    balls: Vec<(DVec3, f64)>,
}

impl<'a> Nearest<'a> {
    pub(crate) fn new(mesh: &'a Mesh, values: &'a [f32]) -> Self {
        let ball = |face: usize| {
            let corners = mesh.corners(face).map(Vec3::as_dvec3);
            let center = corners.iter().sum::<DVec3>() / 3.0;
            (center, corners.iter().map(|corner| corner.distance(center)).fold(0.0, f64::max))
        };
        Self { mesh, values, balls: (0..mesh.faces.len()).map(ball).collect() }
    }

    /// Value at the point of the mesh in object space that is nearest to a point.
    pub(crate) fn value(&self, point: DVec3) -> f64 {
        let mut best = (f64::INFINITY, 0.0);
        for (face, (center, radius)) in self.balls.iter().enumerate() {
            if center.distance(point) - radius > best.0 {
                continue;
            }
            let corners = self.mesh.corners(face).map(Vec3::as_dvec3);
            let phi = nearest_coordinates(point, corners);
            let at: DVec3 = corners.iter().zip(phi).map(|(corner, phi)| *corner * phi).sum();
            if at.distance(point) < best.0 {
                let ao = self.mesh.faces[face].map(|vertex| f64::from(self.values[vertex as usize]));
                best = (at.distance(point), ao.iter().zip(phi).map(|(ao, phi)| ao * phi).sum());
            }
        }
        best.1
    }
}

/// Barycentric coordinates of the point of a triangle that is nearest to a point: its projection, or else the nearest on
/// the edges.
fn nearest_coordinates(point: DVec3, corners: [DVec3; 3]) -> [f64; 3] {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let second = (point - a).cross(c - a).dot(normal) / normal.length_squared();
    let third = (b - a).cross(point - a).dot(normal) / normal.length_squared();
    let inside = [1.0 - second - third, second, third];
    if inside.iter().all(|phi| *phi >= 0.0) {
        return inside;
    }
    let on_edge = |i: usize| {
        let (from, to) = (corners[i], corners[(i + 1) % 3]);
        let along = ((point - from).dot(to - from) / (to - from).length_squared()).clamp(0.0, 1.0);
        let mut phi = [0.0; 3];
        (phi[i], phi[(i + 1) % 3]) = (1.0 - along, along);
        ((from + (to - from) * along).distance_squared(point), phi)
    };
    let nearer = |x: (f64, [f64; 3]), y: (f64, [f64; 3])| if y.0 < x.0 { y } else { x };
    nearer(on_edge(0), nearer(on_edge(1), on_edge(2))).1
}
