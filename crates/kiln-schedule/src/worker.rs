//! Workers, grouped by what they can do.

use crate::{Capabilities, LeaseId, Requirements, WorkerId, job::ClassKey};
use kiln_core::{Digest, LanePart, TaskKind};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Levels of a worker that are remembered as at hand.
const LEVELS: usize = 4;
/// No worker holds more leases, whatever it asks for.
const MAX_CONCURRENT_LEASES: u32 = 64;

/// Whether a worker can run tasks of a kind with needs.
pub(crate) fn fits(capabilities: &Capabilities, kind: TaskKind, needs: &Requirements) -> bool {
    lacking(capabilities, kind, needs).is_none()
}

/// What a worker lacks, in words.
pub(crate) fn lacking(capabilities: &Capabilities, kind: TaskKind, needs: &Requirements) -> Option<String> {
    if !capabilities.roles.take(kind) {
        let role = if kind.traces() { "trace" } else { "reduce" };
        return Some(format!("does not have the role {role}"));
    }
    let lanes = kind.lane_part().map(|part| match part {
        LanePart::Trace => &capabilities.trace_lanes,
        LanePart::Solve => &capabilities.solve_lanes,
    });
    if let (Some(lanes), Some(lane)) = (lanes, &needs.lane)
        && !lanes.contains(lane)
    {
        let lanes: Vec<_> = lanes.iter().map(String::as_str).collect();
        return Some(format!("runs {} tasks in the lanes [{}], not {lane}", kind.name(), lanes.join(", ")));
    }
    let (has, wants) = (capabilities.memory_bytes, needs.memory_bytes);
    (has < wants).then(|| format!("has {has} bytes of memory for a task, not {wants}"))
}

/// How fast a worker is at a kind of task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Speed {
    pub(crate) cost_per_second: f64,
}

impl Speed {
    /// Counts tasks of a cost that took a time; longer measurements weigh more.
    pub(crate) fn add(known: Option<Self>, cost: f64, seconds: f64, target_seconds: f64) -> Self {
        let measured = cost / seconds;
        let Some(Self { cost_per_second }) = known else { return Self { cost_per_second: measured } };
        let weight = (seconds / (seconds + target_seconds)).clamp(0.05, 0.5);
        Self { cost_per_second: cost_per_second + weight * (measured - cost_per_second) }
    }
}

/// A worker that connected and is not given up.
#[derive(Debug)]
pub(crate) struct Worker {
    pub(crate) capabilities: Capabilities,
    /// When its connection broke, if it is broken.
    pub(crate) disconnected_ms: Option<u64>,
    pub(crate) seen_ms: u64,
    pub(crate) set_aside: bool,
    pub(crate) draining: Option<u64>,
    pub(crate) drained: bool,
    /// Oldest first: leases are run in this order.
    pub(crate) leases: BTreeSet<LeaseId>,
    pub(crate) speed: BTreeMap<TaskKind, Speed>,
    pub(crate) levels: VecDeque<Digest>,
    /// Failures since its last success, and until when it rests after them.
    pub(crate) failures_in_row: u32,
    pub(crate) rests_until_ms: u64,
    /// Tasks it failed that others completed, and the log line of its last failure.
    pub(crate) blamed: u32,
    pub(crate) last_failure: String,
    group: u32,
    /// As what its group has it: available, and open with so many leases.
    counted: bool,
    open_at: Option<usize>,
}

impl Worker {
    /// Whether it would take leases if it had room and time.
    pub(crate) fn is_available(&self) -> bool {
        self.disconnected_ms.is_none() && !self.set_aside && self.draining.is_none()
    }

    /// Notes that tasks of a level were sent to it.
    pub(crate) fn remember_level(&mut self, level: Digest) {
        self.levels.retain(|known| *known != level);
        self.levels.push_back(level);
        if self.levels.len() > LEVELS {
            self.levels.pop_front();
        }
    }

    fn is_open(&self, now_ms: u64) -> bool {
        let room = self.capabilities.concurrent_leases.clamp(1, MAX_CONCURRENT_LEASES) as usize;
        self.is_available() && self.leases.len() < room && self.rests_until_ms <= now_ms
    }
}

/// Workers that can do the same.
#[derive(Debug)]
pub(crate) struct Group {
    pub(crate) capabilities: Capabilities,
    pub(crate) members: BTreeSet<WorkerId>,
    /// How many of them take leases.
    pub(crate) available: usize,
    /// Those that can take a lease now, by the number they hold.
    pub(crate) open: BTreeSet<(usize, WorkerId)>,
}

/// All workers.
#[derive(Debug, Default)]
pub(crate) struct Workers {
    pub(crate) all: BTreeMap<WorkerId, Worker>,
    pub(crate) groups: BTreeMap<u32, Group>,
    by_capabilities: BTreeMap<Capabilities, u32>,
    next_group: u32,
    /// When those that rest come back.
    resting: BTreeSet<(u64, WorkerId)>,
}

impl Workers {
    /// Adds a worker, or changes what a known one can do.
    pub(crate) fn join(&mut self, id: WorkerId, capabilities: Capabilities, now_ms: u64) {
        self.leave_group(id);
        let group = self.group_for(&capabilities);
        if let Some(group) = self.groups.get_mut(&group) {
            group.members.insert(id);
        }
        match self.all.get_mut(&id) {
            Some(worker) => {
                worker.group = group;
                worker.capabilities = capabilities;
                worker.disconnected_ms = None;
                worker.draining = None;
                worker.drained = false;
            }
            None => {
                self.all.insert(id, Worker::new(capabilities, group, now_ms));
            }
        }
        self.refresh(id, now_ms);
    }

