//! Geometry made by code for the solver's matrices: a terrain, and a level of very many pieces.

use super::{
    gather::Gathered,
    signal::{self, noise},
};
use glam::DAffine3;
use kiln_core::{FaceGroup, Mesh, SolveSettings};
use kiln_solve::ComponentSystem;

/// One component: a bumpy terrain of `side²` vertices, without samples in a square about its middle that is
/// `hole` (0 to 1) of its side.
pub(super) fn terrain(side: u32, hole: f64, settings: &SolveSettings, columns: usize) -> ComponentSystem<'static> {
    let mut mesh = empty();
    add_grid(&mut mesh, side, 0.0);
    let middle = 0.5 * f64::from(side - 1);
    let half = hole * middle;
    let sampled = |p: glam::DVec3| (p.x - middle).abs() >= half || (p.z - middle).abs() >= half;
    let moments = signal::moments(&mesh, &DAffine3::IDENTITY, columns.div_ceil(2), 20.0, sampled);
    let mut gathered = Gathered::new(columns);
    gathered.add(&mesh, &DAffine3::IDENTITY, &moments, settings);
    gathered.finish()
}

/// Sides of the grids of a level's largest pieces; 400² are 160,000 vertices.
const LARGE_SIDES: [u32; 12] = [400, 300, 240, 200, 160, 130, 110, 90, 80, 70, 60, 50];

/// `count` pieces of the sizes that levels have: one in five a quad, most of some tens of vertices, one in a
/// hundred of some thousand, and a dozen up to 160,000.
pub(super) fn level(count: u32, settings: &SolveSettings, columns: usize) -> ComponentSystem<'static> {
    let mut gathered = Gathered::new(columns);
    for (piece, side) in sides(count).enumerate() {
        let mut mesh = empty();
        add_grid(&mut mesh, side, (piece % 512) as f32 * 500.0);
        let moments = signal::moments(&mesh, &DAffine3::IDENTITY, columns.div_ceil(2), 20.0, |_| true);
        gathered.add(&mesh, &DAffine3::IDENTITY, &moments, settings);
    }
    gathered.finish()
}

fn sides(count: u32) -> impl Iterator<Item = u32> {
    let of_rank = |i: u32| match (i % 100, noise(u64::from(i))) {
        (0, r) => 20 + (r * r * 30.0) as u32,
        (1..=20, _) => 2,
        (_, r) => 3 + (r * r * 7.0) as u32,
    };
    LARGE_SIDES.into_iter().chain((0..).map(of_rank)).take(count as usize)
}

fn empty() -> Mesh {
    let group = FaceGroup::PLAIN;
    Mesh { groups: vec![group], ..Mesh::default() }
}

/// A bumpy grid of `side²` vertices about 1 m apart, with rows and columns of different width.
fn add_grid(mesh: &mut Mesh, side: u32, shift: f32) {
    let side = side.max(2);
    let first = mesh.positions.len() as u32;
    for (i, j) in (0..side).flat_map(|i| (0..side).map(move |j| (i, j))) {
        let [dx, dy] = [i * side + j, j * side + i].map(|k| 0.6 * noise(u64::from(k)) as f32 - 0.3);
        let (x, y) = (i as f32 + dx, j as f32 + dy);
        mesh.positions.push([x + shift, (0.1 * x).sin() * (0.13 * y).cos() * 3.0, y]);
        mesh.normals.push([0.0, 1.0, 0.0]);
    }
    for (i, j) in (0..side - 1).flat_map(|i| (0..side - 1).map(move |j| (i, j))) {
        let v = first + i * side + j;
        let [a, b, c, d] = [v, v + 1, v + side, v + side + 1];
        mesh.faces.extend([[a, b, c], [b, d, c]]);
        mesh.face_group.extend([0, 0]);
    }
}
