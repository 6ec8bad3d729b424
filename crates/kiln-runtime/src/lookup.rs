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
    /// With a hint, the region that the object was in before, it is looked for from there. If the hint's box contains the
    /// point, only smaller boxes that overlap it are looked at; else its neighbours, and only if none of them contains it
    /// all regions. The cost then does not depend on the number of regions, and the result is the same as without where
    /// regions that overlap are neighbours, as they are in what Kiln bakes; but on a face that two regions share, an object
    /// stays in the one that it was in.
    pub fn region_at(&self, point: [f32; 3], hint: Option<u32>) -> Option<RegionHit> {
        if !point.iter().all(|x| x.is_finite()) {
            return None;
        }
        let near = hint.and_then(|hint| self.near(point, hint));
        let found = near.or_else(|| self.smallest(point, 0..self.region_count())).map(|(region, _)| region);
        match found {
            Some(region) => Some(RegionHit { region, distance_m: 0.0 }),
            None => self.nearest(point),
        }
    }

    /// The region of a point by way of another region.
    fn near(&self, point: [f32; 3], hint: u32) -> Option<(u32, Region)> {
        let region = self.region(hint)?;
        let start =
            if region.contains(point) { (hint, region) } else { self.smallest(point, self.neighbours(&region))? };
        Some(
            self.smallest(point, self.inner(&start.1))
                .filter(|inner| inner.1.volume() <= start.1.volume())
                .unwrap_or(start),
        )
    }

    /// The smallest of some regions that contains the point, the first of equal ones.
    #[inline]
    fn smallest(&self, point: [f32; 3], among: impl Iterator<Item = u32>) -> Option<(u32, Region)> {
        let mut best: Option<(u32, Region)> = None;
        for index in among {
            let Some(region) = self.region(index).filter(|region| region.contains(point)) else { continue };
            let rank = |index, region: &Region| (region.volume(), index);
            if best.as_ref().is_none_or(|(other, least)| rank(index, &region) < rank(*other, least)) {
                best = Some((index, region));
            }
        }
        best
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
