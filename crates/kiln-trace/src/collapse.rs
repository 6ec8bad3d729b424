//! From binary to eight-wide trees, at the least expected cost.
//!
//! Source: Ylitie, Karras and Laine 2017, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs",
//! section 3.1: dynamic programming over the binary tree finds, for each of its nodes, the cheapest way to represent its
//! subtree as a forest of at most i roots, i = 1 to 7. Deviation: a leaf costs the same whatever it holds, up to
//! eight, since its triangles are tested side by side.

use crate::node::{BvhChild, BvhLink, WideNode};
use glam::Vec3;
use obvhs::{aabb::Aabb, bvh2::Bvh2};
use rayon::prelude::*;

/// Cost of visiting a leaf, in visits of a node. Of 0.6, 1.0 and 1.5 the second was fastest on two levels of 268 and 595
/// thousand triangles, by 1 % and by 5 to 9 %.
const LEAF_COST: f32 = 1.0;

/// Nodes of a subtree that one thread works on.
const SUBTREE: usize = 1 << 14;

/// A tree over primitives that are known by their boxes only.
#[derive(Debug, Default)]
pub(crate) struct WideTree {
    /// The root is node 0; empty where there is no primitive.
    pub(crate) nodes: Vec<WideNode>,
    /// The primitives, in the order in which leaves name them.
    pub(crate) order: Vec<u32>,
    /// Nodes on the longest path from the root.
    pub(crate) depth: usize,
}

/// A node of the binary tree, in preorder: its left child is the next one, the right child follows the left one's subtree.
#[derive(Clone, Copy, Debug)]
struct Subtree {
    aabb: Aabb,
    /// Nodes in it, itself included.
    size: u32,
    /// Its primitives, as a run.
    first: u32,
    count: u32,
}

impl Subtree {
    fn is_leaf(&self) -> bool {
        self.size == 1
    }
}

/// The cheapest ways to represent a subtree.
#[derive(Clone, Copy, Default)]
struct Costs {
    /// As at most 1 to 7 roots; entry 0 is not used.
    of_roots: [f32; 8],
    /// Roots that the left child gets when that many are shared out; 0 where one root less costs no more. Entry 0 is for
    /// the eight slots of a node of its own.
    left_share: [u8; 8],
    /// As one root: a leaf, or a node.
    is_leaf: bool,
}

/// Merges a binary tree eight-wide. Leaves hold at most `max_leaf` primitives.
pub(crate) fn collapse(bvh: &Bvh2, max_leaf: usize) -> WideTree {
    let (tree, order) = preorder(bvh);
    let costs = costs(&tree, max_leaf);
    let mut wide = WideTree { nodes: Vec::with_capacity(tree.len() / 24 + 1), order, depth: 0 };
    wide.nodes.push(WideNode::EMPTY);
    // Each entry: subtree to turn into a node, the node's index, its depth.
    let mut pending = vec![(0usize, 0usize, 1usize)];
    let mut roots = Vec::with_capacity(8);
    let mut children = Vec::with_capacity(8);
    while let Some((at, index, depth)) = pending.pop() {
        wide.depth = wide.depth.max(depth);
        roots.clear();
        children.clear();
        if costs[at].is_leaf {
            roots.push(at);
        } else {
            share_out(&tree, &costs, at, 8, &mut roots);
        }
        for &root in &roots {
            let Subtree { aabb, first, count, .. } = tree[root];
            let link = if costs[root].is_leaf {
                BvhLink::Leaf { first, count }
            } else {
                pending.push((root, wide.nodes.len(), depth + 1));
                wide.nodes.push(WideNode::EMPTY);
                BvhLink::Node((wide.nodes.len() - 1) as u32)
            };
            children.push(BvhChild { min: Vec3::from(aabb.min), max: Vec3::from(aabb.max), link });
        }
        wide.nodes[index] = WideNode::new(&children);
    }
    wide
}

