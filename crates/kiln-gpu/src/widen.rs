//! From the CPU's trees to the device's: each node takes in children of its children until its eight slots are used.
//!
//! The tree is known by what its nodes' children are, nothing else, so that the CPU's layout is its own matter. A slot
//! goes to the child of greatest surface area (Wald et al. 2008), opened where all its children fit. Slots that are left
//! part runs of triangles: eight boxes cost what one does, and a smaller box is one test of a triangle less, the
//! part of a visit in which lanes differ. Runs longer than a slot may hold become nodes.

use crate::node::{MAX_RUN, SLOTS, Slot, SlotContent, WideNode};
use bytemuck::Zeroable;
use glam::Vec3;
use kiln_trace::{BvhChild, BvhLink, MeshBvh, Scene};
use std::ops::Range;

/// A tree of the CPU tracer. Its root is node 0.
pub(crate) trait SourceTree {
    /// Whether each leaf is one thing that has a record among the nodes, instead of triangles.
    const LEAVES_HAVE_RECORDS: bool;

    /// The children of a node.
    fn children(&self, node: u32) -> Vec<BvhChild>;

    /// Box of one thing that a leaf names, or what contains it.
    fn bounds(&self, thing: u32) -> (Vec3, Vec3);
}

impl SourceTree for MeshBvh {
    const LEAVES_HAVE_RECORDS: bool = false;

    fn children(&self, node: u32) -> Vec<BvhChild> {
        self.children(node).collect()
    }

    fn bounds(&self, thing: u32) -> (Vec3, Vec3) {
        let [a, b, c] = self.triangle(thing).0;
        (a.min(b).min(c), a.max(b).max(c))
    }
}

impl SourceTree for Scene {
    const LEAVES_HAVE_RECORDS: bool = true;

    fn children(&self, node: u32) -> Vec<BvhChild> {
        self.children(node).collect()
    }

    fn bounds(&self, _: u32) -> (Vec3, Vec3) {
        (Vec3::NEG_INFINITY, Vec3::INFINITY)
    }
}

/// A tree in the device's form.
#[derive(Debug, Default)]
pub(crate) struct WideTree {
    /// The root is the first; empty where there is nothing. Records of leaves are zero: see `leaf_records`.
    pub(crate) nodes: Vec<WideNode>,
    /// What the leaves without records name, in the order in which nodes count them.
    pub(crate) leaves: Vec<u32>,
    /// Index and thing of each leaf that has a record among the nodes.
    pub(crate) leaf_records: Vec<(usize, u32)>,
    /// Nodes on the longest path from the root.
    pub(crate) depth: u32,
}

/// A child in the making.
#[derive(Debug)]
struct Item {
    min: Vec3,
    max: Vec3,
    content: Content,
}

#[derive(Debug)]
enum Content {
    Node(Vec<BvhChild>),
    Run(Vec<u32>),
}

impl Item {
    fn new(source: &impl SourceTree, child: &BvhChild) -> Self {
        let content = match child.link {
            BvhLink::Node(node) => Content::Node(source.children(node)),
            BvhLink::Leaf { first, count } => Content::Run((first..first + count).collect()),
        };
        Self { min: child.min, max: child.max, content }
    }

    /// Whether it gets a node of its own.
    fn is_node(&self, source: &impl SourceTree) -> bool {
        match &self.content {
            Content::Node(_) => true,
            Content::Run(things) => things.len() > most(source),
        }
    }

    /// Half its surface.
    fn area(&self) -> f32 {
        area((self.min, self.max))
    }

    /// Slots that it would take if it were opened.
    fn width(&self) -> usize {
        match &self.content {
            Content::Node(children) => children.len(),
            Content::Run(things) => things.len().min(2),
        }
    }

    /// What is in it, as items.
    fn opened(self, source: &impl SourceTree) -> Vec<Self> {
        match self.content {
            Content::Node(children) => children.iter().map(|child| Self::new(source, child)).collect(),
            Content::Run(things) => parts(source, &things, self.min, self.max),
        }
    }
}

/// Things of a slot at most.
fn most<S: SourceTree>(_: &S) -> usize {
    if S::LEAVES_HAVE_RECORDS { 1 } else { MAX_RUN }
}

/// Parts a run where it costs least: over all axes, things in the order of their centers, area by number. Boxes stay within
/// the run's own, which may have been clipped.
fn parts(source: &impl SourceTree, things: &[u32], min: Vec3, max: Vec3) -> Vec<Item> {
    let clipped = |&thing: &u32| {
        let (low, high) = source.bounds(thing);
        Boxed { thing, min: low.clamp(min, max), max: high.clamp(min, max) }
    };
    let boxes: Vec<Boxed> = things.iter().map(clipped).collect();
    let sorted = [0, 1, 2].map(|axis| {
        let mut boxes = boxes.clone();
        let center = |one: &Boxed| 0.5 * one.min[axis] + 0.5 * one.max[axis];
        boxes.sort_by(|a, b| center(a).total_cmp(&center(b)).then(a.thing.cmp(&b.thing)));
        boxes
    });
    let cost = |boxes: &[Boxed]| area(union(boxes)) * boxes.len() as f32;
    let ways = sorted.iter().flat_map(|boxes| (1..boxes.len()).map(move |at| boxes.split_at(at)));
    let cheapest = ways.map(|way| (cost(way.0) + cost(way.1), way)).min_by(|a, b| a.0.total_cmp(&b.0));
    let item = |boxes: &[Boxed]| {
        let (min, max) = union(boxes);
        Item { min, max, content: Content::Run(boxes.iter().map(|one| one.thing).collect()) }
    };
    cheapest.map_or_else(|| vec![item(&boxes)], |(_, (left, right))| vec![item(left), item(right)])
}

