//! What a level's foliage is made of: models of trees, the volume around them, and the list of what gets one number.
//! It follows from the level's manifest alone, so that plan and tasks agree.

use super::{LoadedLevel, out_of_range};
use crate::TaskError;
use glam::{DAffine3, DVec3};
use kiln_bake::{
    model_points,
    volume::{Layout, LayoutSettings, VolumeError},
};
use kiln_core::{Bounds, Digest, DigestBuilder, Gets, Instance, Level, RAYS_PER_VOXEL};
use kiln_plan::{FoliagePlan, InstanceSampling, ModelPlan, Reach, RunPlan, VolumePlan};
use std::{collections::BTreeMap, ops::Range};

/// Voxels of one batch, about: as many rays as a piece's.
const VOXELS_PER_BATCH: usize = 512;

/// Shrubs and decorators that are read together.
const RUN: usize = 256;

/// A sphere is made twice as large at most three times.
const GROWTH: f64 = 8.0;

/// Scales of models are rounded to this power of two, so that an edit seldom changes them.
const SCALE_STEPS: f64 = 4.0;

/// Foliage of a level that gets something.
#[derive(Debug)]
pub(super) struct Trees {
    pub(super) models: Vec<Model>,
    pub(super) layout: Layout,
    /// Instances that get one number, those with the same surroundings together.
    pub(super) scalars: Vec<u32>,
}

/// A model of trees.
#[derive(Debug)]
pub(super) struct Model {
    pub(super) mesh: u32,
    /// Its instances that receive, ascending.
    pub(super) instances: Vec<u32>,
    /// The scale at which it is baked alone.
    pub(super) scale: f64,
    /// Its instances are fitted to what is traced on them, not to the volume.
    pub(super) is_traced: bool,
    /// It is a lower level of detail: it has what the full model has, and nothing is traced for it.
    pub(super) full: Option<Full>,
}

/// The full model of a lower level of detail.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Full {
    /// Its mesh.
    pub(super) mesh: u32,
    /// For each instance of the lower level, the index among the full model's instances of the one that it stands for.
    pub(super) instances: Vec<usize>,
    /// From the object space of the lower level to that of the full model, the same for all instances.
    pub(super) full_from_lod: DAffine3,
}

impl Model {
    /// Where it stands alone.
    pub(super) fn place(&self) -> DAffine3 {
        DAffine3::from_scale(DVec3::splat(self.scale))
    }
}

impl Trees {
    /// Of a level. `seen_m` has a box for each instance, as [`kiln_bake::seen_bounds`] gives it.
    pub(super) fn new(level: &Level, reach: &Reach, seen_m: impl Fn(usize) -> Bounds) -> Result<Self, VolumeError> {
        let mut by_mesh: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        let mut scalars = Vec::new();
        for (index, instance) in (0u32..).zip(&level.instances).filter(|(_, instance)| instance.receives) {
            match instance.gets {
                Gets::Vertices => {}
                Gets::Global | Gets::GlobalTraced => by_mesh.entry(instance.mesh).or_default().push(index),
                // A lower level of detail has the number of what it stands for.
                Gets::Scalar if instance.is_lod() => {}
                Gets::Scalar => scalars.push(index),
            }
        }
        scalars.sort_by_key(|index| (reach.group(*index as usize), *index));
        let fulls: BTreeMap<u32, Full> =
            by_mesh.iter().filter_map(|(mesh, lods)| Some((*mesh, full(level, &by_mesh, lods)?))).collect();
        let in_volume =
            by_mesh.iter().filter(|(mesh, _)| !fulls.contains_key(mesh)).flat_map(|(_, instances)| instances);
        let in_volume = in_volume.filter(|index| level.instances[**index as usize].gets == Gets::Global);
        let mut in_volume: Vec<u32> = in_volume.copied().collect();
        in_volume.sort_unstable();
        let boxes: Vec<Bounds> = in_volume.into_iter().map(|index| seen_m(index as usize)).collect();
        let layout = Layout::new(&boxes, &LayoutSettings::default())?;
        let model = |(mesh, instances): (u32, Vec<u32>)| {
            let scale = scale(instances.iter().map(|index| &level.instances[*index as usize]));
            let is_traced = instances.iter().any(|i| level.instances[*i as usize].gets == Gets::GlobalTraced);
            Model { mesh, instances, scale, is_traced, full: fulls.get(&mesh).cloned() }
        };
        Ok(Self { models: by_mesh.into_iter().map(model).collect(), layout, scalars })
    }

