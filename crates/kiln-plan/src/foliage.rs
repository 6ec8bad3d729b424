//! Tasks of foliage: local AO of each tree model, the volume around trees, the fits of their instances, and one number for each
//! shrub and decorator. A level without them has none of these.

use crate::{InstanceSampling, PlanError, Planner, Reach, Receiver, add_place, pieces, solve_family, trace_family};
use glam::{DAffine3, DVec3};
use kiln_core::{
    Digest, DigestBuilder, FitWork, Output, PlannedTask, PointsWork, ReadWork, SolveWork, TaskKind, TraceWork,
    VolumeWork, Work,
};
use std::collections::BTreeMap;

/// Rays of one task of points, about: as many as a piece's.
const POINT_RAYS: u64 = 1 << 19;

/// What of a level's foliage needs tasks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoliagePlan {
    /// Models of trees, by their meshes.
    pub models: Vec<ModelPlan>,
    /// The volume around trees, batch by batch.
    pub volume: Vec<VolumePlan>,
    /// Shrubs and decorators, run by run.
    pub runs: Vec<RunPlan>,
}

/// A model of trees.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelPlan {
    /// Index of its mesh in the level.
    pub mesh: u32,
    /// Its instances that receive, ascending, at least one.
    pub instances: Vec<u32>,
    /// The scale at which it is baked alone.
    pub scale: f64,
    /// How it is sampled then.
    pub sampling: InstanceSampling,
    /// If its instances are fitted to what is traced on them, its points; else they are fitted to the volume.
    pub points: Option<u32>,
    /// If it is a lower level of detail that is read from the fits of the full model, that one's mesh: nothing is traced for it.
    pub full: Option<u32>,
}

/// Some bricks of the volume around trees.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumePlan {
    /// Index of the first brick in the level's layout.
    pub first_brick: u32,
    /// Bricks, at least one.
    pub brick_count: u32,
    /// Voxels that are traced.
    pub voxel_count: u32,
    /// Digest of where they are.
    pub voxels: Digest,
    /// The instances whose boxes they are needed for: what these come to, the voxels do, but for their spacing, which changes
    /// a ray's value by less than its reach leaves out.
    pub trees: Vec<u32>,
}

/// Shrubs and decorators that are read together.
#[derive(Clone, Debug, PartialEq)]
pub struct RunPlan {
    /// Index of the first in the level's list of them.
    pub first: u32,
    /// The instances, in the order of that list, at least one, all of one group of [`Reach`].
    pub instances: Vec<u32>,
    /// Instances with values that may be read, ascending.
    pub near: Vec<u32>,
    /// Rays that it will take at most.
    pub ray_count: u64,
}

