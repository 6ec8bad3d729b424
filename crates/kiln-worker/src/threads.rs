//! The threads that tasks run on.
//!
//! They are not rayon's. A task may wait for another (two tasks of one level share its BVH: the first builds it, the
//! second waits) and may itself be parallel; on one pool, a thread that waits for its parallel parts would take up
//! the second task in between, and wait for itself for ever. So tasks have threads of their own, in the order in
//! which they were leased.
//!
//! What is parallel within a task is worth it only while there are fewer tasks than processors: else it hands work to
//! and fro for nothing, some hundred thousand times in a bake. So there are two threads for each processor. The one
//! runs small tasks while there are enough of them: it is the only member of a rayon pool of its own, on which what
//! is parallel runs inline. The other runs large tasks and the last small ones, and what is parallel there uses the
//! global pool. Of all these at most as many work at once as there are processors.

use crate::account;
use rayon::ThreadPoolBuilder;
use std::{
    collections::VecDeque,
    io,
    panic::resume_unwind,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread,
};

type Work = Box<dyn FnOnce() + Send>;

/// How much there is within a task for several threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TaskSize {
    /// Not enough, as long as other tasks wait.
    Small,
    /// Enough for all of them.
    Large,
}

/// How a thread works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Manner {
    /// What is parallel in a task runs inline.
    Alone,
    /// What is parallel in a task is shared with the global pool.
    Together,
}

/// A fixed number of threads that take work in order. They end after the queue when this is dropped.
#[derive(Clone)]
pub(crate) struct TaskThreads {
    owner: Arc<Owner>,
}

/// Closes the queue when the last of those who can add to it is gone.
struct Owner(Arc<Queue>);

impl Drop for Owner {
    fn drop(&mut self) {
        self.0.lock().is_closed = true;
        self.0.alone.notify_all();
        self.0.together.notify_all();
    }
}

impl TaskThreads {
    /// Starts the threads: as many run at once as `count` says, at least one.
    pub(crate) fn start(count: usize) -> io::Result<Self> {
        let queue = Arc::new(Queue { count: count.max(1), ..Queue::default() });
        let owner = Arc::new(Owner(Arc::clone(&queue)));
        for (manner, name) in [(Manner::Alone, "task"), (Manner::Together, "wide")] {
            for number in 0..queue.count {
                let queue = Arc::clone(&queue);
                thread::Builder::new().name(format!("kiln-{name}-{number}")).spawn(move || work(&queue, manner))?;
            }
        }
        Ok(Self { owner })
    }

    /// Queues work. It must not panic.
    pub(crate) fn run(&self, size: TaskSize, work: impl FnOnce() + Send + 'static) {
        let queue = &self.owner.0;
        let mut state = queue.lock();
        state.waiting.push_back((size, Box::new(work)));
        queue.wake_next(&state);
    }
}

fn work(queue: &Queue, manner: Manner) {
    // Without a pool of its own, which only a lack of memory explains, the thread shares what is parallel after all.
    let _pool = match manner {
        Manner::Alone => ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().ok(),
        Manner::Together => None,
    };
    let mut is_done = false;
    while let Some(next) = queue.next(manner, is_done) {
        next();
        is_done = true;
    }
}

#[derive(Default)]
struct Queue {
    /// Tasks that may run at once.
    count: usize,
    state: Mutex<State>,
    alone: Condvar,
    together: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<(TaskSize, Work)>,
    running: usize,
    is_closed: bool,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wakeup(&self, manner: Manner) -> &Condvar {
        match manner {
            Manner::Alone => &self.alone,
            Manner::Together => &self.together,
        }
    }

    /// Who may take the first task that waits, if anybody may now.
    fn next_manner(&self, state: &State) -> Option<Manner> {
        let (size, _) = state.waiting.front().filter(|_| state.running < self.count)?;
        let is_enough = state.running + state.waiting.len() >= self.count;
        Some(if *size == TaskSize::Small && is_enough { Manner::Alone } else { Manner::Together })
    }

    fn wake_next(&self, state: &State) {
        if let Some(manner) = self.next_manner(state) {
            self.wakeup(manner).notify_one();
        }
    }