/// A thing of a run and its box.
#[derive(Clone, Copy)]
struct Boxed {
    thing: u32,
    min: Vec3,
    max: Vec3,
}

fn union(boxes: &[Boxed]) -> (Vec3, Vec3) {
    boxes.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |all, one| (all.0.min(one.min), all.1.max(one.max)))
}

/// Half a box's surface.
fn area((min, max): (Vec3, Vec3)) -> f32 {
    let size = max - min;
    size.x * size.y + size.y * size.z + size.z * size.x
}

/// Opens items while there are slots: nodes first, then runs.
fn filled(source: &impl SourceTree, mut items: Vec<Item>) -> Vec<Item> {
    loop {
        let spare = SLOTS.saturating_sub(items.len());
        let fits = |item: &Item| item.width() <= spare + 1 && (item.is_node(source) || item.width() > 1);
        let candidates = (0..items.len()).filter(|&i| fits(&items[i]));
        let best = candidates.max_by(|&a, &b| {
            let (a, b) = (&items[a], &items[b]);
            a.is_node(source).cmp(&b.is_node(source)).then(a.area().total_cmp(&b.area()))
        });
        let Some(best) = best else { return items };
        let opened = items.swap_remove(best).opened(source);
        items.extend(opened);
    }
}

/// Deals items to slots: a slot's bits say on which side of the node its child should lie. The pair of greatest gain
/// goes first.
fn dealt(items: Vec<Item>) -> [Option<Item>; SLOTS] {
    let min = items.iter().fold(Vec3::INFINITY, |all, item| all.min(item.min));
    let max = items.iter().fold(Vec3::NEG_INFINITY, |all, item| all.max(item.max));
    let middle = |min: Vec3, max: Vec3| 0.5 * min + 0.5 * max;
    let side = |slot: usize| Vec3::from_array([0, 1, 2].map(|axis| if slot & (1 << axis) == 0 { -1.0 } else { 1.0 }));
    let gains = items.iter().map(|item| {
        let off = middle(item.min, item.max) - middle(min, max);
        std::array::from_fn::<f32, SLOTS, _>(|slot| off.dot(side(slot)))
    });
    let gains: Vec<[f32; SLOTS]> = gains.collect();
    let mut slots = [const { None }; SLOTS];
    let mut waiting: Vec<Option<Item>> = items.into_iter().map(Some).collect();
    for _ in 0..waiting.len() {
        let free = || (0..SLOTS).filter(|&slot| slots[slot].is_none());
        let open = (0..waiting.len()).filter(|&i| waiting[i].is_some());
        let pairs = open.flat_map(|i| free().map(move |slot| (i, slot)));
        let Some((i, slot)) = pairs.max_by(|a, b| gains[a.0][a.1].total_cmp(&gains[b.0][b.1])) else { break };
        slots[slot] = waiting[i].take();
    }
    slots
}

/// Makes the device's tree. `source` has a root.
pub(crate) fn widen<S: SourceTree>(source: &S) -> WideTree {
    let mut tree = WideTree { nodes: vec![WideNode::zeroed()], ..WideTree::default() };
    let root: Vec<Item> = source.children(0).iter().map(|child| Item::new(source, child)).collect();
    let mut pending = vec![(root, 0, 1)];
    while let Some((items, index, level)) = pending.pop() {
        tree.depth = tree.depth.max(level);
        let child_base = tree.nodes.len() as u32;
        let first_triangle = (!S::LEAVES_HAVE_RECORDS).then_some(tree.leaves.len() as u32);
        let slots = dealt(filled(source, items)).map(|item| {
            let item = item?;
            let (min, max, is_node) = (item.min, item.max, item.is_node(source));
            let content = if is_node {
                pending.push((item.opened(source), tree.nodes.len(), level + 1));
                tree.nodes.push(WideNode::zeroed());
                SlotContent::Node
            } else {
                tree.push_leaf::<S>(&item.content)
            };
            Some(Slot { min, max, content })
        });
        tree.nodes[index] = WideNode::new(&slots, child_base, first_triangle);
    }
    tree
}

impl WideTree {
    /// Which leaves without records lie in one slot, slot by slot.
    pub(crate) fn runs(&self) -> impl Iterator<Item = Range<u32>> {
        self.nodes.iter().flat_map(WideNode::runs)
    }

