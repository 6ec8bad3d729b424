//! Scenes whose ambient obscurance is known in closed form at a point.
//!
//! Every scene has a node `receiver` where there is a surface to bake; the others only block. Blockers are
//! single-sided and face the receiver. Planes without end reach so far that what is missing changes AO by less
//! than 1e-5, and round shapes are so finely cut, with the exact area or volume, that AO differs by less than
//! 1e-4; a test integrates over the very triangles of the files to make sure of both.
//!
//! A receiver lies [`RECEIVER_GAP_M`] below the point to be probed, so that the point is exact and needs no offset.

use super::builder::{Builder, Material, Placement};
use super::closed_form;
use super::round::{disk, sphere, tube_inside};
use super::surface::{Surface, far_lines, lines};
use glam::DVec3;

/// How far a receiving surface lies behind the point that is probed, metres: 2⁻¹⁵, exact in f32.
pub const RECEIVER_GAP_M: f64 = 1.0 / 32768.0;

/// A point of an oracle scene and the AO there.
#[derive(Clone, Copy, Debug)]
pub struct Oracle {
    /// What is known: the scene's name, and for a second point in the same scene a word more.
    pub name: &'static str,
    /// Name of the scene, for [`super::build`].
    pub scene: &'static str,
    /// The point, metres; it lies slightly off the surface, on the side of the normal.
    pub position: [f64; 3],
    /// Unit normal.
    pub normal: [f64; 3],
    /// AO by the closed form, from the half-distance in metres; an infinite one gives plain occlusion without a
    /// ray limit.
    pub expected: fn(f64) -> f64,
    /// The scene's triangles give `expected` to this precision, for half-distances from 1 m up.
    pub tolerance: f64,
}

/// All points that are known, in the order of the scenes.
pub fn oracles() -> &'static [Oracle] {
    &ORACLES
}

/// The known point of a name.
pub fn oracle(name: &str) -> Option<&'static Oracle> {
    ORACLES.iter().find(|oracle| oracle.name == name)
}

const UP: [f64; 3] = [0.0, 1.0, 0.0];
const FAR: f64 = 1e-5;
const ROUND: f64 = 1e-4;

static ORACLES: [Oracle; 9] = [
    Oracle {
        name: "oracle_plane",
        scene: "oracle_plane",
        position: [0.0; 3],
        normal: UP,
        expected: |d| closed_form::plane(2.0, d),
        tolerance: FAR,
    },
    Oracle {
        name: "oracle_sphere",
        scene: "oracle_sphere",
        position: SPHERE_POINT,
        normal: [-SPHERE_DIRECTION[0], -SPHERE_DIRECTION[1], -SPHERE_DIRECTION[2]],
        expected: |d| closed_form::sphere_inner(1.0, d),
        tolerance: ROUND,
    },
    Oracle {
        name: "oracle_sphere_centre",
        scene: "oracle_sphere",
        position: [0.0; 3],
        normal: [0.48, 0.6, 0.64],
        expected: |d| closed_form::sphere_centre(1.0, d),
        tolerance: ROUND,
    },
    Oracle {
        name: "oracle_wall",
        scene: "oracle_wall",
        position: [0.0; 3],
        normal: UP,
        expected: |d| closed_form::wall(1.0, d),
        tolerance: FAR,
    },
    Oracle {
        name: "oracle_wall_finite",
        scene: "oracle_wall_finite",
        position: [0.0; 3],
        normal: UP,
        expected: |d| closed_form::wall_finite(1.0, 3.0, d),
        tolerance: FAR,
    },
    Oracle {
        name: "oracle_disk",
        scene: "oracle_disk",
        position: [0.0; 3],
        normal: UP,
        expected: |d| closed_form::disk(1.0, 1.0, d),
        tolerance: ROUND,
    },
    Oracle {
        name: "oracle_ball",
        scene: "oracle_ball",
        position: [0.0; 3],
        normal: UP,
        expected: |d| closed_form::ball(2.0, 1.0, d),
        tolerance: ROUND,
    },
    Oracle {
        name: "oracle_box",
        scene: "oracle_box",
        position: [1.0, 0.0, 2.0],
        normal: UP,
        expected: |d| closed_form::closed_box([1.0, 2.0], [4.0, 6.0, 3.0], d),
        tolerance: FAR,
    },
    Oracle {
        name: "oracle_cylinder",
        scene: "oracle_cylinder",
        position: [0.0; 3],
        normal: UP,
        expected: |d| closed_form::cylinder_axis(1.0, d),
        tolerance: ROUND,
    },
];

