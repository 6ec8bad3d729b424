//! Clocks of processor time: of this process and of the calling thread.

use std::time::Duration;

/// Processor time that this process has used so far, in all its threads.
#[cfg(unix)]
pub fn process_time() -> Duration {
    read(rustix::time::ClockId::ProcessCPUTime)
}

/// Processor time that the calling thread has used so far.
#[cfg(unix)]
pub(crate) fn thread_time() -> Duration {
    read(rustix::time::ClockId::ThreadCPUTime)
}

#[cfg(unix)]
fn read(clock: rustix::time::ClockId) -> Duration {
    let time = rustix::time::clock_gettime(clock);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

/// Elsewhere wall time has to do.
#[cfg(not(unix))]
pub fn process_time() -> Duration {
    use std::{sync::OnceLock, time::Instant};
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

/// Elsewhere wall time has to do.
#[cfg(not(unix))]
pub(crate) fn thread_time() -> Duration {
    process_time()
}
