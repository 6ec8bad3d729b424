//! Boxes in a tree, to find those near a place among many.

use glam::DVec3;
use kiln_core::Bounds;

/// Boxes in one leaf.
const LEAF: usize = 8;

/// A tree over boxes, split at the median along the longest axis. Which boxes are found does not depend on its shape.
#[derive(Debug)]
pub(crate) struct BoxTree<'a> {
    boxes: &'a [Bounds],
    /// Indices of the boxes that are not empty, a run for each leaf.
    order: Vec<u32>,
    root: Option<Node>,
}

#[derive(Debug)]
struct Node {
    bounds: Bounds,
    children: Children,
}

#[derive(Debug)]
enum Children {
    Leaf(std::ops::Range<usize>),
    Split(Box<[Node; 2]>),
}

impl<'a> BoxTree<'a> {
    pub(crate) fn new(boxes: &'a [Bounds]) -> Self {
        let mut order: Vec<u32> = (0..boxes.len() as u32).filter(|&i| !boxes[i as usize].is_empty()).collect();
        let root = (!order.is_empty()).then(|| Node::new(boxes, &mut order, 0));
        Self { boxes, order, root }
    }

    /// Ascending indices of the boxes for which `is_found` holds. It must hold for every box that holds one for which it
    /// does.
    pub(crate) fn find(&self, is_found: impl Fn(&Bounds) -> bool) -> Vec<u32> {
        let mut found = Vec::new();
        let mut open: Vec<&Node> = self.root.iter().collect();
        while let Some(node) = open.pop() {
            if !is_found(&node.bounds) {
                continue;
            }
            match &node.children {
                Children::Split(children) => open.extend(children.iter()),
                Children::Leaf(run) => {
                    let run = self.order[run.clone()].iter();
                    found.extend(run.filter(|&&index| is_found(&self.boxes[index as usize])));
                }
            }
        }
        found.sort_unstable();
        found
    }
}

impl Node {
    fn new(boxes: &[Bounds], order: &mut [u32], first: usize) -> Self {
        let of = |index: u32| &boxes[index as usize];
        let mut bounds = Bounds::EMPTY;
        for &index in &*order {
            bounds.merge(of(index));
        }
        if order.len() <= LEAF {
            return Self { bounds, children: Children::Leaf(first..first + order.len()) };
        }
        let size = bounds.max - bounds.min;
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
        let middle = order.len() / 2;
        let center = |index: u32| of(index).min[axis] + of(index).max[axis];
        order.select_nth_unstable_by(middle, |&a, &b| center(a).total_cmp(&center(b)));
        let (low, high) = order.split_at_mut(middle);
        let children = [Self::new(boxes, low, first), Self::new(boxes, high, first + middle)];
        Self { bounds, children: Children::Split(Box::new(children)) }
    }
}

/// Distance between two boxes, 0 where they touch; not a number where both are infinite.
pub(crate) fn gap(a: &Bounds, b: &Bounds) -> f64 {
    (a.min - b.max).max(b.min - a.max).max(DVec3::ZERO).length()
}
