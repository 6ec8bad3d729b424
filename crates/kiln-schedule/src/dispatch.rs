//! Who gets what: the choice of the next lease.
//!
//! Among the jobs with tasks that a worker can run, the one with the greatest priority goes first, where a job gains
//! a step for every [`crate::Config::ageing_ms`] that it got nothing; then the one whose tenant has the fewest leases
//! for its weight; then one whose level the worker holds; then the oldest. The size of the lease follows the worker's
//! speed, and leaves something for the others towards the end.

use crate::{
    Scheduler, TaskId, WorkerId,
    job::{Class, Job},
    worker::{Worker, fits},
};
use kiln_core::{Digest, JobId, TaskKind};
use std::cmp::Ordering;

/// Towards the end of a job leases shrink to this part of the target and no further: each has a price of its own.
const LEAST_PART: u64 = 16;
/// Tasks to be leased alone that are looked at for one worker.
const ALONE_LOOKAHEAD: usize = 64;
/// Workers that are looked at for one that holds a level.
const LOCALITY_LOOKAHEAD: usize = 64;

/// How much right a job has to the next lease; greater goes first.
#[derive(Clone, Copy, Debug)]
struct Rank {
    priority: i64,
    tenant_share: f64,
    local: bool,
    job: JobId,
}

impl Rank {
    fn compare(&self, other: &Self) -> Ordering {
        let by_right = self.priority.cmp(&other.priority).then(other.tenant_share.total_cmp(&self.tenant_share));
        by_right.then(self.local.cmp(&other.local)).then(other.job.cmp(&self.job))
    }
}

/// What a worker is to get.
struct Choice {
    job: JobId,
    class: usize,
    /// A task that goes alone; none for those that go together.
    alone: Option<TaskId>,
}

impl Scheduler {
    /// Gives leases as long as open workers and waiting tasks fit each other.
    pub(crate) fn dispatch(&mut self) {
        if self.jobs.values().all(|job| job.waiting == 0) {
            return;
        }
        let groups: Vec<u32> = self.workers.groups.keys().copied().collect();
        for group in groups {
            while self.dispatch_to_group(group) {}
        }
    }

    /// Gives one lease to a worker of a group, if it can.
    fn dispatch_to_group(&mut self, group: u32) -> bool {
        let Some(open) = self.workers.groups.get(&group).map(|group| &group.open) else { return false };
        for &(held, worker) in open {
            if let Some(choice) = self.choose(worker) {
                let worker = self.with_level(group, held, worker, &choice);
                let tasks = self.fill(worker, &choice);
                self.grant(worker, choice.job, tasks, false);
                return true;
            }
            // Workers of a group differ only in which tasks failed on them.
            let any_alone = || self.jobs.values().flat_map(|job| &job.classes).any(|class| !class.alone.is_empty());
            if !any_alone() {
                return false;
            }
        }
        false
    }

    /// The job and class from which a worker is served next.
    fn choose(&self, id: WorkerId) -> Option<Choice> {
        let worker = self.workers.all.get(&id)?;
        let mut best: Option<(Rank, Choice)> = None;
        for (&job_id, job) in self.jobs.iter().filter(|(_, job)| job.waiting > 0 && self.may_lease(job)) {
            for (index, class) in job.classes.iter().enumerate().filter(|(_, class)| class.waiting() > 0) {
                if !fits(&worker.capabilities, class.key.kind, &class.key.needs) {
                    continue;
                }
                let rank = self.rank(job, worker.levels.contains(&class.key.locality));
                if best.as_ref().is_some_and(|(other, _)| rank.compare(other) != Ordering::Greater) {
                    continue;
                }
                let alone = class.alone.iter().take(ALONE_LOOKAHEAD).copied().find(|task| self.may_try(*task, id));
                if alone.is_some() || !class.fresh.is_empty() {
                    best = Some((rank, Choice { job: job_id, class: index, alone }));
                }
            }
        }
        best.map(|(_, choice)| choice)
    }

    /// Whether limits and pauses let a job have another lease.
    pub(crate) fn may_lease(&self, job: &Job) -> bool {
        let job_has_room = job.spec.max_leases.is_none_or(|max| job.leases.len() < max);
        !job.paused && job_has_room && self.tenant_leases(job) < self.limits(job).max_leases
    }

