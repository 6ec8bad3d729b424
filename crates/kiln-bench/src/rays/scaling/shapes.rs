//! Scenes made by code, of any number of triangles or instances: rocks on uneven ground, as dense in a large one as in a
//! small one.

use super::super::{
    case::{Case, RayCounts},
    files::group,
};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use kiln_core::Mesh;
use kiln_trace::{SceneObject, owen_scramble};
use std::{f64::consts::TAU, sync::Arc};

/// Rings and segments of a rock.
const RINGS: u32 = 12;
const SEGMENTS: u32 = 20;
/// Triangles of a rock.
pub(super) const ROCK_TRIANGLES: u32 = 2 * SEGMENTS * (RINGS - 1);
/// Side of the ground that a rock has to itself, metres; rocks are about 2 m across.
const ROCK_SPACING_M: f64 = 4.0;

/// About so many triangles in one mesh, half of them rocks.
pub(super) fn by_triangles(triangles: u32, counts: RayCounts) -> Case {
    let rocks = (triangles / 2 / ROCK_TRIANGLES).max(1);
    let side = f64::from(triangles / 4).sqrt().ceil() as u32;
    let mut mesh = ground(side, field_m(rocks));
    let rock = rock();
    (0..rocks).for_each(|index| add(&mut mesh, &rock, &place(index, rocks)));
    let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
    let name = format!("{} triangles", mesh.faces.len());
    Case::new(name, vec![Arc::new(mesh)], vec![object], counts)
}

/// So many instances of one rock, and the ground.
pub(crate) fn by_instances(rocks: u32, counts: RayCounts) -> Case {
    let meshes = vec![Arc::new(rock()), Arc::new(ground(64, field_m(rocks)))];
    let of_rock = |index| SceneObject { mesh: 0, world_from_object: place(index, rocks) };
    let of_ground = SceneObject { mesh: 1, world_from_object: DAffine3::IDENTITY };
    let objects = (0..rocks).map(of_rock).chain([of_ground]).collect();
    Case::new(format!("{rocks} instances"), meshes, objects, counts)
}

/// Rocks along a side of the square that holds them.
fn columns(rocks: u32) -> u32 {
    f64::from(rocks).sqrt().ceil() as u32
}

fn field_m(rocks: u32) -> f64 {
    ROCK_SPACING_M * f64::from(columns(rocks))
}

/// Where a rock lies: a square grid, jittered and turned.
fn place(index: u32, rocks: u32) -> DAffine3 {
    let columns = columns(rocks);
    let jitter = |purpose: u32| noise(index, purpose) - 0.5;
    let along = |cell: u32, purpose: u32| ROCK_SPACING_M * (f64::from(cell) + 0.5 + 0.4 * jitter(purpose));
    let at = DVec3::new(along(index % columns, 1), 0.3, along(index / columns, 2));
    let axis = DVec3::new(jitter(3), jitter(4), jitter(5)).normalize_or(DVec3::Y);
    let size = 0.6 + 0.8 * noise(index, 7);
    DAffine3 { matrix3: DMat3::from_quat(DQuat::from_axis_angle(axis, TAU * noise(index, 6))) * size, translation: at }
}

/// A number in [0, 1), the same for the same index and purpose.
fn noise(index: u32, purpose: u32) -> f64 {
    f64::from(owen_scramble(index ^ purpose.wrapping_mul(0x9e37_79b9), 0x51ed_270b ^ purpose)) / 4_294_967_296.0
}

/// `side²` squares of two triangles over a field, with bumps of half a metre.
fn ground(side: u32, field_m: f64) -> Mesh {
    let corners = (0..=side).flat_map(|j| (0..=side).map(move |i| (i, j)));
    let step_m = field_m / f64::from(side);
    let position = |(i, j): (u32, u32)| {
        let (x, z) = (step_m * f64::from(i), step_m * f64::from(j));
        [x, 0.25 * ((0.9 * x).sin() + (1.1 * z).cos()), z].map(|v| v as f32)
    };
    let square = |(i, j): (u32, u32)| {
        let a = j * (side + 1) + i;
        let (b, c, d) = (a + 1, a + side + 1, a + side + 2);
        [[a, c, b], [b, c, d]]
    };
    let squares = (0..side).flat_map(|j| (0..side).map(move |i| (i, j)));
    mesh(corners.map(position).collect(), squares.flat_map(square).collect())
}

