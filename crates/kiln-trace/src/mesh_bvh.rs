//! The BVH of one mesh: what of it stops rays, in object space.

use crate::{
    BvhChild,
    boxed::Boxed,
    build::build,
    node::{BvhLink, MAX_LEAF, WideNode},
    pages::Pages,
    triangle::{FLIPPED_BIT, TWO_SIDED_BIT, TriangleRuns, face_of},
};
use glam::Vec3;
use kiln_core::{Bounds, CutoutFace, FaceGroup, Mesh};
use rayon::prelude::*;
use std::{
    collections::HashMap,
    sync::atomic::{AtomicU64, Ordering::Relaxed},
};

/// A mesh's occluding faces in a BVH whose leaves are triangles that are tested side by side.
///
/// Two coincident faces of opposite winding become one that is front from either side, which is what the tie rule
/// (front face first) gives, and leaves it to no rounding. Coincident faces of the same winding become the first.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshBvh {
    /// Nodes; the root is the first. Empty where nothing occludes.
    pub(crate) nodes: Pages<WideNode>,
    /// What the leaves name.
    pub(crate) triangles: TriangleRuns,
    /// Bounds of all occluding faces, object space.
    pub bounds: Bounds,
}

impl MeshBvh {
    /// Builds over the faces whose group occludes, but for those with holes ([`crate::CutoutMesh`]).
    pub fn build(mesh: &Mesh) -> Self {
        Self::build_over(mesh, FaceGroup::is_solid)
    }

    /// Builds over all faces of a mesh, those that stop no rays too: to find its surface.
    pub fn build_whole(mesh: &Mesh) -> Self {
        Self::build_over(mesh, |_| true)
    }

    /// Builds over the faces of some groups.
    pub(crate) fn build_over(mesh: &Mesh, is_in: impl Fn(&FaceGroup) -> bool + Sync) -> Self {
        let ids = occluders(mesh, is_in);
        let boxes: Vec<Boxed> = (0..ids.len() as u32)
            .into_par_iter()
            .map(|index| {
                let [a, b, c] = mesh.corners(face_of(ids[index as usize]) as usize);
                Boxed::new(index, a.min(b).min(c), a.max(b).max(c))
            })
            .collect();
        let tree = build(boxes, MAX_LEAF);
        let mut bounds = Bounds::EMPTY;
        for child in tree.nodes.first().into_iter().flat_map(WideNode::slots) {
            bounds.add(child.min.as_dvec3());
            bounds.add(child.max.as_dvec3());
        }
        let leaves = tree.nodes.iter().flat_map(WideNode::slots).filter_map(|child| match child.link {
            BvhLink::Leaf { first, count } => Some((first, count)),
            BvhLink::Node(_) => None,
        });
        let triangles = TriangleRuns::new(ids.len(), leaves, |index| {
            let id = ids[tree.order[index as usize] as usize];
            let Occluder { corners, primitive } = Occluder::new(mesh, face_of(id), id & TWO_SIDED_BIT != 0);
            (corners, primitive)
        });
        Self { nodes: tree.nodes.into(), triangles, bounds }
    }

    /// Whether nothing in it stops a ray.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The children of a node. There is no node in an empty mesh; else the root is node 0.
    pub fn children(&self, node: u32) -> impl Iterator<Item = BvhChild> {
        self.nodes[node as usize].slots()
    }

    /// Corners of a triangle that a leaf names, object space, and its face index with [`TWO_SIDED_BIT`] and [`FLIPPED_BIT`].
    pub fn triangle(&self, index: u32) -> ([Vec3; 3], u32) {
        self.triangles.triangle(index)
    }

    /// Memory of nodes and triangles, bytes.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.nodes) + self.triangles.memory_bytes()
    }
}

/// A face that stops rays.
pub(crate) struct Occluder {
    /// In rising order of their bits.
    pub(crate) corners: [Vec3; 3],
    /// Face index with [`TWO_SIDED_BIT`] and [`FLIPPED_BIT`].
    pub(crate) primitive: u32,
}

/// The faces of the groups that stop rays, in rising order, of those that coincide the first. With [`TWO_SIDED_BIT`].
pub(crate) fn occluders(mesh: &Mesh, is_in: impl Fn(&FaceGroup) -> bool + Sync) -> Vec<u32> {
    let stops = |face: u32| is_in(mesh.group(face as usize));
    let all = (0..mesh.faces.len() as u32).into_par_iter().filter(|face| stops(*face));
    let is_suspect = suspects(mesh, &stops);
    let joined = coincident(mesh, all.clone().filter(|face| is_suspect(*face)).collect());
    let with_bit = |face: u32, is_set: bool| face | if is_set { TWO_SIDED_BIT } else { 0 };
    let mut ids: Vec<u32> =
        all.map(|face| with_bit(face, mesh.group(face as usize).is_front_from_both_sides())).collect();
    if !joined.is_empty() {
        let mut joined = joined.into_iter().peekable();
        ids.retain_mut(|id| match joined.next_if(|(face, _)| *face == face_of(*id)) {
            Some((face, Some(is_two_sided))) => {
                *id = with_bit(face, is_two_sided);
                true
            }
            Some((_, None)) => false,
            None => true,
        });
    }
    ids
}

