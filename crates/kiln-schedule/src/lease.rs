//! Leases: tasks in the hands of a worker.

use crate::{Action, AttemptLog, LeaseId, RevokeReason, Scheduler, TaskId, WorkerId, job::TaskState};
use kiln_core::{JobId, TaskKind};
use std::collections::BTreeSet;

/// Tasks in the hands of a worker.
#[derive(Debug)]
pub(crate) struct Lease {
    pub(crate) worker: WorkerId,
    pub(crate) job: JobId,
    pub(crate) kind: TaskKind,
    pub(crate) epoch: u32,
    /// Those that are not done.
    pub(crate) tasks: BTreeSet<TaskId>,
    pub(crate) granted_ms: u64,
    /// Cost of this lease and of those of its kind that the worker held already.
    pub(crate) cost_with_ahead: u64,
    /// Its tasks are with a second worker too.
    pub(crate) doubled: bool,
    /// A task of it failed: the time it took says nothing.
    pub(crate) spoilt: bool,
}

/// What happens to the tasks of a lease that ends unfinished.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Requeue {
    /// They wait again, as if nothing had happened.
    Free,
    /// They wait again, and the loss of the worker counts.
    Lost,
    /// They wait for a time first, and the return counts.
    Returned,
    /// The job is over.
    Dropped,
}

impl Scheduler {
    /// The lease, if the worker holds it in this epoch.
    pub(crate) fn held(&self, worker: WorkerId, lease: LeaseId, epoch: u32) -> Option<&Lease> {
        self.leases.get(&lease).filter(|held| held.worker == worker && held.epoch == epoch)
    }

    /// Gives tasks, which are in no queue, to a worker.
    pub(crate) fn grant(&mut self, worker_id: WorkerId, job_id: JobId, tasks: Vec<TaskId>, speculative: bool) {
        let Some(first) = tasks.first().and_then(|id| self.tasks.get(id)) else { return };
        let (Some(job), Some(worker)) = (self.jobs.get_mut(&job_id), self.workers.all.get_mut(&worker_id)) else {
            return;
        };
        let key = &job.classes[first.class].key;
        let (kind, level) = (key.kind, key.locality);
        let id = LeaseId(self.next_lease);
        self.next_lease += 1;
        let ahead = worker.leases.iter().filter_map(|held| self.leases.get(held)).filter(|held| held.kind == kind);
        let ahead: u64 = ahead.flat_map(|held| &held.tasks).filter_map(|id| self.tasks.get(id)).map(|t| t.cost).sum();
        let (mut epoch, mut cost) = (0, ahead);
        for task_id in &tasks {
            let Some(task) = self.tasks.get_mut(task_id) else { continue };
            task.leased += 1;
            epoch = epoch.max(task.leased);
            cost = cost.saturating_add(task.cost);
            task.state = match task.state {
                TaskState::Leased(first, _) => TaskState::Leased(first, Some(id)),
                _ => TaskState::Leased(id, None),
            };
        }
        job.leases.insert(id);
        job.served_ms = self.now_ms;
        *self.tenants.entry(job.spec.tenant.clone()).or_default() += 1;
        worker.leases.insert(id);
        worker.remember_level(level);
        self.workers.refresh(worker_id, self.now_ms);
        self.leases.insert(
            id,
            Lease {
                worker: worker_id,
                job: job_id,
                kind,
                epoch,
                tasks: tasks.iter().copied().collect(),
                granted_ms: self.now_ms,
                cost_with_ahead: cost,
                doubled: speculative,
                spoilt: false,
            },
        );
        let deadline_ms = self.now_ms.saturating_add(self.config.heartbeat_timeout_ms);
        self.actions.push(Action::Lease {
            worker: worker_id,
            lease: id,
            epoch,
            job: job_id,
            tasks,
            deadline_ms,
            speculative,
        });
    }

    /// Takes a lease off all lists; its tasks are still to be seen to.
    pub(crate) fn release(&mut self, id: LeaseId) -> Option<Lease> {
        let lease = self.leases.remove(&id)?;
        if let Some(job) = self.jobs.get_mut(&lease.job) {
            job.leases.remove(&id);
            if let Some(count) = self.tenants.get_mut(&job.spec.tenant) {
                *count -= 1;
                if *count == 0 {
                    self.tenants.remove(&job.spec.tenant);
                }
            }
        }
        if let Some(worker) = self.workers.all.get_mut(&lease.worker) {
            worker.leases.remove(&id);
            if worker.draining.is_some() && worker.leases.is_empty() && !worker.drained {
                worker.drained = true;
                self.actions.push(Action::WorkerDrained(lease.worker));
            }
        }
        self.workers.refresh(lease.worker, self.now_ms);
        Some(lease)
    }

    /// Ends a lease before its tasks are done. Where a reason to revoke is given, the worker is told.
    pub(crate) fn end_lease(&mut self, id: LeaseId, requeue: Requeue, why: Option<RevokeReason>) {
        let Some(lease) = self.release(id) else { return };
        let (worker, epoch) = (lease.worker, lease.epoch);
        if let Some(why) = why {
            let tasks = lease.tasks.iter().copied().collect();
            self.actions.push(Action::RevokeLease { worker, lease: id, epoch, tasks, ended: true, why });
        }
        for task in lease.tasks {
            self.leave_lease(task, id);
            match requeue {
                Requeue::Dropped => {}
                Requeue::Free => self.requeue(task, 0),
                Requeue::Lost => self.task_lost(task, worker),
                Requeue::Returned => self.task_returned(task),
            }
        }
    }

    /// Notes that a task is no longer in a lease; it may be in another.
    pub(crate) fn leave_lease(&mut self, task: TaskId, lease: LeaseId) {
        let Some(task) = self.tasks.get_mut(&task) else { return };
        task.state = match task.state {
            TaskState::Leased(one, Some(other)) if one == lease => TaskState::Leased(other, None),
            TaskState::Leased(one, Some(other)) if other == lease => TaskState::Leased(one, None),
            TaskState::Leased(one, None) if one == lease => TaskState::Delayed(self.now_ms),
            state => state,
        };
    }

    /// Has a task wait again, at once or after a time, unless another worker has it too.
    pub(crate) fn requeue(&mut self, id: TaskId, delay_ms: u64) {
        let Some(task) = self.tasks.get_mut(&id) else { return };
        if matches!(task.state, TaskState::Leased(..) | TaskState::Done) {
            return;
        }
        if delay_ms > 0 {
            let until_ms = self.now_ms.saturating_add(delay_ms);
            task.state = TaskState::Delayed(until_ms);
            self.delayed.insert((until_ms, id));
            return;
        }
        task.state = TaskState::Waiting;
        if let Some(job) = self.jobs.get_mut(&task.job) {
            job.enqueue(id, task);
        }
    }

    /// Queues the tasks whose time has come.
    pub(crate) fn wake_tasks(&mut self) {
        while let Some(&(until_ms, id)) = self.delayed.first() {
            if until_ms > self.now_ms {
                break;
            }
            self.delayed.pop_first();
            // It may have been completed by a late result, or its job may have ended.
            if self.tasks.get(&id).is_some_and(|task| task.state == TaskState::Delayed(until_ms)) {
                self.requeue(id, 0);
            }
        }
    }

    /// The log of a lost worker.
    pub(crate) fn loss(worker: WorkerId) -> AttemptLog {
        AttemptLog { worker, reason: format!("worker {} was lost while it had the task", worker.0) }
    }
}
