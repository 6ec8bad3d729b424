//! A pure, synchronous scheduler of jobs, tasks and leases.
//!
//! [`Scheduler::apply`] takes an event and the time, and returns actions: there is no clock, no input or output, no
//! global and no order that depends on hashing in here, so that the same events give the same actions, and a
//! simulation of days of a farm's life takes a second.
//!
//! It knows tasks that are ready, not what they depend on: the coordinator announces a task when its inputs are there.
//! A *lease* gives tasks of one job and kind to a worker; results are accepted from whoever brings them, the first
//! for each task, so that losing a lease, or giving its tasks out twice, costs time and nothing else.
//!
//! - `dispatch`: which job a worker serves next, and how much of it;
//! - `outcome`: results, failures, returns and losses, each with a budget of its own;
//! - `watch`: what time brings: lost workers, stragglers, jobs that nobody can run;
//! - `explain`: why a job is not running.

mod config;
mod dispatch;
mod explain;
mod job;
mod lease;
mod message;
mod outcome;
mod scheduler;
mod watch;
mod worker;

pub use config::{Config, TenantLimits};
pub use explain::Explanation;
pub use message::{
    Action, AttemptLog, Capabilities, CompletedTask, Event, HeldLease, Ignored, JobSpec, LeaseId, ReadyTask,
    Requirements, ReturnReason, RevokeReason, Roles, SetAsideReason, TaskId, WorkerId,
};
pub use scheduler::{Scheduler, Stats};

#[cfg(test)]
mod rules;
#[cfg(test)]
mod simulator;
