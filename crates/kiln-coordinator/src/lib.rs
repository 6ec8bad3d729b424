//! The coordinator: bakes, workers and artefacts over gRPC.
//!
//! ```text
//!   clients ──▶ services ──▶ dispatcher ──▶ scheduler (pure)
//!   workers ──▶     │        one loop,      jobs (pure state machines)
//!                   │        owns all       keeper ──▶ store: journal, results
//!                   └─────────────────────────────────▶ store: artefacts
//! ```
//!
//! A bake is taken from state to state (`job`) by what the store and the workers answer. Each task is looked up by
//! its key first and run only if nobody has run it before; equal keys in the air run once. What a client is told
//! has happened is in the journal. A coordinator that is started on the same folder goes on where the last one was
//! killed: it replays the journal, and finds the results of finished tasks by their keys.
//!
//! The coordinator sees digests, sizes and counts, never geometry: it decodes levels, task graphs and summaries,
//! and checks the sizes and ranges of results before it accepts them.

mod access;
mod check;
mod config;
mod dispatcher;
mod error;
mod events;
mod flights;
mod job;
mod keeper;
mod lanes;
mod server;
mod services;
mod transport;

pub use access::{ListenError, listen};
pub use config::{Config, Token, TokenError, Unfinished};
pub use error::{ServeError, StartError};
pub use server::Coordinator;
pub use transport::{InMemoryConnector, InMemoryIncoming, in_memory};

use error::store_status;
