//! Four-wide BVH nodes, built by obvhs and collapsed.
//!
//! obvhs builds a binary BVH (PLOC with reinsertion, Meister and Bittner 2018, 2022). Its nodes are merged four at a
//! time by opening the child of greatest surface area first (Wald et al. 2008). Trees deeper than the traversal
//! stack, which only contrived input gives, are built again by halving the sorted primitives.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec3A, Vec4};
use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::{Bvh2, builder::build_bvh2},
};
use std::time::Duration;

/// Set in a child reference that is a leaf; the other bits are the leaf's index.
pub const LEAF_BIT: u32 = 1 << 31;

/// A child slot without a child; its box is inverted, so that no ray enters it.
pub const NO_CHILD: u32 = u32::MAX;

/// Entries of the traversal stack: each level of the deepest tree that is accepted leaves three behind, and the last
/// puts four on it.
pub const MAX_STACK: usize = 97;
const MAX_DEPTH: usize = (MAX_STACK - 1) / 3;

/// Coordinates beyond this could overflow the builder's areas.
const MAX_EXTENT: f32 = 1e15;

/// An inner node with the boxes of up to four children, one child in each lane.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct BvhNode {
    /// Least x, y, z, then greatest x, y, z of the four children.
    pub bounds: [Vec4; 6],
    /// Index of a node, or [`LEAF_BIT`] and the index of a leaf, or [`NO_CHILD`].
    pub children: [u32; 4],
}

const _: () = assert!(size_of::<BvhNode>() == 112);

impl BvhNode {
    const EMPTY: Self = {
        let (low, high) = (Vec4::INFINITY, Vec4::NEG_INFINITY);
        Self { bounds: [low, low, low, high, high, high], children: [NO_CHILD; 4] }
    };

    /// The used slots, as box and reference.
    pub(crate) fn slots(&self) -> impl Iterator<Item = (Vec3, Vec3, u32)> {
        let corner = |slot: usize, base: usize| Vec3::from_array([0, 1, 2].map(|axis| self.bounds[base + axis][slot]));
        let used = (0..4).filter(|&slot| self.children[slot] != NO_CHILD);
        used.map(move |slot| (corner(slot, 0), corner(slot, 3), self.children[slot]))
    }

    fn set_child(&mut self, slot: usize, aabb: &Aabb, child: u32) {
        for axis in 0..3 {
            self.bounds[axis][slot] = aabb.min[axis];
            self.bounds[axis + 3][slot] = aabb.max[axis];
        }
        self.children[slot] = child;
    }
}

/// What a slot of a node leads to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BvhChild {
    /// Least corner of its box.
    pub min: Vec3,
    /// Greatest corner of its box.
    pub max: Vec3,
    /// What is in the box.
    pub link: BvhLink,
}

/// A node or a leaf of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BvhLink {
    /// Index of an inner node.
    Node(u32),
    /// A run of what the tree is over: triangles of a mesh, one instance of a scene.
    Leaf {
        /// Index of the first one.
        first: u32,
        /// How many, at least one.
        count: u32,
    },
}

/// A tree over primitives that are known by their boxes only.
pub(crate) struct Tree {
    /// The root is node 0; empty where there is no primitive.
    pub(crate) nodes: Vec<BvhNode>,
    /// The primitives of each leaf, at most `max_leaf`.
    pub(crate) leaves: Vec<Vec<u32>>,
}

/// Builds a tree whose leaves hold at most `max_leaf` primitives (1 to 4).
pub(crate) fn build(boxes: &[Aabb], max_leaf: u32) -> Tree {
    let mut tree = Tree { nodes: Vec::new(), leaves: Vec::new() };
    if boxes.is_empty() {
        return tree;
    }
    let extent = boxes.iter().fold(0.0f32, |m, b| m.max(b.min.abs().max_element()).max(b.max.abs().max_element()));
    if extent < MAX_EXTENT {
        let params = BvhBuildParams { max_prims_per_leaf: max_leaf, ..BvhBuildParams::medium_build() };
        let bvh = build_bvh2(boxes, params, &mut Duration::default());
        if collapse(&bvh, &mut tree) <= MAX_DEPTH {
            return tree;
        }
        tree = Tree { nodes: Vec::new(), leaves: Vec::new() };
    }
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    halve(boxes, &mut order, max_leaf as usize, &mut tree);
    tree
}

/// Merges a binary BVH four-wide into `tree`; returns its depth.
fn collapse(bvh: &Bvh2, tree: &mut Tree) -> usize {
    let mut depth = 0;
    // Each entry: binary node to turn into a wide node, the wide node's index, its depth.
    let mut pending = vec![(0usize, 0usize, 1usize)];
    tree.nodes.push(BvhNode::EMPTY);
    while let Some((binary, wide, level)) = pending.pop() {
        depth = depth.max(level);
        let mut slots = vec![binary];
        while slots.len() < 4 {
            let open = |&&i: &&usize| !bvh.nodes[i].is_leaf();
            let area = |&&i: &&usize| bvh.nodes[i].aabb().half_area();
            let Some(&largest) = slots.iter().filter(open).max_by(|a, b| area(a).total_cmp(&area(b))) else { break };
            slots.retain(|&i| i != largest);
            let first = bvh.nodes[largest].first_index as usize;
            slots.extend([first, first + 1]);
        }
        for (slot, &child) in slots.iter().enumerate() {
            let node = &bvh.nodes[child];
            let reference = if node.is_leaf() {
                let first = node.first_index as usize;
                let primitives = &bvh.primitive_indices[first..first + node.prim_count as usize];
                push_leaf(tree, primitives)
            } else {
                tree.nodes.push(BvhNode::EMPTY);
                pending.push((child, tree.nodes.len() - 1, level + 1));
                (tree.nodes.len() - 1) as u32
            };
            tree.nodes[wide].set_child(slot, node.aabb(), reference);
        }
    }
    depth
}

