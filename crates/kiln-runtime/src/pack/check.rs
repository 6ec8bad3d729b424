//! What is checked once, so that views need not: fields are there, indices exist, keys rise, numbers are finite.

use super::{
    Pack, RegionEdge, TreeModel, VertexSet,
    meta::string,
    sections::{Sections, Table},
    vertices::key,
};
use crate::{
    PackError, Region,
    bytes::{f32_at, u16_at, u32_at},
    format::{HARMONICS, PARAMETERS, SectionKind, model_engine, model_full, region, scalar, tree_instance},
    half,
};

/// What is wrong with a record.
type Problem = Option<&'static str>;

/// All text, once: records then refer to parts of it in no time.
pub(super) fn strings<'a>(sections: &Sections<'a>) -> Result<&'a str, PackError> {
    core::str::from_utf8(sections.get(SectionKind::Strings).bytes()).map_err(|error| PackError::Record {
        kind: SectionKind::Strings,
        index: u32::try_from(error.valid_up_to()).unwrap_or(u32::MAX),
        problem: "a byte that is not UTF-8",
    })
}

impl Pack<'_> {
    pub(super) fn check(&self) -> Result<(), PackError> {
        for kind in SectionKind::ALL {
            self.check_stride(kind)?;
        }
        self.check_order()?;
        self.check_vertices()?;
        self.check_trees()?;
        self.check_regions()?;
        self.check_models()
    }

    fn check_stride(&self, kind: SectionKind) -> Result<(), PackError> {
        let (table, known) = (self.sections.get(kind), kind.record_bytes(self.channels()));
        let is_good = match (table.count(), kind.is_array()) {
            (0, _) => true,
            (_, true) => table.stride() == known,
            (_, false) => table.stride() >= known,
        };
        let problem = "another size than its fields";
        if is_good { Ok(()) } else { Err(PackError::Record { kind, index: 0, problem }) }
    }

    fn each<'b>(&'b self, kind: SectionKind, problem: impl Fn(&'b [u8]) -> Problem) -> Result<(), PackError> {
        let table: Table<'b> = self.sections.get(kind);
        for (index, record) in table.records() {
            if let Some(problem) = problem(record) {
                return Err(PackError::Record { kind, index, problem });
            }
        }
        Ok(())
    }

    /// Who is looked for by node and instance is in their order, each once.
    fn check_order(&self) -> Result<(), PackError> {
        self.rising::<3>(SectionKind::VertexSets)?;
        self.rising::<2>(SectionKind::TreeInstances)?;
        self.rising::<2>(SectionKind::Scalars)
    }

    fn rising<const N: usize>(&self, kind: SectionKind) -> Result<(), PackError> {
        let mut below = None;
        for (index, record) in self.sections.get(kind).records() {
            let own: Option<[u32; N]> = Some(key(record));
            if own <= below {
                let problem = "a node and instance that do not come after those before it";
                return Err(PackError::Record { kind, index, problem });
            }
            below = own;
        }
        Ok(())
    }

    fn check_vertices(&self) -> Result<(), PackError> {
        let channels = self.channels();
        self.each(SectionKind::VertexSets, |record| match VertexSet::parse(&self.sections, record, channels) {
            Some(_) => None,
            None => Some("values that are not there"),
        })?;
        for index in 0..self.count(SectionKind::TreeBlocks) as u32 {
            if self.tree_block_at(index).is_none() {
                let problem = "values that are not there";
                return Err(PackError::Record { kind: SectionKind::TreeBlocks, index, problem });
            }
        }
        Ok(())
    }

    fn check_trees(&self) -> Result<(), PackError> {
        let (models, blocks) = (self.count(SectionKind::TreeModels), self.count(SectionKind::TreeBlocks) as u64);
        self.each(SectionKind::TreeModels, |record| {
            let model = TreeModel::parse(record);
            let is_good = are_finite(model.center) && are_finite(model.half_extent);
            if !is_good || model.half_extent.iter().any(|half| *half < 0.0) {
                return Some("a box that is not finite, or turned inside out");
            }
            (model.blocks().1 > blocks).then_some("local AO that is not there")
        })?;
        let channels = self.channels();
        self.each(SectionKind::TreeInstances, |record| {
            if u32_at(record, tree_instance::MODEL) as usize >= models {
                return Some("a model that is not there");
            }
            finite(record, tree_instance::NUMBERS, 4 * (channels + 1))
        })?;
        self.each(SectionKind::Scalars, |record| finite(record, scalar::VALUES, channels))
    }

    fn check_regions(&self) -> Result<(), PackError> {
        let (regions, models) = (self.region_count(), self.model_count());
        let neighbours = self.count(SectionKind::RegionNeighbours) as u64;
        self.each(SectionKind::Regions, |record| {
            let region = Region::parse(record);
            let is_good = are_finite(region.min) && are_finite(region.max);
            if !is_good || (0..3).any(|i| region.min[i] > region.max[i]) {
                return Some("a box that is not finite, or turned inside out");
            }
            if region.model >= models {
                return Some("a model that is not there");
            }
            if region.neighbours().1 > neighbours {
                return Some("neighbours that are not there");
            }
            string(self.strings, record, region::ID).is_none().then_some("an id that is no text")
        })?;
        self.each(SectionKind::RegionNeighbours, |record| {
            (u32_at(record, 0) >= regions).then_some("a region that is not there")
        })?;
        self.each(SectionKind::RegionEdges, |record| {
            let edge = RegionEdge::parse(record);
            if edge.regions.iter().any(|index| *index >= regions) {
                return Some("a region that is not there");
            }
            let is_good = are_finite(edge.center) && edge.area_m2 >= 0.0 && edge.area_m2.is_finite();
            (!is_good).then_some("a boundary that is not finite, or of negative area")
        })
    }

    fn check_models(&self) -> Result<(), PackError> {
        let kinds = [SectionKind::ModelsFull, SectionKind::ModelsEngine];
        let [full, engine] = kinds.map(|kind| self.count(kind));
        if full != engine && full != 0 && engine != 0 {
            let index = full.min(engine) as u32;
            return Err(PackError::Record { kind: kinds[0], index, problem: "no counterpart in the engine's form" });
        }
        let (parameters, regions) = (PARAMETERS * HARMONICS * self.channels(), self.region_count());
        self.each(SectionKind::ModelsFull, |record| {
            if u32_at(record, model_full::REGION) >= regions {
                return Some("a region that is not there");
            }
            finite(record, model_full::CENTER, 3).or_else(|| finite(record, model_full::PARAMETERS, parameters))
        })?;
        self.each(SectionKind::ModelsEngine, |record| {
            let is_good = |i| half::is_finite(u16_at(record, model_engine::PARAMETERS + 2 * i));
            let is_wrong = !(0..4 * PARAMETERS).all(is_good);
            finite(record, model_engine::CENTER, 3).or(is_wrong.then_some(NOT_FINITE))
        })
    }
}

const NOT_FINITE: &str = "a number that is not finite";

fn are_finite(numbers: [f32; 3]) -> bool {
    numbers.iter().all(|number| number.is_finite())
}

fn finite(record: &[u8], at: usize, count: usize) -> Problem {
    let is_good = (0..count).all(|i| f32_at(record, at + 4 * i).is_finite());
    (!is_good).then_some(NOT_FINITE)
}
