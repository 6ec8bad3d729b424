//! Visibility regions of a level, and the models of visibility in them (Sloan et al. 2013, section 2.3).

use crate::{Bounds, ResultError, work::check_size};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Candidate points of a region along each axis.
pub const CANDIDATES_PER_AXIS: usize = 8;

/// Candidate points of a region.
pub const CANDIDATES: usize = CANDIDATES_PER_AXIS.pow(3);

/// Coefficients of the quadratic spherical harmonics of one channel.
pub const REGION_HARMONICS: usize = 9;

/// Parameters of a model for each coefficient: the value at the centre, and slopes to +x, −x, +y, −y, +z and −z.
pub const REGION_PARAMETERS: usize = 7;

/// One bit for each candidate point of a region: bit `x + 8y + 64z`, least significant first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CandidateBits(pub [u64; 8]);

impl CandidateBits {
    /// All of them.
    pub const ALL: Self = Self([u64::MAX; 8]);

    /// Whether a candidate's bit is set.
    pub const fn contains(&self, index: usize) -> bool {
        self.0[index / 64] >> (index % 64) & 1 == 1
    }

    /// Sets a candidate's bit.
    pub const fn insert(&mut self, index: usize) {
        self.0[index / 64] |= 1 << (index % 64);
    }

    /// Candidates whose bits are set, ascending.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        (0..CANDIDATES).filter(|index| self.contains(*index))
    }

    /// How many are set.
    pub fn count(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }
}

/// A visibility region: an axis-aligned box in which a moving object is lit by one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// What the level's author calls it; unique in the level.
    pub id: String,
    /// Its box, metres relative to the level's origin, with volume.
    pub bounds: Bounds,
    /// Which of its candidate points are valid, where the author says so; else they are found.
    pub valid: Option<CandidateBits>,
}

impl Region {
    /// A candidate point: the middle of its cell, metres relative to the level's origin.
    pub fn candidate(&self, index: usize) -> DVec3 {
        let cell = DVec3::new((index % 8) as f64, (index / 8 % 8) as f64, (index / 64) as f64);
        self.bounds.min + (self.bounds.max - self.bounds.min) * ((cell + 0.5) / CANDIDATES_PER_AXIS as f64)
    }
}

/// Two regions that touch or overlap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionEdge {
    /// Indices of the regions, the lower first.
    pub regions: [u32; 2],
    /// Area of their boundary, square metres, positive.
    pub area_m2: f64,
    /// Its centre, metres relative to the level's origin.
    pub center: DVec3,
}

/// How models of regions are found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionSettings {
    /// Directions over the sphere at each valid point at most, a power of two.
    pub rays_per_point: u32,
    /// β: how much neighbouring models are drawn to agree on their boundary; 0 leaves them as fitted.
    pub smoothing: f64,
    /// Sweeps of block coordinate descent at most.
    pub sweeps: u32,
    /// A region with fewer valid points is absorbed by a neighbour.
    pub min_points: u32,
    /// A region with less volume is absorbed by a neighbour, cubic metres.
    pub min_volume_m3: f64,
    /// A point is invalid if more of its rays than this fraction see the back of a face.
    pub back_face_limit: f64,
}

/// Rays of all points of a region together, about: a model is of so many points that the noise of each averages out. From
/// 32 to 1,024 rays for each of 512 points models have the same error (docs/regions.md).
const REGION_RAYS: u32 = 1 << 15;

/// Rays of each point at least: as many as are traced together, and enough to say whether it sees backs of faces.
const LEAST_RAYS: u32 = 64;

impl RegionSettings {
    /// Rays of each of so many points of a region, a power of two: fewer where there are many, unless that is turned off
    /// ([`crate::SkipRule::Adaptive`]).
    pub fn rays_of_each(&self, points: usize, is_adaptive: bool) -> u32 {
        if !is_adaptive {
            return self.rays_per_point;
        }
        let points = u32::try_from(points).unwrap_or(u32::MAX).max(1);
        REGION_RAYS.div_ceil(points).next_power_of_two().max(LEAST_RAYS).min(self.rays_per_point)
    }
}

