//! The life of a job, one type for each state.
//!
//! ```text
//!  Waiting ──lane──▶ Answering ──known before──────────────────────────────────┐
//!                        │ not known                                           ▼
//!                        ▼                                                  Ending ──durable──▶ Ended
//!                    Importing ──level──▶ Planning ──graph──▶ Baking           ▲
//!                                                               │ all solved   │
//!                                                               ▼              │
//!                                                           Exporting ──baked──┘
//! ```
//!
//! From every state but the last two a failure or a cancellation leads to `Ending`. Within `Baking` trace and solve
//! overlap: an instance is solved as soon as all of its pieces are traced.

use super::Node;
use kiln_core::{Baked, Digest, TaskGraph};
use kiln_proto::{limits, v1};

/// Waits for a worker that decides the lane.
#[derive(Debug, Default)]
pub(crate) struct Waiting {
    /// Since when workers are there and none of them fits, milliseconds of the coordinator's clock.
    pub(crate) unfit_since_ms: Option<u64>,
}

/// Its tasks between import and plan run.
#[derive(Debug)]
pub(crate) struct Planning {
    pub(crate) level: Digest,
}

/// A plan whose parts do not fit together.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("the plan of the level {level} makes no sense: {problem}; this is a bug of the plan's code")]
pub(crate) struct GraphError {
    level: Digest,
    problem: String,
}

/// Pieces are traced and instances solved.
#[derive(Debug)]
pub(crate) struct Baking {
    pub(crate) graph: TaskGraph,
    /// Moments of each piece.
    moments: Vec<Option<Digest>>,
    /// The solve task of each piece.
    solve_of_piece: Vec<u32>,
    /// Pieces not yet traced of each solve task.
    missing: Vec<u32>,
    /// Solution of each solve task.
    solutions: Vec<Option<Digest>>,
    unsolved: usize,
}

impl Baking {
    /// Checks that the graph's parts fit together: every piece belongs to the solve task of its instance.
    pub(crate) fn new(level: Digest, graph: TaskGraph) -> Result<Self, GraphError> {
        let error = |problem: String| GraphError { level, problem };
        if graph.level != level {
            return Err(error(format!("it is of the level {}", graph.level)));
        }
        let mut solve_of_piece = vec![u32::MAX; graph.trace.len()];
        for (s, solve) in graph.solve.iter().enumerate() {
            let end = solve.first_trace as usize + solve.trace_count as usize;
            let pieces = solve_of_piece.get_mut(solve.first_trace as usize..end);
            let pieces = pieces.ok_or_else(|| error(format!("solve task {s} has pieces that do not exist")))?;
            if pieces.len() > limits::PIECES {
                return Err(error(format!("solve task {s} has {} pieces", pieces.len())));
            }
            if pieces.iter().any(|&other| other != u32::MAX) {
                return Err(error(format!("solve task {s} shares pieces with another")));
            }
            pieces.fill(s as u32);
            if graph.trace[solve.first_trace as usize..end].iter().any(|task| task.instance != solve.instance) {
                return Err(error(format!("solve task {s} has pieces of another instance")));
            }
        }
        if let Some(piece) = solve_of_piece.iter().position(|&solve| solve == u32::MAX) {
            return Err(error(format!("piece {piece} belongs to no solve task")));
        }
        Ok(Self {
            moments: vec![None; graph.trace.len()],
            solve_of_piece,
            missing: graph.solve.iter().map(|solve| solve.trace_count).collect(),
            solutions: vec![None; graph.solve.len()],
            unsolved: graph.solve.len(),
            graph,
        })
    }

    /// The tasks that wait for nothing: all pieces, and instances without any.
    pub(crate) fn first(&self) -> Vec<Node> {
        let traces = (0..self.graph.trace.len()).map(|i| Node::Trace(i as u32));
        let solves = self.missing.iter().enumerate().filter(|(_, missing)| **missing == 0);
        traces.chain(solves.map(|(i, _)| Node::Solve(i as u32))).collect()
    }

    /// A piece is traced; gives the solve task that was waiting for nothing else.
    pub(crate) fn traced(&mut self, piece: u32, moments: Digest) -> Option<Node> {
        if self.moments[piece as usize].replace(moments).is_some() {
            return None;
        }
        let solve = self.solve_of_piece[piece as usize];
        let missing = &mut self.missing[solve as usize];
        *missing -= 1;
        (*missing == 0).then_some(Node::Solve(solve))
    }

    /// An instance is solved; true when it was the last.
    pub(crate) fn solved(&mut self, solve: u32, solution: Digest) -> bool {
        if self.solutions[solve as usize].replace(solution).is_none() {
            self.unsolved -= 1;
        }
        self.unsolved == 0
    }

    /// Whether nothing is left to solve.
    pub(crate) fn is_solved(&self) -> bool {
        self.unsolved == 0
    }