    /// Removes a worker.
    pub(crate) fn remove(&mut self, id: WorkerId) {
        self.leave_group(id);
        if let Some(worker) = self.all.remove(&id) {
            self.resting.remove(&(worker.rests_until_ms, id));
        }
    }

    fn group_for(&mut self, capabilities: &Capabilities) -> u32 {
        if let Some(&group) = self.by_capabilities.get(capabilities) {
            return group;
        }
        let group = self.next_group;
        self.next_group += 1;
        self.by_capabilities.insert(capabilities.clone(), group);
        let capabilities = capabilities.clone();
        self.groups
            .insert(group, Group { capabilities, members: BTreeSet::new(), available: 0, open: BTreeSet::new() });
        group
    }

    fn leave_group(&mut self, id: WorkerId) {
        let Some(worker) = self.all.get_mut(&id) else { return };
        let Some(left) = self.groups.get_mut(&worker.group) else { return };
        left.members.remove(&id);
        left.available -= usize::from(std::mem::take(&mut worker.counted));
        if let Some(leases) = worker.open_at.take() {
            left.open.remove(&(leases, id));
        }
        if left.members.is_empty()
            && let Some(left) = self.groups.remove(&worker.group)
        {
            self.by_capabilities.remove(&left.capabilities);
        }
    }

    /// Brings the lists of a worker's group into step after a change of the worker.
    pub(crate) fn refresh(&mut self, id: WorkerId, now_ms: u64) {
        let Some(worker) = self.all.get_mut(&id) else { return };
        let Some(group) = self.groups.get_mut(&worker.group) else { return };
        let available = worker.is_available();
        group.available -= usize::from(worker.counted);
        group.available += usize::from(available);
        worker.counted = available;
        let open_at = worker.is_open(now_ms).then_some(worker.leases.len());
        if open_at == worker.open_at {
            return;
        }
        if let Some(leases) = std::mem::replace(&mut worker.open_at, open_at) {
            group.open.remove(&(leases, id));
        }
        if let Some(leases) = open_at {
            group.open.insert((leases, id));
        }
    }

    /// Lets a worker rest.
    pub(crate) fn rest(&mut self, id: WorkerId, until_ms: u64, now_ms: u64) {
        let Some(worker) = self.all.get_mut(&id) else { return };
        self.resting.remove(&(worker.rests_until_ms, id));
        worker.rests_until_ms = worker.rests_until_ms.max(until_ms);
        self.resting.insert((worker.rests_until_ms, id));
        self.refresh(id, now_ms);
    }

    /// Opens the workers whose rest is over.
    pub(crate) fn wake(&mut self, now_ms: u64) {
        while let Some(&(until_ms, id)) = self.resting.first() {
            if until_ms > now_ms {
                break;
            }
            self.resting.pop_first();
            self.refresh(id, now_ms);
        }
    }

    /// Number of workers that fit a class and take leases.
    pub(crate) fn available(&self, class: &ClassKey) -> usize {
        let groups = self.groups.values().filter(|group| fits(&group.capabilities, class.kind, &class.needs));
        groups.map(|group| group.available).sum()
    }

    /// Whether any worker fits a class; not one that is set aside or drains, which will not take it.
    pub(crate) fn any_fits(&self, class: &ClassKey) -> bool {
        self.fitting(class).any(|(_, worker)| !worker.set_aside && worker.draining.is_none())
    }

    /// Workers that fit a class, in order.
    pub(crate) fn fitting<'a>(&'a self, class: &'a ClassKey) -> impl Iterator<Item = (WorkerId, &'a Worker)> {
        let groups = self.groups.values().filter(|group| fits(&group.capabilities, class.kind, &class.needs));
        groups.flat_map(|group| &group.members).filter_map(|id| self.all.get(id).map(|worker| (*id, worker)))
    }
}

impl Worker {
    fn new(capabilities: Capabilities, group: u32, now_ms: u64) -> Self {
        Self {
            capabilities,
            disconnected_ms: None,
            seen_ms: now_ms,
            set_aside: false,
            draining: None,
            drained: false,
            leases: BTreeSet::new(),
            speed: BTreeMap::new(),
            levels: VecDeque::new(),
            failures_in_row: 0,
            rests_until_ms: 0,
            blamed: 0,
            last_failure: String::new(),
            group,
            counted: false,
            open_at: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_follows_measurements() {
        let mut speed = Some(Speed::add(None, 100.0, 1.0, 2.0));
        assert_eq!(speed, Some(Speed { cost_per_second: 100.0 }));
        for _ in 0..40 {
            speed = Some(Speed::add(speed, 500.0, 1.0, 2.0));
        }
        assert!((speed.unwrap().cost_per_second - 500.0).abs() < 1.0);
        let short = Speed::add(speed, 1.0, 1e-3, 2.0);
        let long = Speed::add(speed, 2e6, 2e3, 2.0);
        assert!(short.cost_per_second - 500.0 < long.cost_per_second - 500.0);
    }
}
