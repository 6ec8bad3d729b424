//! Small regions become part of the neighbour whose model predicts their points best.

use super::{
    boundaries::Boundaries,
    error::{RegionError, check_length, check_setting},
    fit::{CenterRule, RegionFit, fit_region},
    points::RegionPoints,
};
use kiln_core::RegionEdge;
use std::collections::BTreeSet;

/// Root mean squares of AO that differ by less are equal.
const SAME_ERROR: f64 = 1e-6;

/// The regions that are left.
#[derive(Clone, Debug)]
pub struct Absorbed {
    /// Their points, with those of what they absorbed.
    pub points: Vec<RegionPoints>,
    /// Which touch, by indices of what is left, the lower first and in order.
    pub edges: Vec<RegionEdge>,
    /// For each region given, the index of what is left of it.
    pub model_of: Vec<u32>,
    /// For each that is left, which of the regions given it is; ascending.
    pub region_of: Vec<u32>,
}

/// Gives regions with fewer valid points or less volume (all boxes together) to a neighbour, smallest first: by number
/// of points, volume and index. That is the neighbour whose model ([`CenterRule::Best`]) has the least error at the
/// points; if several have it, the one with the larger boundary, then the one of lower index. It is fitted to both from
/// then on, and may still be small. Small regions without neighbours stay; regions without points always count as
/// small.
///
/// # Errors
/// If an edge or a limit is not usable, or the regions have different numbers of channels.
pub fn absorb(
    points: Vec<RegionPoints>,
    edges: &[RegionEdge],
    min_points: u32,
    min_volume_m3: f64,
) -> Result<Absorbed, RegionError> {
    check_setting("the least volume of a region", min_volume_m3)?;
    for other in points.iter().skip(1) {
        check_length("channels of a region", other.channels(), points[0].channels())?;
    }
    let boundaries = Boundaries::new(points.len(), edges)?;
    let mut state = State {
        fits: vec![None; points.len()],
        into: vec![None; points.len()],
        points,
        boundaries,
        min_points: (min_points as usize).max(1),
        min_volume_m3,
    };
    state.run();
    Ok(state.finish())
}

/// What orders small regions: points, volume (not negative, so that its bits are in order), index.
type Smallness = (usize, u64, usize);

struct State {
    points: Vec<RegionPoints>,
    /// Found when they are asked for, and forgotten when points change.
    fits: Vec<Option<RegionFit>>,
    boundaries: Boundaries,
    /// Who absorbed a region.
    into: Vec<Option<usize>>,
    min_points: usize,
    min_volume_m3: f64,
}

impl State {
    fn smallness(&self, region: usize) -> Option<Smallness> {
        let (count, volume) = (self.points[region].len(), self.points[region].volume_m3());
        let is_small = count < self.min_points || volume < self.min_volume_m3;
        is_small.then_some((count, volume.to_bits(), region))
    }

    fn run(&mut self) {
        let mut small: BTreeSet<_> = (0..self.points.len()).filter_map(|region| self.smallness(region)).collect();
        while let Some((_, _, region)) = small.pop_first() {
            if let Some(into) = self.best_neighbor(region) {
                self.smallness(into).iter().for_each(|key| _ = small.remove(key));
                self.absorb(region, into);
                small.extend(self.smallness(into));
            }
        }
    }

    fn absorb(&mut self, region: usize, into: usize) {
        let absorbed = self.points[region].clone();
        self.points[into].merge(&absorbed);
        self.boundaries.absorb(region, into);
        (self.into[region], self.fits[region], self.fits[into]) = (Some(into), None, None);
    }

    fn best_neighbor(&mut self, region: usize) -> Option<usize> {
        let neighbors: Vec<_> = self.boundaries.neighbors(region).collect();
        if let [(only, _)] = neighbors[..] {
            return Some(only);
        }
        let errors: Vec<_> = neighbors.iter().map(|(other, _)| self.error_by(region, *other)).collect();
        let least = errors.iter().copied().fold(f64::INFINITY, f64::min);
        let as_good = neighbors.iter().zip(errors).filter(|(_, error)| *error <= least + SAME_ERROR);
        // Of equal areas the first is kept.
        let larger = |(best, area): (usize, f64), (other, other_area): (usize, f64)| {
            if other_area > area { (other, other_area) } else { (best, area) }
        };
        as_good.map(|((other, boundary), _)| (*other, boundary.area_m2)).reduce(larger).map(|(other, _)| other)
    }

    /// The root mean square of the error of a neighbour's model at a region's points.
    fn error_by(&mut self, region: usize, neighbor: usize) -> f64 {
        let fit = self.fits[neighbor].get_or_insert_with(|| fit_region(&self.points[neighbor], CenterRule::Best));
        let points = &self.points[region];
        (points.squared_errors(fit).iter().sum::<f64>() / points.len().max(1) as f64).sqrt()
    }

    fn finish(self) -> Absorbed {
        let region_of: Vec<u32> = (0..).zip(&self.into).filter(|(_, into)| into.is_none()).map(|(r, _)| r).collect();
        let mut index_of = vec![0; self.into.len()];
        for (index, region) in (0..).zip(&region_of) {
            index_of[*region as usize] = index;
        }
        let edges = self.boundaries.edges(|region| index_of[region]);
        let model_of = (0..self.into.len()).map(|region| index_of[last(&self.into, region)]).collect();
        let left = self.points.into_iter().zip(&self.into).filter(|(_, into)| into.is_none());
        Absorbed { points: left.map(|(points, _)| points).collect(), edges, model_of, region_of }
    }
}

/// Who is left of a region.
fn last(into: &[Option<usize>], mut region: usize) -> usize {
    while let Some(next) = into[region] {
        region = next;
    }
    region
}