    /// The model with a mesh.
    pub(super) fn model_of(&self, mesh: u32) -> Result<&Model, TaskError> {
        let model = self.models.iter().find(|model| model.mesh == mesh);
        model.ok_or_else(|| out_of_range("tree with the mesh", mesh))
    }

    /// Whether there is nothing to do.
    pub(super) fn is_empty(&self) -> bool {
        self.models.is_empty() && self.scalars.is_empty()
    }

    /// The tasks that it needs. `sampling` says how a model is sampled that stands somewhere.
    pub(super) fn plan(
        &self,
        level: &LoadedLevel,
        sampling: impl Fn(u32, &DAffine3) -> InstanceSampling,
    ) -> FoliagePlan {
        if self.is_empty() {
            return FoliagePlan::default();
        }
        let model = |model: &Model| ModelPlan {
            mesh: model.mesh,
            instances: model.instances.clone(),
            scale: model.scale,
            sampling: sampling(model.mesh, &model.place()),
            full: model.full.as_ref().map(|full| full.mesh),
            points: (model.is_traced && model.full.is_none())
                .then(|| model_points(&level.meshes[model.mesh as usize], level.level.sampling.seed).len() as u32),
        };
        let seen: Vec<Bounds> = (0..level.level.instances.len()).map(|index| level.seen_m(index)).collect();
        FoliagePlan {
            models: self.models.iter().map(model).collect(),
            volume: self.layout.batches(VOXELS_PER_BATCH).into_iter().map(|run| self.batch(run, &seen)).collect(),
            runs: self.runs(level, &seen),
        }
    }

    fn batch(&self, bricks: Range<usize>, seen: &[Bounds]) -> VolumePlan {
        let first_brick = bricks.start as u32;
        let bricks = &self.layout.bricks()[bricks];
        let mut voxels = DigestBuilder::new("kiln voxels");
        voxels.float(self.layout.spacing_m());
        let mut around = Bounds::EMPTY;
        for brick in bricks {
            voxels.value(brick);
            around.merge(&self.layout.bounds_m(brick));
        }
        let is_near = |tree: &u32| do_touch(&around, &seen[*tree as usize]);
        let mut trees: Vec<u32> = self
            .models
            .iter()
            .filter(|m| !m.is_traced && m.full.is_none())
            .flat_map(|m| &m.instances)
            .copied()
            .filter(is_near)
            .collect();
        trees.sort_unstable();
        VolumePlan {
            first_brick,
            brick_count: bricks.len() as u32,
            voxel_count: bricks.iter().map(|brick| brick.voxel_count() as u32).sum(),
            voxels: voxels.finish(),
            trees,
        }
    }

    /// The instances with values that each run may read, by the run's first.
    pub(super) fn near(&self, level: &LoadedLevel) -> BTreeMap<u32, Vec<u32>> {
        let seen: Vec<Bounds> = (0..level.level.instances.len()).map(|index| level.seen_m(index)).collect();
        self.runs(level, &seen).into_iter().map(|run| (run.first, run.near)).collect()
    }

    fn runs(&self, level: &LoadedLevel, seen: &[Bounds]) -> Vec<RunPlan> {
        let group = |index: &u32| level.reach().group(*index as usize);
        let (mut runs, mut first) = (Vec::new(), 0);
        for same in self.scalars.chunk_by(|a, b| group(a) == group(b)) {
            for instances in same.chunks(RUN) {
                let mut around = Bounds::EMPTY;
                instances.iter().for_each(|index| around.merge(&sphere(&level.level, *index)));
                let with_values = level.level.instances.iter().enumerate().filter(|(_, instance)| is_read(instance));
                let near = with_values.filter(|(index, _)| do_touch(&around, &seen[*index]));
                let near = near.map(|(index, _)| index as u32).collect();
                let ray_count =
                    instances.len() as u64 * 4 * u64::from(kiln_bake::DecoratorSettings::default().directions);
                runs.push(RunPlan { first, instances: instances.to_vec(), near, ray_count });
                first += instances.len() as u32;
            }
        }
        runs
    }
}

