//! The workers of the miniature farm, and what happens to them.

use super::farm::{CHAOS_MS, Coming, Farm};
use crate::{Capabilities, CompletedTask, Event, HeldLease, LeaseId, ReturnReason, Roles, TaskId, WorkerId};
use std::collections::{BTreeMap, BTreeSet};

/// The ways of workers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Temper {
    Good,
    /// Takes twenty times as long.
    Slow,
    /// Fails every task at once.
    Broken,
    /// Fails one task in six.
    Flaky,
    /// Reports tasks it never had, twice, with nonsense for times and leases.
    Liar,
    /// Hands back most leases.
    Busy,
    /// Hangs on one task in thirty, with a beating heart.
    Hanging,
}

#[derive(Debug)]
pub(super) struct SimWorker {
    capabilities: Capabilities,
    pub(super) temper: Temper,
    pub(super) alive: bool,
    pub(super) connected: bool,
    /// Heartbeats and results are lost until then.
    pub(super) cut_until: u64,
    held: BTreeMap<LeaseId, (u32, Vec<TaskId>)>,
    busy_until: u64,
}

impl Farm {
    pub(super) fn new_worker(&mut self, at_ms: u64, temper: Option<Temper>) {
        let id = WorkerId(self.workers.len() as u64);
        let tempers = [
            Temper::Good,
            Temper::Good,
            Temper::Good,
            Temper::Slow,
            Temper::Broken,
            Temper::Flaky,
            Temper::Liar,
            Temper::Busy,
            Temper::Hanging,
        ];
        let temper = temper.unwrap_or_else(|| *self.random.pick(&tempers));
        let all = temper == Temper::Good;
        let lanes = |name: &str| BTreeSet::from([name.to_owned()]);
        let capabilities = Capabilities {
            roles: Roles { trace: all || !self.random.once_in(4), reduce: all || !self.random.once_in(4) },
            trace_lanes: if all || self.random.once_in(2) { lanes("cpu") } else { lanes("gpu") },
            solve_lanes: lanes("x86_64"),
            memory_bytes: if all { 1 << 34 } else { 1 << self.random.range(28, 34) },
            cores: 4,
            concurrent_leases: self.random.range(1, 3) as u32,
        };
        let worker = SimWorker {
            capabilities,
            temper,
            alive: true,
            connected: false,
            cut_until: 0,
            held: BTreeMap::new(),
            busy_until: 0,
        };
        self.workers.insert(id, worker);
        self.at(at_ms, Coming::Join(id));
        self.at(at_ms, Coming::Beat(id));
    }

    /// A worker's connection is there, and it says what it holds.
    pub(super) fn join(&mut self, id: WorkerId) {
        let worker = self.workers.get_mut(&id).unwrap();
        if !worker.alive {
            return;
        }
        worker.connected = true;
        let held = worker.held.iter().map(|(lease, (epoch, _))| HeldLease { lease: *lease, epoch: *epoch }).collect();
        let capabilities = worker.capabilities.clone();
        self.deliver(Event::WorkerJoined { worker: id, capabilities, held });
    }

    pub(super) fn granted(&mut self, id: WorkerId, lease: LeaseId, epoch: u32, tasks: Vec<TaskId>) {
        let now = self.now_ms;
        let worker = self.workers.get_mut(&id).unwrap();
        if !worker.alive || !worker.connected || worker.cut_until > now {
            return;
        }
        match worker.temper {
            Temper::Busy if !self.random.once_in(4) && now < CHAOS_MS => {
                self.summary.returned += 1;
                self.send(id, &Event::LeaseReturned { worker: id, lease, epoch, reason: ReturnReason::Busy });
                return;
            }
            Temper::Liar => {
                let tasks = [tasks.clone(), tasks.clone(), vec![TaskId(77)]].concat();
                let nonsense = [f64::NAN, -1.0, 0.0, f64::INFINITY, 1e-300, 1e300];
                let lie = |(i, task): (usize, &TaskId)| CompletedTask { task: *task, seconds: nonsense[i % 6] };
                let tasks = tasks.iter().enumerate().map(lie).collect();
                let lease = LeaseId(lease.0 + self.random.range(0, 1));
                self.send(id, &Event::TasksCompleted { worker: id, lease, epoch, tasks });
                return;
            }
            _ => {}
        }
        worker.held.insert(lease, (epoch, tasks.clone()));
        let mut at = worker.busy_until.max(now);
        for task in tasks {
            let worker = &self.workers[&id];
            let millis = match worker.temper {
                Temper::Slow => 20 * self.random.range(10, 100),
                Temper::Broken => 1,
                Temper::Hanging if self.random.once_in(30) => 10_000_000,
                _ => self.random.range(10, 100),
            };
            at += millis;
            self.at(at, Coming::Ran { worker: id, lease, task, millis });
        }
        self.workers.get_mut(&id).unwrap().busy_until = if at > now + 1_000_000 { now } else { at };
    }

