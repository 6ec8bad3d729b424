//! All that a worker traces on, and which of it a task gets.

use super::Backend;
use crate::TaskError;
use kiln_core::MIXED_LANE;
use kiln_gpu::GpuDevice;
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

/// Tasks of mixed bakes that are on the device at once: one is traced while the next is made ready.
const ON_DEVICE: usize = 2;

/// One backend, or the processor and a device side by side.
pub struct Backends {
    /// The preferred first; at most one of each kind.
    all: Vec<Backend>,
    /// Tasks of mixed bakes that are on the device.
    on_device: AtomicUsize,
    device_is_lost: AtomicBool,
}

impl From<Backend> for Backends {
    fn from(backend: Backend) -> Self {
        Self::new(vec![backend])
    }
}

impl Backends {
    /// The processor, and a device if there is one.
    pub fn mixed(device: Option<Arc<GpuDevice>>) -> Self {
        // A software driver is the processor by a longer way.
        let is_real = device.as_ref().is_some_and(|device| device.adapter().kind.is_real());
        let mut all: Vec<Backend> = device.into_iter().map(Backend::Gpu).chain([Backend::Cpu]).collect();
        if !is_real {
            all.reverse();
        }
        Self::new(all)
    }

    fn new(all: Vec<Backend>) -> Self {
        Self { all, on_device: AtomicUsize::new(0), device_is_lost: AtomicBool::new(false) }
    }

    /// Those that can be used: a device that was lost is not among them.
    fn usable(&self) -> impl Iterator<Item = &Backend> {
        let is_lost = self.device_is_lost.load(Ordering::Relaxed);
        self.all.iter().filter(move |backend| !is_lost || matches!(backend, Backend::Cpu))
    }

    /// The lanes of trace tasks, the preferred first.
    pub fn lanes(&self) -> Vec<String> {
        self.usable().map(Backend::lane).collect()
    }

    /// What they are, for people.
    pub fn describe(&self) -> String {
        self.all.iter().map(Backend::describe).collect::<Vec<_>>().join(" and ")
    }

    /// Threads that tasks are to have where the processor has so many: more where a device works beside it, since the threads
    /// of tasks on the device mostly wait.
    pub fn threads(&self, processor_threads: usize) -> usize {
        processor_threads + if self.all.len() > 1 { ON_DEVICE } else { 0 }
    }

    /// Traces in the lane of a bake; for a mixed bake on the device while it has room, else on the processor.
    pub(super) fn trace<T>(&self, lane: &str, run: impl Fn(&Backend) -> Result<T, TaskError>) -> Result<T, TaskError> {
        if lane != MIXED_LANE {
            let own = self.all.iter().find(|backend| backend.lane() == lane);
            let reason = || format!("this worker traces in the lanes {}, not {lane}", self.lanes().join(", "));
            let outcome = run(own.ok_or_else(|| TaskError::Failed { reason: reason() })?);
            self.note(&outcome);
            return outcome;
        }
        let cpu = self.all.iter().find(|backend| matches!(backend, Backend::Cpu));
        let device = self.usable().find(|backend| matches!(backend, Backend::Gpu(_)));
        if let Some(device) = device
            && let Some(_place) = Place::take(&self.on_device, if cpu.is_some() { ON_DEVICE } else { usize::MAX })
        {
            let outcome = run(device);
            self.note(&outcome);
            match (outcome, cpu) {
                (Err(error @ (TaskError::DeviceLost { .. } | TaskError::Failed { .. })), Some(_)) => {
                    tracing::warn!(%error, "a piece is traced on the processor instead");
                }
                (outcome, _) => return outcome,
            }
        }
        match cpu {
            Some(cpu) => run(cpu),
            None => Err(TaskError::DeviceLost { reason: format!("{} was lost", self.describe()) }),
        }
    }

    fn note<T>(&self, outcome: &Result<T, TaskError>) {
        if matches!(outcome, Err(TaskError::DeviceLost { .. })) {
            self.device_is_lost.store(true, Ordering::Relaxed);
        }
    }
}

/// One of the places on a device.
struct Place<'a>(&'a AtomicUsize);

impl<'a> Place<'a> {
    fn take(taken: &'a AtomicUsize, most: usize) -> Option<Self> {
        let more = |count: usize| (count < most).then_some(count + 1);
        taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more).ok().map(|_| Self(taken))
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_gpu::AdapterChoice;
    use std::sync::Mutex;

    fn both() -> (Backends, String) {
        let device = GpuDevice::open(&AdapterChoice::Software).unwrap();
        let device = device.expect("these tests need a software Vulkan driver, such as mesa-vulkan-drivers");
        let lane = device.lane();
        (Backends::mixed(Some(device)), lane)
    }

    #[test]
    fn the_processor_takes_what_the_device_has_no_room_for() {
        let (backends, card) = both();
        assert_eq!(backends.lanes(), ["cpu".to_owned(), card.clone()], "a software driver is not preferred");
        assert_eq!((backends.threads(4), Backends::from(Backend::Cpu).threads(4)), (6, 4));
        // Each task starts the next before it ends.
        let ran = Mutex::new(Vec::new());
        fn deeper(backends: &Backends, ran: &Mutex<Vec<String>>, left: usize) -> Result<(), TaskError> {
            backends.trace(MIXED_LANE, |backend| {
                ran.lock().unwrap().push(backend.lane());
                if left > 0 { deeper(backends, ran, left - 1) } else { Ok(()) }
            })
        }
        deeper(&backends, &ran, 3).unwrap();
        assert_eq!(*ran.lock().unwrap(), [card.as_str(), &card, "cpu", "cpu"]);
        // And the places are free again.
        let first = backends.trace(MIXED_LANE, |backend| Ok(backend.lane())).unwrap();
        assert_eq!(first, card);
    }

    #[test]
    fn one_lane_is_kept_and_unknown_ones_are_refused() {
        let (backends, card) = both();
        for lane in ["cpu", &card] {
            assert_eq!(backends.trace(lane, |backend| Ok(backend.lane())).unwrap(), lane);
        }
        let error = backends.trace("gpu:other:1", |_| Ok(())).unwrap_err().to_string();
        assert!(error.contains("gpu:other:1") && error.contains(&card), "{error}");
    }

    #[test]
    fn without_its_device_a_mixed_bake_goes_on_and_another_does_not() {
        let (backends, card) = both();
        let lost = |backend: &Backend| match backend {
            Backend::Cpu => Ok(()),
            Backend::Gpu(_) => Err(TaskError::DeviceLost { reason: "it was lost".to_owned() }),
        };
        assert!(backends.trace(MIXED_LANE, lost).is_ok());
        assert_eq!(backends.lanes(), ["cpu"]);
        assert!(matches!(backends.trace(&card, lost), Err(TaskError::DeviceLost { .. })));
        // One that fails is kept: the next piece may fit.
        let (backends, _) = both();
        let fails = |backend: &Backend| match backend {
            Backend::Cpu => Ok(()),
            Backend::Gpu(_) => Err(TaskError::Failed { reason: "too large".to_owned() }),
        };
        assert!(backends.trace(MIXED_LANE, fails).is_ok());
        assert_eq!(backends.lanes().len(), 2);
    }
}
