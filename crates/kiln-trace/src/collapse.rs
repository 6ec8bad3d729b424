//! From binary to eight-wide trees, at the least expected cost.
//!
//! Source: Ylitie, Karras and Laine 2017, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs",
//! section 3.1: dynamic programming over the binary tree finds, for each of its nodes, the cheapest way to represent its
//! subtree as a forest of at most i roots, i = 1 to 7. Deviation: a leaf costs the same whatever it holds, up to
//! eight, since its triangles are tested side by side.

use crate::node::{BvhChild, BvhLink, WideNode};
use glam::Vec3;
use obvhs::bvh2::Bvh2;
use rayon::prelude::*;

/// Cost of visiting a leaf, in visits of a node. Of 0.6, 1.0 and 1.5 the second was fastest on two levels of 268 and 595
/// thousand triangles, by 1 % and by 5 to 9 %.
const LEAF_COST: f32 = 1.0;

/// Nodes of the binary tree for each part that one thread merges, roughly.
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

/// A node of the binary tree, in preorder: its left child is the next one, the right child follows the left one's subtree.
#[derive(Clone, Copy, Debug)]
struct Subtree {
    /// Index of the node.
    node: u32,
    /// Nodes in it, itself included.
    size: u32,
    /// Its primitives, as a run.
    first: u32,
    count: u32,
}

/// Cost of a subtree as at most 1 to 7 roots; entry 0 is not used.
type Costs = [f32; 8];

/// How the cheapest ways to represent a subtree begin: roots that the left child gets when so many are shared out; 0 where one
/// root less costs no more. Entry 0 is for the eight slots of a node of its own, entry 1 is 1 if one root is a leaf.
type Shares = [u8; 8];

/// A binary tree in preorder, or what of it is above the nodes of some depth.
#[derive(Debug, Default)]
struct Binary {
    tree: Vec<Subtree>,
    /// Of each subtree, once they are known.
    shares: Vec<Shares>,
    /// Its primitives in the order of the leaves, or the nodes at which it was cut.
    order: Vec<u32>,
}

/// Merges a binary tree eight-wide. Leaves hold at most `max_leaf` primitives.
pub(crate) fn collapse(bvh: &Bvh2, max_leaf: usize) -> WideTree {
    let binary = weigh(bvh, max_leaf);
    let mut deferred = Vec::new();
    let mut wide = widen(bvh, &binary, 0, Some(&mut deferred));
    let parts: Vec<WideTree> = deferred.par_iter().map(|part| widen(bvh, &binary, part.at, None)).collect();
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
    WideTree { order: binary.order, ..wide }
}

/// A subtree that another thread turns into nodes: which one, the slot that leads to it, and the depth of that slot's node.
struct Deferred {
    at: usize,
    node: usize,
    slot: usize,
    depth: usize,
}

/// Turns a subtree into nodes, its own first; with `deferred` all but those that are small enough for a task.
fn widen(bvh: &Bvh2, binary: &Binary, at: usize, mut deferred: Option<&mut Vec<Deferred>>) -> WideTree {
    let mut wide = WideTree { nodes: vec![WideNode::EMPTY], order: Vec::new(), depth: 0 };
    // Each entry: subtree to turn into a node, the node's index, its depth.
    let mut pending = vec![(at, 0usize, 1usize)];
    let (mut roots, mut children) = (Vec::with_capacity(8), Vec::with_capacity(8));
    while let Some((at, node, depth)) = pending.pop() {
        wide.depth = wide.depth.max(depth);
        roots.clear();
        children.clear();
        if is_leaf(&binary.shares[at]) {
            roots.push(at);
        } else {
            share_out(binary, at, 8, &mut roots);
        }
        for (slot, &root) in roots.iter().enumerate() {
            let Subtree { first, count, size, .. } = binary.tree[root];
            let link = if is_leaf(&binary.shares[root]) {
                BvhLink::Leaf { first, count }
            } else if let (true, Some(deferred)) = (size as usize <= PART, deferred.as_deref_mut()) {
                deferred.push(Deferred { at: root, node, slot, depth });
                BvhLink::Node(0)
            } else {
                pending.push((root, wide.nodes.len(), depth + 1));
                wide.nodes.push(WideNode::EMPTY);
                BvhLink::Node((wide.nodes.len() - 1) as u32)
            };
            let aabb = bvh.nodes[binary.tree[root].node as usize].aabb();
            children.push(BvhChild { min: Vec3::from(aabb.min), max: Vec3::from(aabb.max), link });
        }
        wide.nodes[node] = WideNode::new(&children);
    }
    wide
}

fn is_leaf(shares: &Shares) -> bool {
    shares[1] == 1
}

/// The binary tree in preorder, with the cheapest ways to represent each subtree. It is cut at a depth that gives parts for
/// all threads; what is above them is put together from what they cost.
fn weigh(bvh: &Bvh2, max_leaf: usize) -> Binary {
    let depth = (bvh.nodes.len() / PART + 1).next_power_of_two().ilog2();
    let top = preorder(bvh, 0, Some(depth));
    let weigh_part = |root: &u32| {
        let mut part = preorder(bvh, *root as usize, None);
        let costs = weigh_all(bvh, &mut part, max_leaf);
        (part, costs)
    };
    let (mut parts, costs): (Vec<Binary>, Vec<Costs>) = top.order.par_iter().map(weigh_part).unzip();
    let mut whole = Binary::default();
    if top.tree.len() == 1 {
        return parts.pop().unwrap_or_default();
    }
    let total = top.tree.len() - parts.len() + parts.iter().map(|part| part.tree.len()).sum::<usize>();
    whole.tree.reserve_exact(total);
    whole.shares.reserve_exact(total);
    whole.order.reserve_exact(bvh.primitive_indices.len());
    // Sizes and runs of the top are those of whole subtrees before it is weighed.
    let mut parts = parts.into_iter();
    let mut places = Vec::with_capacity(top.tree.len());
    for subtree in &top.tree {
        places.push(whole.tree.len());
        if subtree.size == 1 {
            let Some(mut part) = parts.next() else { break };
            let first = whole.order.len() as u32;
            whole.tree.extend(part.tree.iter().map(|subtree| Subtree { first: first + subtree.first, ..*subtree }));
            whole.shares.append(&mut part.shares);
            whole.order.append(&mut part.order);
        } else {
            whole.tree.push(Subtree { first: whole.order.len() as u32, ..*subtree });
            whole.shares.push(Shares::default());
        }
    }
    weigh_top(bvh, &top, &places, &costs, max_leaf, &mut whole);
    whole
}

