//! What a task costs, told apart by what it does.
//!
//! Each task has a [`Sheet`]. The thread that runs it has it open and adds its own processor time to one entry at a
//! time, by its own clock, so no time is counted twice and none of another task's comes in. Time of rayon's global
//! pool is added by [`crate::pool_time`]. A clock is read where the entry changes: some thousand times in a second.

use crate::{cpu_time::thread_time, pool_time::Claim};
use std::{
    cell::RefCell,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

/// What a task does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// All that is not told apart.
    Own,
    /// Loads a level: meshes from artefacts.
    Loading,
    /// Builds BVHs.
    Building,
    /// Traces rays.
    Tracing,
}

/// Time of one part.
#[derive(Debug, Default)]
pub(crate) struct Entry {
    cpu_ns: AtomicU64,
    wall_ns: AtomicU64,
}

impl Entry {
    pub(crate) fn add_cpu(&self, time: Duration) {
        self.cpu_ns.fetch_add(nanoseconds(time), Ordering::Relaxed);
    }

    /// Processor seconds so far.
    pub(crate) fn cpu_seconds(&self) -> f64 {
        self.cpu_ns.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// Seconds so far that threads were at it.
    pub(crate) fn seconds(&self) -> f64 {
        self.wall_ns.load(Ordering::Relaxed) as f64 * 1e-9
    }
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// What a task has cost so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sheet([Arc<Entry>; 4]);

impl Sheet {
    /// One part's entry.
    pub(crate) fn entry(&self, part: Part) -> &Arc<Entry> {
        &self.0[part as usize]
    }

    /// Processor seconds of all parts.
    pub(crate) fn cpu_seconds(&self) -> f64 {
        self.0.iter().map(|entry| entry.cpu_seconds()).sum()
    }

    /// Does something on this thread that is charged to this sheet.
    pub(crate) fn charge<R>(&self, work: impl FnOnce() -> R) -> R {
        self.open(Part::Own, true, work)
    }

    fn open<R>(&self, part: Part, claims_pool: bool, work: impl FnOnce() -> R) -> R {
        let _turn = Turn::start(self.clone(), part, claims_pool);
        work()
    }
}

/// Does a part of the task that this thread runs; just does it if it runs none.
pub(crate) fn part<R>(part: Part, work: impl FnOnce() -> R) -> R {
    match sheet() {
        Some(sheet) => sheet.open(part, true, work),
        None => work(),
    }
}

/// Waits for what another thread does, so that the pool does nothing for this one.
pub(crate) fn waiting<R>(work: impl FnOnce() -> R) -> R {
    match sheet() {
        Some(sheet) => sheet.open(Part::Own, false, work),
        None => work(),
    }
}

/// The sheet of the task that this thread runs, for a thread that does a part of it.
pub(crate) fn sheet() -> Option<Sheet> {
    OPEN.with_borrow(|open| open.as_ref().map(|open| open.sheet.clone()))
}

thread_local! {
    static OPEN: RefCell<Option<Open>> = const { RefCell::new(None) };
}

/// What a thread is at.
struct Open {
    sheet: Sheet,
    part: Part,
    claims_pool: bool,
    cpu: Duration,
    wall: Instant,
    claim: Option<Claim>,
}

impl Open {
    fn new(sheet: Sheet, part: Part, claims_pool: bool) -> Self {
        let claim = if claims_pool { Claim::new(sheet.entry(part)) } else { None };
        Self { claim, sheet, part, claims_pool, cpu: thread_time(), wall: Instant::now() }
    }

    fn settle(&mut self) {
        self.claim = None;
        let entry = self.sheet.entry(self.part);
        entry.add_cpu(thread_time().saturating_sub(self.cpu));
        entry.wall_ns.fetch_add(nanoseconds(self.wall.elapsed()), Ordering::Relaxed);
    }
}

/// A stretch of one part; when it ends, also by a panic, the thread goes on with what it was at.
struct Turn {
    before: Option<Open>,
}

impl Turn {
    fn start(sheet: Sheet, part: Part, claims_pool: bool) -> Self {
        let mut before = OPEN.take();
        if let Some(before) = &mut before {
            before.settle();
        }
        OPEN.set(Some(Open::new(sheet, part, claims_pool)));
        Self { before }
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        if let Some(mut open) = OPEN.take() {
            open.settle();
        }
        let resume = |Open { sheet, part, claims_pool, .. }| Open::new(sheet, part, claims_pool);
        OPEN.set(self.before.take().map(resume));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::process_time;
    use rayon::prelude::*;
    use std::{
        hint::black_box,
        panic::catch_unwind,
        sync::{Mutex, MutexGuard, PoisonError},
        thread,
    };

    /// Keeps this thread busy for so much of its own time.
    fn spin(milliseconds: u64) {
        let start = thread_time();
        while thread_time() - start < Duration::from_millis(milliseconds) {
            black_box(0);
        }
    }

    /// Claims of several tests at once would share what the pool does.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

    fn alone() -> MutexGuard<'static, ()> {
        ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn of(sheet: &Sheet, part: Part) -> f64 {
        sheet.entry(part).cpu_seconds()
    }

    #[test]
    fn time_goes_to_the_part_that_uses_it() {
        let _alone = alone();
        let (sheet, other) = (Sheet::default(), Sheet::default());
        let before = process_time();
        thread::scope(|scope| {
            scope.spawn(|| other.charge(|| spin(30)));
            sheet.charge(|| {
                spin(20);
                part(Part::Tracing, || {
                    spin(40);
                    part(Part::Building, || spin(60));
                    spin(10);
                });
                thread::sleep(Duration::from_millis(20));
            });
        });
        let used = (process_time() - before).as_secs_f64();
        let own = |sheet| of(sheet, Part::Own);
        // Nothing is lost; what is above is time of the pool, which other tests here may use meanwhile.
        assert!(own(&sheet) >= 0.02 && of(&sheet, Part::Tracing) >= 0.05 && of(&sheet, Part::Building) >= 0.06);
        assert!(own(&other) >= 0.03);
        assert!(sheet.cpu_seconds() + other.cpu_seconds() <= used, "{sheet:?} {other:?} of {used}");
        assert_eq!(of(&sheet, Part::Loading), 0.0);
        assert!(sheet.entry(Part::Own).seconds() >= 0.04, "waiting takes time, if no processor time");
    }

    #[test]
    fn what_is_parallel_is_charged_to_who_waits_for_it() {
        let _alone = alone();
        let sheet = Sheet::default();
        let before = process_time();
        sheet.charge(|| part(Part::Building, || (0..20).into_par_iter().for_each(|_| spin(10))));
        let used = (process_time() - before).as_secs_f64();
        let building = of(&sheet, Part::Building);
        // The scheduler's figures may be a tick of 10 ms old for each thread.
        if cfg!(target_os = "linux") {
            assert!(building >= 0.1, "{building}");
        }
        assert!(sheet.cpu_seconds() <= used + 0.05, "{} of {used}", sheet.cpu_seconds());
        // In a pool of its own the thread does it all itself.
        let sheet = Sheet::default();
        thread::scope(|scope| {
            scope.spawn(|| {
                let _pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
                sheet.charge(|| part(Part::Tracing, || (0..10).into_par_iter().for_each(|_| spin(10))));
            });
        });
        assert!(of(&sheet, Part::Tracing) >= 0.1 && of(&sheet, Part::Own) < 0.05, "{sheet:?}");
    }

    #[test]
    fn a_panic_ends_a_part() {
        let _alone = alone();
        let sheet = Sheet::default();
        sheet.charge(|| {
            let _ = catch_unwind(|| part(Part::Tracing, || std::panic::resume_unwind(Box::new(()))));
            waiting(|| spin(20));
        });
        assert!(of(&sheet, Part::Own) >= 0.02 && super::sheet().is_none());
        assert_eq!(part(Part::Tracing, || 7), 7, "without a task it is just done");
    }
}