impl Planner<'_> {
    /// Adds the tasks of foliage; those of the instances with values must be there. `solve_of` names the solve of each.
    pub(crate) fn add_foliage(
        &mut self,
        plan: &FoliagePlan,
        reach: &Reach,
        solve_of: &[Option<u32>],
    ) -> Result<(), PlanError> {
        let (lods, fulls): (Vec<&ModelPlan>, Vec<&ModelPlan>) =
            plan.models.iter().partition(|model| model.full.is_some());
        let locals: Vec<u32> = fulls.iter().map(|model| self.add_local(model)).collect();
        let volume: Vec<u32> = plan.volume.iter().map(|batch| self.add_batch(batch, reach)).collect();
        let mut fit_of: BTreeMap<u32, u32> = BTreeMap::new();
        for (model, local) in fulls.into_iter().zip(locals) {
            let values = match model.points {
                Some(point_count) => self.add_points(model, point_count, reach)?,
                None => volume.clone(),
            };
            fit_of.insert(model.mesh, self.add_fit(model, std::iter::once(local).chain(values)));
        }
        for model in lods {
            let full = model.full.and_then(|mesh| fit_of.get(&mesh));
            self.add_fit(model, full.copied());
        }
        plan.runs.iter().try_for_each(|run| self.add_run(run, reach, solve_of))
    }

    /// A new entry among what can stop rays.
    fn surround(&mut self, digest: Digest) -> u32 {
        self.surroundings.push(digest);
        (self.surroundings.len() - 1) as u32
    }

    /// The model alone: its pieces and its solve, which is no output.
    fn add_local(&mut self, model: &ModelPlan) -> u32 {
        let mesh = &self.level.meshes[model.mesh as usize];
        let place = DAffine3::from_scale(DVec3::splat(model.scale));
        let (receiver, instance) = (Receiver { mesh: mesh.digest, place }, model.instances[0]);
        let mut alone = DigestBuilder::new("kiln alone");
        alone.digest(&mesh.digest).float(model.scale);
        let surroundings = Some(self.surround(alone.finish()));
        let first_piece = self.graph.tasks.len() as u32;
        let density_per_m2 = model.sampling.density_per_m2;
        for (faces, samples) in pieces(mesh.face_count).zip(&model.sampling.piece_samples) {
            let family = trace_family(&receiver, &faces, density_per_m2, self.level, self.lane);
            let (first_face, face_count) = (faces.start, faces.len() as u32);
            let work = TraceWork { instance, first_face, face_count, density_per_m2, alone: true };
            let rays = samples * u64::from(self.level.sampling.rays_per_sample);
            let task = PlannedTask::new(Work::Trace(work), family, rays);
            self.graph.add(PlannedTask { surroundings, ..task }, []);
        }
        let work = Work::Solve(SolveWork { instance, vertex_count: mesh.vertex_count, alone: true });
        let family = solve_family(&receiver, self.level, self.lane);
        let all_pieces = first_piece..self.graph.tasks.len() as u32;
        self.graph.add(PlannedTask::new(work, family, u64::from(mesh.vertex_count)), all_pieces)
    }

    fn add_batch(&mut self, batch: &VolumePlan, reach: &Reach) -> u32 {
        let mut groups: Vec<usize> = batch.trees.iter().filter_map(|tree| reach.group(*tree as usize)).collect();
        groups.sort_unstable();
        groups.dedup();
        let mut root = DigestBuilder::new("kiln volume surroundings");
        groups.iter().filter_map(|group| self.surroundings.get(*group)).for_each(|digest| {
            root.digest(digest);
        });
        let surroundings = Some(self.surround(root.finish()));
        let s = &self.level.sampling;
        let mut family = DigestBuilder::new("kiln volume family");
        family.integer(u64::from(TaskKind::Volume.kernel_rev())).text(&self.lane.trace).digest(&batch.voxels);
        family.value(&s.kernel).float(s.back_face_limit).integer(s.seed).value(&s.foliage).value(&s.no_skip);
        let work = Work::Volume(VolumeWork { first_brick: batch.first_brick, brick_count: batch.brick_count });
        let rays = u64::from(batch.voxel_count) * u64::from(kiln_core::RAYS_PER_VOXEL);
        let task = PlannedTask::new(work, family.finish(), rays);
        self.graph.add(PlannedTask { surroundings, ..task }, [])
    }

    /// Points on the instances of a model, as many together as make a task, all with the same surroundings.
    fn add_points(&mut self, model: &ModelPlan, point_count: u32, reach: &Reach) -> Result<Vec<u32>, PlanError> {
        let mesh = &self.level.meshes[model.mesh as usize];
        let rays = kiln_core::rays_per_point(model.instances.len());
        let rays_of_one = u64::from(point_count) * u64::from(rays);
        let most = usize::try_from(POINT_RAYS / rays_of_one.max(1)).unwrap_or(1).max(1);
        let group = |index: &u32| reach.group(*index as usize);
        let (mut tasks, mut first) = (Vec::new(), 0);
        for same in model.instances.chunk_by(|a, b| group(a) == group(b)) {
            let surroundings = Some(self.surroundings_of(group(&same[0]), same[0] as usize)?);
            for instances in same.chunks(most) {
                let s = &self.level.sampling;
                let mut family = DigestBuilder::new("kiln points family");
                family.integer(u64::from(TaskKind::Points.kernel_rev())).text(&self.lane.trace).digest(&mesh.digest);
                for instance in instances {
                    add_place(&mut family, &self.level.instances[*instance as usize].world_from_object);
                }
                family.value(&s.kernel).float(s.back_face_limit).integer(s.seed).value(&s.foliage).value(&s.no_skip);
                family.integer(u64::from(rays));
                let count = instances.len() as u32;
                let work = Work::Points(PointsWork { mesh: model.mesh, first, count, point_count, rays });
                let task = PlannedTask::new(work, family.finish(), u64::from(count) * rays_of_one);
                tasks.push(self.graph.add(PlannedTask { surroundings, ..task }, []));
                first += count;
            }
        }
        Ok(tasks)
    }

    fn add_fit(&mut self, model: &ModelPlan, inputs: impl IntoIterator<Item = u32>) -> u32 {
        let mesh = &self.level.meshes[model.mesh as usize];
        let mut family = DigestBuilder::new("kiln fit family");
        family.integer(u64::from(TaskKind::Fit.kernel_rev())).text(&self.lane.solve).digest(&mesh.digest);
        for instance in &model.instances {
            add_place(&mut family, &self.level.instances[*instance as usize].world_from_object);
        }
        let s = &self.level.sampling;
        family.integer(s.seed).integer(s.kernel.channel_count() as u64).value(&self.level.solve);
        family.value(&self.level.output.blend);
        if let Some(full) = model.full {
            // It is read and solved as other levels of detail are.
            let revisions = [TaskKind::Resample, TaskKind::Solve].map(TaskKind::kernel_rev);
            family.text("level of detail").value(&revisions).digest(&self.level.meshes[full as usize].digest);
            for instance in &model.instances {
                let full = self.level.instances[*instance as usize].lod_of.first();
                full.into_iter()
                    .for_each(|full| add_place(&mut family, &self.level.instances[*full as usize].world_from_object));
            }
        }
        let instances = model.instances.len() as u32;
        let work = FitWork { mesh: model.mesh, vertex_count: mesh.vertex_count, instance_count: instances };
        let cost = u64::from(instances) * u64::from(mesh.vertex_count);
        let output = Some(Output::Trees { mesh: model.mesh });
        let task = PlannedTask { output, ..PlannedTask::new(Work::Fit(work), family.finish(), cost) };
        self.graph.add(task, inputs)
    }

    fn add_run(&mut self, run: &RunPlan, reach: &Reach, solve_of: &[Option<u32>]) -> Result<(), PlanError> {
        let mut family = DigestBuilder::new("kiln read family");
        family.integer(u64::from(TaskKind::Read.kernel_rev())).text(&self.lane.trace);
        for instance in &run.instances {
            let instance = &self.level.instances[*instance as usize];
            family.value(&self.level.meshes[instance.mesh as usize].bounds);
            add_place(&mut family, &instance.world_from_object);
        }
        for near in &run.near {
            let instance = &self.level.instances[*near as usize];
            family.digest(&self.level.meshes[instance.mesh as usize].digest);
            add_place(&mut family, &instance.world_from_object);
        }
        family.integer(self.level.sampling.seed).integer(self.level.sampling.kernel.channel_count() as u64);
        let group = run.instances.first().and_then(|instance| reach.group(*instance as usize));
        let surroundings = Some(self.surroundings_of(group, run.first as usize)?);
        let (first, count) = (run.first, run.instances.len() as u32);
        let task = PlannedTask::new(Work::Read(ReadWork { first, count }), family.finish(), run.ray_count);
        let output = Some(Output::Scalars { first, count });
        let inputs = run.near.iter().filter_map(|near| solve_of.get(*near as usize).copied().flatten());
        self.graph.add(PlannedTask { surroundings, output, ..task }, inputs);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{level, with_foliage};
    use kiln_core::{Gets, Level, TaskGraph};

    /// Instance 1 a tree, instance 2 a shrub beside the wall.
    fn planted() -> (Level, FoliagePlan) {
        let mut level = level();
        level.instances[1].gets = Gets::Global;
        level.instances[2].gets = Gets::Scalar;
        let sampling = InstanceSampling { density_per_m2: 2.0, piece_samples: vec![48] };
        let batch = |first_brick| VolumePlan {
            first_brick,
            brick_count: 2,
            voxel_count: 300,
            voxels: Digest::of(&[first_brick as u8]),
            trees: vec![1],
        };
        let foliage = FoliagePlan {
            models: vec![ModelPlan { mesh: 1, instances: vec![1], scale: 1.0, sampling, points: None, full: None }],
            volume: vec![batch(0), batch(2)],
            runs: vec![RunPlan { first: 0, instances: vec![2], near: vec![0], ray_count: 1024 }],
        };
        (level, foliage)
    }

    #[test]
    fn foliage_has_tasks_of_its_own() {
        let (level, foliage) = planted();
        let graph = with_foliage(&level, &foliage);
        graph.check(Digest::default()).unwrap();
        let kinds: Vec<TaskKind> = graph.tasks.iter().map(|task| task.work.kind()).collect();
        use TaskKind::{Fit, Read, Solve, Trace, Volume};
        assert_eq!(kinds, [Trace, Trace, Trace, Solve, Trace, Solve, Volume, Volume, Fit, Read]);
        assert_eq!((graph.inputs_of(8), graph.inputs_of(9)), (&[5, 6, 7][..], &[3][..]));
        let outputs: Vec<Output> = graph.tasks.iter().filter_map(|task| task.output).collect();
        let scalars = Output::Scalars { first: 0, count: 1 };
        assert_eq!(outputs, [Output::Solution { instance: 0 }, Output::Trees { mesh: 1 }, scalars]);
        assert_eq!(graph.tasks[6].cost, 300 * 1024);
    }

    #[test]
    fn what_is_traced_on_a_tree_takes_the_place_of_the_volume() {
        let (level, mut foliage) = planted();
        foliage.models[0].points = Some(100);
        foliage.volume.clear();
        let graph = with_foliage(&level, &foliage);
        graph.check(Digest::default()).unwrap();
        let kinds: Vec<TaskKind> = graph.tasks.iter().map(|task| task.work.kind()).collect();
        use TaskKind::{Fit, Points, Read, Solve, Trace};
        assert_eq!(kinds, [Trace, Trace, Trace, Solve, Trace, Solve, Points, Fit, Read]);
        assert_eq!(graph.inputs_of(7), [5, 6]);
        assert_eq!(graph.tasks[6].cost, 100 * 128);
        let mut moved = level.clone();
        moved.instances[0].world_from_object.translation.x += 0.5;
        let key = |graph: &TaskGraph| graph.key(&graph.tasks[6], &[]);
        assert_ne!(key(&with_foliage(&moved, &foliage)), key(&graph));
    }

    #[test]
    fn a_level_of_detail_of_a_tree_takes_the_fits_of_the_full_one() {
        let (mut level, mut foliage) = planted();
        level.meshes.push(kiln_core::MeshEntry { digest: Digest::of(b"lower"), ..level.meshes[1].clone() });
        let lower = kiln_core::Instance { mesh: 2, lod_of: vec![1], ..level.instances[1].clone() };
        level.instances.push(lower);
        let full = foliage.models[0].clone();
        foliage.models.insert(0, ModelPlan { mesh: 2, instances: vec![3], full: Some(1), ..full });
        let graph = with_foliage(&level, &foliage);
        graph.check(Digest::default()).unwrap();
        let fits: Vec<u32> = (0..)
            .zip(&graph.tasks)
            .filter(|(_, task)| task.work.kind() == TaskKind::Fit)
            .map(|(index, _)| index)
            .collect();
        assert_eq!((fits.len(), graph.inputs_of(fits[1])), (2, &fits[..1]));
        assert_eq!(graph.tasks.iter().filter(|task| matches!(task.work, Work::Trace(piece) if piece.alone)).count(), 1);
        // Where it stands beside the full one is in its key.
        let mut moved = level.clone();
        moved.instances[3].world_from_object.translation.y += 0.1;
        let key = |graph: &TaskGraph| graph.key(&graph.tasks[fits[1] as usize], &[]);
        assert_ne!(key(&with_foliage(&moved, &foliage)), key(&graph));
    }

    #[test]
    fn tasks_of_foliage_know_what_they_depend_on() {
        let (level, foliage) = planted();
        let key = |graph: &TaskGraph, task: usize| graph.key(&graph.tasks[task], &[]);
        let before = with_foliage(&level, &foliage);
        let keys = |graph: &TaskGraph| (4..10).map(|task| key(graph, task)).collect::<Vec<_>>();
        let same = |level: &Level, foliage: &FoliagePlan| {
            let after = with_foliage(level, foliage);
            keys(&before).iter().zip(keys(&after)).map(|(a, b)| *a == b).collect::<Vec<_>>()
        };
        // What stands around a model is no part of its own light; a tree that moves changes its fit.
        let mut moved = level.clone();
        moved.instances[0].world_from_object.translation.x += 0.5;
        assert_eq!(same(&moved, &foliage), [true, true, false, false, true, false]);
        moved = level.clone();
        moved.instances[1].world_from_object.translation.x += 0.5;
        assert_eq!(same(&moved, &foliage), [true, true, false, false, false, false]);
        let mut other = foliage.clone();
        other.models[0].scale = 2.0;
        assert_eq!(same(&level, &other), [false, false, true, true, true, true]);
        other = foliage.clone();
        other.volume[1].voxels = Digest::of(b"more");
        assert_eq!(same(&level, &other), [true, true, true, false, true, true]);
        let mut blended = level.clone();
        blended.output.blend = Some(vec![0.5, 0.5]);
        assert_eq!(same(&blended, &foliage), [true, true, true, true, false, true]);
    }
}
