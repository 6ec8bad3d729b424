//! Builds the graph of tasks that a level needs, and their keys.
//!
//! An instance is cut into pieces by its mesh's face count alone, so that an edit elsewhere recuts nothing. The key of
//! a trace task is H(family, occluder root): the family covers the piece, its settings, the kernel revision and the
//! lane; the occluder root covers all that can stop one of its rays ([`Reach`]). Instances that receive nothing have no
//! tasks.

mod boxes;
mod foliage;
mod lods;
mod reach;
mod regions;

pub use foliage::{FoliagePlan, ModelPlan, RunPlan, VolumePlan};
pub use reach::Reach;

use glam::DAffine3;
use kiln_core::{
    Class, Digest, DigestBuilder, Gets, Instance, Lane, Level, Output, PlannedTask, SolveWork, TaskGraph, TaskKind,
    TraceWork, Work,
};
use std::ops::Range;

/// Faces of one piece: some 10⁵ rays at medium quality, a fraction of a second on one core.
pub const FACES_PER_PIECE: u32 = 1024;

/// The pieces of a mesh: runs of faces, in order.
pub fn pieces(face_count: u32) -> impl Iterator<Item = Range<u32>> {
    let cut = move |first: u32| first..face_count.min(first.saturating_add(FACES_PER_PIECE));
    (0..face_count).step_by(FACES_PER_PIECE as usize).map(cut)
}

/// How one instance is to be sampled: what needs its geometry, which the plan does not see.
#[derive(Clone, Debug, PartialEq)]
pub struct InstanceSampling {
    /// Samples per square metre.
    pub density_per_m2: f64,
    /// Samples of each of its [`pieces`].
    pub piece_samples: Vec<u64>,
}

/// A plan could not be made.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum PlanError {
    /// The instance table and its sampling disagree.
    #[error(
        "{instances} instances but sampling for {sampled}; the level and its plan are of different versions of Kiln"
    )]
    InstanceCount {
        /// Instances of the level.
        instances: usize,
        /// Instances whose sampling was given.
        sampled: usize,
    },
    /// More pieces than a graph can index.
    #[error("the level needs {pieces} pieces, more than the {limit} of one bake; split it into several levels")]
    TooLarge {
        /// Pieces needed.
        pieces: u64,
        /// The limit.
        limit: u64,
    },
}

/// Most pieces of one bake.
pub const MAX_PIECES: u64 = 1 << 24;

/// Builds the graph. `sampling` has one entry for each instance (ignored for those that get no values), and `foliage` and
/// `reach` are the level's.
pub fn plan(
    level_digest: Digest,
    level: &Level,
    lane: &Lane,
    sampling: &[InstanceSampling],
    foliage: &FoliagePlan,
    reach: &Reach,
) -> Result<TaskGraph, PlanError> {
    if sampling.len() != level.instances.len() {
        return Err(PlanError::InstanceCount { instances: level.instances.len(), sampled: sampling.len() });
    }
    let gets_values = |i: &&Instance| i.receives && i.gets == Gets::Vertices;
    let receivers = || level.instances.iter().filter(gets_values);
    let is_traced = |index: &usize| gets_values(&&level.instances[*index]) && !level.instances[*index].is_lod();
    let count = |i: &Instance| u64::from(level.meshes[i.mesh as usize].face_count.div_ceil(FACES_PER_PIECE));
    let needed: u64 = receivers().map(count).sum();
    if needed > MAX_PIECES {
        return Err(PlanError::TooLarge { pieces: needed, limit: MAX_PIECES });
    }
    let surroundings = occluder_roots(level, reach);
    let mut planner = Planner { level, lane, graph: TaskGraph::new(level_digest, level), surroundings };
    planner.graph.tasks.reserve_exact(needed as usize + receivers().count());
    planner.graph.inputs.reserve_exact(needed as usize);
    let mut solve_of = vec![None; level.instances.len()];
    for (index, sampling) in sampling.iter().enumerate().filter(|(index, _)| is_traced(index)) {
        let group = planner.surroundings_of(reach.group(index), index)?;
        solve_of[index] = Some(planner.add_instance(index, sampling, group));
    }
    planner.add_foliage(foliage, reach, &solve_of)?;
    planner.add_regions(reach)?;
    for (index, sampling) in sampling.iter().enumerate().filter(|(index, _)| !is_traced(index)) {
        if gets_values(&&level.instances[index]) {
            planner.add_lod(index, sampling, &solve_of);
        }
    }
    Ok(TaskGraph { surroundings: planner.surroundings, ..planner.graph })
}

