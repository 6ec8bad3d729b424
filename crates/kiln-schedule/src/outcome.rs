//! What comes of tasks: results, failures, returns and losses, and what they mean for jobs and workers.

use crate::{
    Action, AttemptLog, CompletedTask, Ignored, LeaseId, RevokeReason, Scheduler, SetAsideReason, TaskId, WorkerId,
    job::{Task, TaskState},
    lease::Requeue,
    worker::Speed,
};
use kiln_core::{JobId, TaskKind};
use std::collections::BTreeMap;

/// Delays double at most this often.
const MAX_DOUBLINGS: u32 = 6;

fn doubled(delay_ms: u64, times: u32) -> u64 {
    delay_ms.saturating_mul(1 << times.min(MAX_DOUBLINGS))
}

impl Scheduler {
    /// Results came in.
    pub(crate) fn completed(&mut self, worker: WorkerId, lease: LeaseId, epoch: u32, tasks: &[CompletedTask]) {
        let in_time = self.held(worker, lease, epoch).is_some();
        let mut done_elsewhere: BTreeMap<LeaseId, Vec<TaskId>> = BTreeMap::new();
        let mut measured: BTreeMap<TaskKind, (f64, f64)> = BTreeMap::new();
        for &CompletedTask { task: id, seconds } in tasks {
            let Some(task) = self.tasks.get(&id) else {
                self.actions.push(Action::ResultIgnored { task: id, worker, why: Ignored::Unknown });
                continue;
            };
            if task.state == TaskState::Done {
                self.actions.push(Action::ResultIgnored { task: id, worker, why: Ignored::Duplicate });
                continue;
            }
            if let Some(job) = self.jobs.get(&task.job)
                && seconds.is_finite()
                && seconds > 0.0
            {
                let sums = measured.entry(job.classes[task.class].key.kind).or_default();
                *sums = (sums.0 + task.cost as f64, sums.1 + seconds);
            }
            for other in self.accept(id, worker) {
                if other != lease || !in_time {
                    done_elsewhere.entry(other).or_default().push(id);
                }
            }
        }
        self.measure(worker, &measured);
        self.finish_if_empty(lease, in_time);
        for (lease, tasks) in done_elsewhere {
            let Some(held) = self.leases.get(&lease) else { continue };
            let (worker, epoch, ended) = (held.worker, held.epoch, held.tasks.is_empty());
            let why = RevokeReason::DoneElsewhere;
            self.actions.push(Action::RevokeLease { worker, lease, epoch, tasks, ended, why });
            if ended {
                self.release(lease);
            }
        }
    }

    /// The first result of a task: returns the leases it was in.
    fn accept(&mut self, id: TaskId, worker: WorkerId) -> Vec<LeaseId> {
        let Some(task) = self.tasks.get_mut(&id) else { return Vec::new() };
        let state = std::mem::replace(&mut task.state, TaskState::Done);
        let failures = std::mem::take(&mut task.failures);
        let job_id = task.job;
        task.losses.clear();
        if let (TaskState::Waiting, Some(job)) = (state, self.jobs.get_mut(&job_id)) {
            job.dequeue(id, task);
        }
        let leases: Vec<_> = match state {
            TaskState::Leased(one, other) => [Some(one), other].into_iter().flatten().collect(),
            _ => Vec::new(),
        };
        for lease in &leases {
            if let Some(lease) = self.leases.get_mut(lease) {
                lease.tasks.remove(&id);
            }
        }
        self.actions.push(Action::TaskAccepted { job: job_id, task: id, worker });
        self.blame(worker, &failures);
        leases
    }

    /// Those that failed what another now completed are under suspicion.
    fn blame(&mut self, completer: WorkerId, failures: &[AttemptLog]) {
        let mut suspects: Vec<_> = failures.iter().map(|attempt| attempt.worker).collect();
        suspects.sort();
        suspects.dedup();
        for suspect in suspects.into_iter().filter(|suspect| *suspect != completer) {
            let Some(worker) = self.workers.all.get_mut(&suspect) else { continue };
            worker.blamed += 1;
            if worker.blamed >= self.config.set_aside_after && !worker.set_aside {
                worker.set_aside = true;
                let why = SetAsideReason { failed_tasks: worker.blamed, last_reason: worker.last_failure.clone() };
                let leases: Vec<_> = worker.leases.iter().copied().collect();
                self.workers.refresh(suspect, self.now_ms);
                self.actions.push(Action::WorkerSetAside { worker: suspect, why });
                for lease in leases {
                    self.end_lease(lease, Requeue::Free, Some(RevokeReason::SetAside));
                }
            }
        }
    }

    /// Results of a worker: it works, and at this speed.
    fn measure(&mut self, id: WorkerId, measured: &BTreeMap<TaskKind, (f64, f64)>) {
        let target = self.config.lease_target_seconds;
        let Some(worker) = self.workers.all.get_mut(&id) else { return };
        if !measured.is_empty() {
            worker.failures_in_row = 0;
        }
        for (kind, &(cost, seconds)) in measured {
            let speed = Speed::add(worker.speed.get(kind).copied(), cost, seconds, target);
            worker.speed.insert(*kind, speed);
        }
    }

