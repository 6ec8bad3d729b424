//! Exact nearest neighbours among points: a balanced k-d tree (Bentley 1975, Commun. ACM 18(9)) in an array.
//!
//! The median of a range stands in its middle, so the tree is an order of the points and nothing else. Ties,
//! in building and in queries, go to the lowest index: the answer is a function of the points alone.

use glam::DVec3;
use std::cmp::Ordering;

/// Points ordered for queries.
#[derive(Clone, Debug)]
pub struct KdTree {
    /// The point, and its index in the caller's order.
    nodes: Vec<(DVec3, u32)>,
}

/// A point found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Index in the order in which the tree got its points.
    pub index: u32,
    /// Square of the distance.
    pub distance_squared: f64,
}

impl KdTree {
    /// Orders finite points with the indices that answers will name.
    pub fn new(mut nodes: Vec<(DVec3, u32)>) -> Self {
        build(&mut nodes, 0);
        Self { nodes }
    }

    /// The nearest point, the lowest index among equals; `None` of an empty tree.
    pub fn nearest(&self, query: DVec3) -> Option<Nearest> {
        let mut best = Nearest { index: u32::MAX, distance_squared: f64::INFINITY };
        search(&self.nodes, 0, query, &mut best);
        (best.index != u32::MAX).then_some(best)
    }
}

fn build(nodes: &mut [(DVec3, u32)], axis: usize) {
    if nodes.len() < 2 {
        return;
    }
    let middle = nodes.len() / 2;
    let by_axis = |a: &(DVec3, u32), b: &(DVec3, u32)| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1));
    let (below, _, above) = nodes.select_nth_unstable_by(middle, by_axis);
    let next = (axis + 1) % 3;
    if below.len() > 65_536 {
        rayon::join(|| build(below, next), || build(above, next));
    } else {
        build(below, next);
        build(above, next);
    }
}

fn search(nodes: &[(DVec3, u32)], axis: usize, query: DVec3, best: &mut Nearest) {
    let middle = nodes.len() / 2;
    let Some(&(point, index)) = nodes.get(middle) else { return };
    let found = Nearest { index, distance_squared: point.distance_squared(query) };
    if found.order(best) == Ordering::Less {
        *best = found;
    }
    let offset = query[axis] - point[axis];
    let (below, above) = (&nodes[..middle], &nodes[middle + 1..]);
    let (near, far) = if offset < 0.0 { (below, above) } else { (above, below) };
    let next = (axis + 1) % 3;
    search(near, next, query, best);
    // An equal distance may still hide a lower index on the other side.
    if offset * offset <= best.distance_squared {
        search(far, next, query, best);
    }
}

impl Nearest {
    fn order(&self, other: &Self) -> Ordering {
        self.distance_squared.total_cmp(&other.distance_squared).then(self.index.cmp(&other.index))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn coordinate() -> impl Strategy<Value = f64> {
        // A coarse grid, so that equal distances are common.
        (-3i32..4).prop_map(f64::from)
    }

    proptest! {
        #[test]
        fn agrees_with_trying_all(
            points in prop::collection::vec([coordinate(), coordinate(), coordinate()], 1..60),
            query in [coordinate(), coordinate(), coordinate()],
        ) {
            let query = DVec3::from(query) * 0.5;
            let nodes: Vec<_> = points.iter().enumerate().map(|(i, p)| (DVec3::from(*p), i as u32)).collect();
            let expected = nodes
                .iter()
                .map(|(p, index)| Nearest { index: *index, distance_squared: p.distance_squared(query) })
                .min_by(Nearest::order);
            prop_assert_eq!(KdTree::new(nodes).nearest(query), expected);
        }
    }

    #[test]
    fn empty_has_none() {
        assert_eq!(KdTree::new(Vec::new()).nearest(DVec3::ZERO), None);
    }

    #[test]
    fn many_equal_points_are_found_fast() {
        let tree = KdTree::new((0..10_000).map(|i| (DVec3::ONE, i)).collect());
        assert_eq!(tree.nearest(DVec3::ZERO).unwrap().index, 0);
    }
}
