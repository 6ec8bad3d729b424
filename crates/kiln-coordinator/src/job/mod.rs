//! A job: one bake, as a pure state machine. It is told what has happened and answers with the next steps; it
//! neither waits nor reads nor writes.

pub(crate) mod answer;
mod baking;
mod phase;
mod progress;
mod view;

pub(crate) use answer::{Answer, answer_key, failure_key};
pub(crate) use baking::{Baking, Progressed};
pub(crate) use phase::{Ended, Ending, Exporting, Outcome, Phase, Planning, Success, Waiting};
pub(crate) use progress::{Effort, Parts, Progress};

use crate::{check::Expect, events::EventLog};
use kiln_core::{
    Digest, ExportSpec, GraphError, JobId, Lane, Output, PlanSpec, PlannedTask, TaskGraph, TaskKey, TaskKind, TaskSpec,
    Warning, WorkSpec,
};
use kiln_proto::v1;
use kiln_schedule::Requirements;
use std::sync::Arc;

/// Warnings that clients are shown: they and their texts fit into a message.
const WARNINGS: usize = 500;

/// Times that a job begins anew because the store lost something.
const RESTARTS: u32 = 3;

/// A task's place in its job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Node {
    Import,
    Plan,
    /// A task of the graph.
    Work {
        kind: TaskKind,
        /// Index into [`TaskGraph::tasks`].
        index: u32,
    },
    Export,
}

impl Node {
    pub(crate) fn kind(self) -> TaskKind {
        match self {
            Self::Import => TaskKind::Import,
            Self::Plan => TaskKind::Plan,
            Self::Work { kind, .. } => kind,
            Self::Export => TaskKind::Export,
        }
    }
}

/// What is to be done next for a job.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Step {
    /// Ask the store for the whole answer.
    LookUpAnswer(TaskKey),
    /// Ask the store for the results of tasks, and run those that it does not have.
    LookUp(Vec<Node>),
    /// Read a task graph.
    ReadGraph(Digest),
    /// Store the list of outputs.
    StoreOutputs(Vec<(Output, Digest)>),
    /// Read the summary of what came out.
    ReadBaked(Digest),
}

/// A task as it is leased and checked.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Task {
    pub(crate) key: TaskKey,
    pub(crate) spec: TaskSpec,
    pub(crate) cost: u64,
    pub(crate) needs: Requirements,
    pub(crate) locality: Digest,
    pub(crate) expect: Expect,
}

/// What was submitted.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    pub(crate) id: JobId,
    pub(crate) request_id: String,
    /// Digest of the request: of an artefact that holds it.
    pub(crate) payload: Digest,
    /// Digest of the source manifest.
    pub(crate) source: Digest,
    pub(crate) backend: v1::Backend,
    pub(crate) priority: i32,
    pub(crate) name: String,
    pub(crate) tenant: String,
    pub(crate) submitted_unix_ms: u64,
    /// Results that the store has are taken, and not made again.
    pub(crate) skips_unchanged: bool,
}

/// One bake.
#[derive(Debug)]
pub(crate) struct Job {
    pub(crate) order: Order,
    pub(crate) lane: Option<Lane>,
    pub(crate) paused: bool,
    /// Left by an earlier coordinator and not to be touched by this one.
    pub(crate) dormant: bool,
    pub(crate) phase: Phase,
    pub(crate) progress: Progress,
    pub(crate) warnings: Vec<v1::Warning>,
    restarts: u32,
    pub(crate) events: Arc<EventLog>,
}

impl Job {
    pub(crate) fn new(order: Order, events: EventLog) -> Self {
        Self {
            order,
            lane: None,
            paused: false,
            dormant: false,
            phase: Phase::Waiting(Waiting::default()),
            progress: Progress::default(),
            warnings: Vec::new(),
            restarts: 0,
            events: Arc::new(events),
        }
    }

    /// Whether nothing more will be done for the job.
    pub(crate) fn is_over(&self) -> bool {
        matches!(self.phase, Phase::Ending(_) | Phase::Ended(_))
    }

    /// The lane is decided.
    pub(crate) fn start(&mut self, lane: Lane) -> Step {
        let key = answer_key(self.order.source, &lane);
        self.lane = Some(lane);
        self.phase = Phase::Answering;
        Step::LookUpAnswer(key)
    }

    /// Something that finished tasks had stored is gone: the job goes through all of them again, finds what is
    /// still there, and makes anew what is not. Not for ever: false after the last time.
    pub(crate) fn restart(&mut self) -> bool {
        if self.restarts == RESTARTS || self.is_over() || matches!(self.phase, Phase::Waiting(_)) {
            return false;
        }
        self.restarts += 1;
        self.progress = Progress::default();
        self.phase = Phase::Answering;
        true
    }

    /// The whole answer is not known.
    pub(crate) fn no_answer(&mut self) -> Vec<Step> {
        if !matches!(self.phase, Phase::Answering) {
            return Vec::new();
        }
        self.phase = Phase::Importing;
        vec![Step::LookUp(vec![Node::Import])]
    }

