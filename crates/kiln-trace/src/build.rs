//! Builds eight-wide trees.
//!
//! obvhs builds a binary BVH (PLOC with reinsertion, Meister and Bittner 2018, 2022), which [`crate::collapse`] merges.
//! Trees deeper than the traversal's stack, which only contrived input gives, are built again by halving the
//! sorted primitives.

use crate::{
    collapse::{WideTree, collapse},
    node::{BvhChild, BvhLink, MAX_DEPTH, WideNode},
};
use glam::{Vec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::builder::build_bvh2, ploc::PlocSearchDistance};
use std::time::Duration;

/// Coordinates beyond this could overflow the builder's areas.
const MAX_EXTENT: f32 = 1e15;

/// Where primitives are only halved: nothing says that those of a leaf are near each other.
const MAX_HALVED_LEAF: usize = 4;

/// One primitive a leaf: how many belong together is the collapse's decision. Neighbours within 6 of each other along a curve
/// are paired, and 5 % of the nodes moved to better places once, not twice: trees within 2 % of the library's medium preset
/// (docs/benchmarks/rays.md).
const PARAMS: BvhBuildParams = BvhBuildParams {
    ploc_search_distance: PlocSearchDistance::Low,
    search_depth_threshold: 2,
    reinsertion_batch_ratio: 0.05,
    post_collapse_reinsertion_batch_ratio_multiplier: 0.0,
    max_prims_per_leaf: 1,
    ..BvhBuildParams::medium_build()
};

/// Builds a tree whose leaves hold at most `max_leaf` primitives, 1 to 8.
pub(crate) fn build(boxes: &[Aabb], max_leaf: usize) -> WideTree {
    if boxes.is_empty() {
        return WideTree::default();
    }
    let extent = boxes.iter().fold(0.0f32, |m, b| m.max(b.min.abs().max_element()).max(b.max.abs().max_element()));
    if extent < MAX_EXTENT {
        let tree = collapse(&build_bvh2(boxes, PARAMS, &mut Duration::default()), max_leaf);
        if tree.depth <= MAX_DEPTH {
            return tree;
        }
    }
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = Vec::new();
    let max_leaf = max_leaf.min(MAX_HALVED_LEAF);
    let depth = halve(boxes, &mut order, 0, max_leaf, &mut nodes).1;
    WideTree { nodes, order, depth }
}

/// Splits at the median of the widest axis, so that the depth is logarithmic whatever the boxes are. `run` begins at
/// `first` in the order of all. Returns node and depth.
fn halve(boxes: &[Aabb], run: &mut [u32], first: usize, max_leaf: usize, nodes: &mut Vec<WideNode>) -> (u32, usize) {
    let index = nodes.len();
    nodes.push(WideNode::EMPTY);
    let mut runs = vec![(first, run)];
    while runs.len() < 8 {
        let Some(longest) = (0..runs.len()).max_by_key(|&i| runs[i].1.len()) else { break };
        if runs[longest].1.len() <= max_leaf {
            break;
        }
        let (first, run) = runs.swap_remove(longest);
        let centers = union(boxes, run);
        let size = centers.max - centers.min;
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
        run.sort_unstable_by(|&a, &b| {
            let key = |i: u32| 0.5 * boxes[i as usize].min[axis] + 0.5 * boxes[i as usize].max[axis];
            key(a).total_cmp(&key(b)).then(a.cmp(&b))
        });
        let middle = run.len() / 2;
        let (left, right) = run.split_at_mut(middle);
        runs.extend([(first, left), (first + middle, right)]);
    }
    let mut depth = 1;
    let mut children = Vec::with_capacity(8);
    for (first, run) in runs {
        let aabb = union(boxes, run);
        let link = if run.len() <= max_leaf {
            BvhLink::Leaf { first: first as u32, count: run.len() as u32 }
        } else {
            let (node, levels) = halve(boxes, run, first, max_leaf, nodes);
            depth = depth.max(levels + 1);
            BvhLink::Node(node)
        };
        children.push(BvhChild { min: Vec3::from(aabb.min), max: Vec3::from(aabb.max), link });
    }
    nodes[index] = WideNode::new(&children);
    (index as u32, depth)
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
mod tests {
    use super::*;
    use crate::node::MAX_LEAF;
    use proptest::prelude::*;

    /// Every primitive is in exactly one leaf, and inside the box of every slot above it.
    fn check(tree: &WideTree, boxes: &[Aabb], max_leaf: usize) {
        let mut seen = vec![0; boxes.len()];
        let mut depth = 0;
        let mut pending = vec![(0u32, Aabb::LARGEST, 1)];
        while let Some((index, outer, level)) = pending.pop() {
            depth = depth.max(level);
            for BvhChild { min, max, link } in tree.nodes[index as usize].slots() {
                let aabb = Aabb { min: min.into(), max: max.into() };
                assert!(aabb.min.cmpge(outer.min).all() && aabb.max.cmple(outer.max).all());
                match link {
                    BvhLink::Node(child) => pending.push((child, aabb, level + 1)),
                    BvhLink::Leaf { first, count } => {
                        assert!((1..=max_leaf as u32).contains(&count));
                        for &primitive in &tree.order[first as usize..(first + count) as usize] {
                            seen[primitive as usize] += 1;
                            let inner = &boxes[primitive as usize];
                            assert!(inner.min.cmpge(aabb.min).all() && inner.max.cmple(aabb.max).all());
                        }
                    }
                }
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
        assert!(depth == tree.depth && depth <= MAX_DEPTH, "{depth} {}", tree.depth);
    }

    fn cube(center: [f32; 3], half: f32) -> Aabb {
        let center = Vec3A::from_array(center);
        Aabb { min: center - half, max: center + half }
    }

    proptest! {
        #[test]
        fn trees_are_sound(centers in prop::collection::vec(prop::array::uniform3(-10f32..10.0), 1..200), max_leaf in 1usize..9) {
            let boxes: Vec<Aabb> = centers.iter().enumerate().map(|(i, &c)| cube(c, (i % 7) as f32 * 0.1)).collect();
            check(&build(&boxes, max_leaf), &boxes, max_leaf);
            let far: Vec<Aabb> = centers.iter().map(|c| cube(c.map(|x| x * 1e17), 1.0)).collect();
            check(&build(&far, max_leaf), &far, max_leaf);
        }
    }

    #[test]
    fn depth_is_bounded_for_geometric_series() {
        // Boxes that shrink by halves towards a point make binary trees as deep as they are many.
        let boxes: Vec<Aabb> = (0..2000).map(|i| cube([0.98f32.powi(i), 0.0, 0.0], 0.98f32.powi(i) * 1e-3)).collect();
        check(&build(&boxes, MAX_LEAF), &boxes, MAX_LEAF);
        let equal = vec![cube([1.0; 3], 0.5); 5000];
        check(&build(&equal, 1), &equal, 1);
    }

    #[test]
    fn large_trees_are_sound_and_full() {
        // More nodes than one thread takes.
        let boxes: Vec<Aabb> = (0..40_000u32)
            .map(|i| cube([i % 40, i / 40 % 40, i / 1600].map(|x| x as f32), 0.3 + 0.2 * (i % 3) as f32))
            .collect();
        let tree = build(&boxes, MAX_LEAF);
        check(&tree, &boxes, MAX_LEAF);
        let slots: usize = tree.nodes.iter().map(|node| node.slots().count()).sum();
        assert!(slots as f64 / tree.nodes.len() as f64 > 6.0);
    }

    #[test]
    fn nothing_gives_an_empty_tree() {
        assert!(build(&[], 1).nodes.is_empty());
    }
}
