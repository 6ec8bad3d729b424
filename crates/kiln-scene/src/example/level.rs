//! The courtyard, and its parts as levels of their own.

use super::builder::{Builder, Material, Mesh, Placement};
use super::masonry::{
    ARCADE_HEIGHT, BAY_WIDTH, ROOM_SIZE, STAIRS_HEIGHT, WALL, arcade_end, arch_bay, pavement, room, stairs, terrace,
    wall,
};
use super::props::{PILLAR_HEIGHT, Terrain, beam, pillar, wooden_crate};
use super::surface::{Surface, line_runs, lines};
use glam::{DQuat, DVec2, DVec3, dvec3};
use std::collections::BTreeMap;

/// What a thing is made of: the material's name and colour.
type Stuff = (&'static str, [f32; 3]);
const STONE: Stuff = ("stone", [0.62, 0.58, 0.50]);
const PLASTER: Stuff = ("plaster", [0.80, 0.76, 0.68]);
const PAVING: Stuff = ("paving", [0.48, 0.46, 0.43]);
const WOOD: Stuff = ("wood", [0.42, 0.28, 0.16]);
const GRASS: Stuff = ("grass", [0.24, 0.32, 0.13]);

/// A level in the making, with the materials it has used so far.
struct Site {
    builder: Builder,
    materials: BTreeMap<&'static str, Material>,
}

impl Site {
    fn new() -> Self {
        Self { builder: Builder::new(), materials: BTreeMap::new() }
    }

    fn mesh(&mut self, name: &str, surface: &Surface, (stuff, color): Stuff) -> Mesh {
        let material = *self.materials.entry(stuff).or_insert_with(|| self.builder.material(stuff, color));
        self.builder.mesh(name, &[(surface, material)])
    }

    /// A mesh that is placed once.
    fn single(&mut self, name: &str, surface: &Surface, stuff: Stuff, placement: Placement) {
        let mesh = self.mesh(name, surface, stuff);
        self.builder.node(name, mesh, placement);
    }

    /// One mesh at several places: nodes `kind_0`, `kind_1`, …
    fn repeated(&mut self, kind: &str, surface: &Surface, stuff: Stuff, places: &[Placement]) {
        let mesh = self.mesh(kind, surface, stuff);
        for (i, place) in places.iter().enumerate() {
            self.builder.node(&format!("{kind}_{i}"), mesh, *place);
        }
    }

    fn floor(&mut self, xs: &[f64], zs: &[f64]) {
        self.single("floor", &pavement(xs, zs), PAVING, Placement::ORIGIN);
    }

    fn wall(&mut self, name: &str, min: DVec3, max: DVec3) {
        let foot = min.with_y(0.0);
        self.single(name, &wall(min - foot, max - foot), STONE, Placement::at(foot));
    }

    /// An arcade of bays along x whose wall's middle is at `left`, a gallery behind it (towards −z), and a roof.
    fn arcade(&mut self, left: DVec3, bays: u32) {
        let length = BAY_WIDTH * f64::from(bays);
        let places: Vec<Placement> =
            (0..bays).map(|i| Placement::at(left + DVec3::X * BAY_WIDTH * (f64::from(i) + 0.5))).collect();
        self.repeated("arch", &arch_bay(), STONE, &places);
        let right = left + DVec3::X * length;
        let front = left.z + 0.5 * WALL;
        let back = front - 4.0;
        self.wall("wall_gallery", dvec3(left.x - WALL, -0.3, back), dvec3(right.x + WALL, ARCADE_HEIGHT, back + WALL));
        let eaves = 0.75;
        let from = dvec3(left.x - eaves, ARCADE_HEIGHT, back - 0.25);
        let to = dvec3(right.x + eaves, ARCADE_HEIGHT + 0.3, front + 0.25);
        self.wall("roof_gallery", from, to);
    }

    /// Six pillars in two rows with a pergola on top, from the first pillar.
    fn pergola(&mut self, first: DVec3) {
        let (spacing_x, spacing_z) = (3.0, 3.5);
        let places: Vec<Placement> = (0..6)
            .map(|i| Placement::at(first + dvec3(spacing_x * f64::from(i % 3), 0.0, spacing_z * f64::from(i / 3))))
            .collect();
        self.repeated("pillar", &pillar(), STONE, &places);
        let top = first + DVec3::Y * PILLAR_HEIGHT;
        let length = 2.0 * spacing_x + 2.0;
        let beams = [0.0, spacing_z].map(|z| Placement::at(top + dvec3(-1.0, -0.01, z)));
        self.repeated("beam", &beam(length, 0.28, 0.3), WOOD, &beams);
        let rafters: Vec<Placement> = (0..9)
            .map(|i| Placement::at(top + dvec3(0.95 * f64::from(i) - 0.8, 0.25, spacing_z + 0.5)).turned(90.0))
            .collect();
        self.repeated("rafter", &beam(spacing_z + 1.0, 0.2, 0.12), WOOD, &rafters);
    }

    /// A heap of crates that reach into one another and into the floor.
    fn crates(&mut self, corner: DVec3) {
        let place = |x: f64, y: f64, z: f64, size: f64, degrees: f64| {
            Placement::at(corner + dvec3(x, y, z)).scaled(DVec3::splat(size)).turned(degrees)
        };
        let leaning = place(2.05, 0.12, 0.75, 0.8, 0.0).rotated(DQuat::from_rotation_z(0.5)).turned(-25.0);
        let places = [
            place(0.65, -0.02, 0.65, 1.0, 4.0),
            place(1.5, -0.02, 0.6, 0.9, -13.0),
            place(0.6, -0.03, 1.6, 1.1, 31.0),
            place(0.85, 0.95, 0.75, 0.8, 22.0),
            place(1.45, -0.05, 1.5, 0.6, 58.0),
            leaning,
        ];
        self.repeated("crate", &wooden_crate(), WOOD, &places);
    }

    fn room(&mut self, corner: DVec3) {
        self.single("room", &room(), PLASTER, Placement::at(corner));
    }

    fn finish(self, name: &str) -> Vec<u8> {
        self.builder.finish(name)
    }
}

/// A courtyard of 16 × 12 m: arcade in the north, room in the west, stairs to a terrace in the east, pergola and
/// crates in the middle, open to rising terrain in the south.
pub(super) fn courtyard() -> Vec<u8> {
    let mut site = Site::new();
    // Finer lines where walls and stairs stand. The pavement ends inside the walls around it, so that no two
    // sides share a plane.
    let xs = line_runs(-0.25, &[(3.0, 0.25), (14.0, 0.5), (16.25, 0.25)]);
    let zs = line_runs(-3.75, &[(-3.0, 0.25), (-1.0, 0.5), (1.0, 0.25), (11.5, 0.5), (12.25, 0.25)]);
    site.floor(&xs, &zs);
    site.arcade(dvec3(0.5, 0.0, -0.25), 5);
    site.wall("wall_pier_west", dvec3(0.0, -0.3, -WALL), dvec3(0.5, ARCADE_HEIGHT, 0.0));
    site.wall("wall_pier_east", dvec3(15.5, -0.3, -WALL), dvec3(16.0, ARCADE_HEIGHT, 0.0));
    site.room(dvec3(-ROOM_SIZE[0], 0.0, 3.0));
    site.wall("wall_west_north", dvec3(-WALL, -0.3, -4.0), dvec3(0.0, 3.0, 3.0));
    site.wall("wall_west_south", dvec3(-WALL, -0.3, 9.0), dvec3(0.0, 3.0, 12.5));
    site.single("terrace", &terrace(3.0, &lines(0.0, 16.5, 0.5)), STONE, Placement::at(dvec3(16.0, 0.0, -4.0)));
    site.single("stairs", &stairs(), STONE, Placement::at(dvec3(16.0, 0.0, 8.5)).turned(180.0));
    site.pergola(dvec3(5.0, 0.0, 4.25));
    site.crates(dvec3(0.2, 0.0, 0.3));
    site.wall("wall_south_west", dvec3(0.0, -0.3, 12.0), dvec3(6.0, 0.5, 12.5));
    site.wall("wall_south_east", dvec3(10.0, -0.3, 12.0), dvec3(16.0, 0.5, 12.5));
    let terrain = Terrain {
        min: DVec2::new(-5.0, -4.0),
        max: DVec2::new(19.0, 12.5),
        paved: [DVec2::new(-0.25, -3.75), DVec2::new(16.25, 12.25)],
    };
    let xs = line_runs(-22.0, &[(-12.0, 2.0), (26.0, 0.8), (36.0, 2.0)]);
    let zs = line_runs(-20.0, &[(-11.0, 1.8), (19.4, 0.8), (35.6, 1.8)]);
    site.single("terrain", &terrain.surface(&xs, &zs), GRASS, Placement::ORIGIN);
    site.finish("courtyard")
}

pub(super) fn arches() -> Vec<u8> {
    let mut site = Site::new();
    site.floor(&lines(-1.5, 10.5, 0.25), &line_runs(-5.0, &[(1.0, 0.25), (5.0, 0.5)]));
    let left = dvec3(0.0, 0.0, -0.25);
    site.arcade(left, 3);
    let ends = [Placement::at(left), Placement::at(left + DVec3::X * 3.0 * BAY_WIDTH).turned(180.0)];
    site.repeated("arch_end", &arcade_end(), STONE, &ends);
    site.finish("arches")
}

pub(super) fn room_alone() -> Vec<u8> {
    let mut site = Site::new();
    let [width, length] = ROOM_SIZE;
    site.floor(
        &line_runs(-2.0, &[(width - 0.5, 0.5), (width + 1.0, 0.25), (width + 3.0, 0.5)]),
        &lines(-2.0, length + 2.0, 0.5),
    );
    site.room(DVec3::ZERO);
    site.finish("room")
}

pub(super) fn stairs_alone() -> Vec<u8> {
    let mut site = Site::new();
    site.floor(&lines(-2.0, 4.5, 0.25), &lines(-2.0, 8.0, 0.5));
    site.single("stairs", &stairs(), STONE, Placement::ORIGIN);
    let landing = wall(DVec3::ZERO, dvec3(2.5, STAIRS_HEIGHT, 2.0));
    site.single("landing", &landing, STONE, Placement::at(dvec3(0.0, 0.0, 4.5)));
    site.finish("stairs")
}

pub(super) fn pillars() -> Vec<u8> {
    let mut site = Site::new();
    site.floor(&lines(-2.0, 8.0, 0.25), &lines(-2.0, 5.5, 0.25));
    site.pergola(DVec3::ZERO);
    site.finish("pillars")
}

pub(super) fn terrain_edge() -> Vec<u8> {
    let mut site = Site::new();
    site.floor(&lines(0.0, 12.0, 0.5), &line_runs(0.0, &[(3.0, 0.5), (3.75, 0.25)]));
    site.wall("wall", dvec3(-0.25, -0.3, 3.5), dvec3(12.25, 0.5, 4.0));
    let terrain = Terrain {
        min: DVec2::new(-2.0, -8.0),
        max: DVec2::new(14.0, 4.0),
        paved: [DVec2::ZERO, DVec2::new(12.0, 3.75)],
    };
    site.single("terrain", &terrain.surface(&lines(-4.0, 16.0, 0.5), &lines(0.0, 20.0, 0.5)), GRASS, Placement::ORIGIN);
    site.finish("terrain")
}

pub(super) fn crates() -> Vec<u8> {
    let mut site = Site::new();
    site.floor(&lines(-1.5, 4.5, 0.25), &lines(-1.5, 4.0, 0.25));
    site.crates(DVec3::ZERO);
    site.finish("crates")
}
