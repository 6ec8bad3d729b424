//! Builds eight-wide trees.
//!
//! [`crate::binned`] builds a binary tree, which [`crate::collapse`] merges. Trees deeper than the traversal's stack, which
//! only contrived input gives, are built again by halving the sorted primitives.

use crate::{
    binned::grow,
    boxed::Boxed,
    collapse::{WideTree, collapse},
    node::{BvhChild, BvhLink, MAX_DEPTH, WideNode},
};

/// Coordinates beyond this could overflow the builder's areas.
const MAX_EXTENT: f32 = 1e15;

/// Where primitives are only halved: nothing says that those of a leaf are near each other.
const MAX_HALVED_LEAF: usize = 4;

/// Builds a tree whose leaves hold at most `max_leaf` primitives, 1 to 8.
pub(crate) fn build(mut boxes: Vec<Boxed>, max_leaf: usize) -> WideTree {
    if boxes.is_empty() {
        return WideTree::default();
    }
    let hull = Boxed::around(&boxes);
    if hull.extent() < MAX_EXTENT {
        let nodes = grow(&mut boxes, hull, max_leaf);
        let tree = collapse(&nodes, &boxes, max_leaf);
        if tree.depth <= MAX_DEPTH {
            return tree;
        }
    }
    let mut nodes = Vec::new();
    let depth = halve(&mut boxes, 0, max_leaf.min(MAX_HALVED_LEAF), &mut nodes).1;
    WideTree { nodes, order: boxes.iter().map(Boxed::index).collect(), depth }
}

