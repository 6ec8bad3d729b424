//! Jobs and their tasks, and the queues in which tasks wait.

use crate::{AttemptLog, JobSpec, LeaseId, ReadyTask, Requirements, TaskId};
use kiln_core::{Digest, TaskKind};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The tasks of a job that are alike for every worker.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ClassKey {
    pub(crate) kind: TaskKind,
    /// With memory rounded up, by a sixteenth at most, so that classes stay few.
    pub(crate) needs: Requirements,
    pub(crate) locality: Digest,
}

/// Like tasks of a job that wait.
#[derive(Debug)]
pub(crate) struct Class {
    pub(crate) key: ClassKey,
    /// Those that go into leases together.
    pub(crate) fresh: BTreeSet<TaskId>,
    /// Sum of the costs of these.
    pub(crate) fresh_cost: u64,
    /// Those that go alone, after a failure or repeated loss of their worker: so that others do not suffer with them.
    pub(crate) alone: BTreeSet<TaskId>,
}

impl Class {
    pub(crate) fn waiting(&self) -> usize {
        self.fresh.len() + self.alone.len()
    }
}

/// Where a task is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TaskState {
    /// In its class's queue.
    Waiting,
    /// Handed back or failed: goes into the queue at this time.
    Delayed(u64),
    /// In a lease, or in two.
    Leased(LeaseId, Option<LeaseId>),
    /// Its result was accepted.
    Done,
}

/// A task of a job.
#[derive(Debug)]
pub(crate) struct Task {
    pub(crate) job: kiln_core::JobId,
    pub(crate) class: usize,
    pub(crate) cost: u64,
    pub(crate) state: TaskState,
    /// Leases it was in.
    pub(crate) leased: u32,
    /// Failures, each with its worker.
    pub(crate) failures: Vec<AttemptLog>,
    /// Workers lost with it in hand.
    pub(crate) losses: Vec<AttemptLog>,
    /// Times it was handed back for want of room.
    pub(crate) returns: u32,
}

impl Task {
    /// Whether it is to be leased alone.
    pub(crate) fn goes_alone(&self) -> bool {
        !self.failures.is_empty() || self.losses.len() > 1
    }

    /// All attempts that came to nothing.
    pub(crate) fn attempts(&self) -> Vec<AttemptLog> {
        self.failures.iter().chain(&self.losses).cloned().collect()
    }
}

/// A job that is not over.
#[derive(Debug)]
pub(crate) struct Job {
    pub(crate) spec: JobSpec,
    pub(crate) paused: bool,
    pub(crate) classes: Vec<Class>,
    class_index: BTreeMap<ClassKey, usize>,
    /// Every task that was announced, done or not.
    pub(crate) tasks: BTreeSet<TaskId>,
    pub(crate) leases: BTreeSet<LeaseId>,
    /// Tasks that wait, without those that are delayed.
    pub(crate) waiting: usize,
    /// When it was added or last got a lease: how long it has starved.
    pub(crate) served_ms: u64,
    /// Since when no worker fits some waiting task.
    pub(crate) no_fit_since_ms: Option<u64>,
    pub(crate) pace: BTreeMap<TaskKind, Pace>,
}

impl Job {
    pub(crate) fn new(spec: JobSpec, now_ms: u64) -> Self {
        Self {
            spec,
            paused: false,
            classes: Vec::new(),
            class_index: BTreeMap::new(),
            tasks: BTreeSet::new(),
            leases: BTreeSet::new(),
            waiting: 0,
            served_ms: now_ms,
            no_fit_since_ms: None,
            pace: BTreeMap::new(),
        }
    }

    /// The class of a task, made where it is the first of its kind.
    pub(crate) fn class_of(&mut self, ready: &ReadyTask) -> usize {
        let needs =
            Requirements { lane: ready.needs.lane.clone(), memory_bytes: round_memory(ready.needs.memory_bytes) };
        let key = ClassKey { kind: ready.kind, needs, locality: ready.locality };
        if let Some(&class) = self.class_index.get(&key) {
            return class;
        }
        let class = self.classes.len();
        self.class_index.insert(key.clone(), class);
        self.classes.push(Class { key, fresh: BTreeSet::new(), fresh_cost: 0, alone: BTreeSet::new() });
        class
    }

    /// Puts a task into its queue.
    pub(crate) fn enqueue(&mut self, id: TaskId, task: &Task) {
        let class = &mut self.classes[task.class];
        let new = if task.goes_alone() {
            class.alone.insert(id)
        } else {
            class.fresh_cost = class.fresh_cost.saturating_add(task.cost);
            class.fresh.insert(id)
        };
        self.waiting += usize::from(new);
    }

    /// Takes a task out of its queue.
    pub(crate) fn dequeue(&mut self, id: TaskId, task: &Task) {
        let class = &mut self.classes[task.class];
        let removed = if class.fresh.remove(&id) {
            class.fresh_cost = class.fresh_cost.saturating_sub(task.cost);
            true
        } else {
            class.alone.remove(&id)
        };
        self.waiting -= usize::from(removed);
    }

    /// Cost of all tasks of a kind that wait to go into leases together.
    pub(crate) fn fresh_cost(&self, kind: TaskKind) -> u64 {
        let classes = self.classes.iter().filter(|class| class.key.kind == kind);
        classes.fold(0, |sum, class| sum.saturating_add(class.fresh_cost))
    }
}

/// Rounds up to the next sixteenth of a power of two.
fn round_memory(bytes: u64) -> u64 {
    let step = 1 << bytes.checked_ilog2().unwrap_or(0).saturating_sub(4);
    bytes.checked_next_multiple_of(step).unwrap_or(u64::MAX)
}

/// How long the last finished leases of a kind took for each unit of cost.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    ms_per_cost: VecDeque<f64>,
}

impl Pace {
    const WINDOW: usize = 64;
    const LEAST: usize = 3;

    pub(crate) fn add(&mut self, elapsed_ms: u64, cost: u64) {
        self.ms_per_cost.push_back(elapsed_ms as f64 / cost.max(1) as f64);
        if self.ms_per_cost.len() > Self::WINDOW {
            self.ms_per_cost.pop_front();
        }
    }

    /// A quantile, by nearest rank; none from too few leases.
    pub(crate) fn quantile(&self, quantile: f64) -> Option<f64> {
        if self.ms_per_cost.len() < Self::LEAST {
            return None;
        }
        let mut sorted: Vec<f64> = self.ms_per_cost.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let rank = (quantile * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.clamp(1, sorted.len()) - 1).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_rounded_up_a_little() {
        for bytes in [0, 1, 15, 16, 17, 1000, 5 << 30, (5 << 30) + 1, u64::MAX] {
            let rounded = round_memory(bytes);
            assert!(rounded >= bytes && rounded - bytes <= bytes / 16, "{bytes} to {rounded}");
        }
        let many: BTreeSet<_> = ((1u64 << 30)..(2 << 30)).step_by(1 << 20).map(round_memory).collect();
        assert!(many.len() <= 17);
    }

    #[test]
    fn quantiles_are_those_of_the_nearest_rank() {
        let mut pace = Pace::default();
        assert_eq!(pace.quantile(0.75), None);
        (1..=8).for_each(|ms| pace.add(ms, 1));
        assert_eq!(pace.quantile(0.75), Some(6.0));
        assert_eq!(pace.quantile(1.0), Some(8.0));
        assert_eq!(pace.quantile(0.0), Some(1.0));
        (0..200).for_each(|_| pace.add(100, 50));
        assert_eq!(pace.quantile(0.5), Some(2.0));
    }
}
