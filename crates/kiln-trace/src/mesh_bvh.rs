//! The BVH of one mesh: what of it stops rays, in object space.

use crate::{
    BvhChild,
    build::build,
    node::{BvhLink, MAX_LEAF, WideNode},
    pages::Pages,
    triangle::{FLIPPED_BIT, TWO_SIDED_BIT, TriangleRuns, face_of},
};
use glam::{DVec3, Vec3, Vec3A};
use kiln_core::{Bounds, Mesh};
use obvhs::aabb::Aabb;
use rayon::prelude::*;
use std::collections::HashSet;

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
    /// Builds over the faces whose group occludes.
    pub fn build(mesh: &Mesh) -> Self {
        let occluders = occluders(mesh);
        let boxes: Vec<Aabb> = occluders
            .par_iter()
            .map(|o| {
                let [a, b, c] = o.corners.map(Vec3A::from);
                Aabb { min: a.min(b).min(c), max: a.max(b).max(c) }
            })
            .collect();
        let mut bounds = Bounds::EMPTY;
        for aabb in &boxes {
            bounds.add(Vec3::from(aabb.min).as_dvec3());
            bounds.add(Vec3::from(aabb.max).as_dvec3());
        }
        let tree = build(&boxes, MAX_LEAF);
        let leaves = tree.nodes.iter().flat_map(WideNode::slots).filter_map(|child| match child.link {
            BvhLink::Leaf { first, count } => Some((first, count)),
            BvhLink::Node(_) => None,
        });
        let triangles = TriangleRuns::new(boxes.len(), leaves, |index| {
            let occluder = &occluders[tree.order[index as usize] as usize];
            (occluder.corners, occluder.primitive)
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

    /// Greatest absolute coordinate of each axis.
    pub(crate) fn extent(&self) -> DVec3 {
        if self.bounds.is_empty() { DVec3::ZERO } else { self.bounds.min.abs().max(self.bounds.max.abs()) }
    }
}

/// A face that stops rays.
pub(crate) struct Occluder {
    /// In rising order of their bits.
    pub(crate) corners: [Vec3; 3],
    /// Face index with [`TWO_SIDED_BIT`] and [`FLIPPED_BIT`].
    pub(crate) primitive: u32,
}

/// The faces that stop rays, by index; of those that coincide the first.
pub(crate) fn occluders(mesh: &Mesh) -> Vec<Occluder> {
    let occludes = |face: &u32| mesh.group(*face as usize).occludes;
    let hashes: Vec<u64> = (0..mesh.faces.len() as u32)
        .into_par_iter()
        .filter(occludes)
        .map(|face| hash(&corner_key(mesh.corners(face as usize)).0))
        .collect();
    let repeated = repeated(hashes);
    // Faces of equal corners have equal hashes, so that only those few are compared corner by corner.
    let is_alone =
        |face: &u32| repeated.is_empty() || !repeated.contains(&hash(&corner_key(mesh.corners(*face as usize)).0));
    let all = (0..mesh.faces.len() as u32).into_par_iter().filter(occludes);
    let single = |face: u32| Occluder::new(mesh, face, mesh.group(face as usize).double_sided);
    let mut occluders: Vec<Occluder> = all.clone().filter(is_alone).map(single).collect();
    if !repeated.is_empty() {
        let merged = coincident(mesh, all.filter(|face| !is_alone(face)).collect());
        occluders.extend(merged.into_iter().map(|(face, two_sided)| Occluder::new(mesh, face, two_sided)));
        occluders.par_sort_unstable_by_key(|occluder| face_of(occluder.primitive));
    }
    occluders
}

/// The hashes that occur more than once.
fn repeated(mut hashes: Vec<u64>) -> HashSet<u64> {
    hashes.par_sort_unstable();
    hashes.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| pair[0]).collect()
}

/// One face of each set of coincident ones among the given, and whether it is front from either side.
fn coincident(mesh: &Mesh, faces: Vec<u32>) -> Vec<(u32, bool)> {
    let key = |face: u32| {
        let (key, is_even) = corner_key(mesh.corners(face as usize));
        (key, is_even, face)
    };
    let mut keyed: Vec<_> = faces.into_iter().map(key).collect();
    keyed.sort_unstable();
    let mut merged = Vec::new();
    for same in keyed.chunk_by(|a, b| a.0 == b.0) {
        let Some(first) = same.iter().map(|&(.., face)| face).min() else { continue };
        let is_facing_both = same.iter().any(|&(_, is_even, _)| is_even != same[0].1);
        let is_double_sided = |&(.., face): &(_, bool, u32)| mesh.group(face as usize).double_sided;
        merged.push((first, is_facing_both || same.iter().any(is_double_sided)));
    }
    merged
}

impl Occluder {
    /// A face as it stops rays; two-sided also because another one coincides with it.
    pub(crate) fn new(mesh: &Mesh, face: u32, two_sided: bool) -> Self {
        let (bits, is_even) = corner_key(mesh.corners(face as usize));
        let bit = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
        Self {
            corners: bits.map(|corner| Vec3::from_array(corner.map(f32::from_bits))),
            primitive: face | bit(two_sided, TWO_SIDED_BIT) | bit(!is_even, FLIPPED_BIT),
        }
    }
}

/// Mixes the words of a key (the multiplier is that of Knuth's linear congruential generator, MMIX).
fn hash(key: &[[u32; 3]; 3]) -> u64 {
    let mix = |hash: u64, word: &u32| (hash.rotate_left(23) ^ u64::from(*word)).wrapping_mul(6_364_136_223_846_793_005);
    let hash = key.iter().flatten().fold(0, mix);
    hash ^ hash >> 32
}

/// The corners' bits in an order that does not depend on the winding, and whether that order is an even
/// permutation of the face's.
fn corner_key(corners: [Vec3; 3]) -> ([[u32; 3]; 3], bool) {
    let mut bits = corners.map(|c| (c + 0.0).to_array().map(f32::to_bits));
    let mut is_even = true;
    for (i, j) in [(0, 1), (1, 2), (0, 1)] {
        if bits[i] > bits[j] {
            bits.swap(i, j);
            is_even = !is_even;
        }
    }
    (bits, is_even)
}
