//! The state machine: events in, actions out.

use crate::{
    Action, Capabilities, Config, Event, HeldLease, JobSpec, LeaseId, ReadyTask, ReturnReason, RevokeReason, TaskId,
    TenantLimits, WorkerId,
    job::{Job, Task, TaskState},
    lease::{Lease, Requeue},
    worker::Workers,
};
use kiln_core::JobId;
use std::collections::{BTreeMap, BTreeSet};

/// Jobs, tasks, workers and leases. See the crate's documentation.
#[derive(Debug)]
pub struct Scheduler {
    pub(crate) config: Config,
    pub(crate) now_ms: u64,
    pub(crate) jobs: BTreeMap<JobId, Job>,
    pub(crate) tasks: BTreeMap<TaskId, Task>,
    pub(crate) workers: Workers,
    pub(crate) leases: BTreeMap<LeaseId, Lease>,
    /// Leases of each tenant that has any.
    pub(crate) tenants: BTreeMap<String, usize>,
    pub(crate) delayed: BTreeSet<(u64, TaskId)>,
    pub(crate) next_lease: u64,
    pub(crate) actions: Vec<Action>,
}

/// How much there is of everything.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Jobs that are not over.
    pub jobs: usize,
    /// Workers that are not given up.
    pub workers: usize,
    /// Leases.
    pub leases: usize,
    /// Tasks that wait, without those that are delayed after a failure or return.
    pub waiting_tasks: usize,
}

impl Scheduler {
    /// A scheduler without jobs or workers.
    pub fn new(config: Config) -> Self {
        Self {
            config,
            now_ms: 0,
            jobs: BTreeMap::new(),
            tasks: BTreeMap::new(),
            workers: Workers::default(),
            leases: BTreeMap::new(),
            tenants: BTreeMap::new(),
            delayed: BTreeSet::new(),
            next_lease: 1,
            actions: Vec::new(),
        }
    }

    /// Takes one event and gives what follows from it. `now_ms` never runs back; where it does, the last time counts.
    pub fn apply(&mut self, now_ms: u64, event: Event) -> Vec<Action> {
        self.now_ms = self.now_ms.max(now_ms);
        self.wake_tasks();
        self.workers.wake(self.now_ms);
        let mut dispatch = true;
        match event {
            Event::JobAdded(spec) => self.add_job(spec),
            Event::TasksReady { job, tasks } => self.add_tasks(job, tasks),
            Event::JobFinished(job) | Event::JobCancelled(job) => self.end_job(job),
            Event::JobPaused(job) => self.pause(job, true),
            Event::JobResumed(job) => self.pause(job, false),
            Event::WorkerJoined { worker, capabilities, held } => self.join(worker, capabilities, &held),
            Event::Heartbeat(worker) | Event::LeaseProgress { worker, .. } => {
                self.saw(worker);
                dispatch = false;
            }
            Event::TasksCompleted { worker, lease, epoch, tasks } => {
                self.saw(worker);
                self.completed(worker, lease, epoch, &tasks);
            }
            Event::TaskFailed { worker, lease, epoch, task, reason, permanent } => {
                self.saw(worker);
                if self.held(worker, lease, epoch).is_some() {
                    self.failed(worker, lease, task, reason, permanent);
                }
            }
            Event::LeaseReturned { worker, lease, epoch, reason } => self.returned(worker, lease, epoch, reason),
            Event::WorkerDisconnected(worker) => self.disconnect(worker),
            Event::WorkerLost(worker) => self.lose(worker),
            Event::WorkerDraining { worker, deadline_ms } => self.drain(worker, deadline_ms),
            Event::Tick => {
                self.tick();
                dispatch = false;
            }
        }
        if dispatch {
            self.dispatch();
        }
        std::mem::take(&mut self.actions)
    }

    /// How much there is of everything.
    pub fn stats(&self) -> Stats {
        Stats {
            jobs: self.jobs.len(),
            workers: self.workers.all.len(),
            leases: self.leases.len(),
            waiting_tasks: self.jobs.values().map(|job| job.waiting).sum(),
        }
    }

