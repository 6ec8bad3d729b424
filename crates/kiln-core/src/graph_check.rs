//! Whether a task graph makes sense. It comes from a worker, which may be broken or lie.

use crate::{Digest, MAX_INPUTS, Output, PlannedTask, TaskGraph, TaskKind, WorkError};

/// A task graph whose parts do not fit together.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the task graph of the level {level} makes no sense: {problem}; this is a bug of the plan's code, please report it"
)]
pub struct GraphError {
    /// The level that it should be of.
    pub level: Digest,
    /// What does not fit.
    pub problem: GraphProblem,
}

/// What does not fit in a task graph. Tasks are named by their index.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum GraphProblem {
    /// It is of another level.
    #[error("it is of the level {0}")]
    OtherLevel(Digest),
    /// It has more of something than can be numbered.
    #[error("it has {found} {what}, and only 2^32 - 1 can be numbered")]
    TooLarge {
        /// What there are too many of.
        what: &'static str,
        /// How many there are.
        found: usize,
    },
    /// A task's work cannot be done.
    #[error("task {task} ({kind:?}): {error}")]
    BadWork {
        /// The task.
        task: u32,
        /// Its kind.
        kind: TaskKind,
        /// What is wrong with it.
        error: WorkError,
    },
    /// A run of inputs is not there, or ends before it begins.
    #[error("task {task} has the inputs {begin} to {end}, of {count}")]
    NoSuchInputs {
        /// The task.
        task: u32,
        /// Where its run begins.
        begin: u32,
        /// Where it ends.
        end: u32,
        /// Inputs of the graph.
        count: usize,
    },
    /// Inputs that no task has.
    #[error("the inputs from {end} on, of {count}, belong to no task")]
    StrayInputs {
        /// Where the last task's run ends.
        end: u32,
        /// Inputs of the graph.
        count: usize,
    },
    /// A task takes more than one message holds.
    #[error("task {task} has {found} inputs, more than {MAX_INPUTS}")]
    TooManyInputs {
        /// The task.
        task: u32,
        /// How many it has.
        found: usize,
    },
    /// A task takes what does not come before it: there may be a cycle, or no such task.
    #[error("task {task} takes the result of task {input}, which does not come before it")]
    NotEarlier {
        /// The task.
        task: u32,
        /// Its input.
        input: u32,
    },
    /// A task takes what it has no use for.
    #[error("task {task} ({kind:?}) takes the result of task {input} ({input_kind:?}), which is not for it")]
    WrongInput {
        /// The task.
        task: u32,
        /// Its kind.
        kind: TaskKind,
        /// Its input.
        input: u32,
        /// The input's kind.
        input_kind: TaskKind,
    },
    /// Nothing says what can stop the rays of a task that traces, or something does for one that does not.
    #[error("task {task} ({kind:?}) must have surroundings if it traces, and only then")]
    Surroundings {
        /// The task.
        task: u32,
        /// Its kind.
        kind: TaskKind,
    },
    /// Surroundings that are not there.
    #[error("task {task} has the surroundings {surroundings}, of {count}")]
    NoSuchSurroundings {
        /// The task.
        task: u32,
        /// Their index.
        surroundings: u32,
        /// Surroundings of the graph.
        count: usize,
    },
    /// A result that is of no use.
    #[error("the result of task {task} ({kind:?}) is neither an output nor taken by another task")]
    Unused {
        /// The task.
        task: u32,
        /// Its kind.
        kind: TaskKind,
    },
    /// An output comes twice.
    #[error("two tasks give {0:?}")]
    SameOutput(Output),
}

pub(crate) fn check(graph: &TaskGraph, level: Digest) -> Result<(), GraphError> {
    check_all(graph, level).map_err(|problem| GraphError { level, problem })
}

fn check_all(graph: &TaskGraph, level: Digest) -> Result<(), GraphProblem> {
    if graph.level != level {
        return Err(GraphProblem::OtherLevel(graph.level));
    }
    check_count("tasks", graph.tasks.len())?;
    check_count("inputs", graph.inputs.len())?;
    check_count("surroundings", graph.surroundings.len())?;
    let mut is_needed: Vec<bool> = graph.tasks.iter().map(|task| task.output.is_some()).collect();
    let (mut begin, count) = (0, graph.inputs.len());
    for (index, task) in (0..).zip(&graph.tasks) {
        let end = task.inputs_end;
        let inputs = graph.inputs.get(begin as usize..end as usize);
        let inputs = inputs.ok_or(GraphProblem::NoSuchInputs { task: index, begin, end, count })?;
        let kind = task.work.kind();
        task.work.check().map_err(|error| GraphProblem::BadWork { task: index, kind, error })?;
        check_surroundings(graph, index, task)?;
        check_inputs(graph, index, task, inputs)?;
        inputs.iter().for_each(|&input| is_needed[input as usize] = true);
        begin = end;
    }
    if begin as usize != count {
        return Err(GraphProblem::StrayInputs { end: begin, count });
    }
    if let Some(task) = is_needed.iter().position(|is_needed| !is_needed) {
        return Err(GraphProblem::Unused { task: task as u32, kind: graph.tasks[task].work.kind() });
    }
    check_outputs(graph)
}

