//! What goes into the scheduler and what comes out: events, actions and their parts.

use kiln_core::{Digest, JobId, TaskKind};
use std::collections::BTreeSet;
use std::fmt;

/// The number of a task, given by the coordinator; unique while the task's job lives. Of like tasks of a job those
/// with lower numbers run first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TaskId(pub u64);

/// The number of a worker, given by the coordinator; a worker keeps it over reconnections.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WorkerId(pub u64);

/// The number of a lease, given by the scheduler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeaseId(pub u64);

/// Which kinds of task a worker takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Roles {
    /// Kinds that trace.
    pub trace: bool,
    /// All others.
    pub reduce: bool,
}

impl Roles {
    /// Every kind of task.
    pub const ALL: Self = Self { trace: true, reduce: true };

    /// Whether the roles include a kind of task.
    pub fn take(self, kind: TaskKind) -> bool {
        if kind.traces() { self.trace } else { self.reduce }
    }
}

/// What a worker can do.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Capabilities {
    /// Kinds of task.
    pub roles: Roles,
    /// Lanes in which it can trace, such as `cpu`.
    pub trace_lanes: BTreeSet<String>,
    /// Lanes in which it can solve, such as `x86_64+avx2`.
    pub solve_lanes: BTreeSet<String>,
    /// Memory that one task may use.
    pub memory_bytes: u64,
    /// Cores, for reports.
    pub cores: u32,
    /// Leases it holds at once: 2 lets the next be fetched while one runs; at least 1.
    pub concurrent_leases: u32,
}

/// What a task asks of a worker.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Requirements {
    /// The lane, for kinds whose results depend on one: compared with what the worker offers for that part of it
    /// ([`TaskKind::lane_part`]). `None` runs anywhere.
    pub lane: Option<String>,
    /// Memory that the task needs.
    pub memory_bytes: u64,
}

/// A task whose inputs are all there.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadyTask {
    /// Its number.
    pub task: TaskId,
    /// Its kind.
    pub kind: TaskKind,
    /// Its size in units of its own kind (rays, vertices); 0 counts as 1.
    pub cost: u64,
    /// What it asks of a worker.
    pub needs: Requirements,
    /// What a worker that already holds it is preferred for: the digest of the level.
    pub locality: Digest,
}

/// A job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSpec {
    /// Its number; of two jobs with equal rights the lower goes first.
    pub job: JobId,
    /// Whose it is.
    pub tenant: String,
    /// Greater goes first.
    pub priority: i32,
    /// Most leases of the job at once; `None` for no limit.
    pub max_leases: Option<usize>,
}

/// A lease that a worker says it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldLease {
    /// Its number.
    pub lease: LeaseId,
    /// Its epoch.
    pub epoch: u32,
}

/// A task whose result was checked and stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompletedTask {
    /// The task.
    pub task: TaskId,
    /// Wall time that the worker spent on it, seconds: for tasks that ran side by side, the time of all shared out
    /// by cost. The measure of speed; nonsense (not finite, not positive) is not counted.
    pub seconds: f64,
}

/// Why a worker hands tasks back unfinished.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ReturnReason {
    /// It has no room (memory, disk, queue): counted against the budget for back-pressure.
    Busy,
    /// It is about to stop: not counted.
    Draining,
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A job was submitted. A job that is known is not changed.
    JobAdded(JobSpec),
    /// Tasks of a job became ready. Tasks that are known, and those of unknown jobs, are passed over.
    TasksReady {
        /// Their job.
        job: JobId,
        /// The tasks.
        tasks: Vec<ReadyTask>,
    },
    /// The job is at its end: what is left of it is dropped.
    JobFinished(JobId),
    /// The job is to stop.
    JobCancelled(JobId),
    /// No new leases for the job; those that run go on.
    JobPaused(JobId),
    /// Leases again.
    JobResumed(JobId),
    /// A worker connected, or came back: of the leases that the scheduler knows, those in `held` go on and the
    /// others are given anew; those that only the worker knows are revoked.
    WorkerJoined {
        /// Its number.
        worker: WorkerId,
        /// What it can do.
        capabilities: Capabilities,
        /// The leases it still works on.
        held: Vec<HeldLease>,
    },
    /// A sign of life. Every other event of a worker is one too.
    Heartbeat(WorkerId),
    /// A worker is at work on a lease.
    LeaseProgress {
        /// The worker.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
        /// Its epoch.
        epoch: u32,
    },
    /// Results of tasks were checked and stored. Accepted whoever brings them, lease or not.
    TasksCompleted {
        /// Who ran them.
        worker: WorkerId,
        /// The lease they ran under.
        lease: LeaseId,
        /// Its epoch.
        epoch: u32,
        /// The tasks.
        tasks: Vec<CompletedTask>,
    },
    /// A task did not succeed, or its result was refused.
    TaskFailed {
        /// Who ran it.
        worker: WorkerId,
        /// The lease it ran under.
        lease: LeaseId,
        /// Its epoch.
        epoch: u32,
        /// The task.
        task: TaskId,
        /// The worker's log line.
        reason: String,
        /// No other attempt could succeed (an input is refused): the job fails at once.
        permanent: bool,
    },
    /// A worker hands the rest of a lease back.
    LeaseReturned {
        /// The worker.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
        /// Its epoch.
        epoch: u32,
        /// Why.
        reason: ReturnReason,
    },
    /// A worker's connection broke: it keeps its leases for the time of grace.
    WorkerDisconnected(WorkerId),
    /// A worker is gone for good: its leases are given to others now.
    WorkerLost(WorkerId),
    /// A worker takes no new leases, and loses those that it holds at the deadline.
    WorkerDraining {
        /// The worker.
        worker: WorkerId,
        /// When it stops, on the clock of [`crate::Scheduler::apply`].
        deadline_ms: u64,
    },
    /// Time passed. To be sent about four times a second: timeouts and stragglers are found here.
    Tick,
}