/// Tells the faces that may coincide with another: their corners have the same hash, which few others have.
fn suspects(mesh: &Mesh, stops: impl Fn(u32) -> bool + Sync) -> impl Fn(u32) -> bool + Sync {
    let faces = mesh.faces.len();
    // With 16 to 32 values for each face, about one in 16 at most is suspected for nothing.
    let mask = (16 * faces).next_power_of_two().clamp(1 << 6, 1 << 32) - 1;
    let bits = || -> Vec<AtomicU64> { (0..=mask / 64).map(|_| AtomicU64::new(0)).collect() };
    let (once, again) = (bits(), bits());
    let note = |face: usize| {
        let hash = hash(mesh.corners(face)) as usize & mask;
        let bit = 1 << (hash % 64);
        if stops(face as u32) && once[hash / 64].fetch_or(bit, Relaxed) & bit != 0 {
            again[hash / 64].fetch_or(bit, Relaxed);
        }
        hash as u32
    };
    let hashes: Vec<u32> = (0..faces).into_par_iter().map(note).collect();
    move |face| {
        let hash = hashes[face as usize] as usize;
        again[hash / 64].load(Relaxed) >> (hash % 64) & 1 == 1
    }
}

/// Those of the given faces that coincide, in rising order: whether the first of each set is front from either side,
/// nothing for the others. Where there are textures, they have to be the same at each place.
fn coincident(mesh: &Mesh, faces: Vec<u32>) -> Vec<(u32, Option<bool>)> {
    let textures: HashMap<usize, CutoutFace> = mesh.cutout_faces().map(|face| (face.face, face)).collect();
    let key = |face: u32| {
        let corners = mesh.corners(face as usize);
        let (order, is_even) = corner_order(corners);
        let texture = textures.get(&(face as usize)).map(|cutout| {
            let coordinates = order.map(|corner| cutout.corners[corner].map(|x| (x + 0.0).to_bits()));
            (cutout.mask, coordinates)
        });
        ((order.map(|corner| bits_of(corners[corner])), texture), face, is_even)
    };
    let mut keyed: Vec<_> = faces.into_iter().map(key).collect();
    keyed.sort_unstable();
    let mut joined = Vec::new();
    for same in keyed.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() > 1) {
        let is_facing_both = same.iter().any(|&(.., is_even)| is_even != same[0].2);
        let is_two_sided =
            is_facing_both || same.iter().any(|&(_, face, _)| mesh.group(face as usize).is_front_from_both_sides());
        let faces = same.iter().map(|&(_, face, _)| face);
        joined.extend(faces.enumerate().map(|(rank, face)| (face, (rank == 0).then_some(is_two_sided))));
    }
    joined.sort_unstable();
    joined
}

impl Occluder {
    /// A face as it stops rays; two-sided also because another one coincides with it.
    pub(crate) fn new(mesh: &Mesh, face: u32, two_sided: bool) -> Self {
        let corners = mesh.corners(face as usize);
        let (order, is_even) = corner_order(corners);
        let bit = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
        Self {
            corners: order.map(|corner| corners[corner] + 0.0),
            primitive: face | bit(two_sided, TWO_SIDED_BIT) | bit(!is_even, FLIPPED_BIT),
        }
    }
}

/// The same in whatever order the corners are (the multiplier is that of Knuth's linear congruential generator, MMIX).
fn hash(corners: [Vec3; 3]) -> u64 {
    const MULTIPLIER: u64 = 6_364_136_223_846_793_005;
    let mix = |hash: u64, word: f32| (hash.rotate_left(23) ^ u64::from(word.to_bits())).wrapping_mul(MULTIPLIER);
    let folded = |hash: u64| hash ^ hash >> 32;
    let one = |corner: Vec3| folded((corner + 0.0).to_array().into_iter().fold(0, mix));
    let [a, b, c] = corners.map(one);
    folded(a.wrapping_add(b).wrapping_add(c).wrapping_mul(MULTIPLIER))
}

/// The bits of a position; the two zeros count as one.
fn bits_of(corner: Vec3) -> [u32; 3] {
    (corner + 0.0).to_array().map(f32::to_bits)
}

/// The corners in rising order of their bits, which does not depend on the winding, and whether that order is an even
/// permutation of the face's.
pub(crate) fn corner_order(corners: [Vec3; 3]) -> ([usize; 3], bool) {
    let bits = corners.map(bits_of);
    let (mut order, mut is_even) = ([0, 1, 2], true);
    for (i, j) in [(0, 1), (1, 2), (0, 1)] {
        if bits[order[i]] > bits[order[j]] {
            order.swap(i, j);
            is_even = !is_even;
        }
    }
    (order, is_even)
}
