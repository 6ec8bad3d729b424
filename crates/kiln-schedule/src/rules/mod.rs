//! The rules of scheduling, one test for each.

mod attempts;
mod jobs;
mod workers;

use crate::simulator::check;
use crate::{
    Action, AttemptLog, Capabilities, CompletedTask, Config, Event, Explanation, JobSpec, LeaseId, ReadyTask,
    Requirements, Roles, Scheduler, TaskId, WorkerId,
};
use kiln_core::{Digest, JobId, TaskKind};
use std::collections::BTreeSet;

/// A scheduler with the leases that it has given out.
struct Bench {
    scheduler: Scheduler,
    now_ms: u64,
    given: Vec<Given>,
}

#[derive(Clone, Debug)]
struct Given {
    worker: u64,
    lease: LeaseId,
    epoch: u32,
    job: u64,
    tasks: Vec<TaskId>,
    speculative: bool,
}

impl Bench {
    fn new(config: Config) -> Self {
        Self { scheduler: Scheduler::new(config), now_ms: 0, given: Vec::new() }
    }

    fn apply(&mut self, event: Event) -> Vec<Action> {
        let actions = self.scheduler.apply(self.now_ms, event);
        check(&self.scheduler);
        for action in &actions {
            if let Action::Lease { worker, lease, epoch, job, tasks, speculative, .. } = action.clone() {
                self.given.push(Given { worker: worker.0, lease, epoch, job: job.0, tasks, speculative });
            }
        }
        actions
    }

    fn worker(&mut self, id: u64) -> Vec<Action> {
        self.worker_with(id, |_| {})
    }

    fn worker_with(&mut self, id: u64, change: impl Fn(&mut Capabilities)) -> Vec<Action> {
        let mut capabilities = Capabilities {
            roles: Roles::ALL,
            trace_lanes: BTreeSet::from(["cpu".to_owned()]),
            solve_lanes: BTreeSet::from(["x86_64".to_owned()]),
            memory_bytes: 1 << 30,
            cores: 2,
            concurrent_leases: 1,
        };
        change(&mut capabilities);
        self.apply(Event::WorkerJoined { worker: WorkerId(id), capabilities, held: Vec::new() })
    }

    fn job(&mut self, id: u64) {
        self.job_with(id, |_| {});
    }

    fn job_with(&mut self, id: u64, change: impl Fn(&mut JobSpec)) {
        let mut spec = JobSpec { job: JobId(id), tenant: "studio".to_owned(), priority: 0, max_leases: None };
        change(&mut spec);
        self.apply(Event::JobAdded(spec));
    }

    /// Trace tasks 1000 × job + 0.. of cost 100.
    fn tasks(&mut self, job: u64, count: u64) -> Vec<Action> {
        self.tasks_with(job, count, |_| {})
    }

    fn tasks_with(&mut self, job: u64, count: u64, change: impl Fn(&mut ReadyTask)) -> Vec<Action> {
        let tasks = (0..count).map(|i| {
            let needs = Requirements { lane: Some("cpu".to_owned()), memory_bytes: 1 << 20 };
            let locality = Digest::of(&job.to_le_bytes());
            let mut task =
                ReadyTask { task: TaskId(1000 * job + i), kind: TaskKind::Trace, cost: 100, needs, locality };
            change(&mut task);
            task
        });
        let tasks = tasks.collect();
        self.apply(Event::TasksReady { job: JobId(job), tasks })
    }

    /// The last lease, which must be the worker's.
    fn last(&self, worker: u64) -> Given {
        let given = self.given.last().expect("a lease was given").clone();
        assert_eq!(given.worker, worker, "{given:?}");
        given
    }

    fn complete(&mut self, given: &Given, seconds: f64) -> Vec<Action> {
        let tasks = given.tasks.iter().map(|task| CompletedTask { task: *task, seconds }).collect();
        let (worker, lease, epoch) = (WorkerId(given.worker), given.lease, given.epoch);
        self.apply(Event::TasksCompleted { worker, lease, epoch, tasks })
    }

    fn fail(&mut self, given: &Given, permanent: bool) -> Vec<Action> {
        let (worker, lease, epoch, task) = (WorkerId(given.worker), given.lease, given.epoch, given.tasks[0]);
        let reason = format!("worker {} ran out of luck", given.worker);
        self.apply(Event::TaskFailed { worker, lease, epoch, task, reason, permanent })
    }

    fn pass(&mut self, ms: u64) -> Vec<Action> {
        self.now_ms += ms;
        self.apply(Event::Tick)
    }

    /// Time passes, with heartbeats of the workers.
    fn live(&mut self, ms: u64, workers: &[u64]) -> Vec<Action> {
        let mut actions = Vec::new();
        for _ in 0..ms / 250 {
            workers.iter().for_each(|worker| drop(self.apply(Event::Heartbeat(WorkerId(*worker)))));
            actions.extend(self.pass(250));
        }
        actions
    }

    fn explain(&self, job: u64) -> Explanation {
        self.scheduler.explain(JobId(job))
    }
}

fn failed(actions: &[Action]) -> Option<(String, Vec<AttemptLog>)> {
    actions.iter().find_map(|action| match action {
        Action::JobFailed { reason, attempts, .. } => Some((reason.clone(), attempts.clone())),
        _ => None,
    })
}