    /// Ends a lease whose tasks are all done, and counts the time it took.
    pub(crate) fn finish_if_empty(&mut self, lease: LeaseId, in_time: bool) {
        if !in_time || !self.leases.get(&lease).is_some_and(|held| held.tasks.is_empty()) {
            return;
        }
        let Some(lease) = self.release(lease) else { return };
        if let Some(job) = self.jobs.get_mut(&lease.job).filter(|_| !lease.spoilt) {
            let elapsed_ms = self.now_ms.saturating_sub(lease.granted_ms);
            job.pace.entry(lease.kind).or_default().add(elapsed_ms, lease.cost_with_ahead);
        }
    }

    /// A task failed on a worker that held it.
    pub(crate) fn failed(&mut self, worker: WorkerId, lease: LeaseId, id: TaskId, reason: String, permanent: bool) {
        let Some(held) = self.leases.get_mut(&lease) else { return };
        if !held.tasks.remove(&id) {
            return;
        }
        held.spoilt = true;
        let job = held.job;
        self.leave_lease(id, lease);
        self.finish_if_empty(lease, true);
        self.tire(worker, &reason);
        let Some(task) = self.tasks.get_mut(&id) else { return };
        task.failures.push(AttemptLog { worker, reason: reason.clone() });
        if permanent {
            self.fail_job(job, format!("a task cannot succeed: {reason}"), Some(id));
        } else if self.is_hopeless(id) {
            self.fail_job(job, "a task failed wherever it was tried".to_owned(), Some(id));
        } else {
            let attempt = AttemptLog { worker, reason };
            self.actions.push(Action::TaskRetried { job, task: id, attempt });
            self.requeue(id, 0);
        }
    }

    /// A worker whose tasks fail rests, longer each time.
    fn tire(&mut self, id: WorkerId, reason: &str) {
        let Some(worker) = self.workers.all.get_mut(&id) else { return };
        reason.clone_into(&mut worker.last_failure);
        worker.failures_in_row = worker.failures_in_row.saturating_add(1);
        let rest_ms = doubled(self.config.failure_delay_ms, worker.failures_in_row - 1);
        self.workers.rest(id, self.now_ms.saturating_add(rest_ms), self.now_ms);
    }

    /// Whether a task failed on as many workers as it may, or as often where there are no others.
    fn is_hopeless(&self, id: TaskId) -> bool {
        let Some(task) = self.tasks.get(&id) else { return false };
        let mut workers: Vec<_> = task.failures.iter().map(|attempt| attempt.worker).collect();
        workers.sort();
        workers.dedup();
        let limit = self.config.max_task_failures;
        workers.len() >= limit || (task.failures.len() >= limit && !self.has_untried_worker(id))
    }

    /// Whether a worker that takes leases fits a task that has not failed on it.
    pub(crate) fn has_untried_worker(&self, id: TaskId) -> bool {
        let Some(task) = self.tasks.get(&id) else { return false };
        let Some(job) = self.jobs.get(&task.job) else { return false };
        self.workers
            .fitting(&job.classes[task.class].key)
            .any(|(worker, state)| state.is_available() && task.failures.iter().all(|attempt| attempt.worker != worker))
    }

    /// A worker went away with a task in hand.
    pub(crate) fn task_lost(&mut self, id: TaskId, worker: WorkerId) {
        let Some(task) = self.tasks.get_mut(&id) else { return };
        let (job, attempt) = (task.job, Self::loss(worker));
        task.losses.push(attempt.clone());
        if task.losses.len() > self.config.max_worker_losses as usize {
            self.fail_job(job, "every worker that had a task was lost".to_owned(), Some(id));
        } else {
            self.actions.push(Action::TaskRetried { job, task: id, attempt });
            self.requeue(id, 0);
        }
    }

    /// A worker had no room for a task.
    pub(crate) fn task_returned(&mut self, id: TaskId) {
        let Some(task) = self.tasks.get_mut(&id) else { return };
        task.returns += 1;
        let (job, returns) = (task.job, task.returns);
        if returns > self.config.max_returns {
            self.fail_job(job, format!("workers handed a task back {returns} times for want of room"), Some(id));
        } else {
            self.requeue(id, doubled(self.config.return_delay_ms, returns - 1));
        }
    }

    /// Ends a job that cannot succeed.
    pub(crate) fn fail_job(&mut self, job: JobId, reason: String, task: Option<TaskId>) {
        if !self.jobs.contains_key(&job) {
            return;
        }
        let attempts = task.and_then(|id| self.tasks.get(&id)).map_or(Vec::new(), Task::attempts);
        self.actions.push(Action::JobFailed { job, reason, task, attempts });
        self.end_job(job);
    }

    /// Drops a job and all that belongs to it.
    pub(crate) fn end_job(&mut self, id: JobId) {
        let Some(job) = self.jobs.get(&id) else { return };
        for lease in job.leases.clone() {
            self.end_lease(lease, Requeue::Dropped, Some(RevokeReason::JobEnded));
        }
        if let Some(job) = self.jobs.remove(&id) {
            for task in job.tasks {
                self.tasks.remove(&task);
            }
        }
    }
}
