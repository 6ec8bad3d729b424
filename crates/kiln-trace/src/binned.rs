//! Binary trees by the surface area heuristic over bins, and what they cost as wide ones.
//!
//! Source: Wald 2007, "On fast construction of SAH-based bounding volume hierarchies". Deviations: bins on all axes; sets that
//! one leaf can hold are not split; and a side of n leaves' worth of primitives is expected to cost n to the power of 5/8,
//! not n, since wide nodes make trees flat.
//!
//! Work is divided by the number of primitives alone, so that the tree does not depend on the number of threads.

use crate::{
    boxed::Boxed,
    collapse::{Costs, Inner, leaf, merge},
};
use glam::Vec4;
use rayon::prelude::*;
use std::ops::Range;

/// Bins on each axis for many primitives.
const BINS: usize = 16;

/// Bins on each axis for up to [`FEW`] primitives.
const FEW_BINS: usize = 8;
const FEW: usize = 32;

/// From so many primitives on two are binned at a time, apart: neighbours are often in the same bin, and would wait for each other.
const INTERLEAVED: usize = 512;

/// More primitives than this are two tasks.
const TASK: usize = 1 << 13;

/// Primitives of a piece when many are binned or parted side by side.
const PIECE: usize = 1 << 15;

/// Of more primitives than this, pieces are worth it.
const MANY: usize = 4 * PIECE;

/// From this on numbers have no fraction: adding it rounds, and leaves a small whole number in the lowest bits.
const WHOLE: f32 = 8_388_608.0;

/// Centers that are nearer to each other than this are not told apart.
const LEAST_SIZE: f32 = 1e-30;

/// Of fewer leaves costs are kept.
const KEPT_WEIGHTS: usize = 256;

/// Builds the inner nodes of a binary tree in preorder, whose leaves are runs of at most `max_leaf` primitives, and
/// brings the primitives into the order of the leaves.
pub(crate) fn grow(primitives: &mut [Boxed], hull: Boxed, max_leaf: usize) -> Vec<Inner> {
    let mut kept_weights = [0.0; KEPT_WEIGHTS];
    kept_weights.iter_mut().enumerate().for_each(|(leaves, weight)| *weight = power(leaves as f32));
    // Twice the levels of a balanced tree and some; sets below are halved.
    let levels = 2 * primitives.len().max(1).ilog2() + 16;
    let mut nodes = Vec::new();
    Grower { max_leaf, kept_weights }.subtree(primitives, hull, levels, &mut nodes);
    nodes
}

/// To the power of 5/8. Roots are exact everywhere, other powers are not.
fn power(leaves: f32) -> f32 {
    (leaves * leaves.sqrt().sqrt()).sqrt()
}

/// Two sets: how many primitives are in the first, and their boxes.
struct Split {
    left: usize,
    hulls: [Boxed; 2],
}

struct Grower {
    max_leaf: usize,
    kept_weights: [f32; KEPT_WEIGHTS],
}

impl Grower {
    /// Appends the inner nodes of a subtree. At most so many levels are found by cost. Returns what it costs.
    fn subtree(&self, primitives: &mut [Boxed], hull: Boxed, levels: u32, nodes: &mut Vec<Inner>) -> Costs {
        let count = primitives.len();
        if count <= self.max_leaf {
            return leaf(hull.half_area());
        }
        let at = nodes.len();
        nodes.push(Inner::default());
        let Split { left, hulls: [left_hull, right_hull] } = self.split(primitives, levels);
        let (left_set, right_set) = primitives.split_at_mut(left);
        let levels = levels.saturating_sub(1);
        let (left_costs, right_costs, right);
        if count > TASK {
            let mut right_nodes = Vec::new();
            (left_costs, right_costs) = rayon::join(
                || self.subtree(left_set, left_hull, levels, nodes),
                || self.subtree(right_set, right_hull, levels, &mut right_nodes),
            );
            right = nodes.len() - at;
            nodes.append(&mut right_nodes);
        } else {
            left_costs = self.subtree(left_set, left_hull, levels, nodes);
            right = nodes.len() - at;
            right_costs = self.subtree(right_set, right_hull, levels, nodes);
        }
        let (costs, shares) = merge(hull.half_area(), &left_costs, &right_costs);
        nodes[at] =
            Inner { min: hull.min().into(), max: hull.max().into(), left: left as u32, right: right as u32, shares };
        costs
    }

    /// Splits where it costs least; in halves where costs do not tell, or no longer.
    fn split(&self, primitives: &mut [Boxed], levels: u32) -> Split {
        let found = match primitives.len() {
            _ if levels == 0 => None,
            ..=FEW => self.split_by_bins::<FEW_BINS>(primitives),
            _ => self.split_by_bins::<BINS>(primitives),
        };
        found.unwrap_or_else(|| halve(primitives))
    }

