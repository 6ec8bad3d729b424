//! Which job is served, and how much of it goes into a lease.

use super::{Bench, failed};
use crate::{Action, Config, Event, Explanation, ReturnReason, RevokeReason, TaskId, TenantLimits, WorkerId};
use kiln_core::{JobId, TaskKind};
use std::collections::{BTreeMap, BTreeSet};

#[test]
fn what_nobody_can_run_fails_with_the_reason() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.tasks_with(1, 1, |task| task.needs.lane = Some("gpu:x:1".to_owned()));
    assert_eq!(bench.explain(1), Explanation::NoWorkers);
    assert!(failed(&bench.pass(1_000_000)).is_none(), "workers may still come");
    bench.worker(1);
    bench.worker_with(2, |capabilities| capabilities.roles.trace = false);
    assert!(matches!(bench.explain(1), Explanation::NoWorkerFits { kind: TaskKind::Trace, .. }));
    assert!(failed(&bench.live(59_000, &[1, 2])).is_none());
    let (reason, _) = failed(&bench.live(2_000, &[1, 2])).expect("nobody came");
    for part in ["gpu:x:1", "lanes [cpu]", "role trace"] {
        assert!(reason.contains(part), "{reason}");
    }
    assert_eq!(bench.explain(1), Explanation::Unknown);
}

#[test]
fn memory_and_lanes_and_roles_are_minded() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.tasks_with(1, 1, |task| task.needs.memory_bytes = 1 << 31);
    bench.worker(1);
    assert!(bench.given.is_empty());
    bench.worker_with(2, |capabilities| capabilities.memory_bytes = 1 << 31);
    assert_eq!(bench.last(2).tasks, [TaskId(1000)]);
    bench.job(2);
    bench.tasks_with(2, 1, |task| {
        task.kind = TaskKind::Solve;
        task.needs.lane = Some("x86_64".to_owned());
    });
    assert_eq!(bench.last(1).job, 2);
    bench.job(3);
    bench.tasks_with(3, 1, |task| task.kind = TaskKind::Export);
    bench.worker_with(4, |capabilities| capabilities.roles.reduce = false);
    assert_eq!(bench.given.len(), 2, "an export needs the role reduce");
    bench.worker_with(5, |capabilities| capabilities.trace_lanes.clear());
    assert_eq!(bench.last(5).job, 3, "and no lane");
}

#[test]
fn a_job_without_a_lane_is_traced_in_all_and_outlives_one() {
    let mut bench = Bench::new(Config { max_lease_tasks: 2, ..Config::default() });
    bench.job(1);
    bench.tasks_with(1, 6, |task| task.needs.lane = None);
    bench.worker_with(1, |capabilities| capabilities.trace_lanes = BTreeSet::from(["gpu:x:1".to_owned()]));
    let held = bench.last(1);
    bench.worker(2);
    let mut given = bench.last(2);
    bench.worker_with(3, |capabilities| capabilities.roles.trace = false);
    assert_eq!(bench.given.len(), 2, "nothing for who does not trace");
    // The device is lost: its worker leaves, and hands back what it holds.
    let (worker, lease, epoch) = (WorkerId(1), held.lease, held.epoch);
    bench.apply(Event::WorkerDraining { worker, deadline_ms: 20_000 });
    bench.apply(Event::LeaseReturned { worker, lease, epoch, reason: ReturnReason::Draining });
    let mut traced: BTreeSet<TaskId> = given.tasks.iter().copied().collect();
    while traced.len() < 6 {
        bench.complete(&given, 0.01);
        given = bench.last(2);
        assert!(given.tasks.iter().all(|task| traced.insert(*task)), "{given:?}");
    }
    assert!(held.tasks.iter().all(|task| traced.contains(task)));
}

#[test]
fn priority_goes_first_and_waiting_raises_it() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.job_with(2, |spec| spec.priority = 2);
    bench.tasks(1, 50);
    bench.tasks(2, 500);
    bench.worker(1);
    let mut first_of_low = None;
    for round in 0..400u64 {
        let given = bench.last(1);
        if given.job == 1 {
            first_of_low = Some(round);
            break;
        }
        bench.now_ms += 1000;
        bench.complete(&given, 100.0);
    }
    let waited_s = first_of_low.expect("the low priority starves");
    assert!((120..=181).contains(&waited_s), "two steps and one to be ahead, at a minute each: {waited_s}");
}

#[test]
fn tenants_share_by_weight() {
    let weights = [("a", 2.0), ("b", 1.0)];
    let tenants = weights.map(|(name, weight)| (name.to_owned(), TenantLimits { weight, max_leases: 100 }));
    let mut bench = Bench::new(Config { tenants: BTreeMap::from(tenants), ..Config::default() });
    for (job, tenant) in [(1, "a"), (2, "a"), (3, "b")] {
        bench.job_with(job, |spec| tenant.clone_into(&mut spec.tenant));
        bench.tasks(job, 100);
    }
    (0..9).for_each(|worker| drop(bench.worker(worker)));
    let of_b = bench.given.iter().filter(|given| given.job == 3).count();
    assert_eq!((bench.given.len(), of_b), (9, 3));
}

