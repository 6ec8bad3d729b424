//! Which vertices are one unknown: those at one position whose normals agree, so that UV seams do not show and
//! hard edges stay.
//!
//! Agreement is transitive (union-find over all pairs within the angle), so the order of vertices does not
//! matter. Pairs are found without trying them all: normals are sorted into cells so small that all of one cell
//! agree, and only neighbouring cells are compared, so a pole with 10⁵ normals is no trouble.

use crate::{frame::Frame, nearest::KdTree};
use glam::DVec3;
use kiln_core::Mesh;
use std::collections::BTreeMap;

/// Vertices as unknowns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Weld {
    /// The unknown of each vertex.
    pub unknown_of_vertex: Vec<u32>,
    /// The first vertex of each unknown; unknowns are numbered by it.
    pub first_vertex: Vec<u32>,
}

impl Weld {
    /// Welds the vertices of a mesh; `weld_degrees` is the greatest angle between normals in the world.
    pub fn new(mesh: &Mesh, frame: &Frame, weld_degrees: f64) -> Self {
        let mut sets = DisjointSets::new(mesh.positions.len());
        let normals = Normals::new(mesh, frame);
        let chord = 2.0 * (weld_degrees.clamp(0.0, 180.0).to_radians() / 2.0).sin();
        let mut order: Vec<([u32; 3], u32)> = mesh.positions.iter().zip(0..).map(|(p, v)| (key(*p), v)).collect();
        order.sort_unstable();
        for group in order.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1) {
            let members = group.iter().filter_map(|&(_, v)| normals.of(v).map(|n| (n, v))).collect();
            link(members, chord, &mut sets);
        }
        Self::from_sets(&mut sets)
    }

    fn from_sets(sets: &mut DisjointSets) -> Self {
        let mut weld = Self { unknown_of_vertex: Vec::with_capacity(sets.parent.len()), first_vertex: Vec::new() };
        for vertex in 0..sets.parent.len() as u32 {
            // The root is the lowest member, so it has its number before any other asks for it.
            let root = sets.root(vertex);
            if root == vertex {
                weld.unknown_of_vertex.push(weld.first_vertex.len() as u32);
                weld.first_vertex.push(vertex);
            } else {
                weld.unknown_of_vertex.push(weld.unknown_of_vertex[root as usize]);
            }
        }
        weld
    }

    /// Number of unknowns.
    pub fn unknown_count(&self) -> usize {
        self.first_vertex.len()
    }
}

/// A position as comparable bits, the two zeros as one.
fn key(position: [f32; 3]) -> [u32; 3] {
    position.map(|x| (x + 0.0).to_bits())
}

/// Normals of vertices in the frame: their own, else the area-weighted one of the faces that use the index.
struct Normals<'a> {
    mesh: &'a Mesh,
    frame: &'a Frame,
    of_faces: BTreeMap<u32, DVec3>,
}

impl<'a> Normals<'a> {
    fn new(mesh: &'a Mesh, frame: &'a Frame) -> Self {
        let missing: Vec<bool> = mesh.normals.iter().map(|n| frame.normal(*n).is_none()).collect();
        let mut of_faces = BTreeMap::<u32, DVec3>::new();
        if missing.contains(&true) {
            for face in &mesh.faces {
                let [a, b, c] = face.map(|v| frame.point(mesh.positions[v as usize]));
                for &vertex in face.iter().filter(|v| missing[**v as usize]) {
                    *of_faces.entry(vertex).or_default() += (b - a).cross(c - a);
                }
            }
        }
        Self { mesh, frame, of_faces }
    }

    fn of(&self, vertex: u32) -> Option<DVec3> {
        let own = self.frame.normal(self.mesh.normals[vertex as usize]);
        own.or_else(|| self.of_faces.get(&vertex)?.try_normalize())
    }
}

/// Unites all members that a chain of steps no longer than `chord` joins.
fn link(members: Vec<(DVec3, u32)>, chord: f64, sets: &mut DisjointSets) {
    // Below this the cells would not fit their integers; it is an angle of 6e-7 degrees.
    const LEAST_CHORD: f64 = 1e-8;
    let cell_size = chord.max(LEAST_CHORD) * 0.999 / 3f64.sqrt();
    let mut cells = BTreeMap::<[i32; 3], Vec<(DVec3, u32)>>::new();
    for (normal, vertex) in members {
        cells.entry((normal / cell_size).floor().to_array().map(|x| x as i32)).or_default().push((normal, vertex));
    }
    for (cell, members) in &cells {
        members.iter().for_each(|(_, vertex)| sets.unite(*vertex, members[0].1));
        for other in later_neighbours(*cell).filter_map(|n| cells.get(&n)) {
            let joined = sets.root(members[0].1) == sets.root(other[0].1);
            if !joined && within(members, other, chord) {
                sets.unite(members[0].1, other[0].1);
            }
        }
    }
}

/// The cells that a chord can reach and that follow in lexicographic order.
fn later_neighbours([x, y, z]: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    (0..125)
        .map(|i| [i / 25 - 2, i / 5 % 5 - 2, i % 5 - 2])
        .filter(|offset| *offset > [0; 3])
        .map(move |[dx, dy, dz]| [x.saturating_add(dx), y.saturating_add(dy), z.saturating_add(dz)])
}

fn within(some: &[(DVec3, u32)], others: &[(DVec3, u32)], chord: f64) -> bool {
    let limit = chord * chord;
    if some.len() * others.len() <= 4096 {
        return some.iter().any(|(a, _)| others.iter().any(|(b, _)| a.distance_squared(*b) <= limit));
    }
    let tree = KdTree::new(others.to_vec());
    some.iter().filter_map(|(a, _)| tree.nearest(*a)).any(|found| found.distance_squared <= limit)
}