    fn split_by_bins<const N: usize>(&self, primitives: &mut [Boxed]) -> Option<Split> {
        let places = Places::<N>::of(primitives);
        let bins = Bins::of(primitives, &places);
        let (axis, bin) = self.cheapest(&bins, primitives.len())?;
        let left = part(primitives, &places.before(axis, bin));
        let (low, high) = bins.hulls[axis].split_at(bin);
        (0 < left && left < primitives.len()).then(|| Split { left, hulls: [Boxed::around(low), Boxed::around(high)] })
    }

    /// Axis of the cheapest split, and the first bin that is on its right side.
    #[inline(never)]
    fn cheapest<const N: usize>(&self, bins: &Bins<N>, count: usize) -> Option<(usize, usize)> {
        let (mut least, mut cheapest) = (f32::INFINITY, None);
        for axis in 0..3 {
            let (hulls, counts) = (&bins.hulls[axis], &bins.counts[axis]);
            let mut right_costs = [0.0; N];
            let (mut hull, mut right) = (Boxed::EMPTY, 0);
            for bin in (1..N).rev() {
                hull = hull.join(&hulls[bin]);
                right += counts[bin] as usize;
                right_costs[bin] = hull.half_area() * self.weight(right);
            }
            let (mut hull, mut left) = (Boxed::EMPTY, 0);
            for bin in 1..N {
                hull = hull.join(&hulls[bin - 1]);
                left += counts[bin - 1] as usize;
                let cost = hull.half_area() * self.weight(left) + right_costs[bin];
                if cost < least && left > 0 && left < count {
                    (least, cheapest) = (cost, Some((axis, bin)));
                }
            }
        }
        cheapest
    }

    /// What so many primitives are expected to cost, by the area of their box.
    #[inline(always)]
    fn weight(&self, count: usize) -> f32 {
        let leaves = count.div_ceil(self.max_leaf);
        self.kept_weights.get(leaves).copied().unwrap_or_else(|| power(leaves as f32))
    }
}

/// Splits at the median of the longest axis.
fn halve(primitives: &mut [Boxed]) -> Split {
    let axis = Boxed::around_centers(primitives).longest_axis();
    let left = primitives.len() / 2;
    primitives.select_nth_unstable_by(left, |a, b| {
        a.twice_center()[axis].total_cmp(&b.twice_center()[axis]).then(a.index().cmp(&b.index()))
    });
    let (low, high) = primitives.split_at(left);
    Split { left, hulls: [Boxed::around(low), Boxed::around(high)] }
}

/// In which of N bins on each axis the centers of boxes are.
struct Places<const N: usize> {
    origin: Vec4,
    scale: Vec4,
}

impl<const N: usize> Places<N> {
    fn of(primitives: &[Boxed]) -> Self {
        let centers = if primitives.len() <= MANY {
            Boxed::around_centers(primitives)
        } else {
            let pieces: Vec<Boxed> = primitives.par_chunks(PIECE).map(Boxed::around_centers).collect();
            Boxed::around(&pieces)
        };
        let size = centers.max() - centers.min();
        let scale = size.to_array().map(|size| if size > LEAST_SIZE { (N - 1) as f32 / size } else { 0.0 });
        Self { origin: centers.min().extend(0.0), scale: Vec4::new(scale[0], scale[1], scale[2], 0.0) }
    }

    /// The bins on the three axes, as numbers above [`WHOLE`].
    #[inline(always)]
    fn of_one(&self, one: &Boxed) -> Vec4 {
        ((one.twice_center() - self.origin) * self.scale).min(Vec4::splat((N - 1) as f32)) + Vec4::splat(WHOLE)
    }

    /// Whether something is in a bin before the given one.
    fn before(&self, axis: usize, bin: usize) -> impl Fn(&Boxed) -> bool + Sync {
        let mut limits = Vec4::ZERO;
        limits[axis] = WHOLE + bin as f32;
        move |one| self.of_one(one).cmplt(limits).any()
    }
}

/// What is in N bins on each axis.
struct Bins<const N: usize> {
    hulls: [[Boxed; N]; 3],
    counts: [[u32; N]; 3],
}

impl<const N: usize> Bins<N> {
    const EMPTY: Self = Self { hulls: [[Boxed::EMPTY; N]; 3], counts: [[0; N]; 3] };

    fn of(primitives: &[Boxed], places: &Places<N>) -> Self {
        if primitives.len() <= MANY {
            return Self::of_piece(primitives, places);
        }
        let pieces: Vec<Self> = primitives.par_chunks(PIECE).map(|piece| Self::of_piece(piece, places)).collect();
        let mut all = Self::EMPTY;
        pieces.iter().for_each(|piece| all.add(piece));
        all
    }