impl Default for RegionSettings {
    fn default() -> Self {
        Self {
            rays_per_point: 1024,
            smoothing: 0.1,
            sweeps: 8,
            min_points: 8,
            min_volume_m3: 1.0,
            back_face_limit: 0.25,
        }
    }
}

/// All of a level's regions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct Regions {
    /// The regions.
    pub regions: Vec<Region>,
    /// Which of them touch; each pair once, in the order of their indices.
    pub edges: Vec<RegionEdge>,
    /// How their models are found.
    pub settings: RegionSettings,
}

/// Rays that find the valid points of a region, about: one from each candidate to each neighbour, and 64 from a few.
const FINDING_RAYS: u64 = 16 * CANDIDATES as u64;

impl Regions {
    /// Rays of a region at most; where its valid points are to be found, of all of them, and those that find them.
    pub fn rays_of(&self, region: &Region, is_adaptive: bool) -> u64 {
        let (points, more) = region.valid.map_or((CANDIDATES, FINDING_RAYS), |valid| (valid.count(), 0));
        points as u64 * u64::from(self.settings.rays_of_each(points, is_adaptive)) + more
    }

    /// Keeps some regions, and the edges between them.
    pub fn retain(&mut self, keep: impl Fn(&Region) -> bool) {
        let mut kept = 0;
        let new_index: Vec<Option<u32>> = self
            .regions
            .iter()
            .map(|region| {
                keep(region).then(|| {
                    kept += 1;
                    kept - 1
                })
            })
            .collect();
        let mut index = new_index.iter();
        self.regions.retain(|_| index.next().is_some_and(Option::is_some));
        self.edges.retain_mut(|edge| {
            let ends = edge.regions.map(|end| new_index.get(end as usize).copied().flatten());
            let [Some(a), Some(b)] = ends else { return false };
            edge.regions = [a, b];
            true
        });
    }
}

/// What valid points of some regions see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionSamples {
    /// Channels (half-distances).
    pub channels: u32,
    /// For each region, which of its candidates are valid.
    pub valid: Vec<CandidateBits>,
    /// For each valid point of each region, in order, [`REGION_HARMONICS`] coefficients for each channel: AO as a function of
    /// the normal (what is seen, convolved with the clamped cosine and divided by π).
    pub values: Vec<f32>,
    /// For each region, candidates that were traced and left out, for they saw too many back faces.
    pub dropped: Vec<u32>,
    /// Rays traced.
    pub rays: u64,
}

/// No coefficient of AO is greater: √4π, that of an open sky, is 3.545.
const MOST_COEFFICIENT: f32 = 8.0;

impl RegionSamples {
    /// Samples of runs of regions as those of all of them, in order.
    pub fn joined(channels: usize, runs: Vec<Self>) -> Self {
        Self {
            channels: channels as u32,
            valid: runs.iter().flat_map(|run| run.valid.iter().copied()).collect(),
            dropped: runs.iter().flat_map(|run| run.dropped.iter().copied()).collect(),
            rays: runs.iter().map(|run| run.rays).sum(),
            values: runs.into_iter().flat_map(|run| run.values).collect(),
        }
    }

    /// Checks samples that are said to be of so many regions and channels.
    pub fn check(&self, regions: usize, channels: usize) -> Result<(), ResultError> {
        check_size("channels", self.channels as usize, channels)?;
        check_size("regions", self.valid.len(), regions)?;
        check_size("counts", self.dropped.len(), regions)?;
        let points: usize = self.valid.iter().map(CandidateBits::count).sum();
        check_size("values", self.values.len(), points.saturating_mul(channels * REGION_HARMONICS))?;
        // Not for NaN either.
        let wrong = self.values.iter().filter(|value| value.is_nan() || value.abs() > MOST_COEFFICIENT).count();
        check_size("values out of bounds", wrong, 0)
    }
}

/// The model of a region: AO at a point p for each spherical harmonic,
/// `mean + Σ over the axes (p − c)_i · slope_{2i + s_i}`, with s_i = 0 where (p − c)_i ≥ 0, else 1 (Sloan et al. 2013,
/// equation 4).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionModel {
    /// c, metres relative to the level's origin.
    pub center: [f64; 3],
    /// For each channel and harmonic: the mean, then slopes per metre to +x, −x, +y, −y, +z and −z.
    pub coefficients: Vec<[f32; REGION_PARAMETERS]>,
}