/// Splits at the median of the widest axis, so that the depth is logarithmic whatever the boxes are. `run` begins at
/// `first` in the order of all. Returns node and depth.
fn halve(run: &mut [Boxed], first: usize, max_leaf: usize, nodes: &mut Vec<WideNode>) -> (u32, usize) {
    let index = nodes.len();
    nodes.push(WideNode::EMPTY);
    let mut runs = vec![(first, run)];
    while runs.len() < 8 {
        let Some(longest) = (0..runs.len()).max_by_key(|&i| runs[i].1.len()) else { break };
        if runs[longest].1.len() <= max_leaf {
            break;
        }
        let (first, run) = runs.swap_remove(longest);
        let axis = Boxed::around(run).longest_axis();
        run.sort_unstable_by(|a, b| {
            let key = |one: &Boxed| 0.5 * one.min()[axis] + 0.5 * one.max()[axis];
            key(a).total_cmp(&key(b)).then(a.index().cmp(&b.index()))
        });
        let middle = run.len() / 2;
        let (left, right) = run.split_at_mut(middle);
        runs.extend([(first, left), (first + middle, right)]);
    }
    let mut depth = 1;
    let mut children = Vec::with_capacity(8);
    for (first, run) in runs {
        let hull = Boxed::around(run);
        let link = if run.len() <= max_leaf {
            BvhLink::Leaf { first: first as u32, count: run.len() as u32 }
        } else {
            let (node, levels) = halve(run, first, max_leaf, nodes);
            depth = depth.max(levels + 1);
            BvhLink::Node(node)
        };
        children.push(BvhChild { min: hull.min(), max: hull.max(), link });
    }
    nodes[index] = WideNode::new(&children);
    (index as u32, depth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::MAX_LEAF;
    use glam::Vec3;
    use proptest::prelude::*;

    /// Every primitive is in exactly one leaf, and inside the box of every slot above it.
    fn check(tree: &WideTree, boxes: &[Boxed], max_leaf: usize) {
        let holds = |min: Vec3, max: Vec3, inner: [Vec3; 2]| inner[0].cmpge(min).all() && inner[1].cmple(max).all();
        let mut seen = vec![0; boxes.len()];
        let mut depth = 0;
        let mut pending = vec![(0u32, [Vec3::MIN, Vec3::MAX], 1)];
        while let Some((index, outer, level)) = pending.pop() {
            depth = depth.max(level);
            for BvhChild { min, max, link } in tree.nodes[index as usize].slots() {
                assert!(holds(outer[0], outer[1], [min, max]));
                match link {
                    BvhLink::Node(child) => pending.push((child, [min, max], level + 1)),
                    BvhLink::Leaf { first, count } => {
                        assert!((1..=max_leaf as u32).contains(&count));
                        for &primitive in &tree.order[first as usize..(first + count) as usize] {
                            seen[primitive as usize] += 1;
                            let inner = &boxes[primitive as usize];
                            assert!(holds(min, max, [inner.min(), inner.max()]));
                        }
                    }
                }
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
        assert!(depth == tree.depth && depth <= MAX_DEPTH, "{depth} {}", tree.depth);
    }

    fn check_built(boxes: &[Boxed], max_leaf: usize) -> WideTree {
        let tree = build(boxes.to_vec(), max_leaf);
        check(&tree, boxes, max_leaf);
        tree
    }

    /// Cubes by center and half their size.
    fn cubes(all: impl Iterator<Item = ([f32; 3], f32)>) -> Vec<Boxed> {
        let cube = |(index, (center, half)): (usize, ([f32; 3], f32))| {
            let center = Vec3::from_array(center);
            Boxed::new(index as u32, center - half, center + half)
        };
        all.enumerate().map(cube).collect()
    }

    fn random(state: &mut u32) -> f32 {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (*state >> 8) as f32 / 16_777_216.0
    }

    /// Clusters of different density, of many small cubes and few large ones.
    fn soup(count: usize) -> Vec<Boxed> {
        let mut state = 1;
        let clusters: [[f32; 4]; 16] = [(); 16].map(|()| [(); 4].map(|()| random(&mut state)));
        cubes((0..count).map(|i| {
            let [x, y, z, size] = clusters[i % 16];
            let center = [x, y, z].map(|c| 10.0 * c + 8.0 * size * size * (random(&mut state) - 0.5));
            (center, 0.5 * random(&mut state).powi(6))
        }))
    }

    /// Expected visits of nodes and leaves by rays that meet the root.
    fn cost(nodes: &[WideNode]) -> f32 {
        let area = |child: &BvhChild| Boxed::new(0, child.min, child.max).half_area();
        let root = nodes[0].slots().fold(Boxed::EMPTY, |all, child| all.join(&Boxed::new(0, child.min, child.max)));
        1.0 + nodes.iter().flat_map(WideNode::slots).map(|child| area(&child)).sum::<f32>() / root.half_area()
    }

    proptest! {
        #[test]
        fn trees_are_sound(centers in prop::collection::vec(prop::array::uniform3(-10f32..10.0), 1..200), max_leaf in 1usize..9) {
            check_built(&cubes(centers.iter().enumerate().map(|(i, c)| (*c, (i % 7) as f32 * 0.1))), max_leaf);
            check_built(&cubes(centers.iter().map(|c| (c.map(|x| x * 1e17), 1.0))), max_leaf);
        }

        /// On few points, lines and planes, of sizes whose areas are 0, or nearly infinite.
        #[test]
        fn degenerate_trees_are_sound(
            centers in prop::collection::vec(prop::array::uniform3(0u8..3), 1..300),
            scale in prop::sample::select(vec![0.0f32, 1e-42, 1e-30, 1e-20, 1.0, 1e14, 1e30, 1e38]),
            half in prop::sample::select(vec![0.0f32, 0.5]),
            axes in prop::array::uniform3(0u8..2),
            max_leaf in 1usize..9,
        ) {
            let center = |c: &[u8; 3]| [0, 1, 2].map(|axis| f32::from(c[axis] * axes[axis]) * scale);
            check_built(&cubes(centers.iter().map(|c| (center(c), half * scale))), max_leaf);
        }
    }

    #[test]
    fn depth_is_bounded_for_geometric_series() {
        // Boxes that shrink by halves towards a point make binary trees as deep as they are many.
        let size = |i: i32| 0.98f32.powi(i);
        check_built(&cubes((0..2000).map(|i| ([size(i), 0.0, 0.0], size(i) * 1e-3))), MAX_LEAF);
        check_built(&cubes((0..120).map(|i| ([0.5f32.powi(i); 3], 0.0))), 1);
        check_built(&cubes((0..5000).map(|_| ([1.0; 3], 0.5))), 1);
        check_built(&cubes((0..300_000).map(|i| ([size(i % 5000), 0.0, 0.0], 0.0))), MAX_LEAF);
    }

    #[test]
    fn large_trees_are_sound_and_full() {
        // More nodes than one thread takes.
        let center = |i: u32| [i % 40, i / 40 % 40, i / 1600].map(|x| x as f32);
        let tree = check_built(&cubes((0..40_000).map(|i| (center(i), 0.3 + 0.2 * (i % 3) as f32))), MAX_LEAF);
        let slots: usize = tree.nodes.iter().map(|node| node.slots().count()).sum();
        assert!(slots as f64 / tree.nodes.len() as f64 > 6.0);
    }

    #[test]
    fn the_tree_does_not_depend_on_the_threads() {
        // Enough to be binned and parted in pieces.
        let boxes = soup(300_000);
        let built = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| build(boxes.clone(), MAX_LEAF))
        };
        let one = built(1);
        check(&one, &boxes, MAX_LEAF);
        for threads in [2, 3, 8] {
            let many = built(threads);
            assert!(bytemuck::cast_slice::<_, u32>(&many.nodes) == bytemuck::cast_slice::<_, u32>(&one.nodes));
            assert!(many.order == one.order && many.depth == one.depth);
        }
    }

    #[test]
    fn trees_cost_less_than_halved_ones() {
        let boxes = soup(20_000);
        let mut halved = Vec::new();
        halve(&mut boxes.clone(), 0, MAX_LEAF, &mut halved);
        let (built, halved) = (cost(&build(boxes, MAX_LEAF).nodes), cost(&halved));
        assert!(built < 0.8 * halved, "{built} {halved}");
    }

    #[test]
    fn nothing_gives_an_empty_tree() {
        assert!(build(Vec::new(), 1).nodes.is_empty());
    }
}
