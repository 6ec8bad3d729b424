//! How many rays a dispatch has: few enough that no watchdog thinks the device hangs and that others get their turn,
//! enough that its overhead does not count.

use std::time::Duration;

/// Rays of the first dispatch: some milliseconds even on the slowest device.
const FIRST: u64 = 1 << 14;
const LEAST: u64 = 1 << 10;
const MOST: u64 = 1 << 26;

const TOO_SHORT: Duration = Duration::from_millis(25);
const TOO_LONG: Duration = Duration::from_millis(50);

/// Follows the device's speed by powers of two. What is traced together changes no result.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    rays: u64,
}

impl Budget {
    pub(crate) fn new() -> Self {
        Self { rays: FIRST }
    }

    /// Rays that the next dispatch should have at most.
    pub(crate) fn rays(&self) -> u64 {
        self.rays
    }

    /// Takes note of a dispatch. A small one that was fast says nothing; one that compiled a shader says too much, for
    /// which one step down is a small price.
    pub(crate) fn observe(&mut self, rays: u64, elapsed: Duration) {
        if elapsed > TOO_LONG {
            self.rays = (self.rays / 2).max(LEAST);
        } else if elapsed < TOO_SHORT && rays > self.rays / 2 {
            self.rays = (self.rays * 2).min(MOST);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settles_within_the_bounds_at_any_speed() {
        for rays_per_second in [1e5, 1e6, 3e7, 1e9] {
            let mut budget = Budget::new();
            for _ in 0..40 {
                budget.observe(budget.rays(), Duration::from_secs_f64(budget.rays() as f64 / rays_per_second));
            }
            let secs = budget.rays() as f64 / rays_per_second;
            assert!((0.0125..=0.05).contains(&secs), "{secs} at {rays_per_second}");
        }
    }

    #[test]
    fn small_dispatches_say_nothing() {
        let mut budget = Budget::new();
        budget.observe(10, Duration::from_micros(100));
        assert_eq!(budget.rays(), FIRST);
    }
}
