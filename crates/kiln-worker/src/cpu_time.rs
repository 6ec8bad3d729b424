//! Processor time of tasks.
//!
//! A task may be parallel and share its threads with others, so it has no clock of its own. The process has: what
//! it used since the last lease ended is put down to the lease that ends now. The sum is right; between leases that
//! overlap, the one that ends first gets the time of both.

use std::{
    sync::{Mutex, PoisonError},
    time::Duration,
};

/// Gives out the process's processor time, each bit of it once.
pub(crate) struct CpuMeter(Mutex<Duration>);

impl CpuMeter {
    /// A meter that starts now.
    pub(crate) fn start() -> Self {
        Self(Mutex::new(process_time()))
    }

    /// Seconds used since the last call.
    pub(crate) fn take(&self) -> f64 {
        let mut given = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = process_time();
        let seconds = now.saturating_sub(*given).as_secs_f64();
        *given = now;
        seconds
    }
}

/// Processor time that this process has used so far, in all its threads.
#[cfg(unix)]
pub fn process_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

/// Elsewhere wall time has to do.
#[cfg(not(unix))]
pub fn process_time() -> Duration {
    use std::{sync::OnceLock, time::Instant};
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{hint::black_box, thread, time::Instant};

    #[test]
    fn counts_work_of_every_thread_once() {
        let meter = CpuMeter::start();
        let spin = || {
            let start = Instant::now();
            while start.elapsed() < Duration::from_millis(50) {
                black_box(0);
            }
        };
        thread::spawn(spin).join().unwrap();
        let used = meter.take();
        assert!(used > 0.005, "{used}");
        assert!(meter.take() < used, "it was given out already");
    }
}
