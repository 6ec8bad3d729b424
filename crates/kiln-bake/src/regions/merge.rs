//! Boxes that are one room, put together: cuts go through all of a box, and so through rooms that they are not meant for.

use super::{
    cut::{Demands, LEAST_PART, defect},
    links::{Link, links},
    profile::{Profile, Span},
    voxels::Voxels,
};
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

/// Boxes with fewer free cells are small: less is demanded where they are added to others.
const SMALL: usize = 3 * LEAST_PART;

struct Merger<'v> {
    voxels: &'v Voxels,
    edge: usize,
    /// Boxes and their free cells; those that were put together are gone.
    boxes: Vec<Option<(Span, usize)>>,
    neighbours: Vec<BTreeMap<u32, Link>>,
    /// Pairs that may be put together, the most open first.
    pairs: BinaryHeap<(u64, [u32; 2])>,
}

/// Puts boxes together as long as the box around two of them is as a box should be and meets no third; in the order of their
/// least corners.
pub(super) fn merge(voxels: &Voxels, boxes: Vec<Span>, edge: usize) -> Vec<Span> {
    let links = links(voxels, &boxes);
    let mut neighbours = vec![BTreeMap::new(); boxes.len()];
    for ([a, b], link) in &links {
        neighbours[*a as usize].insert(*b, *link);
        neighbours[*b as usize].insert(*a, *link);
    }
    let counted = |span: Span| Some((span, voxels.free_in(&span).count()));
    let boxes = boxes.into_iter().map(counted).collect();
    let mut merger = Merger { voxels, edge, boxes, neighbours, pairs: BinaryHeap::new() };
    for ([a, b], link) in links {
        merger.consider([a, b], &link);
    }
    while let Some((_, pair)) = merger.pairs.pop() {
        merger.put_together(pair);
    }
    let mut boxes: Vec<Span> = merger.boxes.into_iter().flatten().map(|(span, _)| span).collect();
    boxes.sort_unstable();
    boxes
}

impl Merger<'_> {
    /// Lists a pair, if it can be put together.
    fn consider(&mut self, pair: [u32; 2], link: &Link) {
        let [Some((a, count_a)), Some((b, count_b))] = pair.map(|index| self.boxes[index as usize]) else { return };
        let both = a.around(&b);
        let is_small = count_a.min(count_b) < SMALL;
        let demands = if is_small { Demands::lax(self.edge) } else { Demands::usual(self.edge) };
        let is_long = (0..3).any(|axis| both.extent(axis) > self.edge);
        let fill = (count_a + count_b) as f64 / both.volume() as f64;
        if is_long || fill < demands.fill(&both) || self.meets_others(pair, &both) {
            return;
        }
        if defect(self.voxels, &Profile::of(self.voxels, both), &demands) > 0.0 {
            return;
        }
        let openness = link.faces as f64 / libm::pow(count_a.min(count_b) as f64, 2.0 / 3.0);
        self.pairs.push((openness.to_bits(), pair));
    }

    fn meets_others(&self, pair: [u32; 2], both: &Span) -> bool {
        let others = (0u32..).zip(&self.boxes).filter(|(index, _)| !pair.contains(index));
        others.filter_map(|(_, other)| other.as_ref()).any(|(other, _)| other.overlaps(both))
    }

    fn put_together(&mut self, pair: [u32; 2]) {
        let [a, b] = pair.map(|index| index as usize);
        let (Some((span_a, count_a)), Some((span_b, count_b))) = (self.boxes[a], self.boxes[b]) else { return };
        let both = span_a.around(&span_b);
        // Boxes have grown since the pair was listed.
        if self.meets_others(pair, &both) {
            return;
        }
        let new = self.boxes.len() as u32;
        (self.boxes[a], self.boxes[b]) = (None, None);
        self.boxes.push(Some((both, count_a + count_b)));
        let mut around: BTreeMap<u32, Link> = BTreeMap::new();
        for old in [a, b] {
            for (neighbour, link) in std::mem::take(&mut self.neighbours[old]) {
                if !pair.contains(&neighbour) {
                    around.entry(neighbour).or_default().add(&link);
                    self.neighbours[neighbour as usize].remove(&(old as u32));
                }
            }
        }
        self.neighbours.push(around.clone());
        let near: BTreeSet<u32> = around.keys().copied().collect();
        for neighbour in near {
            let link = around[&neighbour];
            self.neighbours[neighbour as usize].insert(new, link);
            self.consider([neighbour, new], &link);
        }
    }
}
