//! The BVH of one mesh: what of it stops rays, in object space.

use crate::{
    bvh::{self, BvhChild, BvhLink, BvhNode, LEAF_BIT},
    triangle::{NO_PRIMITIVE, TWO_SIDED_BIT, TriangleBlock},
};
use glam::{DVec3, Vec3, Vec3A};
use kiln_core::{Bounds, Mesh};
use obvhs::aabb::Aabb;

/// A mesh's occluding faces in a BVH whose leaves are [`TriangleBlock`]s.
///
/// Two coincident faces of opposite winding become one that is front from either side, which is what the tie rule
/// (front face first) gives, and leaves it to no rounding. Coincident faces of the same winding become the first.
#[derive(Clone, Debug)]
pub struct MeshBvh {
    /// Nodes; the root is the first. Empty where nothing occludes.
    pub nodes: Vec<BvhNode>,
    /// Leaves.
    pub blocks: Vec<TriangleBlock>,
    /// Bounds of all occluding faces, object space.
    pub bounds: Bounds,
}

impl MeshBvh {
    /// Builds over the faces whose group occludes.
    pub fn build(mesh: &Mesh) -> Self {
        let occluders = occluders(mesh);
        let boxes: Vec<Aabb> = occluders
            .iter()
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
        let tree = bvh::build(&boxes, 4);
        let block = |leaf: &Vec<u32>| {
            let mut block = TriangleBlock::EMPTY;
            for (lane, &i) in leaf.iter().enumerate() {
                let occluder = &occluders[i as usize];
                block.set(lane, occluder.corners, occluder.primitive);
            }
            block
        };
        Self { nodes: tree.nodes, blocks: tree.leaves.iter().map(block).collect(), bounds }
    }

    /// The children of a node. There is none without faces; else the root is node 0.
    pub fn children(&self, node: u32) -> impl Iterator<Item = BvhChild> {
        self.nodes[node as usize].slots().map(|(min, max, child)| {
            let link = if child & LEAF_BIT == 0 {
                BvhLink::Node(child)
            } else {
                let block = child & !LEAF_BIT;
                let used = self.blocks[block as usize].primitives.iter().filter(|&&id| id != NO_PRIMITIVE);
                BvhLink::Leaf { first: 4 * block, count: used.count() as u32 }
            };
            BvhChild { min, max, link }
        })
    }

    /// Corners of a triangle that a leaf names, object space, and its face index with [`TWO_SIDED_BIT`].
    pub fn triangle(&self, index: u32) -> ([Vec3; 3], u32) {
        let (block, lane) = (&self.blocks[index as usize / 4], index as usize % 4);
        ([0, 1, 2].map(|corner| block.corner(corner, lane)), block.primitives[lane])
    }

    /// Memory of nodes and triangles, bytes.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.blocks.as_slice())
    }

    /// Greatest absolute coordinate of each axis.
    pub(crate) fn extent(&self) -> DVec3 {
        if self.bounds.is_empty() { DVec3::ZERO } else { self.bounds.min.abs().max(self.bounds.max.abs()) }
    }
}

struct Occluder {
    corners: [Vec3; 3],
    /// Face index with [`TWO_SIDED_BIT`].
    primitive: u32,
}

fn occluders(mesh: &Mesh) -> Vec<Occluder> {
    let mut keyed: Vec<([[u32; 3]; 3], bool, u32)> = (0..mesh.faces.len() as u32)
        .filter(|&face| mesh.group(face as usize).occludes)
        .map(|face| {
            let (key, is_even) = corner_key(mesh.corners(face as usize));
            (key, is_even, face)
        })
        .collect();
    keyed.sort_unstable();
    let mut faces: Vec<(u32, bool)> = keyed
        .chunk_by(|a, b| a.0 == b.0)
        .filter_map(|same| {
            let first = same.iter().map(|&(.., face)| face).min()?;
            let is_facing_both = same.iter().any(|&(_, is_even, _)| is_even != same[0].1);
            let is_double_sided = same.iter().any(|&(.., face)| mesh.group(face as usize).double_sided);
            Some((first, is_facing_both || is_double_sided))
        })
        .collect();
    faces.sort_unstable();
    let occluder = |(face, two_sided): (u32, bool)| Occluder {
        corners: mesh.corners(face as usize),
        primitive: face | if two_sided { TWO_SIDED_BIT } else { 0 },
    };
    faces.into_iter().map(occluder).collect()
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
