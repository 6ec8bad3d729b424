//! What an export is given: solutions of instances, fits of trees, and numbers of shrubs and decorators.

use super::{LoadedLevel, out_of_range};
use crate::{Artefacts, TaskError};
use kiln_core::{
    Digest, FoliageSummary, Gets, InstanceNumbers, ModelSummary, NodeErrors, Output, RAYS_PER_VOXEL, RegionModels,
    TraceSummary, TreeErrors, TreeFits, ValueFormat, Warning, codec,
};
use kiln_scene::{BakedModel, NumberedInstance};
use std::collections::HashMap;

/// The outputs of a task graph, by what they are.
pub(super) struct Outputs {
    pub(super) solutions: Vec<(u32, Digest)>,
    /// By mesh.
    trees: Vec<(u32, Digest)>,
    /// By the first of a run, with their number.
    scalars: Vec<(u32, u32, Digest)>,
    /// Models of visibility regions.
    regions: Option<Digest>,
}

impl Outputs {
    pub(super) fn load(list: Digest, artefacts: &dyn Artefacts) -> Result<Self, TaskError> {
        let list: Vec<(Output, Digest)> = codec::decode("a list of outputs", &artefacts.get(list)?)?;
        let mut outputs = Self { solutions: Vec::new(), trees: Vec::new(), scalars: Vec::new(), regions: None };
        for (output, digest) in list {
            match output {
                Output::Solution { instance } => outputs.solutions.push((instance, digest)),
                Output::Trees { mesh } => outputs.trees.push((mesh, digest)),
                Output::Scalars { first, count } => outputs.scalars.push((first, count, digest)),
                Output::Regions => outputs.regions = Some(digest),
            }
        }
        Ok(outputs)
    }

    /// The models of visibility regions, if the level has any.
    pub(super) fn regions(&self, artefacts: &dyn Artefacts) -> Result<Option<RegionModels>, TaskError> {
        let read = |digest| Ok(codec::decode("models of regions", &artefacts.get(digest)?)?);
        self.regions.map(read).transpose()
    }
}

/// What became of a level's foliage.
pub(super) struct FoliageOutputs {
    /// Mesh, instances and fits of each model.
    trees: Vec<(u32, Vec<u32>, TreeFits)>,
    /// Instance and number of each shrub and decorator.
    scalars: Vec<(u32, InstanceNumbers)>,
}

impl FoliageOutputs {
    pub(super) fn load(outputs: &Outputs, level: &LoadedLevel, artefacts: &dyn Artefacts) -> Result<Self, TaskError> {
        let mut found = Self { trees: Vec::new(), scalars: Vec::new() };
        for &(mesh, digest) in &outputs.trees {
            let fits: TreeFits = codec::decode("fits of trees", &artefacts.get(digest)?)?;
            let instances = level.trees()?.model_of(mesh)?.instances.clone();
            if instances.len() != fits.numbers.len() {
                return Err(out_of_range("tree", fits.numbers.len() as u32));
            }
            found.trees.push((mesh, instances, fits));
        }
        for &(first, count, digest) in &outputs.scalars {
            let numbers: Vec<InstanceNumbers> = codec::decode("numbers of instances", &artefacts.get(digest)?)?;
            let end = first.saturating_add(count);
            let run = level.trees()?.scalars.get(first as usize..end as usize);
            let run = run.filter(|run| run.len() == numbers.len());
            let run = run.ok_or_else(|| out_of_range("shrub or decorator", end))?;
            found.scalars.extend(run.iter().copied().zip(numbers));
        }
        Ok(found)
    }