/// The full model of instances of one mesh, if all are lower levels of detail of instances of one other model, placed beside
/// them in the same way.
fn full(level: &Level, by_mesh: &BTreeMap<u32, Vec<u32>>, lods: &[u32]) -> Option<Full> {
    let instance = |index: u32| &level.instances[index as usize];
    let mesh = instance(*instance(*lods.first()?).lod_of.first()?).mesh;
    let fulls = by_mesh.get(&mesh)?;
    if fulls.iter().any(|index| instance(*index).is_lod()) {
        return None;
    }
    let place = |lod: &u32| {
        let full = *instance(*lod).lod_of.first()?;
        Some((fulls.binary_search(&full).ok()?, from_lod(instance(*lod), instance(full))))
    };
    let (instances, places): (Vec<usize>, Vec<DAffine3>) =
        lods.iter().map(place).collect::<Option<Vec<_>>>()?.into_iter().unzip();
    let full_from_lod = *places.first()?;
    let is_same = |place: &DAffine3| {
        let size = level.meshes[instance(lods[0]).mesh as usize].bounds.diagonal();
        let most = SAME_PLACE * full_from_lod.matrix3.to_cols_array().iter().fold(1.0f64, |most, x| most.max(x.abs()));
        place.matrix3.abs_diff_eq(full_from_lod.matrix3, most)
            && place.translation.abs_diff_eq(full_from_lod.translation, most * size)
    };
    places.iter().all(is_same).then_some(Full { mesh, instances, full_from_lod })
}

/// By how much of a length places may differ that pass for the same.
const SAME_PLACE: f64 = 1e-4;

fn from_lod(lod: &Instance, full: &Instance) -> DAffine3 {
    full.world_from_object.inverse() * lod.world_from_object
}

/// Whether an instance has values that others can read.
pub(super) fn is_read(instance: &Instance) -> bool {
    instance.receives && instance.gets == Gets::Vertices && !instance.is_lod()
}

/// A box around the largest sphere in which surfaces are read for an instance.
fn sphere(level: &Level, index: u32) -> Bounds {
    let decorator = decorator(level, index);
    let reach = DVec3::splat(GROWTH * decorator.radius_m);
    Bounds { min: decorator.anchor_m - reach, max: decorator.anchor_m + reach }
}

/// Where an instance that gets one number is read: around the middle of its box's bottom, as far as its box reaches.
pub(super) fn decorator(level: &Level, index: u32) -> kiln_bake::Decorator {
    let instance = &level.instances[index as usize];
    let world = kiln_bake::seen_bounds(&level.meshes[instance.mesh as usize].bounds, &instance.world_from_object);
    let anchor = DVec3::new(world.center().x, world.min.y, world.center().z);
    kiln_bake::Decorator::new(anchor, &world)
}

fn do_touch(a: &Bounds, b: &Bounds) -> bool {
    !a.is_empty() && !b.is_empty() && a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}

/// The geometric mean of the scales of instances, rounded to a quarter of an octave, in whatever order they are.
fn scale<'i>(instances: impl Iterator<Item = &'i Instance>) -> f64 {
    let mut logs: Vec<f64> = instances.map(|i| i.world_from_object.matrix3.determinant().abs().cbrt().log2()).collect();
    logs.sort_by(f64::total_cmp);
    let mean = logs.iter().sum::<f64>() / logs.len().max(1) as f64;
    let scale = ((mean * SCALE_STEPS).round() / SCALE_STEPS).exp2();
    if scale.is_normal() { scale } else { 1.0 }
}

/// Rays of a voxel, and by which rule it is valid.
pub(super) fn gather_settings(level: &Level) -> kiln_bake::volume::GatherSettings {
    let sampling = &level.sampling;
    kiln_bake::volume::GatherSettings {
        kernel: kiln_trace::KernelRates::of(sampling),
        rays_per_voxel: RAYS_PER_VOXEL,
        back_face_limit: sampling.back_face_limit,
        seed: sampling.seed,
    }
}

/// What orders the instances of a model, whatever their order in the level.
pub(super) fn key(instance: &Instance) -> Digest {
    let mut key = DigestBuilder::new("kiln tree");
    instance.world_from_object.to_cols_array().iter().for_each(|value| {
        key.float(*value);
    });
    key.finish()
}
