//! What must hold of the scheduler's state after every event.

use crate::{
    Scheduler,
    job::{Job, TaskState},
    worker::fits,
};
use std::collections::{BTreeMap, BTreeSet};

/// Panics where the state contradicts itself.
pub(crate) fn check(scheduler: &Scheduler) {
    check_leases(scheduler);
    check_tasks(scheduler);
    scheduler.jobs.values().for_each(|job| check_job(scheduler, job));
    check_workers(scheduler);
}

/// Leased resources are the sum of leases, seen from workers, jobs and tenants alike.
fn check_leases(scheduler: &Scheduler) {
    let mut tenants: BTreeMap<String, usize> = BTreeMap::new();
    for (id, lease) in &scheduler.leases {
        assert!(!lease.tasks.is_empty(), "{id:?} is empty and not released");
        let worker = scheduler.workers.all.get(&lease.worker).expect("a lease's worker is known");
        assert!(worker.leases.contains(id) && !worker.set_aside);
        let job = scheduler.jobs.get(&lease.job).expect("a lease's job is not over");
        assert!(job.leases.contains(id));
        *tenants.entry(job.spec.tenant.clone()).or_default() += 1;
        for task in &lease.tasks {
            let task = &scheduler.tasks[task];
            let here = matches!(task.state, TaskState::Leased(one, other) if one == *id || other == Some(*id));
            assert!(here && task.job == lease.job);
            let key = &job.classes[task.class].key;
            assert_eq!(key.kind, lease.kind);
        }
    }
    assert_eq!(tenants, scheduler.tenants);
    let by_worker: usize = scheduler.workers.all.values().map(|worker| worker.leases.len()).sum();
    let by_job: usize = scheduler.jobs.values().map(|job| job.leases.len()).sum();
    assert_eq!((by_worker, by_job), (scheduler.leases.len(), scheduler.leases.len()));
}

fn check_tasks(scheduler: &Scheduler) {
    for (id, task) in &scheduler.tasks {
        let job = scheduler.jobs.get(&task.job).expect("a task's job is not over");
        assert!(job.tasks.contains(id));
        let class = &job.classes[task.class];
        let queued = class.fresh.contains(id) || class.alone.contains(id);
        assert_eq!(queued, task.state == TaskState::Waiting, "{id:?} {task:?}");
        match task.state {
            TaskState::Leased(one, other) => {
                assert_ne!(Some(one), other);
                for lease in [Some(one), other].into_iter().flatten() {
                    assert!(scheduler.leases[&lease].tasks.contains(id));
                }
            }
            TaskState::Delayed(until) => assert!(scheduler.delayed.contains(&(until, *id)), "{id:?} is forgotten"),
            TaskState::Waiting | TaskState::Done => {}
        }
    }
}

fn check_job(scheduler: &Scheduler, job: &Job) {
    assert_eq!(job.waiting, job.classes.iter().map(crate::job::Class::waiting).sum::<usize>());
    for class in &job.classes {
        let cost: u64 = class.fresh.iter().map(|task| scheduler.tasks[task].cost).sum();
        assert_eq!(cost, class.fresh_cost);
        assert!(class.alone.is_disjoint(&class.fresh));
    }
    assert!(job.spec.max_leases.is_none_or(|max| job.leases.len() <= max));
    assert!(scheduler.tenant_leases(job) <= scheduler.limits(job).max_leases);
}

fn check_workers(scheduler: &Scheduler) {
    let mut members = BTreeSet::new();
    for group in scheduler.workers.groups.values() {
        assert!(!group.members.is_empty());
        for id in &group.members {
            assert!(members.insert(*id));
            assert_eq!(scheduler.workers.all[id].capabilities, group.capabilities);
        }
        let available = group.members.iter().filter(|id| scheduler.workers.all[id].is_available()).count();
        assert_eq!(available, group.available);
        for (leases, id) in &group.open {
            let worker = &scheduler.workers.all[id];
            assert_eq!(*leases, worker.leases.len());
            assert!(worker.is_available() && worker.leases.len() < worker.capabilities.concurrent_leases as usize);
        }
    }
    assert_eq!(members.len(), scheduler.workers.all.len());
    for worker in scheduler.workers.all.values() {
        assert!(worker.leases.len() <= worker.capabilities.concurrent_leases as usize);
    }
}

/// After a dispatch, no worker that could take a lease is left idle beside a task that it could run.
pub(crate) fn check_no_idle_hands(scheduler: &Scheduler) {
    for group in scheduler.workers.groups.values().filter(|group| !group.open.is_empty()) {
        for job in scheduler.jobs.values().filter(|job| scheduler.may_lease(job)) {
            for class in job.classes.iter().filter(|class| !class.fresh.is_empty()) {
                let idle = fits(&group.capabilities, class.key.kind, &class.key.needs);
                assert!(!idle, "{:?} is idle and {:?} waits", group.open, class.key);
            }
        }
    }
}