    /// Local AO of each model.
    pub(super) fn models(&self) -> Vec<BakedModel<'_>> {
        self.trees.iter().map(|(mesh, _, fits)| BakedModel { mesh: *mesh as usize, values: &fits.local }).collect()
    }

    /// Numbers of all instances that have some.
    pub(super) fn numbers(&self, level: &LoadedLevel) -> Vec<NumberedInstance<'_>> {
        let scalar_of: HashMap<u32, &InstanceNumbers> =
            self.scalars.iter().map(|(instance, numbers)| (*instance, numbers)).collect();
        let lods = level.level.instances.iter().enumerate().filter_map(|(instance, lod)| {
            let numbers = *scalar_of.get(lod.lod_of.first()?)?;
            (lod.receives && lod.gets == Gets::Scalar).then_some(NumberedInstance { instance, numbers })
        });
        let of_trees = self.trees.iter().flat_map(|(_, instances, fits)| instances.iter().zip(&fits.numbers));
        let of_scalars = self.scalars.iter().map(|(instance, numbers)| (instance, numbers));
        let numbered = |(instance, numbers): (&u32, _)| NumberedInstance { instance: *instance as usize, numbers };
        of_trees.map(numbered).chain(of_scalars.map(numbered)).chain(lods).collect()
    }

    /// Adds what was traced for foliage.
    pub(super) fn add_to(&self, trace: &mut TraceSummary) {
        self.trees.iter().for_each(|(.., fits)| trace.merge(&fits.trace));
        trace.rays += self.trees.iter().map(|(.., fits)| fits.point_rays).sum::<u64>();
        trace.rays += self.voxels() * u64::from(RAYS_PER_VOXEL);
        trace.rays += self.scalars.len() as u64 * u64::from(kiln_bake::DecoratorSettings::default().directions);
    }

    /// All models that are fitted to a volume have the same.
    fn voxels(&self) -> u64 {
        self.trees.iter().map(|(.., fits)| fits.voxels).max().unwrap_or(0)
    }

    /// What is worth saying.
    pub(super) fn warnings(&self, level: &LoadedLevel) -> Vec<Warning> {
        let open: Vec<u32> = self.open_scalars().collect();
        let Some(first) = open.first() else { return Vec::new() };
        let (count, name) = (open.len() as u64, level.level.instances[*first as usize].name.clone());
        let message = format!(
            "{count} shrubs and decorators ({name} is one) have no baked surface around them, and count as open; \
             bake what they stand on together with them, or give them another class"
        );
        vec![Warning { code: "open_scalars".into(), subject: name, message, count }]
    }

    /// Shrubs and decorators around which nothing has values.
    fn open_scalars(&self) -> impl Iterator<Item = u32> {
        let is_open = |numbers: &InstanceNumbers| matches!(numbers, InstanceNumbers::Scalar { is_open: true, .. });
        self.scalars.iter().filter(move |(_, numbers)| is_open(numbers)).map(|(instance, _)| *instance)
    }

    /// Bytes of what a game loads, and of values at the vertices of every instance.
    fn bytes(&self, level: &LoadedLevel) -> (u64, u64) {
        let channels = level.level.sampling.kernel.channel_count() as u64;
        let of_value = if level.level.output.format == ValueFormat::U16 { 2 } else { 4 };
        let of_vertices = |mesh: u32| {
            u64::from(level.level.meshes[mesh as usize].vertex_count) * (channels * of_value).next_multiple_of(4)
        };
        let (mut bytes, mut at_vertices) = (0, 0);
        for (mesh, instances, _) in &self.trees {
            let count = instances.len() as u64;
            // Four floats for each half-distance, and for the blend.
            bytes += of_vertices(*mesh) + count * (channels + 1) * 16;
            at_vertices += count * of_vertices(*mesh);
        }
        for (instance, _) in &self.scalars {
            bytes += channels * 4;
            at_vertices += of_vertices(level.level.instances[*instance as usize].mesh);
        }
        (bytes, at_vertices)
    }

    pub(super) fn summary(&self, level: &LoadedLevel) -> FoliageSummary {
        let node = |(index, errors): (&u32, &Vec<TreeErrors>)| NodeErrors {
            node: level.level.instances[*index as usize].name.clone(),
            errors: errors.clone(),
        };
        let model = |(mesh, instances, fits): &(u32, Vec<u32>, TreeFits)| ModelSummary {
            mesh: level.level.meshes[*mesh as usize].name.clone(),
            instances: instances.len() as u64,
            traced: fits.point_rays > 0,
            errors: fits.errors.clone(),
            nodes: instances.iter().zip(&fits.instance_errors).map(node).collect(),
        };
        let (bytes, bytes_at_vertices) = self.bytes(level);
        FoliageSummary {
            bytes,
            bytes_at_vertices,
            models: self.trees.iter().filter(|(.., fits)| !fits.is_lod).map(model).collect(),
            lod_models: self.trees.iter().filter(|(.., fits)| fits.is_lod).count() as u64,
            voxels: self.voxels(),
            scalars: self.scalars.len() as u64,
            open_scalars: self.open_scalars().count() as u64,
        }
    }
}
