//! The graph of a level's tasks between plan and export: what is to be done, and what of it needs what.
//!
//! Tasks are numbered, and take the results of tasks with lower numbers only, so that there are no cycles. Levels have up
//! to 2²⁴ pieces: what all tasks take is one vector, of which each task has a run, right after that of the task before;
//! and what can stop rays, which thousands of pieces share, is named by number. Nothing is allocated for a task.

use crate::{Digest, DigestBuilder, GraphError, Level, LevelCounts, Output, Sampling, TaskKey, Warning, Work};
use serde::{Deserialize, Serialize};

/// Most inputs of one task, such as the pieces of an instance.
pub const MAX_INPUTS: usize = 400_000;

/// A task of a graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedTask {
    /// What is to be done.
    pub work: Work,
    /// H(everything that the result depends on but surroundings and inputs): settings, what is worked on, the kind's
    /// kernel revision and lane. Of tasks that trace it may later serve to find a result within an error bound.
    pub family: Digest,
    /// Index into [`TaskGraph::surroundings`]: there if, and only if, the kind traces.
    pub surroundings: Option<u32>,
    /// End of its run in [`TaskGraph::inputs`]; it begins where that of the task before ends.
    pub inputs_end: u32,
    /// What leases are filled by, in units of the kind: rays at most if it traces.
    pub cost: u64,
    /// As what export is given the result; `None` if only other tasks take it.
    pub output: Option<Output>,
}

impl PlannedTask {
    /// A task without surroundings that is no output.
    pub const fn new(work: Work, family: Digest, cost: u64) -> Self {
        Self { work, family, surroundings: None, inputs_end: 0, cost, output: None }
    }

    /// Rays that the task may take: none unless it traces.
    pub const fn rays(&self) -> u64 {
        if self.work.kind().traces() { self.cost } else { 0 }
    }
}

/// All tasks of a level between plan and export. Tasks that a level does not need are not there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskGraph {
    /// Digest of the level.
    pub level: Digest,
    /// Digests of all that can stop rays (occluder roots), each for the tasks that name it.
    pub surroundings: Vec<Digest>,
    /// Tasks, each after those whose results it takes.
    pub tasks: Vec<PlannedTask>,
    /// What tasks take, as indices of tasks: the runs of all tasks, one after another.
    pub inputs: Vec<u32>,
    /// How samples are made, for reports and for checks of results.
    pub sampling: Sampling,
    /// Totals of the level, for reports.
    pub counts: LevelCounts,
    /// What import found worth saying.
    pub warnings: Vec<Warning>,
}

impl TaskGraph {
    /// A graph without tasks, of a level with this digest.
    pub fn new(digest: Digest, level: &Level) -> Self {
        Self {
            level: digest,
            surroundings: Vec::new(),
            tasks: Vec::new(),
            inputs: Vec::new(),
            sampling: level.sampling.clone(),
            counts: level.counts.clone(),
            warnings: level.warnings.clone(),
        }
    }

    /// Adds a task that takes the results of earlier ones, and gives its index. Whether the parts fit together shows in
    /// [`Self::check`].
    pub fn add(&mut self, task: PlannedTask, inputs: impl IntoIterator<Item = u32>) -> u32 {
        self.inputs.extend(inputs);
        self.tasks.push(PlannedTask { inputs_end: self.inputs.len() as u32, ..task });
        (self.tasks.len() - 1) as u32
    }

    /// The tasks whose results a task takes, in order; none if there is no such task, or its run does not exist.
    pub fn inputs_of(&self, index: u32) -> &[u32] {
        let end = |index: usize| self.tasks.get(index).map_or(0, |task| task.inputs_end as usize);
        let index = index as usize;
        self.inputs.get(index.checked_sub(1).map_or(0, end)..end(index)).unwrap_or_default()
    }

    /// The key of a task of this graph: H(kind, family, surroundings, inputs), where `inputs` are the results that it
    /// takes, in order. Without inputs it is known from the start.
    ///
    /// Kinds that trace have surroundings and others have none, so that neither is taken for an input.
    pub fn key(&self, task: &PlannedTask, inputs: &[Digest]) -> TaskKey {
        let mut key = DigestBuilder::new(&format!("kiln {}", task.work.kind().name()));
        key.digest(&task.family);
        let surroundings = task.surroundings.and_then(|index| self.surroundings.get(index as usize));
        surroundings.into_iter().chain(inputs).for_each(|digest| {
            key.digest(digest);
        });
        TaskKey(key.finish())
    }

