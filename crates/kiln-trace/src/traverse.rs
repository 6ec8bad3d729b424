//! Traversal of four-wide nodes: near children first, popped nodes tested again against the closest hit.
//!
//! Boxes are tested conservatively (Ize 2013, "Robust BVH ray traversal": the far distance is widened by two roundings
//! for each operation), so that the closest hit is that of all triangles, whatever the tree.

use crate::bvh::{BvhNode, LEAF_BIT, MAX_STACK};
use glam::{Vec3, Vec4};

/// Widens a far distance beyond the rounding error of the slab test, 1 + 2γ₃ and a little more.
const WIDEN: f32 = 1.000_000_6;

/// Directions shorter than this along an axis count as this long in box tests only, so that no 0 · ∞ occurs.
const LEAST_DIRECTION: f32 = 1e-18;

/// A ray in the form that boxes are tested with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SlabRay {
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
    /// Index into [`BvhNode::bounds`] of the near and far plane of each axis.
    near: [usize; 3],
    far: [usize; 3],
}

impl SlabRay {
    pub(crate) fn new(origin: Vec3, direction: Vec3) -> Self {
        let safe = |d: f32| if d.abs() < LEAST_DIRECTION { LEAST_DIRECTION.copysign(d) } else { d };
        let inverse = direction.to_array().map(|d| 1.0 / safe(d));
        let near = std::array::from_fn(|axis| if inverse[axis] < 0.0 { axis + 3 } else { axis });
        let far = std::array::from_fn(|axis| if inverse[axis] < 0.0 { axis } else { axis + 3 });
        Self { origin: origin.to_array().map(Vec4::splat), inverse: inverse.map(Vec4::splat), near, far }
    }

    /// Distance to each child's box and the mask of those entered before `t_max`.
    #[inline(always)]
    fn enter(&self, node: &BvhNode, t_max: f32) -> (Vec4, u32) {
        let plane =
            |planes: &[usize; 3], axis: usize| (node.bounds[planes[axis]] - self.origin[axis]) * self.inverse[axis];
        let near = plane(&self.near, 0).max(plane(&self.near, 1)).max(plane(&self.near, 2)).max(Vec4::ZERO);
        let far = plane(&self.far, 0).min(plane(&self.far, 1)).min(plane(&self.far, 2)).min(Vec4::splat(t_max));
        (near, near.cmple(far * WIDEN).bitmask())
    }
}

/// Visits the leaves that a ray enters before the closest hit, near ones first. `visit` gets a leaf's index and the
/// distance beyond which nothing matters, and returns the new one.
#[inline(always)]
pub(crate) fn traverse(nodes: &[BvhNode], ray: &SlabRay, mut t_max: f32, mut visit: impl FnMut(u32, f32) -> f32) {
    if nodes.is_empty() {
        return;
    }
    let mut stack = [(0u32, 0f32); MAX_STACK];
    let (mut depth, mut current) = (0, 0);
    loop {
        let node = &nodes[current as usize];
        let (near, mut mask) = ray.enter(node, t_max);
        let first = depth;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            // Insertion keeps the nearest of this node's children on top.
            let (entry, mut at) = ((node.children[lane], near[lane]), depth);
            while at > first && stack[at - 1].1 < entry.1 {
                stack[at] = stack[at - 1];
                at -= 1;
            }
            stack[at] = entry;
            depth += 1;
        }
        loop {
            if depth == 0 {
                return;
            }
            depth -= 1;
            let (child, near) = stack[depth];
            if near > t_max * WIDEN {
                continue;
            }
            if child & LEAF_BIT == 0 {
                current = child;
                break;
            }
            t_max = visit(child & !LEAF_BIT, t_max);
        }
    }
}