/// A bumpy ball of about 1 m radius: rings between two poles.
fn rock() -> Mesh {
    let ring = |r: u32, s: u32| {
        let (theta, phi) = (0.5 * TAU * f64::from(r) / f64::from(RINGS), TAU * f64::from(s) / f64::from(SEGMENTS));
        let radius = 0.8 + 0.4 * noise(r * SEGMENTS + s, 11);
        [theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()].map(|v| (radius * v) as f32)
    };
    let mut positions: Vec<[f32; 3]> = (1..RINGS).flat_map(|r| (0..SEGMENTS).map(move |s| ring(r, s))).collect();
    let (top, bottom) = (positions.len() as u32, positions.len() as u32 + 1);
    positions.extend([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]);
    let at = |r: u32, s: u32| (r - 1) * SEGMENTS + s % SEGMENTS;
    let mut faces = Vec::new();
    for s in 0..SEGMENTS {
        faces.extend([[top, at(1, s + 1), at(1, s)], [bottom, at(RINGS - 1, s), at(RINGS - 1, s + 1)]]);
        for r in 1..RINGS - 1 {
            faces.extend([[at(r, s), at(r, s + 1), at(r + 1, s)], [at(r, s + 1), at(r + 1, s + 1), at(r + 1, s)]]);
        }
    }
    mesh(positions, faces)
}

fn mesh(positions: Vec<[f32; 3]>, faces: Vec<[u32; 3]>) -> Mesh {
    let (normals, face_group) = (vec![[0.0; 3]; positions.len()], vec![0; faces.len()]);
    Mesh { positions, normals, faces, face_group, groups: vec![group(false)], ..Mesh::default() }
}

fn add(mesh: &mut Mesh, other: &Mesh, place: &DAffine3) {
    let first = mesh.positions.len() as u32;
    let moved = |p: &[f32; 3]| place.transform_point3(DVec3::from(p.map(f64::from))).as_vec3().to_array();
    mesh.positions.extend(other.positions.iter().map(moved));
    mesh.normals.resize(mesh.positions.len(), [0.0; 3]);
    mesh.faces.extend(other.faces.iter().map(|face| face.map(|vertex| vertex + first)));
    mesh.face_group.resize(mesh.faces.len(), 0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    const COUNTS: RayCounts = RayCounts { points: 100, per_point: 4 };

    /// Six times the volume that faces enclose, positive where they face outward.
    fn volume(mesh: &Mesh) -> f64 {
        let of_face = |face| {
            let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
            a.dot(b.cross(c))
        };
        (0..mesh.faces.len()).map(of_face).sum()
    }

    #[test]
    fn rocks_are_closed_and_face_outward() {
        let rock = rock();
        assert_eq!(rock.faces.len() as u32, ROCK_TRIANGLES);
        let ball = 6.0 * 4.0 / 3.0 * std::f64::consts::PI;
        assert!((0.5..1.5).contains(&(volume(&rock) / ball)), "{}", volume(&rock) / ball);
        let mut edges: Vec<[u32; 2]> = rock.faces.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]).collect();
        edges.sort_unstable();
        let is_paired = |[a, b]: &[u32; 2]| edges.binary_search(&[*b, *a]).is_ok();
        assert!(edges.iter().all(is_paired) && edges.windows(2).all(|pair| pair[0] != pair[1]));
    }

    #[test]
    fn ground_faces_up() {
        let ground = ground(8, 32.0);
        assert_eq!(ground.faces.len(), 128);
        for face in 0..128 {
            let [a, b, c] = ground.corners(face);
            assert!((b - a).cross(c - a).y > 0.0);
        }
    }

    #[test]
    fn scenes_have_about_as_many_triangles_or_instances_as_asked() {
        for triangles in [3_000, 40_000] {
            let case = by_triangles(triangles, COUNTS);
            assert!((0.9..1.15).contains(&(case.triangles() as f64 / f64::from(triangles))), "{}", case.name);
        }
        let case = by_instances(50, COUNTS);
        assert_eq!((case.meshes.len(), case.objects.len()), (2, 51));
        assert_eq!(case.rays.origins.len(), 100);
    }
}