impl RegionModel {
    /// Coefficients at a point, for each channel and harmonic. Metres relative to the level's origin.
    pub fn at(&self, point: DVec3) -> impl Iterator<Item = f64> + '_ {
        let offset = point - DVec3::from_array(self.center);
        let slope = |axis: usize| 1 + 2 * axis + usize::from(offset[axis] < 0.0);
        let slopes = [slope(0), slope(1), slope(2)];
        self.coefficients.iter().map(move |c| {
            let along = (0..3).map(|axis| offset[axis] * f64::from(c[slopes[axis]])).sum::<f64>();
            f64::from(c[0]) + along
        })
    }
}

/// Errors of regions' models, roots of means of squares over all valid points, coefficients in the basis' own norm: for AO
/// averaged over all normals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct RegionErrors {
    /// The mean alone.
    pub mean: f64,
    /// One gradient.
    pub gradient: f64,
    /// Seven parameters about the mean of the valid points.
    pub point_center: f64,
    /// Seven parameters about the middle of the box.
    pub box_center: f64,
    /// The better of both in each region.
    pub best_center: f64,
    /// With a refined centre where that pays.
    pub refined: f64,
    /// After smoothing.
    pub smoothed: f64,
    /// Root mean square of jumps at the centres of boundaries before smoothing, weighted by their areas.
    pub jump_fitted: f64,
    /// The same after smoothing.
    pub jump_smoothed: f64,
}

/// The models of all regions of a level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionModels {
    /// Channels (half-distances).
    pub channels: u32,
    /// One for each region that is left.
    pub models: Vec<RegionModel>,
    /// For each region of the level, the index of its model: that of the neighbour that absorbed it, if one did.
    pub model_of: Vec<u32>,
    /// For each model, the region that it is of.
    pub region_of: Vec<u32>,
    /// Which models' regions touch, by indices of models.
    pub edges: Vec<RegionEdge>,
    /// What became of the regions.
    pub summary: RegionSummary,
}

/// What became of a level's regions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct RegionSummary {
    /// Regions of the level.
    pub regions: u64,
    /// Regions that a neighbour absorbed.
    pub absorbed: u64,
    /// Valid points.
    pub points: u64,
    /// Points left out since they see too many back faces.
    pub dropped: u64,
    /// Regions without a valid point: their models are open sky, or what a neighbour's is.
    pub empty: u64,
    /// Models whose slopes were shrunk, for they overshot.
    pub shrunk: u64,
    /// Models that smoothing moved less far than their neighbours drew, for they would have overshot.
    pub held: u64,
    /// Models whose centre was refined.
    pub refined: u64,
    /// Sweeps of smoothing.
    pub sweeps: u32,
    /// The energy before smoothing and after each sweep.
    pub energy: Vec<f64>,
    /// Rays traced.
    pub rays: u64,
    /// Errors for each channel.
    pub errors: Vec<RegionErrors>,
}

