//! Wall and processor time of a stretch of work.

use kiln_worker::process_time;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Seconds that something took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Cost {
    /// By the clock on the wall.
    pub(crate) wall_secs: f64,
    /// Of all processors, by this process.
    pub(crate) cpu_secs: f64,
}

impl std::ops::Add for Cost {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { wall_secs: self.wall_secs + other.wall_secs, cpu_secs: self.cpu_secs + other.cpu_secs }
    }
}

/// Measures from when it is made.
pub(crate) struct Stopwatch {
    wall: Instant,
    cpu: Duration,
}

impl Stopwatch {
    pub(crate) fn start() -> Self {
        Self { wall: Instant::now(), cpu: process_time() }
    }

    pub(crate) fn read(&self) -> Cost {
        let cpu_secs = process_time().saturating_sub(self.cpu).as_secs_f64();
        Cost { wall_secs: self.wall.elapsed().as_secs_f64(), cpu_secs }
    }
}
