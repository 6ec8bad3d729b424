//! Workers that go silent, break, drain or fail.

use super::Bench;
use crate::{
    Action, Capabilities, Config, Event, Explanation, HeldLease, Ignored, LeaseId, RevokeReason, Roles, WorkerId,
};
use kiln_core::JobId;
use std::collections::BTreeSet;

#[test]
fn a_silent_workers_tasks_go_to_others_and_its_late_result_counts() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 1);
    let first = bench.last(1);
    bench.worker(2);
    assert_eq!(first.epoch, 1);
    assert!(bench.live(14_000, &[2]).is_empty());
    let actions = bench.live(1_000, &[2]);
    assert!(actions.contains(&Action::WorkerExpired(WorkerId(1))));
    let second = bench.last(2);
    assert_eq!((second.tasks.clone(), second.epoch), (first.tasks.clone(), 2));
    let task = first.tasks[0];
    let actions = bench.complete(&first, 1.0);
    assert!(actions.contains(&Action::TaskAccepted { job: JobId(1), task, worker: WorkerId(1) }));
    let revoked = actions.iter().any(|action| {
        matches!(action, Action::RevokeLease { worker: WorkerId(2), ended: true, why: RevokeReason::DoneElsewhere, .. })
    });
    assert!(revoked);
    let actions = bench.complete(&second, 1.0);
    assert_eq!(actions, [Action::ResultIgnored { task, worker: WorkerId(2), why: Ignored::Duplicate }]);
    bench.apply(Event::JobFinished(JobId(1)));
    let actions = bench.complete(&second, 1.0);
    assert_eq!(actions, [Action::ResultIgnored { task, worker: WorkerId(2), why: Ignored::Unknown }]);
}

#[test]
fn a_short_break_costs_nothing_and_a_long_one_the_lease() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 1);
    let given = bench.last(1);
    let rejoin = |bench: &mut Bench, held: &[(LeaseId, u32)]| {
        let held = held.iter().map(|&(lease, epoch)| HeldLease { lease, epoch }).collect();
        let capabilities = bench.scheduler.workers.all.values().next().map(|worker| worker.capabilities.clone());
        let capabilities = capabilities.unwrap_or(Capabilities {
            roles: Roles::ALL,
            trace_lanes: BTreeSet::from(["cpu".to_owned()]),
            solve_lanes: BTreeSet::new(),
            memory_bytes: 1 << 30,
            cores: 1,
            concurrent_leases: 1,
        });
        bench.apply(Event::WorkerJoined { worker: WorkerId(1), capabilities, held })
    };
    bench.apply(Event::WorkerDisconnected(WorkerId(1)));
    assert!(bench.pass(2_500).is_empty());
    assert_eq!(rejoin(&mut bench, &[(given.lease, given.epoch)]), [], "it keeps its lease");
    bench.apply(Event::WorkerDisconnected(WorkerId(1)));
    assert!(bench.pass(3_500).contains(&Action::WorkerExpired(WorkerId(1))));
    let actions = rejoin(&mut bench, &[(given.lease, given.epoch)]);
    let revoked = |action: &Action| matches!(action, Action::RevokeLease { lease, why: RevokeReason::Unknown, .. } if *lease == given.lease);
    assert!(actions.iter().any(revoked), "{actions:?}");
    let again = bench.last(1);
    assert_eq!((again.tasks.clone(), again.epoch), (given.tasks, 2));
    let actions = rejoin(&mut bench, &[]);
    assert!(actions.iter().any(|action| matches!(action, Action::TaskRetried { .. })), "started anew: {actions:?}");
    assert_eq!(bench.last(1).epoch, 3);
}

#[test]
fn who_fails_what_others_complete_is_set_aside() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.worker(2);
    bench.tasks(1, 40);
    let mut set_aside = None;
    for _ in 0..60 {
        let latest = |worker| bench.given.iter().rfind(|given| given.worker == worker).cloned();
        if let Some(given) = latest(1) {
            bench.fail(&given, false);
        }
        let given = bench.given.iter().rfind(|given| given.worker == 2).cloned().unwrap();
        for action in bench.complete(&given, 5.0) {
            if let Action::WorkerSetAside { worker, why } = action {
                set_aside = Some((worker, why));
            }
        }
        bench.live(500, &[1, 2]);
        if set_aside.is_some() {
            break;
        }
    }
    let (worker, why) = set_aside.expect("the broken worker is found out");
    assert_eq!((worker, why.failed_tasks), (WorkerId(1), 3));
    assert!(why.to_string().contains("ran out of luck"));
    let before = bench.given.len();
    bench.live(120_000, &[1, 2]);
    assert!(bench.given[before..].iter().all(|given| given.worker != 1), "it gets nothing more");
}

#[test]
fn a_worker_that_fails_rests_longer_each_time() {
    let mut bench = Bench::new(Config { max_task_failures: 100, ..Config::default() });
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 1);
    let mut rests = Vec::new();
    for _ in 0..5 {
        let (given, failed_ms) = (bench.last(1), bench.now_ms);
        bench.fail(&given, false);
        while bench.given.last().unwrap().lease == given.lease {
            bench.live(250, &[1]);
        }
        rests.push(bench.now_ms - failed_ms);
    }
    assert_eq!(rests, [250, 500, 1000, 2000, 4000]);
}

#[test]
fn draining_ends_by_itself_or_at_the_deadline() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.worker(2);
    bench.tasks(1, 10);
    let (one, two) = (bench.given[0].clone(), bench.given[1].clone());
    for worker in [1, 2] {
        assert_eq!(bench.apply(Event::WorkerDraining { worker: WorkerId(worker), deadline_ms: 2_000 }), []);
    }
    assert!(bench.complete(&one, 1.0).contains(&Action::WorkerDrained(WorkerId(1))));
    assert!(bench.live(1_750, &[1, 2]).is_empty());
    let actions = bench.live(500, &[1, 2]);
    let revoked = actions.iter().any(
        |action| matches!(action, Action::RevokeLease { lease, why: RevokeReason::Drained, .. } if *lease == two.lease),
    );
    assert!(revoked && actions.contains(&Action::WorkerDrained(WorkerId(2))), "{actions:?}");
    assert_eq!(bench.given.len(), 2, "those that drain get nothing new");
    assert_eq!(bench.explain(1), Explanation::WorkersUnavailable { workers: 2 });
    bench.worker(3);
    assert_eq!(bench.last(3).tasks, two.tasks, "what was taken back goes first");
}