impl RegionModels {
    /// Checks models that are said to be of so many regions and channels.
    pub fn check(&self, regions: usize, channels: usize) -> Result<(), ResultError> {
        check_size("channels", self.channels as usize, channels)?;
        check_size("regions", self.model_of.len(), regions)?;
        check_size("regions of models", self.region_of.len(), self.models.len())?;
        check_size("errors", self.summary.errors.len(), channels)?;
        let is_beyond = |list: &[u32], end: usize| list.iter().filter(|index| **index as usize >= end).count();
        check_size("models that do not exist", is_beyond(&self.model_of, self.models.len()), 0)?;
        check_size("regions that do not exist", is_beyond(&self.region_of, regions), 0)?;
        let ends = self.edges.iter().map(|edge| is_beyond(&edge.regions, self.models.len())).sum();
        check_size("edges to models that do not exist", ends, 0)?;
        for model in &self.models {
            check_size("coefficients", model.coefficients.len(), channels * REGION_HARMONICS)?;
            let center = model.center.iter().filter(|c| !c.is_finite()).count();
            let wrong = center + model.coefficients.iter().flatten().filter(|c| !c.is_finite()).count();
            check_size("numbers that are not finite", wrong, 0)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region() -> Region {
        let bounds = Bounds { min: DVec3::new(-1.0, 0.0, 2.0), max: DVec3::new(1.0, 4.0, 10.0) };
        Region { id: "hall".into(), bounds, valid: None }
    }

    #[test]
    fn candidates_are_in_the_middle_of_cells() {
        assert_eq!(region().candidate(0), DVec3::new(-0.875, 0.25, 2.5));
        assert_eq!(region().candidate(1 + 8 * 2 + 64 * 7), DVec3::new(-0.625, 1.25, 9.5));
        assert_eq!(region().candidate(CANDIDATES - 1), DVec3::new(0.875, 3.75, 9.5));
    }

    #[test]
    fn bits_are_those_of_candidates() {
        let mut bits = CandidateBits::default();
        [0, 63, 64, 511].into_iter().for_each(|index| bits.insert(index));
        assert_eq!(bits.iter().collect::<Vec<_>>(), [0, 63, 64, 511]);
        assert_eq!((bits.count(), CandidateBits::ALL.count()), (4, CANDIDATES));
        assert_eq!(bits.0, [1 | 1 << 63, 1, 0, 0, 0, 0, 0, 1 << 63]);
    }

    #[test]
    fn regions_that_are_kept_keep_their_edges() {
        let named = |id: &str| Region { id: id.into(), ..region() };
        let edge = |regions| RegionEdge { regions, area_m2: 1.0, center: DVec3::ZERO };
        let mut regions = Regions {
            regions: ["hall", "door", "room", "hut"].map(named).into(),
            edges: vec![edge([0, 1]), edge([0, 3]), edge([1, 2])],
            ..Regions::default()
        };
        regions.retain(|region| region.id.starts_with('h'));
        assert_eq!(regions.regions.iter().map(|region| &*region.id).collect::<Vec<_>>(), ["hall", "hut"]);
        assert_eq!(regions.edges, [edge([0, 1])]);
    }

    #[test]
    fn many_points_have_fewer_rays_each() {
        let settings = RegionSettings::default();
        let rays = [0, 1, 32, 33, 300, 512, usize::MAX].map(|points| settings.rays_of_each(points, true));
        assert_eq!(rays, [1024, 1024, 1024, 1024, 128, 64, 64]);
        assert_eq!(settings.rays_of_each(512, false), 1024);
        let few = RegionSettings { rays_per_point: 32, ..settings };
        assert_eq!((few.rays_of_each(512, true), few.rays_of_each(1, true)), (32, 32));
    }

    #[test]
    fn a_model_has_two_slopes_on_each_axis() {
        let coefficients = vec![[0.5, 0.1, -0.2, 0.0, 0.0, 0.3, 0.4]];
        let model = RegionModel { center: [1.0, 2.0, 3.0], coefficients };
        let at = |x, y, z| model.at(DVec3::new(x, y, z)).next().unwrap();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
        assert!(close(at(1.0, 2.0, 3.0), 0.5) && close(at(3.0, 9.0, 3.0), 0.7));
        assert!(close(at(0.0, 2.0, 2.0), 0.5 + 0.2 - 0.4) && close(at(1.0, 0.0, 4.0), 0.8));
    }

    #[test]
    fn samples_that_cannot_be_are_refused() {
        let mut bits = CandidateBits::default();
        bits.insert(3);
        let good =
            RegionSamples { channels: 2, valid: vec![bits], values: vec![0.5; 18], dropped: vec![0], rays: 1024 };
        assert!(good.check(1, 2).is_ok());
        assert!(good.check(2, 2).is_err() && good.check(1, 1).is_err());
        for value in [f32::NAN, f32::INFINITY, -9.0] {
            let mut wrong = good.clone();
            wrong.values[4] = value;
            assert!(wrong.check(1, 2).is_err());
        }
        let short = RegionSamples { values: vec![0.5; 17], ..good };
        assert!(short.check(1, 2).unwrap_err().to_string().contains("17 values"));
    }
}