    /// The moments of a solve task's pieces, in order, once all are there.
    pub(crate) fn inputs(&self, solve: u32) -> Option<Vec<Digest>> {
        let task = &self.graph.solve[solve as usize];
        self.moments[task.first_trace as usize..][..task.trace_count as usize].iter().copied().collect()
    }

    /// Each receiving instance and its solution.
    pub(crate) fn solutions(&self) -> Vec<(u32, Digest)> {
        let solved = self.graph.solve.iter().zip(&self.solutions);
        solved.filter_map(|(task, solution)| Some((task.instance, (*solution)?))).collect()
    }
}

/// The file is written.
#[derive(Debug)]
pub(crate) struct Exporting {
    pub(crate) level: Digest,
    /// Digest of the encoded list of solutions.
    pub(crate) solutions: Digest,
}

/// How a job ends.
#[derive(Clone, Debug)]
pub(crate) enum Outcome {
    Succeeded(Box<Success>),
    Failed(v1::BakeFailure),
    Cancelled,
}

/// What came out.
#[derive(Clone, Debug)]
pub(crate) struct Success {
    /// Digest of the encoded [`Baked`].
    pub(crate) digest: Digest,
    pub(crate) baked: Baked,
    /// The whole answer was known before.
    pub(crate) from_store: bool,
}

/// The outcome is decided and not yet durable.
#[derive(Debug)]
pub(crate) struct Ending {
    pub(crate) outcome: Outcome,
    /// The state that is shown until it is durable.
    pub(crate) shown: v1::BakeState,
    /// When to try again to make it durable, after the store failed.
    pub(crate) retry_at_ms: Option<u64>,
}

/// Over.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) outcome: Outcome,
    /// Milliseconds since 1970.
    pub(crate) at_unix_ms: u64,
}

/// Where a job is.
#[derive(Debug)]
pub(crate) enum Phase {
    Waiting(Waiting),
    /// The store is asked for the whole answer.
    Answering,
    Importing,
    Planning(Planning),
    Baking(Box<Baking>),
    Exporting(Exporting),
    Ending(Ending),
    Ended(Ended),
}

impl Phase {
    /// The state as shown to clients.
    pub(crate) fn shown(&self) -> v1::BakeState {
        match self {
            Self::Waiting(_) | Self::Answering => v1::BakeState::Submitted,
            Self::Importing => v1::BakeState::Importing,
            Self::Planning(_) => v1::BakeState::Planning,
            Self::Baking(_) => v1::BakeState::Baking,
            Self::Exporting(_) => v1::BakeState::Exporting,
            Self::Ending(ending) => ending.shown,
            Self::Ended(ended) => match ended.outcome {
                Outcome::Succeeded(_) => v1::BakeState::Succeeded,
                Outcome::Failed(_) => v1::BakeState::Failed,
                Outcome::Cancelled => v1::BakeState::Cancelled,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::tests::graph;

    #[test]
    fn an_instance_is_ready_when_its_last_piece_is_traced() {
        let mut baking = Baking::new(Digest::of(b"level"), graph(&[2, 0, 1])).unwrap();
        assert_eq!(baking.first(), [Node::Trace(0), Node::Trace(1), Node::Trace(2), Node::Solve(1)]);
        assert_eq!(baking.traced(1, Digest::of(b"1")), None);
        assert_eq!(baking.traced(1, Digest::of(b"1")), None, "a second result changes nothing");
        assert_eq!(baking.inputs(0), None);
        assert_eq!(baking.traced(0, Digest::of(b"0")), Some(Node::Solve(0)));
        assert_eq!(baking.inputs(0), Some(vec![Digest::of(b"0"), Digest::of(b"1")]));
        assert!(!baking.solved(1, Digest::of(b"b")) && !baking.solved(1, Digest::of(b"b")));
        assert_eq!(baking.traced(2, Digest::of(b"2")), Some(Node::Solve(2)));
        assert!(!baking.solved(2, Digest::of(b"c")));
        assert!(baking.solved(0, Digest::of(b"a")));
        let expected = [(0, Digest::of(b"a")), (1, Digest::of(b"b")), (2, Digest::of(b"c"))];
        assert_eq!(baking.solutions(), expected);
    }

    #[test]
    fn graphs_that_make_no_sense_are_refused() {
        let level = Digest::of(b"level");
        let refused = |change: fn(&mut TaskGraph)| {
            let mut graph = graph(&[2, 1]);
            change(&mut graph);
            Baking::new(level, graph).unwrap_err().to_string()
        };
        assert!(refused(|g| g.level = Digest::of(b"other")).contains("is of the level"));
        assert!(refused(|g| g.solve[1].trace_count = 2).contains("do not exist"));
        assert!(refused(|g| g.solve[1].first_trace = u32::MAX).contains("do not exist"));
        assert!(refused(|g| g.solve[1].first_trace = 1).contains("shares pieces"));
        assert!(refused(|g| g.solve[0].trace_count = 1).contains("belongs to no solve task"));
        assert!(refused(|g| g.trace[0].instance = 1).contains("another instance"));
    }
}
