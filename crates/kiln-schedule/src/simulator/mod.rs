//! A farm in miniature, driven by a seed: workers that crash, freeze, lose their connection, are slow, fail or lie;
//! messages that are late, lost and doubled; jobs with stages, some of which nobody can finish. After every event the
//! state is checked, and at the end every job must be over or say why not.
//!
//! A failing seed is printed; `KILN_SIM_SEED=n cargo test -p kiln-schedule simulator` runs that one alone, and tells
//! the story of it. `KILN_SIM_SEEDS=n` runs that many instead of 300.

mod check;
mod farm;
mod fleet;
mod hands;

pub(crate) use check::{check, check_no_idle_hands};

use crate::{Action, Config, Event, Scheduler};
use farm::{Farm, Summary};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A small generator with a good spread: splitmix64 (Steele, Lea and Flood, 2014).
#[derive(Clone, Debug)]
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From `low` to `high`, both included.
    pub(crate) fn range(&mut self, low: u64, high: u64) -> u64 {
        low + self.next() % (high - low + 1)
    }

    /// True once in `of` times.
    pub(crate) fn once_in(&mut self, of: u64) -> bool {
        self.next().is_multiple_of(of)
    }

    pub(crate) fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.range(0, from.len() as u64 - 1) as usize]
    }
}

fn run(seed: u64, tell: bool) -> Summary {
    let farm = Farm::new(seed, tell);
    farm.run()
}

#[test]
fn many_farms_go_well() {
    if let Ok(seed) = std::env::var("KILN_SIM_SEED") {
        println!("{:?}", run(seed.parse().expect("KILN_SIM_SEED is a number"), true));
        return;
    }
    let seeds = std::env::var("KILN_SIM_SEEDS").map_or(300, |count| count.parse().expect("KILN_SIM_SEEDS is a number"));
    let mut total = Summary::default();
    for seed in 0..seeds {
        match catch_unwind(AssertUnwindSafe(|| run(seed, false))) {
            Ok(summary) => total.add(&summary),
            Err(_) => panic!("seed {seed} fails: KILN_SIM_SEED={seed} cargo test -p kiln-schedule simulator"),
        }
    }
    // That everything the simulator knows does happen, so that the checks above check something.
    println!("{total:?}");
    let happened = [
        total.succeeded,
        total.failed,
        total.cancelled,
        total.duplicates,
        total.unknown,
        total.speculative,
        total.set_aside,
        total.expired,
        total.drained,
        total.returned,
        total.late_accepted,
    ];
    assert!(happened.iter().all(|count| *count > 0), "something never happened: {total:?}");
    assert!(total.succeeded > total.failed, "most jobs survive: {total:?}");
}

#[test]
fn the_same_events_give_the_same_actions() {
    for seed in 1000..1010 {
        let mut farm = Farm::new(seed, false);
        farm.keep_history();
        let history: Vec<(u64, Event, Vec<Action>)> = farm.run_for_history();
        assert!(history.len() > 100);
        let mut again = Scheduler::new(farm::config());
        for (now_ms, event, actions) in history {
            assert_eq!(again.apply(now_ms, event), actions);
        }
    }
}

#[test]
fn a_thousand_workers_and_a_hundred_thousand_tasks() {
    let report = fleet::run(Config::default(), 1000, 100_000);
    println!("{report:?}");
    assert_eq!(report.tasks, 100_000);
    assert!(report.leases < 60_000, "leases grow with measured speed: {report:?}");
    assert!(report.events_per_second > 2_000.0, "{report:?}");
}