fn check_count(what: &'static str, found: usize) -> Result<(), GraphProblem> {
    if u32::try_from(found).is_ok() { Ok(()) } else { Err(GraphProblem::TooLarge { what, found }) }
}

fn check_surroundings(graph: &TaskGraph, index: u32, task: &PlannedTask) -> Result<(), GraphProblem> {
    let kind = task.work.kind();
    if task.surroundings.is_some() != kind.traces() {
        return Err(GraphProblem::Surroundings { task: index, kind });
    }
    let count = graph.surroundings.len();
    match task.surroundings.filter(|&surroundings| surroundings as usize >= count) {
        Some(surroundings) => Err(GraphProblem::NoSuchSurroundings { task: index, surroundings, count }),
        None => Ok(()),
    }
}

fn check_inputs(graph: &TaskGraph, index: u32, task: &PlannedTask, inputs: &[u32]) -> Result<(), GraphProblem> {
    if inputs.len() > MAX_INPUTS {
        return Err(GraphProblem::TooManyInputs { task: index, found: inputs.len() });
    }
    for &input in inputs {
        if input >= index {
            return Err(GraphProblem::NotEarlier { task: index, input });
        }
        let other = &graph.tasks[input as usize].work;
        if !task.work.takes(other) {
            let (kind, input_kind) = (task.work.kind(), other.kind());
            return Err(GraphProblem::WrongInput { task: index, kind, input, input_kind });
        }
    }
    Ok(())
}

