//! Which region a point is in.

use crate::{Pack, Region};

/// The region of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionHit {
    /// Its index.
    pub region: u32,
    /// How far the point is from its box, metres; 0 within.
    pub distance_m: f32,
}

impl Pack<'_> {
    /// The region of a point, metres relative to the level's origin; none if there are no regions or the point is not
    /// finite.
    ///
    /// Boxes may overlap: the smallest that contains the point wins, the first of equal ones. If none does, the nearest.
    ///
    /// With a hint, the region that the object was in before, it is looked for from there: among the hint and its
    /// neighbours, from the smallest of these that contains the point among its neighbours, and so on; only if none of
    /// the first contains it among all. The cost then does not depend on the number of regions, and the result is the same
    /// as without where regions that overlap are neighbours, as they are in what Kiln bakes.
    pub fn region_at(&self, point: [f32; 3], hint: Option<u32>) -> Option<RegionHit> {
        if !point.iter().all(|x| x.is_finite()) {
            return None;
        }
        let near = hint.and_then(|hint| self.descend(point, hint));
        match near.or_else(|| self.smallest(point, 0..self.region_count())) {
            Some(region) => Some(RegionHit { region, distance_m: 0.0 }),
            None => self.nearest(point),
        }
    }

    /// From a region to ever smaller neighbours that contain the point.
    fn descend(&self, point: [f32; 3], start: u32) -> Option<u32> {
        let mut current = None;
        let mut next = start;
        // Each step is to a smaller box, or to an equal one before it, so this ends.
        while current != Some(next) {
            current = Some(next);
            let region = self.region(next)?;
            next = self.smallest(point, core::iter::once(next).chain(self.neighbours(&region)))?;
        }
        current
    }

    fn smallest(&self, point: [f32; 3], among: impl Iterator<Item = u32>) -> Option<u32> {
        let mut best: Option<(u32, f32)> = None;
        for (index, region) in among.filter_map(|index| Some((index, self.region(index)?))) {
            let is_better = |(other, volume)| region.volume() < volume || (region.volume() == volume && index < other);
            if region.contains(point) && best.is_none_or(is_better) {
                best = Some((index, region.volume()));
            }
        }
        best.map(|(index, _)| index)
    }

    fn nearest(&self, point: [f32; 3]) -> Option<RegionHit> {
        let mut best: Option<RegionHit> = None;
        for (index, region) in (0..self.region_count()).filter_map(|index| Some((index, self.region(index)?))) {
            let distance_m = distance(&region, point);
            if best.is_none_or(|best| distance_m < best.distance_m) {
                best = Some(RegionHit { region: index, distance_m });
            }
        }
        best
    }
}

fn distance(region: &Region, point: [f32; 3]) -> f32 {
    let clamped = region.clamp(point);
    let [x, y, z] = core::array::from_fn(|i| f64::from(point[i]) - f64::from(clamped[i]));
    // f64, in which squares of floats do not overflow.
    libm::sqrt(x * x + y * y + z * z) as f32
}