#[test]
fn limits_hold_and_are_explained() {
    let tenants = BTreeMap::from([("studio".to_owned(), TenantLimits { weight: 1.0, max_leases: 3 })]);
    let mut bench = Bench::new(Config { tenants, ..Config::default() });
    bench.job_with(1, |spec| spec.max_leases = Some(2));
    bench.job(2);
    bench.job(3);
    (1..=3).for_each(|job| drop(bench.tasks(job, 10)));
    (0..6).for_each(|worker| drop(bench.worker(worker)));
    let jobs: Vec<_> = bench.given.iter().map(|given| given.job).collect();
    assert_eq!(jobs, [1, 1, 2]);
    assert_eq!(bench.explain(1), Explanation::Running { leases: 2, tasks: 2, waiting: 8 });
    assert_eq!(bench.explain(3), Explanation::TenantLimit { tenant: "studio".to_owned(), max_leases: 3 });
    bench.job_with(4, |spec| (spec.tenant, spec.max_leases) = ("other".to_owned(), Some(0)));
    bench.tasks(4, 1);
    assert_eq!(bench.explain(4), Explanation::JobLimit { max_leases: 0 });
    bench.apply(Event::JobCancelled(JobId(1)));
    assert_eq!(bench.given.len(), 5, "what a job held goes to others");
}

#[test]
fn leases_grow_with_speed_and_shrink_towards_the_end() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.worker(2);
    bench.tasks(1, 1000);
    let (one, two) = (bench.given[0].clone(), bench.given[1].clone());
    assert_eq!((one.tasks.len(), two.tasks.len()), (1, 1), "unknown workers get little");
    bench.complete(&one, 0.01);
    assert_eq!(bench.last(1).tasks.len(), 200, "2 s at 100 tasks a second");
    bench.complete(&two, 1.0);
    assert_eq!(bench.last(2).tasks.len(), 2, "2 s at 1 task a second");
    bench.complete(&bench.last(2).clone(), 1.0);
    let mut sizes = Vec::new();
    let mut given = bench.given.iter().rfind(|given| given.worker == 1).cloned().unwrap();
    loop {
        bench.complete(&given, 0.01);
        let next = bench.given.last().unwrap().clone();
        if next.lease == given.lease || next.worker != 1 {
            break;
        }
        sizes.push(next.tasks.len());
        given = next;
    }
    assert!(sizes.is_sorted_by(|a, b| a >= b), "{sizes:?}");
    assert!(sizes[0] == 199 || sizes[0] == 200 || sizes[0] == 198, "{sizes:?}");
    assert!(sizes.len() > 10 && sizes[5] < 100, "a part is left for the other: {sizes:?}");
}

#[test]
fn a_worker_is_given_the_level_it_holds() {
    let mut bench = Bench::new(Config::default());
    bench.worker(1);
    bench.worker(2);
    for job in [1, 2] {
        bench.job(job);
        bench.tasks(job, 20);
    }
    let (one, two) = (bench.given[0].clone(), bench.given[1].clone());
    assert_eq!((one.job, two.job), (1, 1), "the oldest job first");
    bench.apply(Event::JobPaused(JobId(1)));
    bench.complete(&two, 50.0);
    let two = bench.last(2);
    assert_eq!(two.job, 2);
    bench.apply(Event::JobResumed(JobId(1)));
    bench.complete(&two, 50.0);
    assert_eq!(bench.last(2).job, 1, "of two levels at hand the older job");
    bench.worker(3);
    bench.apply(Event::JobPaused(JobId(1)));
    bench.worker(4);
    let four = bench.last(4);
    assert_eq!(four.job, 2);
    bench.apply(Event::JobResumed(JobId(1)));
    bench.complete(&four, 50.0);
    assert_eq!(bench.last(4).job, 2, "it holds the level of 2 only");
}

#[test]
fn pausing_lets_leases_run_and_gives_none() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 3);
    let given = bench.last(1);
    bench.apply(Event::JobPaused(JobId(1)));
    assert_eq!(bench.explain(1), Explanation::Paused { leases: 1 });
    bench.complete(&given, 1.0);
    assert_eq!((bench.given.len(), bench.explain(1)), (1, Explanation::Paused { leases: 0 }));
    bench.apply(Event::JobResumed(JobId(1)));
    assert_eq!(bench.given.len(), 2);
    let actions = bench.apply(Event::JobCancelled(JobId(1)));
    assert!(matches!(actions[..], [Action::RevokeLease { why: RevokeReason::JobEnded, ended: true, .. }]));
    assert_eq!(bench.scheduler.stats(), crate::Stats { workers: 1, ..Default::default() });
}

#[test]
fn a_busy_farm_says_who_is_ahead() {
    let mut bench = Bench::new(Config::default());
    bench.worker(1);
    bench.job_with(1, |spec| spec.priority = 5);
    bench.tasks(1, 9);
    bench.job(2);
    assert_eq!(bench.explain(2), Explanation::NothingReady);
    bench.tasks(2, 1);
    assert_eq!(bench.explain(2), Explanation::Waiting { jobs_ahead: 1, workers: 1 });
    assert_eq!(bench.explain(9), Explanation::Unknown);
}
