//! A worker: leases tasks, runs them and streams results back.
//!
//! [`run`] keeps one session with the coordinator: hello, leases, heartbeats, results. A lease runs on the worker's
//! threads while the next is already here; its results are stored together, then reported, and reported again after a
//! reconnect until the coordinator has settled them. What a task *is* stands in [`tasks`]; where its bytes come from
//! and go to is [`Artefacts`]: the coordinator's own store in one process, uploads and downloads elsewhere.

mod account;
mod artefacts;
mod cpu_time;
mod executor;
mod lease;
mod local_cache;
mod pool_time;
mod recent;
mod session;
pub mod tasks;
mod threads;

pub use artefacts::{ArtefactError, Artefacts, LocalArtefacts, RemoteArtefacts};
pub use cpu_time::process_time;
pub use executor::{CancelFlag, Executor, Lanes, TaskError, TaskOutput};
pub use local_cache::LocalCache;
pub use session::{Role, WorkerConfig, WorkerError, run};