/// The binary tree in preorder, and its primitives in the order of the leaves.
fn preorder(bvh: &Bvh2) -> (Vec<Subtree>, Vec<u32>) {
    let mut tree: Vec<Subtree> = Vec::with_capacity(bvh.nodes.len());
    let mut order = Vec::with_capacity(bvh.primitive_indices.len());
    enum Step {
        Enter(usize),
        /// All of the subtree that begins here has been entered.
        Close(usize),
    }
    let mut steps = vec![Step::Enter(0)];
    while let Some(step) = steps.pop() {
        match step {
            Step::Close(at) => {
                tree[at].size = (tree.len() - at) as u32;
                tree[at].count = order.len() as u32 - tree[at].first;
            }
            Step::Enter(index) => {
                let node = &bvh.nodes[index];
                let first = node.first_index as usize;
                tree.push(Subtree { aabb: *node.aabb(), size: 1, first: order.len() as u32, count: node.prim_count });
                if node.is_leaf() {
                    order.extend_from_slice(&bvh.primitive_indices[first..first + node.prim_count as usize]);
                } else {
                    steps.extend([Step::Close(tree.len() - 1), Step::Enter(first + 1), Step::Enter(first)]);
                }
            }
        }
    }
    (tree, order)
}

fn costs(tree: &[Subtree], max_leaf: usize) -> Vec<Costs> {
    let mut costs = vec![Costs::default(); tree.len()];
    // Subtrees that are small enough, and what is above them.
    let (mut above, mut runs, mut at) = (Vec::new(), Vec::new(), 0);
    while at < tree.len() {
        let size = tree[at].size as usize;
        if size <= SUBTREE {
            runs.push((at, size));
            at += size;
        } else {
            above.push(at);
            at += 1;
        }
    }
    let mut rest = costs.as_mut_slice();
    let (mut begun, mut parts) = (0, Vec::with_capacity(runs.len()));
    for &(first, size) in &runs {
        let (_, from_first) = rest.split_at_mut(first - begun);
        let (part, after) = from_first.split_at_mut(size);
        parts.push((&tree[first..first + size], part));
        (rest, begun) = (after, first + size);
    }
    // A parent comes before its children, so that backwards both children are known.
    parts
        .into_par_iter()
        .for_each(|(tree, costs)| (0..tree.len()).rev().for_each(|at| cost(tree, costs, at, max_leaf)));
    above.into_iter().rev().for_each(|at| cost(tree, &mut costs, at, max_leaf));
    costs
}

fn cost(tree: &[Subtree], costs: &mut [Costs], at: usize, max_leaf: usize) {
    let subtree = &tree[at];
    let area = subtree.aabb.half_area();
    let as_leaf = if subtree.count as usize <= max_leaf { LEAF_COST * area } else { f32::INFINITY };
    let mut here = Costs { of_roots: [as_leaf; 8], left_share: [0; 8], is_leaf: true };
    if !subtree.is_leaf() {
        let left = costs[at + 1].of_roots;
        let right = costs[at + 1 + tree[at + 1].size as usize].of_roots;
        let (inside, share) = cheapest(&left, &right, 8);
        here.left_share[0] = share;
        let as_node = area + inside;
        here.is_leaf = as_leaf <= as_node;
        here.of_roots[1] = as_leaf.min(as_node);
        for roots in 2..8 {
            let (shared, share) = cheapest(&left, &right, roots);
            let fewer = here.of_roots[roots - 1];
            here.left_share[roots] = if shared < fewer { share } else { 0 };
            here.of_roots[roots] = shared.min(fewer);
        }
    }
    costs[at] = here;
}

/// The best way to share roots out to two children: cost, and the left one's share.
fn cheapest(left: &[f32; 8], right: &[f32; 8], roots: usize) -> (f32, u8) {
    let mut best = (f32::INFINITY, 1);
    for share in roots.saturating_sub(7).max(1)..roots.min(8) {
        let cost = left[share] + right[roots - share];
        if cost < best.0 {
            best = (cost, share as u8);
        }
    }
    best
}

/// Appends the roots of an inner subtree's children, of which there are to be so many at most.
fn share_out(tree: &[Subtree], costs: &[Costs], at: usize, roots: usize, out: &mut Vec<usize>) {
    let share = usize::from(costs[at].left_share[roots % 8]);
    let right = at + 1 + tree[at + 1].size as usize;
    for (child, mut roots) in [(at + 1, share), (right, roots - share)] {
        while roots > 1 && costs[child].left_share[roots] == 0 {
            roots -= 1;
        }
        if roots == 1 { out.push(child) } else { share_out(tree, costs, child, roots, out) }
    }
}
