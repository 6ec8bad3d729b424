//! Processor time of tasks that share threads.

use std::{cell::Cell, time::Duration};

thread_local! {
    /// Processor time of tasks that ran on this thread inside the present one.
    static INNER: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// Runs a task and returns its processor time on this thread, seconds. A thread that waits inside one task may run
/// another meanwhile: that one's time is its own.
pub(crate) fn measure<T>(task: impl FnOnce() -> T) -> (T, f64) {
    let outer = INNER.replace(Duration::ZERO);
    let start = thread_time();
    let result = task();
    let whole = thread_time().saturating_sub(start);
    let inner = INNER.replace(outer + whole);
    (result, whole.saturating_sub(inner).as_secs_f64())
}

#[cfg(unix)]
fn thread_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

/// Elsewhere wall time has to do.
#[cfg(not(unix))]
fn thread_time() -> Duration {
    use std::{sync::OnceLock, time::Instant};
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{hint::black_box, time::Instant};

    fn spin(time: Duration) {
        let start = Instant::now();
        while start.elapsed() < time {
            black_box(0);
        }
    }

    #[test]
    fn inner_tasks_keep_their_own_time() {
        let ((_, inner), outer) = measure(|| {
            spin(Duration::from_millis(5));
            measure(|| spin(Duration::from_millis(60)))
        });
        assert!(inner > outer, "{inner} {outer}");
    }
}
