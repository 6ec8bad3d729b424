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

pub(crate) fn capabilities() -> Capabilities {
    Capabilities {
        roles: Roles::ALL,
        trace_lanes: BTreeSet::from(["cpu".to_owned()]),
        solve_lanes: BTreeSet::from(["x86_64".to_owned()]),
        memory_bytes: 1 << 34,
        cores: 8,
        concurrent_leases: 2,
    }
}

/// Cost that worker `id` does in a second.
fn speed(id: WorkerId) -> f64 {
    1e6 * (1 + id.0 % 10) as f64
}

pub(crate) fn run(config: Config, workers: u64, tasks: u64) -> Report {
    let mut scheduler = Scheduler::new(config);
    let mut queue: BTreeMap<(u64, u64), (WorkerId, LeaseId, u32, Vec<TaskId>)> = BTreeMap::new();
    let mut busy_until: BTreeMap<WorkerId, u64> = BTreeMap::new();
    let (mut events, mut leases, mut accepted, mut sequence, mut now) = (0u64, 0, BTreeSet::new(), 0, 0);
    let cost = |task: TaskId| 100_000 + 37 * (task.0 % 5000);
    let began = Instant::now();
    let mut pending: Vec<Event> = Vec::new();
    let job = JobId(1);
    pending.push(Event::JobAdded(JobSpec { job, tenant: "t".to_owned(), priority: 0, max_leases: None }));
    for worker in 0..workers {
        let worker = WorkerId(worker);
        pending.push(Event::WorkerJoined { worker, capabilities: capabilities(), held: Vec::new() });
    }
    let ready = (0..tasks).map(TaskId).map(|task| ReadyTask {
        task,
        kind: TaskKind::Trace,
        cost: cost(task),
        needs: Requirements { lane: Some("cpu".to_owned()), memory_bytes: 1 << 30 },
        locality: Digest::of(b"level"),
    });
    pending.push(Event::TasksReady { job, tasks: ready.collect() });
    pending.reverse();
    let mut next_tick = 250;
    loop {
        let event = if let Some(event) = pending.pop() {
            event
        } else if queue.first_key_value().is_some_and(|((due, _), _)| *due <= next_tick) {
            let Some(((due, _), (worker, lease, epoch, tasks))) = queue.pop_first() else { break };
            now = due;
            let done = |task: &TaskId| CompletedTask { task: *task, seconds: cost(*task) as f64 / speed(worker) };
            Event::TasksCompleted { worker, lease, epoch, tasks: tasks.iter().map(done).collect() }
        } else if queue.is_empty() {
            break;
        } else {
            now = next_tick;
            next_tick += 250;
            pending.extend((0..workers).map(|worker| Event::Heartbeat(WorkerId(worker))));
            Event::Tick
        };
        events += 1;
        for action in scheduler.apply(now, event) {
            match action {
                Action::Lease { worker, lease, epoch, tasks, .. } => {
                    leases += 1;
                    let seconds = tasks.iter().map(|task| cost(*task) as f64).sum::<f64>() / speed(worker);
                    let start = busy_until.get(&worker).copied().unwrap_or(0).max(now);
                    let end = start + (seconds * 1000.0).ceil() as u64;
                    busy_until.insert(worker, end);
                    sequence += 1;
                    queue.insert((end, sequence), (worker, lease, epoch, tasks));
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
        simulated_seconds: now as f64 / 1000.0,
    }
}