/// Why a lease, or a part of it, is taken from a worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RevokeReason {
    /// Its job ended.
    JobEnded,
    /// Another worker finished the tasks first.
    DoneElsewhere,
    /// The scheduler does not know the lease, or gave its tasks to others.
    Unknown,
    /// It ran longer than a lease may.
    TooLong,
    /// The worker is set aside.
    SetAside,
    /// The worker's deadline to drain is past.
    Drained,
}

/// Why a result was not the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ignored {
    /// The task is finished already: compare the two results.
    Duplicate,
    /// The job is over, or the task was never announced.
    Unknown,
}

/// One attempt at a task that did not succeed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AttemptLog {
    /// Who tried.
    pub worker: WorkerId,
    /// The worker's log line, or how it was lost.
    pub reason: String,
}

/// Why a worker gets no more leases, until it comes with a new number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SetAsideReason {
    /// Tasks it failed that others completed.
    pub failed_tasks: u32,
    /// Its last log line.
    pub last_reason: String,
}

impl fmt::Display for SetAsideReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { failed_tasks, last_reason } = self;
        write!(f, "it failed {failed_tasks} tasks that other workers completed (the last: {last_reason})")
    }
}

/// What the coordinator is to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Send tasks to a worker.
    Lease {
        /// The worker.
        worker: WorkerId,
        /// The lease's number.
        lease: LeaseId,
        /// Guards the lease's state only: one more than the leases that its tasks had before.
        epoch: u32,
        /// The job.
        job: JobId,
        /// The tasks, all of one kind, in the order in which they are best run: that of their numbers, or the reverse
        /// where they run elsewhere already, so that the two meet.
        tasks: Vec<TaskId>,
        /// When the lease ends unless the worker shows life.
        deadline_ms: u64,
        /// These tasks run elsewhere already, too slowly.
        speculative: bool,
    },
    /// Tell a worker to stop work on tasks.
    RevokeLease {
        /// The worker.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
        /// The lease's epoch.
        epoch: u32,
        /// The tasks to stop; empty where the lease is unknown here.
        tasks: Vec<TaskId>,
        /// Nothing of the lease is left.
        ended: bool,
        /// Why.
        why: RevokeReason,
    },
    /// The first result of a task: it counts.
    TaskAccepted {
        /// Its job.
        job: JobId,
        /// The task.
        task: TaskId,
        /// Who ran it.
        worker: WorkerId,
    },
    /// A result that does not count.
    ResultIgnored {
        /// The task.
        task: TaskId,
        /// Who ran it.
        worker: WorkerId,
        /// Why.
        why: Ignored,
    },
    /// A task will be tried again.
    TaskRetried {
        /// Its job.
        job: JobId,
        /// The task.
        task: TaskId,
        /// What happened to the last attempt.
        attempt: AttemptLog,
    },
    /// A job cannot succeed; it is dropped.
    JobFailed {
        /// The job.
        job: JobId,
        /// What is the matter.
        reason: String,
        /// The task at fault, if one is.
        task: Option<TaskId>,
        /// Its attempts.
        attempts: Vec<AttemptLog>,
    },
    /// A worker gets no more leases.
    WorkerSetAside {
        /// The worker.
        worker: WorkerId,
        /// Why.
        why: SetAsideReason,
    },
    /// A worker was given up: silent for too long.
    WorkerExpired(WorkerId),
    /// A worker that drains holds nothing any more.
    WorkerDrained(WorkerId),
}