    #[inline(never)]
    fn of_piece(primitives: &[Boxed], places: &Places<N>) -> Self {
        let mut bins = Self::EMPTY;
        if primitives.len() < INTERLEAVED {
            primitives.iter().for_each(|one| bins.take(one, places));
            return bins;
        }
        let mut others = Self::EMPTY;
        let (low, high) = primitives.split_at(primitives.len() / 2);
        for (one, other) in low.iter().zip(high) {
            bins.take(one, places);
            others.take(other, places);
        }
        high[low.len()..].iter().for_each(|one| bins.take(one, places));
        bins.add(&others);
        bins
    }

    #[inline(always)]
    fn take(&mut self, one: &Boxed, places: &Places<N>) {
        let [x, y, z, _] = places.of_one(one).to_array().map(|place| place.to_bits() as usize % N);
        for (axis, bin) in [x, y, z].into_iter().enumerate() {
            self.hulls[axis][bin] = self.hulls[axis][bin].join(one);
            self.counts[axis][bin] += 1;
        }
    }

    fn add(&mut self, other: &Self) {
        for (axis, bin) in (0..3).flat_map(|axis| (0..N).map(move |bin| (axis, bin))) {
            self.hulls[axis][bin] = self.hulls[axis][bin].join(&other.hulls[axis][bin]);
            self.counts[axis][bin] += other.counts[axis][bin];
        }
    }
}

/// Brings those that are left before the others. Returns how many they are.
fn part(primitives: &mut [Boxed], is_left: &(impl Fn(&Boxed) -> bool + Sync)) -> usize {
    let count = primitives.len();
    if count <= MANY {
        return part_piece(primitives, is_left);
    }
    let lefts: Vec<usize> = primitives.par_chunks_mut(PIECE).map(|piece| part_piece(piece, is_left)).collect();
    let left: usize = lefts.iter().sum();
    // Runs of right ones where left ones belong, and the reverse; as many of either.
    let pieces = || lefts.iter().enumerate().map(|(piece, left)| (piece * PIECE, piece * PIECE + left));
    let rights = pieces().map(|(first, middle)| middle..(first + PIECE).min(left));
    let lefts = pieces().map(|(first, middle)| first.max(left)..middle);
    exchange(primitives, rights, lefts);
    left
}

/// Exchanges what is in ranges, those of each kind in rising order, the first kind before the second. Empty ones may end before
/// they begin.
fn exchange(
    primitives: &mut [Boxed],
    firsts: impl Iterator<Item = Range<usize>>,
    seconds: impl Iterator<Item = Range<usize>>,
) {
    let mut seconds = seconds.filter(|range| !range.is_empty());
    let mut second = 0..0;
    for mut first in firsts {
        while !first.is_empty() {
            if second.is_empty() {
                let Some(next) = seconds.next() else { return };
                second = next;
            }
            let length = first.len().min(second.len());
            let (low, high) = primitives.split_at_mut(second.start);
            low[first.start..first.start + length].swap_with_slice(&mut high[..length]);
            first.start += length;
            second.start += length;
        }
    }
}

/// Without branches, which nothing would foretell.
#[inline(always)]
fn part_piece(primitives: &mut [Boxed], is_left: &impl Fn(&Boxed) -> bool) -> usize {
    let mut left = 0;
    for i in 0..primitives.len() {
        let is_left = is_left(&primitives[i]);
        primitives.swap(i, left);
        left += usize::from(is_left);
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    proptest! {
        /// In pieces as in one.
        #[test]
        fn those_on_the_left_come_first(count in 0usize..5 * PIECE, modulus in 1u32..50, more in 0u32..3, first_half in any::<bool>()) {
            let is_left = |one: &Boxed| if first_half { one.index() as usize <= count / 2 } else { one.index() % modulus <= more };
            let mut boxes: Vec<Boxed> = (0..count as u32).map(|i| Boxed::new(i, Vec3::ZERO, Vec3::ZERO)).collect();
            let expected = boxes.iter().filter(|one| is_left(one)).count();
            let left = part(&mut boxes, &is_left);
            prop_assert_eq!(left, expected);
            prop_assert!(boxes[..left].iter().all(is_left) && !boxes[left..].iter().any(is_left));
            let mut indices: Vec<u32> = boxes.iter().map(Boxed::index).collect();
            indices.sort_unstable();
            prop_assert!(indices.into_iter().eq(0..count as u32));
        }
    }

    #[test]
    fn weights_are_powers() {
        for leaves in [1.0f32, 2.0, 255.0, 256.0, 1e6] {
            assert!((power(leaves) / leaves.powf(0.625) - 1.0).abs() < 1e-5);
        }
    }
}
