//! Visibility regions and their models.

use super::{Pack, meta::string};
use crate::{
    EngineModel, FullModel,
    bytes::{f32_at, floats_at, u32_at},
    format::{HARMONICS, SectionKind, region, region_edge},
};

/// A region: a box in which moving objects are lit by one model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Its box's lowest corner, metres relative to the level's origin.
    pub min: [f32; 3],
    /// Its box's highest corner.
    pub max: [f32; 3],
    /// Index of its model; a region that was absorbed has its neighbour's.
    pub model: u32,
    first_neighbour: u32,
    neighbour_count: u32,
    /// How many of the first neighbours overlap it and are smaller.
    inner_count: u32,
}

impl Region {
    /// Whether a point is in the box, or on its faces.
    #[inline]
    pub fn contains(&self, point: [f32; 3]) -> bool {
        (0..3).all(|i| self.min[i] <= point[i] && point[i] <= self.max[i])
    }

    /// The point of the box that is nearest; a coordinate that is NaN becomes the box's lowest.
    #[inline]
    pub fn clamp(&self, point: [f32; 3]) -> [f32; 3] {
        core::array::from_fn(|i| if point[i] > self.min[i] { point[i].min(self.max[i]) } else { self.min[i] })
    }

    /// Volume of the box, cubic metres.
    #[inline]
    pub fn volume(&self) -> f64 {
        volume(self.min, self.max)
    }

    #[inline]
    pub(crate) fn parse(record: &[u8]) -> Self {
        // A whole record, so that the compiler sees that all of its fields are there.
        let record = record.first_chunk().unwrap_or(&[0; region::BYTES]);
        Self {
            min: floats_at(record, region::MIN),
            max: floats_at(record, region::MAX),
            model: u32_at(record, region::MODEL),
            first_neighbour: u32_at(record, region::FIRST_NEIGHBOUR),
            neighbour_count: u32_at(record, region::NEIGHBOUR_COUNT),
            inner_count: u32_at(record, region::INNER_COUNT),
        }
    }

    /// Indices of the first neighbour and of the one after the last.
    pub(super) fn neighbours(&self) -> (u64, u64) {
        (u64::from(self.first_neighbour), u64::from(self.first_neighbour) + u64::from(self.neighbour_count))
    }
}

/// Volume of a box, in f64: of floats no product overflows there, so that none is NaN.
#[inline]
pub(crate) fn volume(min: [f32; 3], max: [f32; 3]) -> f64 {
    (0..3).map(|i| f64::from(max[i]) - f64::from(min[i])).product()
}

/// Two regions that touch or overlap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionEdge {
    /// Indices of the regions.
    pub regions: [u32; 2],
    /// Area of their boundary, square metres.
    pub area_m2: f32,
    /// Its centre, metres relative to the level's origin.
    pub center: [f32; 3],
}

impl RegionEdge {
    pub(super) fn parse(record: &[u8]) -> Self {
        Self {
            regions: [0, 4].map(|at| u32_at(record, region_edge::REGIONS + at)),
            area_m2: f32_at(record, region_edge::AREA),
            center: floats_at(record, region_edge::CENTER),
        }
    }
}

impl<'a> Pack<'a> {
    /// Number of regions.
    pub fn region_count(&self) -> u32 {
        self.count(SectionKind::Regions) as u32
    }

    /// Number of models.
    pub fn model_count(&self) -> u32 {
        self.count(SectionKind::ModelsEngine).max(self.count(SectionKind::ModelsFull)) as u32
    }

    /// A region by its index.
    #[inline]
    pub fn region(&self, index: u32) -> Option<Region> {
        self.sections.get(SectionKind::Regions).record(index).map(Region::parse)
    }

    /// What the level's author calls a region.
    pub fn region_id(&self, index: u32) -> Option<&'a str> {
        string(self.strings, self.sections.get(SectionKind::Regions).record(index)?, region::ID)
    }

    /// The region that the level's author calls so. Looks at all of them: for when a level is loaded.
    pub fn region_with_id(&self, id: &str) -> Option<u32> {
        (0..self.region_count()).find(|index| self.region_id(*index) == Some(id))
    }

    /// Indices of the regions beside one: first those that overlap it and are smaller, then the others.
    #[inline]
    pub fn neighbours(&self, region: &Region) -> impl Iterator<Item = u32> + use<'a> {
        let (first, end) = region.neighbours();
        let table = self.sections.get(SectionKind::RegionNeighbours);
        let listed = table.bytes().get(first as usize * 4..).and_then(|rest| rest.get(..(end - first) as usize * 4));
        listed.unwrap_or_default().chunks_exact(4).map(|index| u32_at(index, 0))
    }

    /// Indices of the regions that overlap one and are smaller.
    #[inline]
    pub(crate) fn inner(&self, region: &Region) -> impl Iterator<Item = u32> + use<'a> {
        self.neighbours(region).take(region.inner_count as usize)
    }

    /// A boundary by its index, below [`Pack::count`] of [`SectionKind::RegionEdges`].
    pub fn region_edge(&self, index: u32) -> Option<RegionEdge> {
        self.sections.get(SectionKind::RegionEdges).record(index).map(RegionEdge::parse)
    }

    /// A model in the engine's form; none if the pack was written without.
    #[inline]
    pub fn engine_model(&self, model: u32) -> Option<EngineModel<'a>> {
        EngineModel::new(self.sections.get(SectionKind::ModelsEngine).record(model)?)
    }

    /// A full model; none if the pack was written without.
    #[inline]
    pub fn full_model(&self, model: u32) -> Option<FullModel<'a>> {
        let record = self.sections.get(SectionKind::ModelsFull).record(model)?;
        Some(FullModel::new(record, self.channels()))
    }

    /// Linear coefficients of the blended AO in a region, at the point of its box that is nearest: outside its box nothing
    /// bounds a model. Metres relative to the level's origin.
    #[inline]
    pub fn engine_at(&self, region: u32, point: [f32; 3]) -> Option<[f32; 4]> {
        let region = self.region(region)?;
        Some(self.engine_model(region.model)?.at(region.clamp(point)))
    }

    /// Quadratic coefficients of a channel's AO in a region, at the point of its box that is nearest.
    #[inline]
    pub fn full_at(&self, region: u32, point: [f32; 3], channel: usize) -> Option<[f32; HARMONICS]> {
        let region = self.region(region)?;
        self.full_model(region.model)?.at(region.clamp(point), channel)
    }
}