    fn add_job(&mut self, spec: JobSpec) {
        let now_ms = self.now_ms;
        self.jobs.entry(spec.job).or_insert_with(|| Job::new(spec, now_ms));
    }

    fn add_tasks(&mut self, job_id: JobId, tasks: Vec<ReadyTask>) {
        let Some(job) = self.jobs.get_mut(&job_id) else { return };
        for ready in tasks {
            if self.tasks.contains_key(&ready.task) {
                continue;
            }
            let task = Task {
                job: job_id,
                class: job.class_of(&ready),
                cost: ready.cost.max(1),
                state: TaskState::Waiting,
                leased: 0,
                failures: Vec::new(),
                losses: Vec::new(),
                returns: 0,
            };
            job.tasks.insert(ready.task);
            job.enqueue(ready.task, &task);
            self.tasks.insert(ready.task, task);
        }
    }

    fn pause(&mut self, job: JobId, paused: bool) {
        if let Some(job) = self.jobs.get_mut(&job) {
            job.paused = paused;
        }
    }

    /// Any event of a worker is a sign of life.
    fn saw(&mut self, worker: WorkerId) {
        if let Some(worker) = self.workers.all.get_mut(&worker) {
            worker.seen_ms = self.now_ms;
        }
    }

    fn join(&mut self, id: WorkerId, capabilities: Capabilities, held: &[HeldLease]) {
        self.workers.join(id, capabilities, self.now_ms);
        self.saw(id);
        let known: Vec<_> = self.workers.all.get(&id).into_iter().flat_map(|worker| worker.leases.clone()).collect();
        for (position, lease) in known.into_iter().enumerate() {
            let epoch = self.leases.get(&lease).map(|lease| lease.epoch);
            if !held.iter().any(|held| held.lease == lease && Some(held.epoch) == epoch) {
                // The worker started anew and lost it: as if the worker had been lost.
                let requeue = if position == 0 { Requeue::Lost } else { Requeue::Free };
                self.end_lease(lease, requeue, None);
            }
        }
        for &HeldLease { lease, epoch } in held {
            if self.held(id, lease, epoch).is_none() {
                let (tasks, why) = (Vec::new(), RevokeReason::Unknown);
                self.actions.push(Action::RevokeLease { worker: id, lease, epoch, tasks, ended: true, why });
            }
        }
    }

    fn returned(&mut self, worker: WorkerId, lease: LeaseId, epoch: u32, reason: ReturnReason) {
        self.saw(worker);
        if self.held(worker, lease, epoch).is_none() {
            return;
        }
        match reason {
            ReturnReason::Draining => self.end_lease(lease, Requeue::Free, None),
            ReturnReason::Busy => {
                let until_ms = self.now_ms.saturating_add(self.config.return_delay_ms);
                self.workers.rest(worker, until_ms, self.now_ms);
                self.end_lease(lease, Requeue::Returned, None);
            }
        }
    }

    fn disconnect(&mut self, id: WorkerId) {
        let now_ms = self.now_ms;
        if let Some(worker) = self.workers.all.get_mut(&id) {
            worker.disconnected_ms.get_or_insert(now_ms);
            self.workers.refresh(id, now_ms);
        }
    }

    fn drain(&mut self, id: WorkerId, deadline_ms: u64) {
        self.saw(id);
        let Some(worker) = self.workers.all.get_mut(&id) else { return };
        worker.draining = Some(deadline_ms);
        if worker.leases.is_empty() && !worker.drained {
            worker.drained = true;
            self.actions.push(Action::WorkerDrained(id));
        }
        self.workers.refresh(id, self.now_ms);
    }

    pub(crate) fn limits(&self, job: &Job) -> &TenantLimits {
        self.config.tenants.get(&job.spec.tenant).unwrap_or(&self.config.default_tenant)
    }

    pub(crate) fn tenant_leases(&self, job: &Job) -> usize {
        self.tenants.get(&job.spec.tenant).copied().unwrap_or(0)
    }
}
