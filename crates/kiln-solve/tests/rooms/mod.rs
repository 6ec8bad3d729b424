//! Regions with known visibility, for the tests of their models.

use glam::DVec3;
use kiln_core::{
    Bounds, CANDIDATES, CandidateBits, REGION_HARMONICS, Region, RegionEdge, RegionSamples, RegionSettings, Regions,
};
use kiln_solve::region::{OPEN_SKY, RegionPoints};

/// Noise in [0, 1) by splitmix64.
pub(crate) fn noise(i: u64) -> f64 {
    let mut z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

pub(crate) fn region(min: [f64; 3], max: [f64; 3]) -> Region {
    Region { id: String::new(), bounds: Bounds { min: DVec3::from(min), max: DVec3::from(max) }, valid: None }
}

/// An unremarkable box.
pub(crate) fn hall() -> Region {
    region([-3.0, 2.0, 10.0], [9.0, 5.0, 14.0])
}

/// The candidates that satisfy a condition.
pub(crate) fn bits(is_valid: impl Fn(usize) -> bool) -> CandidateBits {
    let mut bits = CandidateBits::default();
    (0..CANDIDATES).filter(|index| is_valid(*index)).for_each(|index| bits.insert(index));
    bits
}

/// Values at the valid points from a function of the point and of the harmonic of all channels.
pub(crate) fn values(
    region: &Region,
    valid: &CandidateBits,
    channels: usize,
    f: impl Fn(DVec3, usize) -> f64,
) -> Vec<f32> {
    let at = |index: usize| (0..channels * REGION_HARMONICS).map(|k| f(region.candidate(index), k) as f32).collect();
    valid.iter().flat_map(|index| -> Vec<f32> { at(index) }).collect()
}

pub(crate) fn points(
    region: &Region,
    valid: &CandidateBits,
    channels: usize,
    f: impl Fn(DVec3, usize) -> f64,
) -> RegionPoints {
    let values = values(region, valid, channels, f);
    RegionPoints::new(region, valid, &values, channels).expect("points of the region")
}

/// A constant AO for all normals.
pub(crate) fn flat(ao: f64) -> impl Fn(DVec3, usize) -> f64 {
    move |_, k| if k.is_multiple_of(REGION_HARMONICS) { ao * OPEN_SKY } else { 0.0 }
}

/// A model of seven parameters for each of 18 harmonics, slopes per metre.
pub(crate) struct Known {
    pub(crate) center: DVec3,
    pub(crate) parameters: Vec<[f64; 7]>,
}

impl Known {
    /// Slopes change AO by some tenths over the box.
    pub(crate) fn new(region: &Region, center: DVec3, seed: u64) -> Self {
        let half = 0.5 * (region.bounds.max - region.bounds.min);
        let number = |k: u64, i: u64| noise(1000 * seed + 7 * k + i) - 0.5;
        let parameters = |k: u64| {
            std::array::from_fn(|i| match i {
                0 if k.is_multiple_of(9) => 0.6 * OPEN_SKY,
                0 => 0.1 * number(k, 0),
                _ => 0.2 * number(k, i as u64) / half[(i - 1) / 2],
            })
        };
        Self { center, parameters: (0..18).map(parameters).collect() }
    }

    pub(crate) fn at(&self, point: DVec3, k: usize) -> f64 {
        let offset = point - self.center;
        let along = |axis: usize| offset[axis] * self.parameters[k][1 + 2 * axis + usize::from(offset[axis] < 0.0)];
        self.parameters[k][0] + (0..3).map(along).sum::<f64>()
    }
}

/// Rooms of 4 m in a row along x, each touching the next, with seeded models of their own.
pub(crate) fn row(count: u32, smoothing: f64) -> Regions {
    let room = |i: u32| region([4.0 * f64::from(i), 0.0, 0.0], [4.0 * f64::from(i + 1), 4.0, 3.0]);
    let edge = |i: u32| RegionEdge {
        regions: [i, i + 1],
        area_m2: 3.0 + f64::from(i % 4),
        center: DVec3::new(4.0 * f64::from(i + 1), 2.0, 1.0 + 0.25 * f64::from(i % 3)),
    };
    Regions {
        regions: (0..count).map(room).collect(),
        edges: (1..count).map(|i| edge(i - 1)).collect(),
        settings: RegionSettings { smoothing, ..RegionSettings::default() },
    }
}

/// Samples of all regions where `f` gives the value of a region's point.
pub(crate) fn samples(
    regions: &Regions,
    valid: Vec<CandidateBits>,
    channels: usize,
    f: impl Fn(usize, DVec3, usize) -> f64,
) -> RegionSamples {
    let each = regions.regions.iter().zip(&valid).enumerate();
    let values = each.flat_map(|(r, (region, valid))| values(region, valid, channels, |p, k| f(r, p, k))).collect();
    let dropped = vec![1; valid.len()];
    RegionSamples { channels: channels as u32, values, dropped, rays: 1024, valid }
}

/// A field that is no model of any region: uneven, and of jumps between regions.
pub(crate) fn uneven(region: usize, point: DVec3, k: usize) -> f64 {
    let level = if k.is_multiple_of(REGION_HARMONICS) { 0.5 * OPEN_SKY } else { 0.0 };
    let seed = (region * 31 + k) as u64;
    let slope = DVec3::new(noise(seed), noise(seed + 1), noise(seed + 2)) - 0.5;
    level + 0.2 * (noise(seed + 3) - 0.5) + 0.1 * slope.dot(point).sin() + 0.05 * (point.x * point.y).cos()
}
