//! Processor time of rayon's global pool, given to those who use it.
//!
//! The pool's threads belong to no task: what is parallel within a task that runs on a thread of no pool is done by
//! them while it waits. Such a task claims the pool for as long. What its threads used since the last change of claims is
//! split equally among the claims there were, which for one claim is exact.

use crate::account::Entry;
use std::{
    mem,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

struct Meter {
    last: Duration,
    claims: Vec<(u64, Arc<Entry>)>,
    next_id: u64,
}

static METER: Mutex<Meter> = Mutex::new(Meter { last: Duration::ZERO, claims: Vec::new(), next_id: 0 });

/// As long as it lives, the pool works for an entry, too.
pub(crate) struct Claim(u64);

impl Claim {
    /// A claim from now on; none on a thread of a pool, whose parallel work is done there or counted by who waits.
    pub(crate) fn new(entry: &Arc<Entry>) -> Option<Self> {
        if rayon::current_thread_index().is_some() {
            return None;
        }
        let mut meter = settled();
        let id = meter.next_id;
        meter.next_id += 1;
        meter.claims.push((id, Arc::clone(entry)));
        Some(Self(id))
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        settled().claims.retain(|(id, _)| *id != self.0);
    }
}

/// The meter, with all time up to now given out. What nobody claims is nobody's.
fn settled() -> MutexGuard<'static, Meter> {
    let mut meter = METER.lock().unwrap_or_else(PoisonError::into_inner);
    let now = pool_time();
    let used = now.saturating_sub(mem::replace(&mut meter.last, now));
    if let Some(share) = used.checked_div(meter.claims.len() as u32) {
        meter.claims.iter().for_each(|(_, entry)| entry.add_cpu(share));
    }
    meter
}

/// Processor time of all threads of the global pool so far. The scheduler's figures are up to a tick old for a thread
/// that runs; they never run ahead.
#[cfg(target_os = "linux")]
fn pool_time() -> Duration {
    use std::{fs, sync::OnceLock};
    static FILES: OnceLock<Vec<String>> = OnceLock::new();
    let file = || format!("/proc/self/task/{}/schedstat", rustix::thread::gettid().as_raw_nonzero());
    let nanoseconds =
        |file: &String| -> Option<u64> { fs::read_to_string(file).ok()?.split_whitespace().next()?.parse().ok() };
    let files = FILES.get_or_init(|| rayon::broadcast(|_| file()));
    Duration::from_nanos(files.iter().filter_map(nanoseconds).sum())
}

/// Elsewhere the pool's threads tell nobody, and their time is in no stage.
#[cfg(not(target_os = "linux"))]
fn pool_time() -> Duration {
    Duration::ZERO
}
