//! Tasks that fail, lag behind, are handed back, or take their workers with them.

use super::{Bench, failed};
use crate::{Action, Config, Event, Explanation, Ignored, ReturnReason, RevokeReason, TaskId, WorkerId};

#[test]
fn failing_on_three_workers_fails_the_job_with_their_logs() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    (1..=4).for_each(|worker| drop(bench.worker(worker)));
    bench.tasks(1, 1);
    let mut tried = Vec::new();
    let (reason, attempts) = loop {
        let given = bench.given.last().unwrap().clone();
        tried.push(given.worker);
        if let Some(failed) = failed(&bench.fail(&given, false)) {
            break failed;
        }
    };
    assert_eq!(tried, [1, 2, 3], "a task does not go back to where it failed");
    assert_eq!(attempts.iter().map(|attempt| attempt.worker.0).collect::<Vec<_>>(), tried);
    assert!(attempts[2].reason.contains("worker 3 ran out of luck") && !reason.is_empty());
}

#[test]
fn where_there_is_one_worker_three_attempts_do() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 1);
    for attempt in 1..=3 {
        let given = bench.last(1);
        assert_eq!(given.epoch, attempt);
        let actions = bench.fail(&given, false);
        assert_eq!(failed(&actions).is_some(), attempt == 3);
        bench.live(1000, &[1]);
    }
}

#[test]
fn a_permanent_failure_is_not_tried_again() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.worker(2);
    bench.tasks(1, 2);
    let given = bench.given[0].clone();
    let actions = bench.fail(&given, true);
    let (reason, attempts) = failed(&actions).expect("it fails at once");
    assert!(reason.contains("ran out of luck") && attempts.len() == 1);
    let ended = |action: &Action| matches!(action, Action::RevokeLease { why: RevokeReason::JobEnded, .. });
    assert!(actions.iter().any(ended), "the other lease is called back: {actions:?}");
}

#[test]
fn a_straggler_is_run_twice_and_the_first_wins() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.worker(2);
    bench.tasks(1, 8);
    let stuck = bench.given[0].clone();
    for _ in 0..7 {
        let given = bench.given.iter().rfind(|given| given.worker == 2).cloned().unwrap();
        bench.live(1_000, &[1, 2]);
        assert!(bench.given.iter().all(|given| !given.speculative), "while others wait, nothing runs twice");
        bench.complete(&given, 1.0);
    }
    assert!(bench.given.iter().all(|given| !given.speculative));
    bench.live(250, &[1, 2]);
    let second = bench.last(2);
    assert!(second.speculative && second.tasks == stuck.tasks);
    bench.live(5_000, &[1, 2]);
    assert_eq!(bench.last(2).lease, second.lease, "twice is enough");
    let actions = bench.complete(&second, 1.0);
    let revoked = |action: &Action| {
        matches!(action, Action::RevokeLease { worker: WorkerId(1), ended: true, why: RevokeReason::DoneElsewhere, .. })
    };
    assert!(actions.iter().any(revoked), "{actions:?}");
    let actions = bench.complete(&stuck, 9.0);
    assert!(matches!(actions[..], [Action::ResultIgnored { why: Ignored::Duplicate, .. }]));
}

#[test]
fn what_is_handed_back_waits_and_has_a_budget() {
    let mut bench = Bench::new(Config { max_returns: 3, ..Config::default() });
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 1);
    let hand_back = |bench: &mut Bench, reason| {
        let given = bench.last(1);
        let (worker, lease, epoch) = (WorkerId(1), given.lease, given.epoch);
        bench.apply(Event::LeaseReturned { worker, lease, epoch, reason })
    };
    for _ in 0..5 {
        hand_back(&mut bench, ReturnReason::Draining);
        assert_eq!(bench.scheduler.stats().leases, 1, "not counted, and given anew");
    }
    let mut waits = Vec::new();
    for _ in 0..3 {
        let (leases, returned_ms) = (bench.given.len(), bench.now_ms);
        assert!(failed(&hand_back(&mut bench, ReturnReason::Busy)).is_none());
        assert!(matches!(bench.explain(1), Explanation::Delayed { .. }));
        while bench.given.len() == leases {
            bench.live(250, &[1]);
        }
        waits.push(bench.now_ms - returned_ms);
    }
    assert_eq!(waits, [250, 500, 1000]);
    let (reason, _) = failed(&hand_back(&mut bench, ReturnReason::Busy)).expect("the budget is spent");
    assert!(reason.contains("4 times"), "{reason}");
}

#[test]
fn a_task_that_takes_workers_with_it_goes_alone_and_then_fails() {
    let mut bench = Bench::new(Config::default());
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 400);
    bench.complete(&bench.last(1).clone(), 0.01);
    assert_eq!(bench.last(1).tasks.len(), 200);
    let mut sizes = Vec::new();
    let mut end = None;
    for worker in 2..20 {
        let actions = bench.apply(Event::WorkerLost(WorkerId(worker - 1)));
        end = failed(&actions);
        if end.is_some() {
            break;
        }
        bench.worker(worker);
        let given = bench.last(worker);
        sizes.push(given.tasks.len());
        assert!(given.tasks.contains(&TaskId(1001)), "{sizes:?}");
    }
    let (_, attempts) = end.expect("the sixth loss is too many");
    assert_eq!(attempts.len(), 6);
    assert!(sizes[1..].iter().all(|size| *size == 1), "{sizes:?}");
}

#[test]
fn a_lease_that_hangs_is_ended() {
    let mut bench = Bench::new(Config { max_lease_ms: 10_000, ..Config::default() });
    bench.job(1);
    bench.worker(1);
    bench.tasks(1, 1);
    let given = bench.last(1);
    let actions = bench.live(10_000, &[1]);
    let too_long = |action: &&Action| matches!(action, Action::RevokeLease { why: RevokeReason::TooLong, .. });
    assert_eq!(actions.iter().filter(too_long).count(), 1, "{actions:?}");
    bench.live(500, &[1]);
    assert_eq!(bench.last(1).epoch, given.epoch + 1);
}