/// Middle of one face of the icosahedron, and so of the sphere: (0, φ², 1) normalised, φ the golden ratio.
const SPHERE_DIRECTION: [f64; 3] = [0.0, 0.934_172_358_962_715_7, 0.356_822_089_773_089_9];
/// Just inside the face there.
const SPHERE_POINT: [f64; 3] = {
    let [x, y, z] = SPHERE_DIRECTION;
    [x * SPHERE_POINT_RADIUS, y * SPHERE_POINT_RADIUS, z * SPHERE_POINT_RADIUS]
};
/// The face's plane is at 0.999_895_4 m; the point is the gap inside it.
const SPHERE_POINT_RADIUS: f64 = 0.999_895_4 - RECEIVER_GAP_M;
/// 20,480 triangles, 2 cm to 4 cm each.
const SPHERE_LEVEL: u32 = 5;

struct Scene {
    builder: Builder,
    material: Material,
}

impl Scene {
    fn new() -> Self {
        let mut builder = Builder::new();
        let material = builder.material("grey", [0.5; 3]);
        Self { builder, material }
    }

    fn add(mut self, name: &str, surface: &Surface, at: DVec3) -> Self {
        let mesh = self.builder.mesh(name, &[(surface, self.material)]);
        self.builder.node(name, mesh, Placement::at(at));
        self
    }

    /// A square of 2 m about the origin, in cells of an eighth of a metre, with a vertex below the probed point.
    fn receiver(self) -> Self {
        let cells = lines(-1.0, 1.0, 0.125);
        self.add("receiver", &Surface::floor(&cells, &cells, 0.0), -DVec3::Y * RECEIVER_GAP_M)
    }

    fn finish(self, name: &str) -> Vec<u8> {
        self.builder.finish(name)
    }
}

/// A plane at height 2 m, 8 km wide: what is missing is less than `(2/4096)²`.
pub(super) fn plane() -> Vec<u8> {
    let far = far_lines(6);
    let ceiling = Surface::floor(&far, &far, 0.0).flipped();
    Scene::new().receiver().add("ceiling", &ceiling, DVec3::Y * 2.0).finish("oracle_plane")
}

/// A wall at x = 1 m through the receiver's edge, 500 km high and long: what is missing is less than
/// `1/2^18`. It reaches as far down, so that the middle of the scene stays near the origin, where f32 is fine.
pub(super) fn wall() -> Vec<u8> {
    let far = far_lines(9);
    Scene::new().receiver().add("wall", &facing_west(&far, &far), DVec3::X).finish("oracle_wall")
}

/// The same wall, 3 m high and 8 km long.
pub(super) fn wall_finite() -> Vec<u8> {
    let ys = lines(-1.0, 3.0, 0.5);
    Scene::new().receiver().add("wall", &facing_west(&ys, &far_lines(6)), DVec3::X).finish("oracle_wall_finite")
}

fn facing_west(ys: &[f64], zs: &[f64]) -> Surface {
    Surface::rectangle(zs, ys, DVec3::ZERO, DVec3::Z, DVec3::Y)
}

/// A disk of radius 1 m at height 1 m: 128 corners, the exact area.
pub(super) fn disk_above() -> Vec<u8> {
    let disk = disk(1.0, 128, 16).flipped();
    Scene::new().receiver().add("disk", &disk, DVec3::Y).finish("oracle_disk")
}

/// A ball of radius 1 m whose centre is at height 2 m.
pub(super) fn ball() -> Vec<u8> {
    let ball = sphere(1.0, SPHERE_LEVEL);
    Scene::new().receiver().add("ball", &ball, DVec3::Y * 2.0).finish("oracle_ball")
}

/// The inside of a sphere of radius 1 m; the sphere itself receives, the same everywhere.
pub(super) fn sphere_inside() -> Vec<u8> {
    let inside = sphere(1.0, SPHERE_LEVEL).flipped();
    Scene::new().add("receiver", &inside, DVec3::ZERO).finish("oracle_sphere")
}

/// The inside of a closed room of 4 × 6 × 3 m with a corner at the origin, in cells of a quarter of a metre.
pub(super) fn closed_box() -> Vec<u8> {
    let mut ys = lines(0.0, 3.0, 0.25);
    ys[0] = -RECEIVER_GAP_M;
    let inside = Surface::block(&lines(0.0, 4.0, 0.25), &ys, &lines(0.0, 6.0, 0.25)).flipped();
    Scene::new().add("receiver", &inside, DVec3::ZERO).finish("oracle_box")
}

/// The inside of a tube of radius 1 m along x, 512 m long: what is missing at its ends is less than `(1/256)³`.
pub(super) fn cylinder() -> Vec<u8> {
    let tube = tube_inside(1.0, &far_lines(4), 256);
    Scene::new().add("tube", &tube, DVec3::ZERO).finish("oracle_cylinder")
}
