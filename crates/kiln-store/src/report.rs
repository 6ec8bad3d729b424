//! What a store says of itself and of what it was given.

use kiln_core::{Digest, TaskKey};

/// A result that differs from the one that is kept for its task. Tasks are pure, so that one of the two was computed
/// wrongly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResultConflict {
    /// The task.
    pub key: TaskKey,
    /// The result that is kept: the first.
    pub kept: Digest,
    /// The other.
    pub offered: Digest,
}

/// What a store holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Artefacts.
    pub artefacts: u64,
    /// Results of tasks.
    pub results: u64,
    /// Pack files.
    pub packs: u64,
    /// Their bytes.
    pub pack_bytes: u64,
    /// Bytes of uploads under way.
    pub incoming_bytes: u64,
    /// Bytes of the index.
    pub index_bytes: u64,
    /// Bytes of the journal.
    pub journal_bytes: u64,
    /// Bytes of damaged files that were set aside.
    pub quarantine_bytes: u64,
}