/// A graph that grows.
struct Planner<'a> {
    level: &'a Level,
    lane: &'a Lane,
    graph: TaskGraph,
    /// What can stop rays: of each group of receivers, then what else there is.
    surroundings: Vec<Digest>,
}

impl Planner<'_> {
    /// The surroundings of a group of receivers, which an instance must have.
    fn surroundings_of(&self, group: Option<usize>, instance: usize) -> Result<u32, PlanError> {
        let group = group.filter(|group| *group < self.surroundings.len());
        let error = PlanError::InstanceCount { instances: self.level.instances.len(), sampled: instance };
        group.map(|group| group as u32).ok_or(error)
    }

    /// Adds the pieces of an instance that receives, and its solve, whose index it gives. The number of its group is that of
    /// its surroundings.
    fn add_instance(&mut self, index: usize, sampling: &InstanceSampling, group: u32) -> u32 {
        let (instance, placed) = (index as u32, &self.level.instances[index]);
        let mesh = &self.level.meshes[placed.mesh as usize];
        let receiver = Receiver { mesh: mesh.digest, place: placed.world_from_object };
        let density_per_m2 = sampling.density_per_m2;
        let first_piece = self.graph.tasks.len() as u32;
        for (faces, samples) in pieces(mesh.face_count).zip(&sampling.piece_samples) {
            let family = trace_family(&receiver, &faces, density_per_m2, self.level, self.lane);
            let (first_face, face_count) = (faces.start, faces.len() as u32);
            let work = Work::Trace(TraceWork { instance, first_face, face_count, density_per_m2, alone: false });
            let task = PlannedTask::new(work, family, samples * u64::from(self.level.sampling.rays_per_sample));
            self.graph.add(PlannedTask { surroundings: Some(group), ..task }, []);
        }
        let work = Work::Solve(SolveWork { instance, vertex_count: mesh.vertex_count, alone: false });
        let family = solve_family(&receiver, self.level, self.lane);
        let solve = PlannedTask::new(work, family, u64::from(mesh.vertex_count));
        let all_pieces = first_piece..self.graph.tasks.len() as u32;
        self.graph.add(PlannedTask { output: Some(Output::Solution { instance }), ..solve }, all_pieces)
    }
}

struct Receiver {
    mesh: Digest,
    place: DAffine3,
}

impl Receiver {
    fn add_to(&self, builder: &mut DigestBuilder) {
        builder.digest(&self.mesh);
        add_place(builder, &self.place);
    }
}

fn add_place(builder: &mut DigestBuilder, place: &DAffine3) {
    place.to_cols_array().iter().for_each(|&value| {
        builder.float(value);
    });
}

/// Everything that can stop a ray of each group of receivers, in the order that ties are decided by.
fn occluder_roots(level: &Level, reach: &Reach) -> Vec<Digest> {
    let occluder = |instance: &Instance| {
        let mut builder = DigestBuilder::new("kiln occluder");
        builder.digest(&level.meshes[instance.mesh as usize].digest);
        add_place(&mut builder, &instance.world_from_object);
        // Its density depends on the shrubs around it, which may be beyond the reach.
        builder.value(&instance.fog).finish()
    };
    let occluders: Vec<Digest> = level.instances.iter().map(occluder).collect();
    (0..reach.group_count()).map(|group| occluder_root(level, &occluders, reach.occluders(group))).collect()
}