    fn push_leaf<S: SourceTree>(&mut self, content: &Content) -> SlotContent {
        let Content::Run(things) = content else { return SlotContent::Node };
        if S::LEAVES_HAVE_RECORDS {
            self.leaf_records.extend(things.iter().map(|&thing| (self.nodes.len(), thing)));
            self.nodes.push(WideNode::zeroed());
            return SlotContent::Record;
        }
        self.leaves.extend_from_slice(things);
        SlotContent::Run(things.len() as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A tree that is given node by node, over boxes.
    struct Given {
        nodes: Vec<Vec<BvhChild>>,
        boxes: Vec<(Vec3, Vec3)>,
    }

    impl SourceTree for Given {
        const LEAVES_HAVE_RECORDS: bool = false;

        fn children(&self, node: u32) -> Vec<BvhChild> {
            self.nodes[node as usize].clone()
        }

        fn bounds(&self, thing: u32) -> (Vec3, Vec3) {
            self.boxes[thing as usize]
        }
    }

    impl Given {
        /// Children of up to `width`, leaves of up to `leaf`, whatever the boxes.
        fn new(boxes: Vec<(Vec3, Vec3)>, width: usize, leaf: usize) -> Self {
            let mut tree = Self { nodes: vec![Vec::new()], boxes };
            tree.fill(0, 0..tree.boxes.len(), width, leaf);
            tree
        }

        fn fill(&mut self, node: usize, things: Range<usize>, width: usize, leaf: usize) {
            let part = things.len().div_ceil(width).max(1);
            for first in things.clone().step_by(part) {
                let run = first..things.end.min(first + part);
                let union = self.boxes[run.clone()]
                    .iter()
                    .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |all, one| (all.0.min(one.0), all.1.max(one.1)));
                let link = if run.len() <= leaf {
                    BvhLink::Leaf { first: run.start as u32, count: run.len() as u32 }
                } else {
                    self.nodes.push(Vec::new());
                    let child = self.nodes.len() - 1;
                    self.fill(child, run, width, leaf);
                    BvhLink::Node(child as u32)
                };
                self.nodes[node].push(BvhChild { min: union.0, max: union.1, link });
            }
        }
    }

    /// Each thing is in exactly one leaf, inside every decoded box above it.
    fn check(tree: &WideTree, boxes: &[(Vec3, Vec3)]) -> u32 {
        let mut seen = vec![0; boxes.len()];
        let mut pending = vec![(0usize, 1, Vec::new())];
        let mut deepest = 0;
        while let Some((index, level, outer)) = pending.pop() {
            deepest = deepest.max(level);
            let node = &tree.nodes[index];
            for slot in 0..SLOTS {
                let Some((content, first)) = node.content(slot, false) else { continue };
                let mut above: Vec<[[f64; 3]; 2]> = outer.clone();
                above.push(node.decoded(slot));
                match content {
                    SlotContent::Run(count) => {
                        for &thing in &tree.leaves[first as usize..first as usize + usize::from(count)] {
                            seen[thing as usize] += 1;
                            let (min, max) = boxes[thing as usize];
                            let contains = |b: &[[f64; 3]; 2]| {
                                (0..3).all(|a| b[0][a] <= f64::from(min[a]) && b[1][a] >= f64::from(max[a]))
                            };
                            assert!(above.iter().all(contains));
                        }
                    }
                    _ => pending.push((first as usize, level + 1, above)),
                }
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
        deepest
    }

    proptest! {
        #[test]
        fn every_thing_keeps_one_place(
            corners in prop::collection::vec(prop::array::uniform3(-10f32..10.0), 1..300),
            width in 2usize..=8,
            leaf in 1usize..=8,
        ) {
            let boxes = corners.iter().enumerate().map(|(i, &c)| {
                let c = Vec3::from_array(c);
                (c, c + (i % 5) as f32 * 0.1)
            });
            let source = Given::new(boxes.collect(), width, leaf);
            let tree = widen(&source);
            prop_assert_eq!(check(&tree, &source.boxes), tree.depth);
            prop_assert_eq!(tree.leaves.len(), source.boxes.len());
            let mut in_runs: Vec<u32> = tree.runs().flatten().collect();
            in_runs.sort_unstable();
            prop_assert!(in_runs.into_iter().eq(0..tree.leaves.len() as u32));
            // Never more nodes than the source has, but for runs that are too long for a slot.
            prop_assert!(leaf > MAX_RUN || tree.nodes.len() <= source.nodes.len());
        }
    }

    /// Binary trees become trees whose nodes are full but for the last.
    #[test]
    fn slots_are_used() {
        let boxes = (0..4096).map(|i| {
            let corner = Vec3::new((i % 16) as f32, (i / 16 % 16) as f32, (i / 256) as f32);
            (corner, corner + 1.0)
        });
        let source = Given::new(boxes.collect(), 2, 1);
        let tree = widen(&source);
        assert_eq!((source.nodes.len(), tree.nodes.len()), (4095, 585));
    }
}
