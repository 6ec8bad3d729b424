//! From binary to eight-wide trees, at the least expected cost.
//!
//! Source: Ylitie, Karras and Laine 2017, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs",
//! section 3.1: dynamic programming over the binary tree finds, for each of its nodes, the cheapest way to represent its
//! subtree as a forest of at most i roots, i = 1 to 7. Deviation: a leaf costs the same whatever it holds, up to
//! eight, since its triangles are tested side by side.

use crate::{
    boxed::Boxed,
    node::{BvhChild, BvhLink, WideNode},
};
use glam::Vec3;
use rayon::prelude::*;

/// Cost of visiting a leaf, in visits of a node. Of 0.6, 1.0 and 1.5 the second was fastest on two levels of 268 and 595
/// thousand triangles, by 1 % and by 5 to 9 %.
const LEAF_COST: f32 = 1.0;

/// Primitives of the largest part that one thread turns into nodes.
const PART: usize = 1 << 14;

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

/// An inner node of a binary tree. Its left child is the next one, if it is an inner node.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Inner {
    /// Least corner of its box.
    pub(crate) min: [f32; 3],
    /// Greatest corner of its box.
    pub(crate) max: [f32; 3],
    /// Primitives in its left child.
    pub(crate) left: u32,
    /// How many nodes further on its right child is, if it is an inner node.
    pub(crate) right: u32,
    /// How it is represented.
    pub(crate) shares: Shares,
}

/// Cost of a subtree as at most 1 to 7 roots; entry 0 is not used.
pub(crate) type Costs = [f32; 8];

/// How the cheapest ways to represent a subtree begin: roots that the left child gets when so many are shared out, three bits
/// for each number; 0 where one root less costs no more. Number 0 is for the eight slots of a node of its own.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shares(u32);

impl Shares {
    fn of(self, roots: usize) -> usize {
        (self.0 >> (3 * roots) & 7) as usize
    }

    fn set(&mut self, roots: usize, share: usize) {
        self.0 |= (share as u32) << (3 * roots);
    }
}

/// A binary tree: inner nodes in preorder, primitives in the order of its leaves.
#[derive(Clone, Copy)]
struct Binary<'a> {
    nodes: &'a [Inner],
    primitives: &'a [Boxed],
    max_leaf: usize,
}

/// A run of primitives; with more than a leaf holds, the node that splits it.
#[derive(Clone, Copy, Debug)]
struct Subtree {
    node: usize,
    first: usize,
    count: usize,
}

impl Binary<'_> {
    fn is_leaf(&self, subtree: Subtree) -> bool {
        subtree.count <= self.max_leaf
    }

    fn children(&self, Subtree { node, first, count }: Subtree) -> [Subtree; 2] {
        let (left, right) = (self.nodes[node].left as usize, self.nodes[node].right as usize);
        let children = [(node + 1, first, left), (node + right, first + left, count - left)];
        children.map(|(node, first, count)| Subtree { node, first, count })
    }

    fn corners(&self, subtree: Subtree) -> (Vec3, Vec3) {
        if self.is_leaf(subtree) {
            let hull = Boxed::around(&self.primitives[subtree.first..subtree.first + subtree.count]);
            return (hull.min(), hull.max());
        }
        let node = &self.nodes[subtree.node];
        (node.min.into(), node.max.into())
    }

    /// Appends the roots of an inner subtree's children, of which there are to be so many at most.
    fn share_out(&self, subtree: Subtree, roots: usize, out: &mut Vec<Subtree>) {
        let share = self.nodes[subtree.node].shares.of(roots % 8);
        let [left, right] = self.children(subtree);
        for (child, mut roots) in [(left, share), (right, roots - share)] {
            if self.is_leaf(child) {
                roots = 1;
            }
            while roots > 1 && self.nodes[child.node].shares.of(roots) == 0 {
                roots -= 1;
            }
            if roots == 1 { out.push(child) } else { self.share_out(child, roots, out) }
        }
    }
}