fn occluder_root(level: &Level, occluders: &[Digest], within_reach: &[u32]) -> Digest {
    let mut builder = DigestBuilder::new("kiln occluders");
    builder.integer(within_reach.len() as u64);
    for &index in within_reach {
        builder.digest(&occluders[index as usize]);
    }
    if let Some(height) = level.sampling.ground_plane_y_m {
        // The plane is cut to the level's bounds and reach, so both are part of what it is.
        builder.text("ground plane").float(height).value(&level.bounds).value(&level.sampling.kernel);
    }
    builder.finish()
}

fn trace_family(receiver: &Receiver, faces: &Range<u32>, density: f64, level: &Level, lane: &Lane) -> Digest {
    let s = &level.sampling;
    let mut builder = DigestBuilder::new("kiln trace family");
    builder.integer(u64::from(TaskKind::Trace.kernel_rev())).text(&lane.trace);
    receiver.add_to(&mut builder);
    builder.integer(u64::from(faces.start)).integer(u64::from(faces.end)).float(density).value(&s.kernel);
    for count in [s.rays_per_sample, s.min_samples_per_face, s.max_samples_per_face] {
        builder.integer(u64::from(count));
    }
    builder.float(s.back_face_limit).integer(s.seed).value(&s.target).value(&s.no_skip);
    if [Class::Tree, Class::Shrub].iter().any(|class| level.counts.classes.get(class).is_some_and(|faces| *faces > 0)) {
        builder.value(&s.foliage);
    }
    builder.finish()
}

