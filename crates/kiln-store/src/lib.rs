//! Artefacts by digest, results by task key, and the journal.
//!
//! Two kinds of file are the truth. *Packs* hold artefacts, and the results of tasks that name them: what is put
//! together goes into one file, written under another name, synced and renamed, so that a lease of work is durable
//! after one sync. The *journal* holds what happened to jobs: records appended and synced in groups. The index, in
//! sled, says in which pack an artefact is; it is derived, and is built anew wherever it is in doubt.
//!
//! Bytes are checked against their digest whenever they are read. What is damaged counts as missing: tasks are pure,
//! so that it is computed again. Opening a damaged folder never panics, and keeps what can still be read.
//!
//! One process has a data folder at a time. All calls block, and may come from any number of threads.

mod catalogue;
mod error;
mod fault;
mod garbage;
mod index;
mod journal;
mod layout;
mod lock;
mod options;
mod pack;
mod packs;
mod report;
mod store;
mod upload;

pub use error::StoreError;
pub use fault::{FaultAction, FaultPoint};
pub use garbage::Collected;
pub use journal::{Fence, JobOutcome, JournalEvent, SubmittedJob};
pub use options::OpenOptions;
pub use report::{ResultConflict, Usage};
pub use store::Store;
pub use upload::UploadState;