    /// Waits for the next task of a thread, whose last one is done; none when the queue has ended.
    fn next(&self, manner: Manner, is_done: bool) -> Option<Work> {
        let mut state = self.lock();
        state.running -= usize::from(is_done);
        loop {
            match self.next_manner(&state) {
                Some(next) if next == manner => break,
                Some(other) => self.wakeup(other).notify_one(),
                None if state.is_closed && state.waiting.is_empty() => return None,
                None => {}
            }
            state = self.wakeup(manner).wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        let (_, next) = state.waiting.pop_front()?;
        state.running += 1;
        self.wake_next(&state);
        Some(next)
    }
}

/// Does something on a thread of no pool, so that what is parallel in it uses the global one: for work that other tasks
/// wait for, whichever task comes to it.
pub(crate) fn on_all_threads<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    let sheet = account::sheet();
    let charged = || match sheet {
        Some(sheet) => sheet.charge(work),
        None => work(),
    };
    let done = account::waiting(|| thread::scope(|scope| scope.spawn(charged).join()));
    done.unwrap_or_else(|panic| resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::{
        sync::{
            OnceLock,
            atomic::{AtomicUsize, Ordering},
            mpsc,
        },
        time::Duration,
    };

    const PATIENCE: Duration = Duration::from_secs(10);

    #[test]
    fn parallel_tasks_may_wait_for_each_other() {
        static SHARED: OnceLock<u64> = OnceLock::new();
        let threads = TaskThreads::start(4).unwrap();
        let (done, finished) = mpsc::channel();
        for number in 0..64 {
            let done = done.clone();
            let size = if number % 5 == 0 { TaskSize::Large } else { TaskSize::Small };
            threads.run(size, move || {
                let sum = || (0..10_000u64).into_par_iter().map(|i| i % 7).sum();
                let value = *SHARED.get_or_init(|| on_all_threads(sum));
                assert_eq!(value, sum());
                done.send(value).unwrap();
            });
        }
        let results: Vec<u64> = (0..64).map(|_| finished.recv_timeout(PATIENCE).unwrap()).collect();
        assert!(results.iter().all(|value| *value == results[0]));
    }

    /// Runs tasks, the first of which is at work before the others are queued, and tells how many threads each had for
    /// what is parallel in it.
    fn pools(count: usize, sizes: &[TaskSize]) -> Vec<usize> {
        let threads = TaskThreads::start(count).unwrap();
        let (begin, begun) = mpsc::channel();
        let (done, finished) = mpsc::channel();
        let gate = Arc::new((Mutex::new(false), Condvar::new()));
        for (task, size) in sizes.iter().enumerate() {
            let (begin, done, gate) = (begin.clone(), done.clone(), Arc::clone(&gate));
            threads.run(*size, move || {
                begin.send(()).unwrap();
                let (is_open, opened) = &*gate;
                drop(opened.wait_while(is_open.lock().unwrap(), |is_open| !*is_open).unwrap());
                done.send((task, rayon::current_num_threads())).unwrap();
            });
            if task == 0 {
                begun.recv_timeout(PATIENCE).unwrap();
            }
        }
        // As many as may be are at work before the first of them ends.
        (1..count.min(sizes.len())).for_each(|_| begun.recv_timeout(PATIENCE).unwrap());
        *gate.0.lock().unwrap() = true;
        gate.1.notify_all();
        let mut pools = vec![0; sizes.len()];
        for _ in sizes {
            let (task, pool) = finished.recv_timeout(PATIENCE).unwrap();
            pools[task] = pool;
        }
        pools
    }

    #[test]
    fn small_tasks_run_inline_while_there_are_enough() {
        let all = rayon::current_num_threads();
        assert_eq!(pools(1, &[TaskSize::Small; 3]), [1; 3]);
        assert_eq!(pools(1, &[TaskSize::Large; 3]), [all; 3]);
        // The first is by itself when it begins; the next one finds it at work.
        let two = pools(2, &[TaskSize::Small; 2]);
        assert_eq!(two, [all, 1]);
        let mixed = pools(2, &[TaskSize::Large, TaskSize::Small, TaskSize::Large]);
        assert_eq!(mixed, [all, 1, all]);
    }

    #[test]
    fn no_more_tasks_run_at_once_than_there_are_processors() {
        let threads = TaskThreads::start(3).unwrap();
        let (running, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let (done, finished) = mpsc::channel();
        for number in 0..60 {
            let (running, most, done) = (Arc::clone(&running), Arc::clone(&most), done.clone());
            let size = if number % 3 == 0 { TaskSize::Large } else { TaskSize::Small };
            threads.run(size, move || {
                most.fetch_max(running.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                thread::sleep(Duration::from_millis(1));
                running.fetch_sub(1, Ordering::SeqCst);
                done.send(()).unwrap();
            });
        }
        (0..60).for_each(|_| finished.recv_timeout(PATIENCE).unwrap());
        assert_eq!(most.load(Ordering::SeqCst), 3);
    }

    #[test]
    fn what_is_queued_is_done_before_the_threads_end() {
        let (done, finished) = mpsc::channel();
        let threads = TaskThreads::start(2).unwrap();
        for number in 0..20 {
            let done = done.clone();
            threads.run(TaskSize::Small, move || done.send(number).unwrap());
        }
        drop((threads, done));
        let mut all: Vec<i32> = finished.iter().collect();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..20), "and the channel ends with the threads");
    }
}