/// Weighs the inner nodes of the top, which are at given places of the whole.
fn weigh_top(bvh: &Bvh2, top: &Binary, places: &[usize], parts: &[Costs], max_leaf: usize, whole: &mut Binary) {
    let mut costs = vec![Costs::default(); top.tree.len()];
    for at in (0..top.tree.len()).rev() {
        let subtree = top.tree[at];
        if subtree.size == 1 {
            costs[at] = parts[subtree.first as usize];
            continue;
        }
        let children = [at + 1, at + 1 + top.tree[at + 1].size as usize];
        let [left, right] = children.map(|child| whole.tree[places[child]]);
        let place = places[at];
        whole.tree[place].size = 1 + left.size + right.size;
        whole.tree[place].count = left.count + right.count;
        let children = Some(children.map(|child| costs[child]));
        (costs[at], whole.shares[place]) = cost(bvh, &whole.tree[place], children, max_leaf);
    }
}

/// Weighs all subtrees of a binary tree. Returns what the whole costs.
fn weigh_all(bvh: &Bvh2, binary: &mut Binary, max_leaf: usize) -> Costs {
    let tree = &binary.tree;
    let mut costs = vec![Costs::default(); tree.len()];
    binary.shares = vec![Shares::default(); tree.len()];
    // A parent comes before its children, so that backwards both children are known.
    for at in (0..tree.len()).rev() {
        let is_inner = tree[at].size > 1;
        let children = is_inner.then(|| [costs[at + 1], costs[at + 1 + tree[at + 1].size as usize]]);
        (costs[at], binary.shares[at]) = cost(bvh, &tree[at], children, max_leaf);
    }
    costs.first().copied().unwrap_or_default()
}

/// The binary tree below a node. Cut at a depth, nodes there are leaves of one thing, themselves.
fn preorder(bvh: &Bvh2, root: usize, cut: Option<u32>) -> Binary {
    let mut binary = Binary::default();
    let Binary { tree, order, .. } = &mut binary;
    enum Step {
        Enter(usize, u32),
        /// All of the subtree that begins here has been entered.
        Close(usize),
    }
    let mut steps = vec![Step::Enter(root, 0)];
    while let Some(step) = steps.pop() {
        match step {
            Step::Close(at) => {
                tree[at].size = (tree.len() - at) as u32;
                tree[at].count = order.len() as u32 - tree[at].first;
            }
            Step::Enter(index, depth) => {
                let node = &bvh.nodes[index];
                let below = node.first_index as usize;
                let first = order.len() as u32;
                tree.push(Subtree { node: index as u32, size: 1, first, count: node.prim_count });
                match cut {
                    Some(cut) if depth == cut || node.is_leaf() => order.push(index as u32),
                    _ if node.is_leaf() => {
                        order.extend_from_slice(&bvh.primitive_indices[below..below + node.prim_count as usize]);
                    }
                    _ => {
                        let close = Step::Close(tree.len() - 1);
                        steps.extend([close, Step::Enter(below + 1, depth + 1), Step::Enter(below, depth + 1)]);
                    }
                }
            }
        }
    }
    binary
}

/// The cheapest ways to represent a subtree, by those of its children.
fn cost(bvh: &Bvh2, subtree: &Subtree, children: Option<[Costs; 2]>, max_leaf: usize) -> (Costs, Shares) {
    let area = bvh.nodes[subtree.node as usize].aabb().half_area();
    let as_leaf = if subtree.count as usize <= max_leaf { LEAF_COST * area } else { f32::INFINITY };
    let (mut costs, mut shares) = ([as_leaf; 8], Shares::default());
    shares[1] = 1;
    if let Some([left, right]) = children {
        let (inside, share) = cheapest(&left, &right, 8);
        shares[0] = share;
        let as_node = area + inside;
        shares[1] = u8::from(as_leaf <= as_node);
        costs[1] = as_leaf.min(as_node);
        for roots in 2..8 {
            let (shared, share) = cheapest(&left, &right, roots);
            let fewer = costs[roots - 1];
            shares[roots] = if shared < fewer { share } else { 0 };
            costs[roots] = shared.min(fewer);
        }
    }
    (costs, shares)
}

/// The best way to share roots out to two children: cost, and the left one's share.
fn cheapest(left: &Costs, right: &Costs, roots: usize) -> (f32, u8) {
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
fn share_out(binary: &Binary, at: usize, roots: usize, out: &mut Vec<usize>) {
    let share = usize::from(binary.shares[at][roots % 8]);
    let right = at + 1 + binary.tree[at + 1].size as usize;
    for (child, mut roots) in [(at + 1, share), (right, roots - share)] {
        while roots > 1 && binary.shares[child][roots] == 0 {
            roots -= 1;
        }
        if roots == 1 { out.push(child) } else { share_out(binary, child, roots, out) }
    }
}