/// Union-find (Tarjan 1975) whose roots are the lowest members.
#[derive(Clone, Debug)]
pub struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    /// `n` sets of one.
    pub fn new(n: usize) -> Self {
        Self { parent: (0..n as u32).collect() }
    }

    /// The lowest member of the set.
    pub fn root(&mut self, mut member: u32) -> u32 {
        while self.parent[member as usize] != member {
            let above = self.parent[self.parent[member as usize] as usize];
            self.parent[member as usize] = above;
            member = above;
        }
        member
    }

    /// Makes two sets one.
    pub fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DAffine3;
    use proptest::prelude::*;

    /// Vertices at the origin with the given normals, and one elsewhere so that there is an extent.
    fn at_one_point(normals: &[DVec3]) -> Mesh {
        let mut mesh = Mesh {
            positions: vec![[0.0; 3]; normals.len()],
            normals: normals.iter().map(|n| n.as_vec3().to_array()).collect(),
            ..Mesh::default()
        };
        let first = mesh.positions.len() as u32;
        mesh.positions.extend([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        mesh.normals.extend([[0.0, 0.0, 1.0]; 3]);
        mesh.faces.push([first, first + 1, first + 2]);
        mesh
    }

    fn weld(mesh: &Mesh, degrees: f64) -> Weld {
        Weld::new(mesh, &Frame::new(mesh, &DAffine3::IDENTITY).unwrap(), degrees)
    }

    fn turned(degrees: f64) -> DVec3 {
        DVec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos())
    }

    #[test]
    fn seams_close_and_hard_edges_stay() {
        let mesh = at_one_point(&[turned(0.0), turned(90.0), turned(14.0), turned(91.0)]);
        assert_eq!(weld(&mesh, 15.0).unknown_of_vertex[..4], [0, 1, 0, 1]);
        assert_eq!(weld(&mesh, 0.0).unknown_count(), 7);
        assert_eq!(weld(&mesh, 180.0).unknown_of_vertex[..4], [0; 4]);
    }

    #[test]
    fn chains_join_in_any_order() {
        let mesh = at_one_point(&[turned(0.0), turned(28.0), turned(14.0)]);
        assert_eq!(weld(&mesh, 15.0).unknown_of_vertex[..3], [0; 3]);
        let apart = at_one_point(&[turned(0.0), turned(28.0)]);
        assert_eq!(weld(&apart, 15.0).unknown_of_vertex[..2], [0, 1]);
    }

    #[test]
    fn negative_zero_is_zero_and_positions_must_be_equal() {
        let mut mesh = at_one_point(&[DVec3::Z; 3]);
        mesh.positions[1] = [-0.0; 3];
        mesh.positions[2] = [f32::MIN_POSITIVE, 0.0, 0.0];
        assert_eq!(weld(&mesh, 15.0).unknown_of_vertex[..3], [0, 0, 1]);
    }

    #[test]
    fn missing_normals_come_from_the_faces_of_the_index() {
        let mut mesh = at_one_point(&[DVec3::ZERO, DVec3::Z, DVec3::X]);
        mesh.faces.push([0, 3, 4]);
        assert_eq!(weld(&mesh, 15.0).unknown_of_vertex[..3], [0, 0, 1]);
        mesh.faces.pop();
        assert_eq!(weld(&mesh, 15.0).unknown_of_vertex[..3], [0, 1, 2], "no normal and no face: joins nothing");
    }

    #[test]
    fn a_pole_of_many_normals_is_no_trouble() {
        // Two dense caps 20° across whose nearest normals are 30° apart, spread so that no two are equal.
        let cap = |center: f64, i: u32| {
            let (r, turn) = (10f64.to_radians() * (f64::from(i) / 3e4).sqrt(), f64::from(i) * 2.399_963);
            let side = DVec3::Y * (r * turn.sin()) + DVec3::X * (r * turn.cos());
            glam::DQuat::from_rotation_y(center.to_radians()) * (DVec3::Z + side).normalize()
        };
        let normals: Vec<_> = (0..60_000).map(|i| cap(if i % 2 == 0 { 0.0 } else { 50.0 }, i / 2)).collect();
        let mesh = at_one_point(&normals);
        assert_eq!(weld(&mesh, 15.0).unknown_count(), 2 + 3);
        assert_eq!(weld(&mesh, 31.0).unknown_count(), 1 + 3);
    }

    proptest! {
        #[test]
        fn agrees_with_trying_all_pairs(
            angles in prop::collection::vec((0.0..180.0f64, 0.0..360.0f64), 1..40),
            degrees in 0.5..60.0f64,
        ) {
            let normals: Vec<_> = angles
                .iter()
                .map(|(tilt, turn)| glam::DQuat::from_rotation_z(turn.to_radians()) * turned(*tilt))
                .map(|n| n.as_vec3().as_dvec3())
                .collect();
            let mut sets = DisjointSets::new(normals.len());
            for (i, a) in normals.iter().enumerate() {
                for (j, b) in normals.iter().enumerate() {
                    if a.normalize().angle_between(b.normalize()) <= degrees.to_radians() {
                        sets.unite(i as u32, j as u32);
                    }
                }
            }
            let expected = Weld::from_sets(&mut sets);
            let found = weld(&at_one_point(&normals), degrees);
            prop_assert_eq!(&found.unknown_of_vertex[..normals.len()], &expected.unknown_of_vertex[..]);
        }
    }
}