fn solve_family(receiver: &Receiver, level: &Level, lane: &Lane) -> Digest {
    let mut builder = DigestBuilder::new("kiln solve family");
    builder.integer(u64::from(TaskKind::Solve.kernel_rev())).text(&lane.solve);
    receiver.add_to(&mut builder);
    builder.value(&level.solve).integer(level.sampling.kernel.channel_count() as u64);
    builder.finish()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use glam::DVec3;
    use kiln_core::{
        BakeSettings, Bounds, Instance, Kernel, LevelCounts, MeshEntry, Sampling, SkipRule, SolveSettings, TaskKey,
    };

    pub(crate) fn level() -> Level {
        let mesh = |name: &str, face_count| MeshEntry {
            digest: Digest::of(name.as_bytes()),
            name: name.into(),
            vertex_count: 3 * face_count,
            face_count,
            duplicate_faces: 0,
            bounds: Bounds { min: DVec3::ZERO, max: DVec3::ONE },
            center: DVec3::ZERO,
            source_mesh: 0,
            blocks: Vec::new(),
        };
        let instance = |mesh, x: f64| Instance {
            name: String::new(),
            mesh,
            node: 0,
            gpu_instance: None,
            world_from_object: DAffine3::from_translation(DVec3::X * x),
            receives: true,
            gets: Gets::Vertices,
            fog: None,
            lod_of: Vec::new(),
        };
        Level {
            origin_m: DVec3::ZERO,
            bounds: Bounds { min: DVec3::ZERO, max: DVec3::ONE },
            meshes: vec![mesh("wall", 2500), mesh("crate", 12)],
            instances: vec![instance(0, 0.0), instance(1, 1.0), instance(1, 2.0)],
            regions: kiln_core::Regions::default(),
            sampling: Sampling {
                target: None,
                kernel: Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] },
                rays_per_sample: 32,
                mean_samples_per_face: 4.0,
                density_per_m2: None,
                min_samples_per_face: 2,
                max_samples_per_face: 64,
                back_face_limit: 0.25,
                seed: 0,
                foliage: kiln_core::FoliageMode::default(),
                ground_plane_y_m: None,
                no_skip: std::collections::BTreeSet::new(),
            },
            solve: SolveSettings::default(),
            output: BakeSettings::default().output,
            warnings: Vec::new(),
            counts: LevelCounts::default(),
        }
    }

    pub(crate) fn graph(level: &Level) -> TaskGraph {
        with_foliage(level, &FoliagePlan::default())
    }

    pub(crate) fn with_foliage(level: &Level, foliage: &FoliagePlan) -> TaskGraph {
        let sampling: Vec<InstanceSampling> = level
            .instances
            .iter()
            .map(|i| level.meshes[i.mesh as usize].face_count)
            .map(|faces| InstanceSampling {
                density_per_m2: 1.0,
                piece_samples: pieces(faces).map(|p| 4 * p.len() as u64).collect(),
            })
            .collect();
        let lane = Lane { trace: "cpu".into(), solve: "portable".into() };
        let seen: Vec<Bounds> = level.instances.iter().map(|i| seen(level, i)).collect();
        plan(Digest::default(), level, &lane, &sampling, foliage, &Reach::new(level, &seen)).unwrap()
    }

    pub(crate) fn seen(level: &Level, instance: &Instance) -> Bounds {
        let bounds = level.meshes[instance.mesh as usize].bounds;
        let at = |corner| instance.world_from_object.transform_point3(corner);
        Bounds { min: at(bounds.min), max: at(bounds.max) }
    }

    /// As many instances, and one half-distance.
    pub(crate) fn level_of(instances: usize, half_distance_m: f64) -> Level {
        let mut level = level();
        level.instances = vec![level.instances[0].clone(); instances];
        level.sampling.kernel = Kernel::Obscurance { half_distances_m: vec![half_distance_m] };
        level
    }

    fn traces(graph: &TaskGraph) -> impl Iterator<Item = (&PlannedTask, &TraceWork)> {
        graph.tasks.iter().filter_map(|task| match &task.work {
            Work::Trace(piece) => Some((task, piece)),
            _ => None,
        })
    }

    fn keys(level: &Level) -> Vec<TaskKey> {
        let graph = graph(level);
        traces(&graph).map(|(task, _)| graph.key(task, &[])).collect()
    }

    #[test]
    fn pieces_cover_each_face_once() {
        for count in [0, 1, 1023, 1024, 1025, 5000, u32::MAX - 5] {
            let mut next = 0;
            for range in pieces(count).take(10) {
                assert!(range.start == next && !range.is_empty() && range.len() <= 1024);
                next = range.end;
            }
            assert!(next == count || count > 10 * 1024);
        }
    }

    #[test]
    fn the_graph_has_what_the_level_needs() {
        let mut level = level();
        let full = graph(&level);
        full.check(Digest::default()).unwrap();
        assert_eq!((traces(&full).count(), full.tasks.len()), (5, 8));
        assert_eq!(traces(&full).map(|(_, piece)| piece.face_count).sum::<u32>(), 2500 + 12 + 12);
        assert_eq!(full.tasks[0].cost, 1024 * 4 * 32);
        let solves = [(3, 0, 7500, vec![0, 1, 2]), (5, 1, 36, vec![4]), (7, 2, 36, vec![6])];
        for (task, instance, vertex_count, inputs) in solves {
            assert_eq!(full.tasks[task].work, Work::Solve(SolveWork { instance, vertex_count, alone: false }));
            assert_eq!(full.tasks[task].output, Some(Output::Solution { instance }));
            assert_eq!(full.inputs_of(task as u32), inputs);
        }
        level.instances[0].receives = false;
        let less = graph(&level);
        less.check(Digest::default()).unwrap();
        assert_eq!((traces(&less).count(), less.tasks.len()), (2, 4));
        // What is left out still occludes: keys of the rest do not change.
        assert_eq!(keys(&level), keys(&self::level())[3..]);
    }

    /// Fails when the plan changes: raise `TaskKind::Plan`'s kernel revision, and put both here. Keys of traces change with
    /// that kind's revision too.
    #[test]
    fn the_plan_is_that_of_its_revision() {
        let digest = Digest::of(&kiln_core::codec::encode(&graph(&level()))).short();
        let revisions = [TaskKind::Plan, TaskKind::Trace, TaskKind::Solve].map(TaskKind::kernel_rev);
        assert_eq!((revisions, digest.as_str()), ([7, 9, 4], "8a20be52"));
    }

    #[test]
    fn keys_change_with_what_matters_and_with_nothing_else() {
        let base = level();
        let before = keys(&base);
        let mut renamed = base.clone();
        renamed.instances[0].name = "other".into();
        renamed.solve.regularization = 0.5;
        renamed.sampling.mean_samples_per_face = 5.0;
        assert_eq!(keys(&renamed), before);

        let mut moved = base.clone();
        moved.instances[2].world_from_object.translation.x += 1e-9;
        let after = keys(&moved);
        assert!(after.iter().zip(&before).all(|(a, b)| a != b), "every piece sees another occluder");
        let families = |level: &Level| traces(&graph(level)).map(|(task, _)| task.family).collect::<Vec<_>>();
        assert_eq!(families(&moved)[..4], families(&base)[..4], "the families of the others are as they were");
        assert_ne!(families(&moved)[4], families(&base)[4]);

        for change in [
            |s: &mut Sampling| s.rays_per_sample = 64,
            |s: &mut Sampling| s.seed = 1,
            |s: &mut Sampling| s.back_face_limit = 0.3,
            |s: &mut Sampling| s.kernel = Kernel::Obscurance { half_distances_m: vec![2.0] },
            |s: &mut Sampling| s.ground_plane_y_m = Some(0.0),
            |s: &mut Sampling| s.no_skip = SkipRule::ALL.into(),
        ] {
            let mut changed = base.clone();
            change(&mut changed.sampling);
            assert!(keys(&changed).iter().zip(&before).all(|(a, b)| a != b));
        }
    }

    #[test]
    fn keys_know_of_foliage() {
        let mut base = level();
        let mut changed = base.clone();
        changed.sampling.foliage = kiln_core::FoliageMode::Attenuate;
        assert_eq!(keys(&changed), keys(&base), "a level without foliage is not asked what it does");
        for level in [&mut base, &mut changed] {
            level.counts.classes.insert(Class::Tree, 12);
        }
        assert!(keys(&changed).iter().zip(keys(&base)).all(|(a, b)| *a != b));
        let mut denser = base.clone();
        let fog = kiln_core::Fog { bounds: denser.meshes[1].bounds, density_per_m: 0.5 };
        denser.instances[2].fog = Some(fog);
        assert!(keys(&denser).iter().zip(keys(&base)).all(|(a, b)| *a != b));
    }

    #[test]
    fn an_edit_changes_the_keys_of_what_it_can_reach() {
        // At a half-distance of 2 m rays end after 20 m.
        let mut base = level();
        base.sampling.kernel = Kernel::Obscurance { half_distances_m: vec![2.0] };
        base.instances[2].world_from_object.translation.x = 100.0;
        let mut edited = base.clone();
        edited.meshes.push(MeshEntry { digest: Digest::of(b"barrel"), ..base.meshes[1].clone() });
        edited.instances[2].mesh = 2;
        let same = |a: &Level, b: &Level| keys(a).iter().zip(keys(b)).map(|(a, b)| *a == b).collect::<Vec<_>>();
        assert_eq!(same(&base, &edited), [true, true, true, true, false]);
        // A new neighbour is noticed on both sides, a new stranger by nobody.
        edited.instances[2].world_from_object.translation.x = 10.0;
        assert_eq!(same(&base, &edited), [false; 5]);
        let mut grown = base.clone();
        grown.instances.push(Instance { receives: false, ..base.instances[1].clone() });
        grown.instances[3].world_from_object.translation.x = 200.0;
        assert_eq!(same(&base, &grown), [true; 5]);
        // Rays without an end notice everything.
        for level in [&mut base, &mut grown] {
            level.sampling.no_skip.insert(SkipRule::Reach);
        }
        assert_eq!(same(&base, &grown), [false; 5]);
    }

    #[test]
    fn all_keys_of_a_level_differ() {
        let mut all = keys(&level());
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 5);
    }
}