    /// Checks that this is a graph of the level and that its parts fit together: every task can run once those that it
    /// needs have, every result is of use, and no output comes twice. So all tasks have run when all outputs are there.
    pub fn check(&self, level: Digest) -> Result<(), GraphError> {
        crate::graph_check::check(self, level)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{Kernel, SolveWork, TaskKind, TraceWork};

    /// A graph with one instance for each number of pieces: its pieces, and then its solve.
    pub(crate) fn graph(pieces: &[u32]) -> TaskGraph {
        let mut graph = TaskGraph {
            level: Digest::of(b"level"),
            surroundings: vec![Digest::of(b"surroundings")],
            tasks: Vec::new(),
            inputs: Vec::new(),
            sampling: sampling(),
            counts: LevelCounts::default(),
            warnings: Vec::new(),
        };
        for (instance, &count) in (0..).zip(pieces) {
            let first = graph.tasks.len() as u32;
            for first_face in 0..count {
                let piece = TraceWork { instance, first_face, face_count: 1, density_per_m2: 1.0, alone: false };
                let task = PlannedTask::new(Work::Trace(piece), Digest::of(&first_face.to_le_bytes()), 64);
                graph.add(PlannedTask { surroundings: Some(0), ..task }, []);
            }
            let solve = Work::Solve(SolveWork { instance, vertex_count: 3, alone: false });
            let output = Some(Output::Solution { instance });
            graph.add(PlannedTask { output, ..PlannedTask::new(solve, Digest::default(), 3) }, first..first + count);
        }
        graph
    }

    fn sampling() -> Sampling {
        Sampling {
            target: None,
            kernel: Kernel::Occlusion { ray_distance_m: 1.0 },
            rays_per_sample: 32,
            mean_samples_per_face: 2.0,
            density_per_m2: None,
            min_samples_per_face: 2,
            max_samples_per_face: 2,
            back_face_limit: 0.25,
            seed: 0,
            foliage: crate::FoliageMode::default(),
            ground_plane_y_m: None,
            no_skip: std::collections::BTreeSet::new(),
        }
    }

    #[test]
    fn runs_of_inputs_follow_one_another() {
        let graph = graph(&[2, 0, 1]);
        let all: Vec<&[u32]> = (0..7).map(|index| graph.inputs_of(index)).collect();
        assert_eq!(all, [&[][..], &[], &[0, 1], &[], &[], &[4], &[]]);
        assert_eq!(graph.inputs_of(u32::MAX), [0; 0]);
        let mut wrong = graph.clone();
        wrong.tasks[2].inputs_end = 9;
        assert_eq!((wrong.inputs_of(2), wrong.inputs_of(3)), (&[][..], &[][..]));
    }

    #[test]
    fn a_key_is_of_all_that_a_result_depends_on() {
        let graph = graph(&[1]);
        let [a, b] = [b"a", b"b"].map(|bytes| Digest::of(bytes));
        let (trace, solve) = (&graph.tasks[0], &graph.tasks[1]);
        let keys = [
            graph.key(trace, &[]),
            graph.key(&PlannedTask { family: a, ..trace.clone() }, &[]),
            TaskGraph { surroundings: vec![a], ..graph.clone() }.key(trace, &[]),
            graph.key(trace, &[a]),
            graph.key(solve, &[]),
            graph.key(solve, &[a]),
            graph.key(solve, &[b]),
            graph.key(solve, &[a, b]),
            graph.key(solve, &[b, a]),
            graph.key(&PlannedTask { family: a, ..solve.clone() }, &[b]),
        ];
        let mut distinct = keys.to_vec();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), keys.len());
        // Where it is and what it costs make no difference.
        let elsewhere = PlannedTask { cost: 9, inputs_end: 7, output: None, ..solve.clone() };
        assert_eq!(graph.key(&elsewhere, &[a]), graph.key(solve, &[a]));
    }

    /// Stores answer by these keys: where they change, everything is baked anew.
    #[test]
    fn keys_are_made_as_they_were() {
        let graph = graph(&[1]);
        let root = graph.surroundings[0];
        let trace = DigestBuilder::new("kiln trace").digest(&graph.tasks[0].family).digest(&root).finish();
        assert_eq!(graph.key(&graph.tasks[0], &[]), TaskKey(trace));
        let solve = DigestBuilder::new("kiln solve").digest(&graph.tasks[1].family).digest(&root).finish();
        assert_eq!(graph.key(&graph.tasks[1], &[root]), TaskKey(solve));
    }

    #[test]
    fn only_what_traces_counts_rays() {
        let graph = graph(&[1]);
        assert_eq!(graph.tasks.iter().map(PlannedTask::rays).collect::<Vec<_>>(), [64, 0]);
        assert_eq!(graph.tasks[1].work.kind(), TaskKind::Solve);
    }

    #[test]
    fn tasks_are_small() {
        assert!(size_of::<PlannedTask>() <= 96, "a level has millions of them");
    }
}