/// Merges a binary tree eight-wide: inner nodes in preorder, primitives in the order of its leaves, of which each holds
/// at most `max_leaf`.
pub(crate) fn collapse(nodes: &[Inner], primitives: &[Boxed], max_leaf: usize) -> WideTree {
    let binary = Binary { nodes, primitives, max_leaf };
    let mut deferred = Vec::new();
    let root = Subtree { node: 0, first: 0, count: primitives.len() };
    let mut wide = widen(&binary, root, Some(&mut deferred));
    let parts: Vec<WideTree> = deferred.par_iter().map(|part| widen(&binary, part.subtree, None)).collect();
    let total = wide.nodes.len() + parts.iter().map(|part| part.nodes.len()).sum::<usize>();
    wide.nodes.reserve_exact(total - wide.nodes.len());
    for (Deferred { node, slot, depth, .. }, mut part) in deferred.into_iter().zip(parts) {
        let first = wide.nodes.len() as u32;
        wide.nodes[node].children[slot] = BvhLink::Node(first).to_reference();
        for child in part.nodes.iter_mut().flat_map(|node| &mut node.children) {
            if let (true, BvhLink::Node(index)) = (*child != u32::MAX, BvhLink::of_reference(*child)) {
                *child = BvhLink::Node(first + index).to_reference();
            }
        }
        wide.depth = wide.depth.max(depth + part.depth);
        wide.nodes.append(&mut part.nodes);
    }
    WideTree { order: primitives.iter().map(Boxed::index).collect(), ..wide }
}

/// A subtree that another thread turns into nodes: which one, the slot that leads to it, and the depth of that slot's node.
struct Deferred {
    subtree: Subtree,
    node: usize,
    slot: usize,
    depth: usize,
}

/// Turns a subtree into nodes, its own first; with `deferred` all but those that are small enough for a task.
fn widen(binary: &Binary, subtree: Subtree, mut deferred: Option<&mut Vec<Deferred>>) -> WideTree {
    let mut wide = WideTree { nodes: vec![WideNode::EMPTY], order: Vec::new(), depth: 0 };
    // Each entry: subtree to turn into a node, the node's index, its depth.
    let mut pending = vec![(subtree, 0usize, 1usize)];
    let (mut roots, mut children) = (Vec::with_capacity(8), Vec::with_capacity(8));
    while let Some((subtree, node, depth)) = pending.pop() {
        wide.depth = wide.depth.max(depth);
        roots.clear();
        children.clear();
        if binary.is_leaf(subtree) {
            roots.push(subtree);
        } else {
            binary.share_out(subtree, 8, &mut roots);
        }
        for (slot, &root) in roots.iter().enumerate() {
            let link = if binary.is_leaf(root) {
                BvhLink::Leaf { first: root.first as u32, count: root.count as u32 }
            } else if let (true, Some(deferred)) = (root.count <= PART, deferred.as_deref_mut()) {
                deferred.push(Deferred { subtree: root, node, slot, depth });
                BvhLink::Node(0)
            } else {
                pending.push((root, wide.nodes.len(), depth + 1));
                wide.nodes.push(WideNode::EMPTY);
                BvhLink::Node((wide.nodes.len() - 1) as u32)
            };
            let (min, max) = binary.corners(root);
            children.push(BvhChild { min, max, link });
        }
        wide.nodes[node] = WideNode::new(&children);
    }
    wide
}

/// What a leaf costs, however many roots it may have.
pub(crate) fn leaf(area: f32) -> Costs {
    [LEAF_COST * area; 8]
}

/// The cheapest ways to represent an inner subtree, by those of its children.
pub(crate) fn merge(area: f32, left: &Costs, right: &Costs) -> (Costs, Shares) {
    let (mut costs, mut shares) = (Costs::default(), Shares::default());
    let (inside, share) = cheapest(left, right, 8);
    shares.set(0, share);
    costs[1] = area + inside;
    for roots in 2..8 {
        let (shared, share) = cheapest(left, right, roots);
        let fewer = costs[roots - 1];
        shares.set(roots, if shared < fewer { share } else { 0 });
        costs[roots] = shared.min(fewer);
    }
    (costs, shares)
}

/// The best way to share roots out to two children: cost, and the left one's share.
#[inline(always)]
fn cheapest(left: &Costs, right: &Costs, roots: usize) -> (f32, usize) {
    let mut best = (f32::INFINITY, 1);
    for share in roots.saturating_sub(7).max(1)..roots.min(8) {
        let cost = left[share] + right[roots - share];
        if cost < best.0 {
            best = (cost, share);
        }
    }
    best
}
