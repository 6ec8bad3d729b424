//! A large farm without faults, to see how fast the scheduler hands out work.

use crate::{
    Action, Capabilities, CompletedTask, Config, Event, JobSpec, LeaseId, ReadyTask, Requirements, Roles, Scheduler,
    TaskId, WorkerId,
};
use kiln_core::{Digest, JobId, TaskKind};
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Instant,
};

const TICK_MS: u64 = 250;

#[derive(Debug)]
pub(crate) struct Report {
    pub(crate) tasks: usize,
    pub(crate) leases: usize,
    pub(crate) events_per_second: f64,
    #[expect(dead_code, reason = "read by people, in the test's output")]
    pub(crate) tasks_per_second: f64,
    #[expect(dead_code, reason = "read by people, in the test's output")]
    pub(crate) simulated_seconds: f64,
}

struct Running {
    worker: WorkerId,
    lease: LeaseId,
    epoch: u32,
    tasks: Vec<TaskId>,
}

/// Cost that a worker does in a second.
fn speed(id: WorkerId) -> f64 {
    1e6 * (1 + id.0 % 10) as f64
}

fn cost(task: TaskId) -> u64 {
    100_000 + 37 * (task.0 % 5000)
}

/// A job, its workers and its tasks, last first.
fn beginning(workers: u64, tasks: u64) -> Vec<Event> {
    let job = JobId(1);
    let capabilities = Capabilities {
        roles: Roles::ALL,
        trace_lanes: BTreeSet::from(["cpu".to_owned()]),
        solve_lanes: BTreeSet::from(["x86_64".to_owned()]),
        memory_bytes: 1 << 34,
        cores: 8,
        concurrent_leases: 2,
    };
    let ready = (0..tasks).map(TaskId).map(|task| ReadyTask {
        task,
        kind: TaskKind::Trace,
        cost: cost(task),
        needs: Requirements { lane: Some("cpu".to_owned()), memory_bytes: 1 << 30 },
        locality: Digest::of(b"level"),
    });
    let mut events = vec![Event::TasksReady { job, tasks: ready.collect() }];
    events.extend((0..workers).map(|worker| Event::WorkerJoined {
        worker: WorkerId(worker),
        capabilities: capabilities.clone(),
        held: Vec::new(),
    }));
    events.push(Event::JobAdded(JobSpec { job, tenant: "t".to_owned(), priority: 0, max_leases: None }));
    events
}

pub(crate) fn run(config: Config, workers: u64, tasks: u64) -> Report {
    let mut scheduler = Scheduler::new(config);
    let mut running: BTreeMap<(u64, LeaseId), Running> = BTreeMap::new();
    let mut busy_until: BTreeMap<WorkerId, u64> = BTreeMap::new();
    let (mut events, mut leases, mut now_ms, mut next_tick_ms) = (0u64, 0, 0, TICK_MS);
    let mut accepted = BTreeSet::new();
    let mut pending = beginning(workers, tasks);
    let began = Instant::now();
    loop {
        let event = if let Some(event) = pending.pop() {
            event
        } else {
            let Some(&(due_ms, first)) = running.keys().next() else { break };
            if due_ms <= next_tick_ms {
                now_ms = due_ms;
                running.remove(&(due_ms, first)).map_or(Event::Tick, completed)
            } else {
                now_ms = next_tick_ms;
                next_tick_ms += TICK_MS;
                pending.extend((0..workers).map(|worker| Event::Heartbeat(WorkerId(worker))));
                Event::Tick
            }
        };
        events += 1;
        for action in scheduler.apply(now_ms, event) {
            match action {
                Action::Lease { worker, lease, epoch, tasks, .. } => {
                    leases += 1;
                    let seconds = tasks.iter().map(|task| cost(*task) as f64).sum::<f64>() / speed(worker);
                    let free_ms = busy_until.entry(worker).or_default();
                    *free_ms = (*free_ms).max(now_ms) + (seconds * 1000.0).ceil() as u64;
                    running.insert((*free_ms, lease), Running { worker, lease, epoch, tasks });
                }
                Action::TaskAccepted { task, .. } => assert!(accepted.insert(task)),
                _ => {}
            }
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    Report {
        tasks: accepted.len(),
        leases,
        events_per_second: events as f64 / seconds,
        tasks_per_second: tasks as f64 / seconds,
        simulated_seconds: now_ms as f64 / 1000.0,
    }
}

fn completed(running: Running) -> Event {
    let Running { worker, lease, epoch, tasks } = running;
    let done = |task: TaskId| CompletedTask { task, seconds: cost(task) as f64 / speed(worker) };
    Event::TasksCompleted { worker, lease, epoch, tasks: tasks.into_iter().map(done).collect() }
}
