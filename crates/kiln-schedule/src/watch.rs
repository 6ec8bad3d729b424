//! What time brings: lost workers, leases that take too long, stragglers, jobs that nobody can run.

use crate::{
    Action, LeaseId, RevokeReason, Scheduler, TaskId, WorkerId,
    job::TaskState,
    lease::{Lease, Requeue},
    worker::fits,
};
use kiln_core::JobId;
use std::collections::BTreeMap;

impl Scheduler {
    /// Sees to all that only time brings about.
    pub(crate) fn tick(&mut self) {
        self.expire_workers();
        self.drain_workers();
        self.end_long_leases();
        self.fail_jobs_nobody_fits();
        self.dispatch();
        self.double_stragglers();
    }

    fn expire_workers(&mut self) {
        let now = self.now_ms;
        let (timeout, grace) = (self.config.heartbeat_timeout_ms, self.config.reconnect_grace_ms);
        let is_lost = |worker: &crate::worker::Worker| {
            let silent = now.saturating_sub(worker.seen_ms) >= timeout;
            silent || worker.disconnected_ms.is_some_and(|since| now.saturating_sub(since) >= grace)
        };
        let lost: Vec<_> = self.workers.all.iter().filter(|(_, worker)| is_lost(worker)).map(|(id, _)| *id).collect();
        for worker in lost {
            self.actions.push(Action::WorkerExpired(worker));
            self.lose(worker);
        }
    }

    /// A worker is gone: its tasks are given to others. The loss counts for what it ran, not for what it held ready.
    pub(crate) fn lose(&mut self, id: WorkerId) {
        let Some(worker) = self.workers.all.get(&id) else { return };
        let leases: Vec<_> = worker.leases.iter().copied().collect();
        // Removed first, so that nothing is given to it and its draining is not reported.
        self.workers.remove(id);
        for (position, lease) in leases.into_iter().enumerate() {
            let requeue = if position == 0 { Requeue::Lost } else { Requeue::Free };
            self.end_lease(lease, requeue, None);
        }
    }

    fn drain_workers(&mut self) {
        let past = |deadline: &u64| *deadline <= self.now_ms;
        let draining = self.workers.all.iter().filter(|(_, worker)| worker.draining.as_ref().is_some_and(past));
        let leases: Vec<_> = draining.flat_map(|(_, worker)| worker.leases.iter().copied()).collect();
        for lease in leases {
            self.end_lease(lease, Requeue::Free, Some(RevokeReason::Drained));
        }
    }

    fn end_long_leases(&mut self) {
        let most = self.config.max_lease_ms;
        let is_long = |lease: &Lease| self.now_ms.saturating_sub(lease.granted_ms) >= most;
        let long: Vec<_> = self.leases.iter().filter(|(_, lease)| is_long(lease)).map(|(id, _)| *id).collect();
        for id in long {
            let Some(lease) = self.leases.get(&id) else { continue };
            let (worker, epoch, first) = (lease.worker, lease.epoch, lease.tasks.first().copied());
            let is_oldest = self.workers.all.get(&worker).is_some_and(|worker| worker.leases.first() == Some(&id));
            if let (Some(task), true) = (first, is_oldest) {
                let (tasks, why) = (vec![task], RevokeReason::TooLong);
                self.actions.push(Action::RevokeLease { worker, lease: id, epoch, tasks, ended: false, why });
                self.failed(worker, id, task, format!("it ran for more than {} s", most / 1000), false);
            }
            self.end_lease(id, Requeue::Free, Some(RevokeReason::TooLong));
        }
    }

    /// Jobs with a task that no worker could run, though there are workers, fail after a time.
    fn fail_jobs_nobody_fits(&mut self) {
        if self.workers.all.is_empty() {
            return;
        }
        let ids: Vec<JobId> = self.jobs.keys().copied().collect();
        for id in ids {
            let Some(job) = self.jobs.get(&id) else { continue };
            let mut waiting = job.classes.iter().filter(|class| class.waiting() > 0);
            let unfit = waiting.find(|class| !self.workers.any_fits(&class.key)).map(|class| self.no_fit(class));
            let Some(job) = self.jobs.get_mut(&id) else { continue };
            let Some(explanation) = unfit else {
                job.no_fit_since_ms = None;
                continue;
            };
            let since = *job.no_fit_since_ms.get_or_insert(self.now_ms);
            let waited = self.now_ms.saturating_sub(since);
            if self.config.no_fit_timeout_ms.is_some_and(|timeout| waited >= timeout) {
                self.fail_job(id, explanation.to_string(), None);
            }
        }
    }

    /// Gives the tasks of leases that take far longer than their peers to workers that have nothing else to do.
    fn double_stragglers(&mut self) {
        if self.workers.groups.values().all(|group| group.open.is_empty()) {
            return;
        }
        let quantile = self.config.straggler_quantile;
        let paces =
            self.jobs.iter().flat_map(|(id, job)| job.pace.iter().map(move |(kind, pace)| ((*id, *kind), pace)));
        let usual: BTreeMap<_, f64> = paces.filter_map(|(of, pace)| Some((of, pace.quantile(quantile)?))).collect();
        let is_late = |lease: &Lease| {
            usual.get(&(lease.job, lease.kind)).is_some_and(|ms_per_cost| self.is_late(lease, *ms_per_cost))
        };
        let late: Vec<_> = self.leases.iter().filter(|(_, lease)| is_late(lease)).map(|(id, _)| *id).collect();
        for id in late {
            if let Some((worker, job, tasks)) = self.second_run(id) {
                if let Some(lease) = self.leases.get_mut(&id) {
                    lease.doubled = true;
                }
                self.grant(worker, job, tasks, true);
            }
        }
    }

    /// Whether a lease takes far longer than its cost and that of the leases before it would usually take.
    fn is_late(&self, lease: &Lease, ms_per_cost: f64) -> bool {
        let elapsed_ms = self.now_ms.saturating_sub(lease.granted_ms);
        let usual_ms = ms_per_cost * lease.cost_with_ahead as f64;
        let is_old = elapsed_ms >= self.config.straggler_min_ms;
        !lease.doubled && is_old && elapsed_ms as f64 > self.config.straggler_factor * usual_ms
    }

    /// An idle worker for what is left of a lease, and its tasks from the end on, so that the two workers meet.
    fn second_run(&self, id: LeaseId) -> Option<(WorkerId, JobId, Vec<TaskId>)> {
        let lease = self.leases.get(&id)?;
        let job = self.jobs.get(&lease.job).filter(|job| self.may_lease(job))?;
        let once = |task: &TaskId| {
            self.tasks
                .get(task)
                .is_some_and(|task| task.state == TaskState::Leased(id, None) && task.failures.is_empty())
        };
        let tasks: Vec<_> = lease.tasks.iter().copied().filter(once).rev().collect();
        let key = &job.classes[self.tasks.get(tasks.first()?)?.class].key;
        let groups = self.workers.groups.values().filter(|group| fits(&group.capabilities, key.kind, &key.needs));
        let idle = groups.flat_map(|group| group.open.iter()).filter(|(_, worker)| *worker != lease.worker).min();
        idle.map(|&(_, worker)| (worker, lease.job, tasks))
    }
}
