//! The threads that tasks run on.
//!
//! They are not rayon's. A task may wait for another (two tasks of one level share its BVH: the first builds it, the
//! second waits) and may itself be parallel; on one pool, a thread that waits for its parallel parts would take up
//! the second task in between, and wait for itself for ever. So tasks have threads of their own, in the order in
//! which they were leased, and what is parallel within a task uses rayon's pool.

use std::{
    io,
    sync::{Arc, Mutex, PoisonError, mpsc},
    thread,
};

type Work = Box<dyn FnOnce() + Send>;

/// A fixed number of threads that take work in order. They end after the queue when this is dropped.
#[derive(Clone)]
pub(crate) struct TaskThreads {
    queue: mpsc::Sender<Work>,
}

impl TaskThreads {
    /// Starts the threads, at least one.
    pub(crate) fn start(count: usize) -> io::Result<Self> {
        let (queue, work) = mpsc::channel::<Work>();
        let work = Arc::new(Mutex::new(work));
        for number in 0..count.max(1) {
            let work = Arc::clone(&work);
            thread::Builder::new().name(format!("kiln-task-{number}")).spawn(move || {
                loop {
                    // The lock is held while waiting: whoever has it is next, and the others queue for it.
                    let next = work.lock().unwrap_or_else(PoisonError::into_inner).recv();
                    let Ok(next) = next else { return };
                    next();
                }
            })?;
        }
        Ok(Self { queue })
    }

    /// Queues work. It must not panic.
    pub(crate) fn run(&self, work: impl FnOnce() + Send + 'static) {
        // The threads live as long as the queue.
        let _ = self.queue.send(Box::new(work));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::{sync::OnceLock, time::Duration};

    #[test]
    fn parallel_tasks_may_wait_for_each_other() {
        static SHARED: OnceLock<u64> = OnceLock::new();
        let threads = TaskThreads::start(4).unwrap();
        let (done, finished) = mpsc::channel();
        for _ in 0..16 {
            let done = done.clone();
            threads.run(move || {
                let value = *SHARED.get_or_init(|| (0..10_000u64).into_par_iter().map(|i| i % 7).sum());
                done.send(value).unwrap();
            });
        }
        let results: Vec<u64> = (0..16).map(|_| finished.recv_timeout(Duration::from_secs(10)).unwrap()).collect();
        assert!(results.iter().all(|value| *value == results[0]));
    }
}
