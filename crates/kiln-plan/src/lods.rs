//! Tasks of lower levels of detail: each is read from the finished values of what it stands for, and solved like any other
//! instance.

use crate::{InstanceSampling, Planner, Receiver, add_place, pieces, solve_family};
use kiln_core::{Digest, DigestBuilder, Output, PlannedTask, ResampleWork, SolveWork, TaskKind, Work};
use std::ops::Range;

impl Planner<'_> {
    /// Adds the pieces of a lower level of detail, and its solve. `solve_of` names the solves of the instances of full detail.
    pub(crate) fn add_lod(&mut self, index: usize, sampling: &InstanceSampling, solve_of: &[Option<u32>]) {
        let (instance, placed) = (index as u32, &self.level.instances[index]);
        let mesh = &self.level.meshes[placed.mesh as usize];
        let receiver = Receiver { mesh: mesh.digest, place: placed.world_from_object };
        let fulls: Vec<u32> =
            placed.lod_of.iter().filter_map(|full| solve_of.get(*full as usize).copied().flatten()).collect();
        let first_piece = self.graph.tasks.len() as u32;
        for (faces, samples) in pieces(mesh.face_count).zip(&sampling.piece_samples) {
            let family = self.resample_family(&receiver, &placed.lod_of, &faces, sampling.density_per_m2);
            let (first_face, face_count) = (faces.start, faces.len() as u32);
            let density_per_m2 = sampling.density_per_m2;
            let work = Work::Resample(ResampleWork { instance, first_face, face_count, density_per_m2 });
            self.graph.add(PlannedTask::new(work, family, *samples), fulls.iter().copied());
        }
        let work = Work::Solve(SolveWork { instance, vertex_count: mesh.vertex_count, alone: false });
        let family = solve_family(&receiver, self.level, self.lane);
        let solve = PlannedTask::new(work, family, u64::from(mesh.vertex_count));
        let all_pieces = first_piece..self.graph.tasks.len() as u32;
        self.graph.add(PlannedTask { output: Some(Output::Solution { instance }), ..solve }, all_pieces);
    }

    fn resample_family(&self, receiver: &Receiver, fulls: &[u32], faces: &Range<u32>, density_per_m2: f64) -> Digest {
        let mut family = DigestBuilder::new("kiln resample family");
        family.integer(u64::from(TaskKind::Resample.kernel_rev()));
        receiver.add_to(&mut family);
        family.integer(u64::from(faces.start)).integer(u64::from(faces.end)).float(density_per_m2);
        for full in fulls {
            let full = &self.level.instances[*full as usize];
            family.digest(&self.level.meshes[full.mesh as usize].digest);
            add_place(&mut family, &full.world_from_object);
        }
        family.integer(self.level.sampling.seed).integer(self.level.sampling.kernel.channel_count() as u64);
        family.finish()
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        FoliagePlan,
        tests::{level, with_foliage},
    };
    use kiln_core::{Level, Output, TaskGraph, TaskKind, Work};

    fn graph(level: &Level) -> TaskGraph {
        with_foliage(level, &FoliagePlan::default())
    }

    /// Instance 2, a crate, stands for the wall.
    fn with_lod() -> Level {
        let mut level = level();
        level.instances[2].lod_of = vec![0];
        level
    }

    #[test]
    fn a_level_of_detail_is_read_and_solved() {
        let graph = graph(&with_lod());
        graph.check(kiln_core::Digest::default()).unwrap();
        let kinds: Vec<TaskKind> = graph.tasks.iter().map(|task| task.work.kind()).collect();
        use TaskKind::{Resample, Solve, Trace};
        assert_eq!(kinds, [Trace, Trace, Trace, Solve, Trace, Solve, Resample, Solve]);
        assert_eq!((graph.inputs_of(6), graph.inputs_of(7)), (&[3][..], &[6][..]));
        assert_eq!(graph.tasks[7].output, Some(Output::Solution { instance: 2 }));
        assert!(matches!(graph.tasks[6].work, Work::Resample(piece) if piece.instance == 2 && piece.face_count == 12));
    }

    #[test]
    fn a_level_of_detail_stops_no_rays_and_knows_what_it_stands_for() {
        let (level, without) = (with_lod(), {
            let mut level = with_lod();
            level.instances.pop();
            level
        });
        let key = |graph: &TaskGraph, task: usize| graph.key(&graph.tasks[task], &[]);
        let (with, without) = (graph(&level), graph(&without));
        assert!((0..6).all(|task| key(&with, task) == key(&without, task)));
        let mut moved = level.clone();
        moved.instances[0].world_from_object.translation.x += 0.5;
        assert_ne!(key(&graph(&moved), 6), key(&with, 6));
        moved = level.clone();
        moved.instances[1].world_from_object.translation.x += 0.5;
        assert_eq!(key(&graph(&moved), 6), key(&with, 6));
    }
}