    /// A task's result is there, for the first time.
    pub(crate) fn done(&mut self, node: Node, result: Digest) -> Vec<Step> {
        match (&mut self.phase, node) {
            (Phase::Importing, Node::Import) => {
                self.phase = Phase::Planning(Planning { level: result });
                vec![Step::LookUp(vec![Node::Plan])]
            }
            (Phase::Planning(_), Node::Plan) => vec![Step::ReadGraph(result)],
            (Phase::Baking(baking), Node::Work { index, .. }) => match baking.done(index, result) {
                Progressed::Ready(nodes) if nodes.is_empty() => Vec::new(),
                Progressed::Ready(nodes) => vec![Step::LookUp(nodes)],
                Progressed::Finished => vec![Step::StoreOutputs(baking.outputs())],
            },
            (Phase::Exporting(_), Node::Export) => vec![Step::ReadBaked(result)],
            _ => Vec::new(),
        }
    }

    /// The task graph was read.
    pub(crate) fn planned(&mut self, graph: TaskGraph) -> Result<Vec<Step>, GraphError> {
        let Phase::Planning(planning) = &self.phase else { return Ok(Vec::new()) };
        self.warnings = shown(&graph.warnings);
        let baking = Baking::new(planning.level, graph)?;
        let steps = match baking.is_finished() {
            true => vec![Step::StoreOutputs(Vec::new())],
            false => vec![Step::LookUp(baking.first())],
        };
        // Tasks that wait for others are counted now, so that the totals are right from the start.
        for task in &baking.graph.tasks {
            self.progress.planned(task.work.kind(), task.rays());
        }
        self.phase = Phase::Baking(Box::new(baking));
        Ok(steps)
    }

    /// The list of outputs was stored.
    pub(crate) fn listed(&mut self, outputs: Digest) -> Vec<Step> {
        let Phase::Baking(baking) = &self.phase else { return Vec::new() };
        self.phase = Phase::Exporting(Exporting { level: baking.graph.level, outputs });
        vec![Step::LookUp(vec![Node::Export])]
    }

    /// The whole answer, or the export's summary, was read.
    pub(crate) fn succeed(&mut self, success: Success) {
        // The export's summary repeats import's warnings and adds its own.
        self.warnings = shown(&success.baked.summary.warnings);
        self.end(Outcome::Succeeded(Box::new(success)));
    }

    /// The outcome is decided, unless one was before; tells whether it counts.
    pub(crate) fn end(&mut self, outcome: Outcome) -> bool {
        if self.is_over() {
            return false;
        }
        let shown = self.phase.shown();
        self.phase = Phase::Ending(Ending { outcome, shown, retry_at_ms: None });
        true
    }

    /// A task of the job, as long as the job is where the task belongs and its inputs are known.
    pub(crate) fn task(&self, node: Node) -> Option<Task> {
        let lane = self.lane.as_ref()?;
        let source = self.order.source;
        let whole = |spec: TaskSpec, locality, expect| Task {
            key: spec.whole_key(),
            spec,
            cost: 1,
            needs: Requirements::default(),
            locality,
            expect,
        };
        match (&self.phase, node) {
            (Phase::Importing, Node::Import) => Some(whole(TaskSpec::Import { source }, source, Expect::Level)),
            (Phase::Planning(Planning { level }), Node::Plan) => {
                let spec = TaskSpec::Plan(PlanSpec { level: *level, lane: lane.clone() });
                Some(whole(spec, *level, Expect::Graph { level: *level }))
            }
            (Phase::Baking(baking), Node::Work { index, .. }) => work(baking, index, lane),
            (Phase::Exporting(Exporting { level, outputs }), Node::Export) => {
                let spec = TaskSpec::Export(ExportSpec { source, level: *level, outputs: *outputs });
                Some(whole(spec, *level, Expect::Baked { level: *level }))
            }
            _ => None,
        }
    }

    /// Rays that a task may take: none unless it traces.
    pub(crate) fn rays(&self, node: Node) -> u64 {
        self.planned_task(node).map_or(0, PlannedTask::rays)
    }

    /// What leases are filled by, in units of the task's kind.
    pub(crate) fn cost(&self, node: Node) -> Option<u64> {
        self.planned_task(node).map(|task| task.cost)
    }

    fn planned_task(&self, node: Node) -> Option<&PlannedTask> {
        match (&self.phase, node) {
            (Phase::Baking(baking), Node::Work { index, .. }) => baking.graph.tasks.get(index as usize),
            _ => None,
        }
    }
}

/// A task of the graph, once its inputs are there.
fn work(baking: &Baking, index: u32, lane: &Lane) -> Option<Task> {
    let graph = &baking.graph;
    let planned = graph.tasks.get(index as usize)?;
    let inputs = baking.inputs(index)?;
    let work = planned.work.clone();
    let channels = graph.sampling.kernel.channel_count();
    Some(Task {
        key: graph.key(planned, &inputs),
        spec: TaskSpec::Work(WorkSpec { level: graph.level, work: work.clone(), inputs }),
        cost: planned.cost,
        needs: Requirements { lane: lane.needed_by(work.kind()).map(str::to_owned), memory_bytes: 0 },
        locality: graph.level,
        expect: Expect::Work { work, channels },
    })
}

/// Warnings as shown to clients: the first, and how many more there are. A report has them all.
pub(crate) fn shown(warnings: &[Warning]) -> Vec<v1::Warning> {
    let mut shown: Vec<v1::Warning> = warnings.iter().take(WARNINGS).map(Into::into).collect();
    if warnings.len() > WARNINGS {
        let count = (warnings.len() - WARNINGS) as u64;
        let message = format!("{count} more warnings are in the report");
        shown.push(v1::Warning { code: "more_warnings".into(), subject: String::new(), message, count });
    }
    shown
}

#[cfg(test)]
pub(crate) mod tests;
