//! Which regions touch, as regions disappear.

use super::error::RegionError;
use glam::DVec3;
use kiln_core::RegionEdge;
use std::collections::BTreeMap;

/// Where two regions touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Boundary {
    pub(crate) area_m2: f64,
    /// Metres.
    pub(crate) center: DVec3,
}

impl Boundary {
    /// Both as one: areas add up, the centre is their centre of mass.
    fn with(self, other: Self) -> Self {
        let area_m2 = self.area_m2 + other.area_m2;
        Self { area_m2, center: self.center + (other.center - self.center) * (other.area_m2 / area_m2) }
    }
}

/// The neighbours of each region, by index, with their boundary.
#[derive(Clone, Debug)]
pub(crate) struct Boundaries {
    of: Vec<BTreeMap<usize, Boundary>>,
}

impl Boundaries {
    /// Takes edges in any order; several of one pair become one.
    pub(crate) fn new(regions: usize, edges: &[RegionEdge]) -> Result<Self, RegionError> {
        edges.iter().enumerate().try_for_each(|(index, edge)| check(index, edge, regions))?;
        let mut ordered: Vec<_> = edges.iter().map(|edge| (pair(edge), edge)).collect();
        // Several of one pair are added in an order of their own.
        ordered.sort_by(|(a, one), (b, other)| {
            let numbers = |edge: &RegionEdge| [edge.area_m2, edge.center.x, edge.center.y, edge.center.z];
            let by_numbers = || numbers(one).into_iter().zip(numbers(other)).map(|(x, y)| x.total_cmp(&y));
            a.cmp(b).then_with(|| by_numbers().find(|order| order.is_ne()).unwrap_or(std::cmp::Ordering::Equal))
        });
        let mut boundaries = Self { of: vec![BTreeMap::new(); regions] };
        for ([a, b], edge) in ordered {
            boundaries.add(a, b, Boundary { area_m2: edge.area_m2, center: edge.center });
        }
        Ok(boundaries)
    }

    fn add(&mut self, a: usize, b: usize, boundary: Boundary) {
        for (from, to) in [(a, b), (b, a)] {
            self.of[from].entry(to).and_modify(|known| *known = known.with(boundary)).or_insert(boundary);
        }
    }

    /// A region's neighbours, ascending.
    pub(crate) fn neighbors(&self, region: usize) -> impl Iterator<Item = (usize, Boundary)> + '_ {
        self.of[region].iter().map(|(other, boundary)| (*other, *boundary))
    }

    /// Makes a region part of a neighbour, which gets its boundaries with others.
    pub(crate) fn absorb(&mut self, region: usize, into: usize) {
        for (other, boundary) in std::mem::take(&mut self.of[region]) {
            self.of[other].remove(&region);
            if other != into {
                self.add(into, other, boundary);
            }
        }
    }

    /// The edges by new indices of the regions that are left, the lower first; in order if the new indices ascend.
    pub(crate) fn edges(&self, index_of: impl Fn(usize) -> u32) -> Vec<RegionEdge> {
        let of_region = |region: usize| {
            let above = self.of[region].range(region + 1..);
            let edge = |other: usize, boundary: &Boundary| RegionEdge {
                regions: [index_of(region), index_of(other)],
                area_m2: boundary.area_m2,
                center: boundary.center,
            };
            above.map(|(other, boundary)| edge(*other, boundary)).collect::<Vec<_>>()
        };
        (0..self.of.len()).flat_map(of_region).collect()
    }

    /// The regions by colours, so that those of one colour do not touch: each has the first that no neighbour of lower
    /// index has.
    pub(crate) fn colors(&self) -> Vec<Vec<usize>> {
        let mut color_of: Vec<usize> = Vec::with_capacity(self.of.len());
        let mut colors: Vec<Vec<usize>> = Vec::new();
        for (region, neighbors) in self.of.iter().enumerate() {
            let taken: Vec<usize> = neighbors.range(..region).map(|(other, _)| color_of[*other]).collect();
            let color = (0..).find(|color| !taken.contains(color)).unwrap_or(taken.len());
            color_of.push(color);
            match colors.get_mut(color) {
                Some(regions) => regions.push(region),
                None => colors.push(vec![region]),
            }
        }
        colors
    }
}

/// The regions of an edge, the lower first.
fn pair(edge: &RegionEdge) -> [usize; 2] {
    let [a, b] = edge.regions.map(|region| region as usize);
    [a.min(b), a.max(b)]
}

fn check(index: usize, edge: &RegionEdge, regions: usize) -> Result<(), RegionError> {
    let fault = |what| Err(RegionError::Edge { edge: index, what });
    let [a, b] = pair(edge);
    if b >= regions {
        return fault("a region that is not there");
    }
    if a == b {
        return fault("one region at both ends");
    }
    if !(edge.area_m2 > 0.0 && edge.area_m2.is_finite()) {
        return fault("an area that is not positive");
    }
    if edge.center.is_finite() { Ok(()) } else { fault("a centre that is not finite") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(a: u32, b: u32, area_m2: f64) -> RegionEdge {
        RegionEdge { regions: [a, b], area_m2, center: DVec3::splat(area_m2) }
    }

    fn new(regions: usize, edges: &[RegionEdge]) -> Boundaries {
        Boundaries::new(regions, edges).unwrap()
    }

    #[test]
    fn several_of_one_pair_are_one() {
        let all = new(2, &[edge(1, 0, 3.0), edge(0, 1, 1.0)]).edges(|region| region as u32);
        assert_eq!(all, [RegionEdge { regions: [0, 1], area_m2: 4.0, center: DVec3::splat(2.5) }]);
    }

    #[test]
    fn an_absorbed_region_leaves_its_boundaries() {
        // 1 becomes a part of 0: 0-1 is gone, 1-2 joins 0-2, 1-3 is 0-3.
        let mut all = new(4, &[edge(0, 1, 1.0), edge(0, 2, 1.0), edge(1, 2, 3.0), edge(1, 3, 2.0)]);
        all.absorb(1, 0);
        let left = all.edges(|region| region as u32);
        let expected = RegionEdge { regions: [0, 2], area_m2: 4.0, center: DVec3::splat(2.5) };
        assert_eq!(left, [expected, edge(0, 3, 2.0)]);
        assert_eq!(all.neighbors(1).count(), 0);
    }

    #[test]
    fn regions_of_one_colour_do_not_touch() {
        let edges = [edge(0, 1, 1.0), edge(1, 2, 1.0), edge(0, 2, 1.0), edge(2, 3, 1.0)];
        assert_eq!(new(5, &edges).colors(), [vec![0, 3, 4], vec![1], vec![2]]);
    }

    #[test]
    fn edges_that_cannot_be_are_refused() {
        let not_finite = RegionEdge { center: DVec3::NAN, ..edge(0, 1, 1.0) };
        for wrong in [edge(0, 2, 1.0), edge(1, 1, 1.0), edge(0, 1, 0.0), edge(0, 1, f64::NAN), not_finite] {
            let found = Boundaries::new(2, &[edge(0, 1, 1.0), wrong]);
            assert!(matches!(found, Err(RegionError::Edge { edge: 1, .. })), "{found:?}");
        }
    }
}