fn check_outputs(graph: &TaskGraph) -> Result<(), GraphProblem> {
    let mut outputs: Vec<Output> = graph.tasks.iter().filter_map(|task| task.output).collect();
    outputs.sort_unstable();
    match outputs.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(GraphProblem::SameOutput(pair[0])),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Work, codec, graph::tests::graph};
    use proptest::prelude::*;

    fn level() -> Digest {
        Digest::of(b"level")
    }

    #[test]
    fn graphs_that_fit_together_are_accepted() {
        for pieces in [&[][..], &[0], &[2, 0, 1], &[1; 50]] {
            graph(pieces).check(level()).unwrap();
        }
        // The same input twice is odd, but harmless.
        let mut twice = graph(&[2]);
        twice.inputs.push(0);
        twice.tasks[2].inputs_end = 3;
        twice.check(level()).unwrap();
    }

    /// Tasks 0 and 1 are pieces and 2 is their solve; 3 is a piece and 4 its solve.
    fn problem(change: fn(&mut TaskGraph)) -> GraphProblem {
        let mut graph = graph(&[2, 1]);
        change(&mut graph);
        graph.check(level()).unwrap_err().problem
    }

    #[test]
    fn a_graph_is_of_its_level() {
        let other = Digest::of(b"other");
        let error = graph(&[2, 1]).check(other).unwrap_err();
        assert_eq!(error, GraphError { level: other, problem: GraphProblem::OtherLevel(level()) });
        assert!(error.to_string().contains("is of the level"));
    }

    #[test]
    fn runs_of_inputs_must_be_there_and_cover_them() {
        use GraphProblem::{NoSuchInputs, StrayInputs};
        let found = problem(|g| g.tasks[4].inputs_end = 4);
        assert_eq!(found, NoSuchInputs { task: 4, begin: 2, end: 4, count: 3 });
        let found = problem(|g| g.tasks[3].inputs_end = 1);
        assert_eq!(found, NoSuchInputs { task: 3, begin: 2, end: 1, count: 3 });
        assert!(matches!(problem(|g| g.tasks[0].inputs_end = u32::MAX), NoSuchInputs { task: 0, .. }));
        assert_eq!(problem(|g| g.inputs.push(0)), StrayInputs { end: 3, count: 4 });
    }

    #[test]
    fn work_can_be_done() {
        let problem = problem(|g| {
            if let Work::Trace(piece) = &mut g.tasks[3].work {
                piece.face_count = 0;
            }
        });
        assert!(matches!(problem, GraphProblem::BadWork { task: 3, kind: TaskKind::Trace, .. }), "{problem}");
        assert!(problem.to_string().contains("face_count is 0"));
    }

    #[test]
    fn inputs_come_before_the_task_and_are_for_it() {
        use GraphProblem::{NotEarlier, WrongInput};
        let (solve, trace) = (TaskKind::Solve, TaskKind::Trace);
        assert_eq!(problem(|g| g.inputs[0] = 2), NotEarlier { task: 2, input: 2 });
        assert_eq!(problem(|g| g.inputs[0] = 3), NotEarlier { task: 2, input: 3 });
        assert_eq!(problem(|g| g.inputs[0] = u32::MAX), NotEarlier { task: 2, input: u32::MAX });
        let of_another_kind = WrongInput { task: 4, kind: solve, input: 2, input_kind: solve };
        assert_eq!(problem(|g| g.inputs[2] = 2), of_another_kind);
        let of_another_instance = WrongInput { task: 4, kind: solve, input: 1, input_kind: trace };
        assert_eq!(problem(|g| g.inputs[2] = 1), of_another_instance);
        let traced_from_results = problem(|g| {
            g.inputs.insert(0, 0);
            g.tasks[1..].iter_mut().for_each(|task| task.inputs_end += 1);
        });
        assert_eq!(traced_from_results, WrongInput { task: 1, kind: trace, input: 0, input_kind: trace });
    }

    #[test]
    fn a_task_takes_no_more_than_a_message_holds() {
        let most = MAX_INPUTS as u32;
        graph(&[most]).check(level()).unwrap();
        let problem = graph(&[most + 1]).check(level()).unwrap_err().problem;
        assert_eq!(problem, GraphProblem::TooManyInputs { task: most + 1, found: MAX_INPUTS + 1 });
    }

    #[test]
    fn what_traces_has_surroundings_and_nothing_else() {
        let missing = GraphProblem::Surroundings { task: 3, kind: TaskKind::Trace };
        assert_eq!(problem(|g| g.tasks[3].surroundings = None), missing);
        let needless = GraphProblem::Surroundings { task: 2, kind: TaskKind::Solve };
        assert_eq!(problem(|g| g.tasks[2].surroundings = Some(0)), needless);
        let absent = GraphProblem::NoSuchSurroundings { task: 1, surroundings: 1, count: 1 };
        assert_eq!(problem(|g| g.tasks[1].surroundings = Some(1)), absent);
    }

    #[test]
    fn every_result_is_of_use_and_no_output_comes_twice() {
        let unused = |task, kind| GraphProblem::Unused { task, kind };
        assert_eq!(problem(|g| g.tasks[4].output = None), unused(4, TaskKind::Solve));
        let piece_left_out = problem(|g| {
            g.inputs.remove(0);
            g.tasks[2..].iter_mut().for_each(|task| task.inputs_end -= 1);
        });
        assert_eq!(piece_left_out, unused(0, TaskKind::Trace));
        let twice = GraphProblem::SameOutput(Output::Solution { instance: 0 });
        assert_eq!(problem(|g| g.tasks[4].output = g.tasks[2].output), twice);
    }

    #[test]
    fn numbers_have_an_end() {
        assert_eq!(check_count("tasks", u32::MAX as usize), Ok(()));
        let found = u32::MAX as usize + 1;
        assert_eq!(check_count("tasks", found), Err(GraphProblem::TooLarge { what: "tasks", found }));
    }

    proptest! {
        /// Whatever a damaged graph holds, checking it and asking it for inputs and keys ends well.
        #[test]
        fn damaged_graphs_never_panic(at in any::<prop::sample::Index>(), to in any::<u8>()) {
            let mut bytes = codec::encode(&graph(&[2, 0, 3]));
            let at = at.index(bytes.len());
            bytes[at] = to;
            if let Ok(graph) = codec::decode::<TaskGraph>("a task graph", &bytes) {
                let checked = graph.check(level());
                for (index, task) in (0..).zip(&graph.tasks) {
                    let inputs = graph.inputs_of(index);
                    graph.key(task, &[]);
                    prop_assert!(checked.is_err() || inputs.iter().all(|&input| input < index));
                }
            }
        }

        /// The checks find any single index that is led astray: that of another piece of the instance leaves one unused.
        #[test]
        fn no_stray_index_is_accepted(at in 0usize..6, to in prop_oneof![0u32..12, any::<u32>()]) {
            let mut graph = graph(&[1, 2, 3]);
            let before = std::mem::replace(&mut graph.inputs[at], to);
            prop_assert_eq!(graph.check(level()).is_ok(), to == before);
        }
    }
}