    /// Whether a task has not failed on a worker, or on all there are.
    pub(crate) fn may_try(&self, task: TaskId, worker: WorkerId) -> bool {
        let failed_here = self.tasks.get(&task).is_some_and(|t| t.failures.iter().any(|a| a.worker == worker));
        !failed_here || !self.has_untried_worker(task)
    }

    fn rank(&self, job: &Job, local: bool) -> Rank {
        let starved_ms = self.now_ms.saturating_sub(job.served_ms);
        let aged = i64::try_from(starved_ms / self.config.ageing_ms.max(1)).unwrap_or(i64::MAX);
        Rank {
            priority: i64::from(job.spec.priority).saturating_add(aged),
            tenant_share: self.tenant_leases(job) as f64 / self.limits(job).weight.max(f64::MIN_POSITIVE),
            local,
            job: job.spec.job,
        }
    }

    /// Jobs with waiting tasks that go before one.
    pub(crate) fn jobs_ahead(&self, job: &Job) -> usize {
        let own = self.rank(job, false);
        let others = self.jobs.values().filter(|other| other.waiting > 0 && self.may_lease(other));
        others.filter(|other| self.rank(other, false).compare(&own) == Ordering::Greater).count()
    }

    /// Another worker of the group with as much room that holds the level, where the first does not.
    fn with_level(&self, group: u32, held: usize, first: WorkerId, choice: &Choice) -> WorkerId {
        let Some(level) = self.class(choice).map(|class| class.key.locality) else { return first };
        let holds = |id: &WorkerId| self.workers.all.get(id).is_some_and(|worker| holds_level(worker, &level));
        if choice.alone.is_some() || holds(&first) {
            return first;
        }
        let open = self.workers.groups.get(&group).map(|group| &group.open);
        let peers = open.into_iter().flatten().take_while(|(leases, _)| *leases == held).map(|(_, id)| *id);
        peers.take(LOCALITY_LOOKAHEAD).find(|id| holds(id)).unwrap_or(first)
    }

    fn class(&self, choice: &Choice) -> Option<&Class> {
        self.jobs.get(&choice.job).map(|job| &job.classes[choice.class])
    }

    /// Takes the tasks of a lease from their queue.
    fn fill(&mut self, worker: WorkerId, choice: &Choice) -> Vec<TaskId> {
        let most_cost = self.class(choice).map_or(0, |class| self.lease_cost(worker, choice.job, class));
        let Some(job) = self.jobs.get_mut(&choice.job) else { return Vec::new() };
        let mut taken = Vec::new();
        let mut cost = 0u64;
        if let Some(id) = choice.alone {
            taken.push(id);
        } else {
            for id in job.classes[choice.class].fresh.iter().take(self.config.max_lease_tasks.max(1)) {
                cost = cost.saturating_add(self.tasks.get(id).map_or(1, |task| task.cost));
                if cost > most_cost && !taken.is_empty() {
                    break;
                }
                taken.push(*id);
            }
        }
        for id in &taken {
            if let Some(task) = self.tasks.get(id) {
                job.dequeue(*id, task);
            }
        }
        taken
    }

    /// Most cost of a lease: what the worker does in the target time, but where there are others, no more than half a
    /// fair part of what is left of the job, so that all end together. A worker that is not known yet gets one task.
    fn lease_cost(&self, worker: WorkerId, job: JobId, class: &Class) -> u64 {
        let kind: TaskKind = class.key.kind;
        let speed = self.workers.all.get(&worker).and_then(|worker| worker.speed.get(&kind));
        let Some(speed) = speed else { return 0 };
        let by_speed = (speed.cost_per_second * self.config.lease_target_seconds) as u64;
        let workers = self.workers.available(&class.key) as u64;
        if workers < 2 {
            return by_speed;
        }
        let left = self.jobs.get(&job).map_or(0, |job| job.fresh_cost(kind));
        by_speed.min((left / (2 * workers)).max(by_speed / LEAST_PART))
    }
}

fn holds_level(worker: &Worker, level: &Digest) -> bool {
    worker.levels.contains(level)
}