    pub(super) fn revoked(&mut self, id: WorkerId, lease: LeaseId, tasks: &[TaskId], ended: bool) {
        let Some(worker) = self.workers.get_mut(&id) else { return };
        if let Some((_, held)) = worker.held.get_mut(&lease) {
            held.retain(|task| !tasks.contains(task));
        }
        if ended {
            worker.held.remove(&lease);
        }
    }

    pub(super) fn ran(&mut self, id: WorkerId, lease: LeaseId, task: TaskId, millis: u64) {
        let worker = self.workers.get_mut(&id).unwrap();
        let Some((epoch, tasks)) = worker.held.get_mut(&lease).filter(|_| worker.alive) else { return };
        if !tasks.contains(&task) {
            return;
        }
        let epoch = *epoch;
        tasks.retain(|held| *held != task);
        if tasks.is_empty() {
            worker.held.remove(&lease);
        }
        let fails = match worker.temper {
            Temper::Broken => true,
            Temper::Flaky => self.random.once_in(6),
            _ => false,
        };
        let event = if fails || self.poison.contains(&task) {
            let reason = format!("{task:?} broke");
            Event::TaskFailed { worker: id, lease, epoch, task, reason, permanent: false }
        } else {
            let tasks = vec![CompletedTask { task, seconds: millis as f64 / 1000.0 }];
            Event::TasksCompleted { worker: id, lease, epoch, tasks }
        };
        self.send(id, &event);
    }

    /// Something bad happens to some worker.
    pub(super) fn chaos(&mut self) {
        if self.now_ms >= CHAOS_MS {
            return;
        }
        let next = self.now_ms + self.random.range(200, 5000);
        self.at(next, Coming::Chaos);
        let id = WorkerId(self.random.range(0, self.workers.len() as u64 - 1));
        let (now, pause) = (self.now_ms, self.random.range(10, 12_000));
        let what = self.random.range(0, 5);
        let worker = self.workers.get_mut(&id).unwrap();
        if !worker.alive {
            return;
        }
        match what {
            // It crashes, and another comes in its place.
            0 => {
                worker.alive = false;
                worker.connected = false;
                self.at(now, Coming::Message(None, Event::WorkerDisconnected(id)));
                self.new_worker(now + pause, None);
            }
            // Its connection breaks; it comes back with what it holds, or finds that it was given up.
            1 => {
                worker.connected = false;
                self.at(now, Coming::Message(None, Event::WorkerDisconnected(id)));
                self.at(now + pause, Coming::Join(id));
            }
            // It crashes and is started anew at once under its number, with empty hands.
            2 => {
                worker.held.clear();
                self.at(now + 50, Coming::Join(id));
            }
            // Nothing comes through for a while, and nobody notices but by the clock.
            3 => {
                worker.cut_until = now + pause;
                self.at(now + pause, Coming::Join(id));
            }
            4 => {
                let event = Event::WorkerDraining { worker: id, deadline_ms: now + pause };
                self.at(now, Coming::Message(None, event));
                self.new_worker(now + pause, None);
            }
            _ => {
                worker.connected = false;
                self.at(now, Coming::Message(None, Event::WorkerLost(id)));
                self.at(now + pause, Coming::Join(id));
            }
        }
    }
}