fn push_leaf(tree: &mut Tree, primitives: &[u32]) -> u32 {
    let mut primitives = primitives.to_vec();
    primitives.sort_unstable();
    tree.leaves.push(primitives);
    (tree.leaves.len() - 1) as u32 | LEAF_BIT
}

/// Splits at the median of the widest axis, so that the depth is logarithmic whatever the boxes are.
fn halve(boxes: &[Aabb], order: &mut [u32], max_leaf: usize, tree: &mut Tree) -> usize {
    let index = tree.nodes.len();
    tree.nodes.push(BvhNode::EMPTY);
    let mut runs = vec![order];
    while runs.len() < 4 {
        let Some(longest) = (0..runs.len()).filter(|&i| runs[i].len() > max_leaf).max_by_key(|&i| runs[i].len()) else {
            break;
        };
        let run = runs.swap_remove(longest);
        let centers = union(boxes, run);
        let size = centers.max - centers.min;
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
        run.sort_unstable_by(|&a, &b| {
            let key = |i: u32| 0.5 * boxes[i as usize].min[axis] + 0.5 * boxes[i as usize].max[axis];
            key(a).total_cmp(&key(b)).then(a.cmp(&b))
        });
        let (left, right) = run.split_at_mut(run.len() / 2);
        runs.extend([left, right]);
    }
    for (slot, run) in runs.into_iter().enumerate() {
        let aabb = union(boxes, run);
        let child = if run.len() <= max_leaf { push_leaf(tree, run) } else { halve(boxes, run, max_leaf, tree) as u32 };
        tree.nodes[index].set_child(slot, &aabb, child);
    }
    index
}

fn union(boxes: &[Aabb], run: &[u32]) -> Aabb {
    let mut all = Aabb { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };
    for &i in run {
        all.min = all.min.min(boxes[i as usize].min);
        all.max = all.max.max(boxes[i as usize].max);
    }
    all
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every primitive is in exactly one leaf, and inside the box of every slot above it.
    pub(crate) fn check(tree: &Tree, boxes: &[Aabb], max_leaf: usize) -> usize {
        let mut seen = vec![0; boxes.len()];
        let mut depth = 0;
        let mut pending = vec![(0u32, Aabb::LARGEST, 1)];
        while let Some((index, outer, level)) = pending.pop() {
            depth = depth.max(level);
            let node = &tree.nodes[index as usize];
            for slot in 0..4 {
                let child = node.children[slot];
                if child == NO_CHILD {
                    continue;
                }
                let corner =
                    |base: usize| Vec3A::from_array(std::array::from_fn(|axis| node.bounds[base + axis][slot]));
                let aabb = Aabb { min: corner(0), max: corner(3) };
                assert!(aabb.min.cmpge(outer.min).all() && aabb.max.cmple(outer.max).all());
                if child & LEAF_BIT == 0 {
                    pending.push((child, aabb, level + 1));
                    continue;
                }
                let leaf = &tree.leaves[(child & !LEAF_BIT) as usize];
                assert!((1..=max_leaf).contains(&leaf.len()));
                for &primitive in leaf {
                    seen[primitive as usize] += 1;
                    let inner = &boxes[primitive as usize];
                    assert!(inner.min.cmpge(aabb.min).all() && inner.max.cmple(aabb.max).all());
                }
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
        depth
    }

    fn cube(center: [f32; 3], half: f32) -> Aabb {
        let center = Vec3A::from_array(center);
        Aabb { min: center - half, max: center + half }
    }

    proptest! {
        #[test]
        fn trees_are_sound(centers in prop::collection::vec(prop::array::uniform3(-10f32..10.0), 1..200), max_leaf in 1u32..5) {
            let boxes: Vec<Aabb> = centers.iter().enumerate().map(|(i, &c)| cube(c, (i % 7) as f32 * 0.1)).collect();
            check(&build(&boxes, max_leaf), &boxes, max_leaf as usize);
            let far: Vec<Aabb> = centers.iter().map(|c| cube(c.map(|x| x * 1e17), 1.0)).collect();
            check(&build(&far, max_leaf), &far, max_leaf as usize);
        }
    }

    #[test]
    fn depth_is_bounded_for_geometric_series() {
        // Boxes that shrink by halves towards a point make binary trees as deep as they are many.
        let boxes: Vec<Aabb> = (0..2000).map(|i| cube([0.98f32.powi(i), 0.0, 0.0], 0.98f32.powi(i) * 1e-3)).collect();
        let depth = check(&build(&boxes, 1), &boxes, 1);
        assert!(depth <= MAX_DEPTH, "{depth}");
        let equal = vec![cube([1.0; 3], 0.5); 5000];
        assert!(check(&build(&equal, 4), &equal, 4) <= MAX_DEPTH);
    }

    #[test]
    fn nothing_gives_an_empty_tree() {
        assert!(build(&[], 4).nodes.is_empty());
    }
}
