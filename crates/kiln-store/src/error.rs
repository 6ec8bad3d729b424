//! What can go wrong in a store.

use kiln_core::Digest;
use std::{io, path::PathBuf};

/// An operation on the store failed. What was acknowledged before stays.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another process has the folder.
    #[error(
        "the data folder {} is in use by another kiln{}; stop it, or name another folder with --data-dir",
        .folder.display(), .holder_pid.map_or(String::new(), |pid| format!(" (process {pid})"))
    )]
    Locked {
        /// The data folder.
        folder: PathBuf,
        /// The process that has it, where it could be read.
        holder_pid: Option<u32>,
    },
    /// The disk is full.
    #[error("the disk of {} is full: free some space and try again; nothing that was acknowledged is lost", .path.display())]
    DiskFull {
        /// What was being written.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The folder would grow beyond its quota.
    #[error(
        "{wanted_bytes} bytes do not fit into {}: {used_bytes} of its quota of {quota_bytes} bytes are in use; \
         raise the quota, or let finished bakes be collected", .folder.display()
    )]
    OverQuota {
        /// The data folder.
        folder: PathBuf,
        /// Bytes of packs and uploads now.
        used_bytes: u64,
        /// What was to be added.
        wanted_bytes: u64,
        /// The quota.
        quota_bytes: u64,
    },
    /// The system failed to read or write.
    #[error("cannot {action} {}: {source}", .path.display())]
    Io {
        /// What was tried, such as `write`.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A file is of a later version of Kiln.
    #[error(
        "{} is of format {found}, and this kiln knows formats up to {known}: use the kiln that wrote it, or another --data-dir",
        .path.display()
    )]
    NewerFormat {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: u32,
        /// The newest format known here.
        known: u32,
    },
    /// The folder holds something else.
    #[error("{} is not a data folder of kiln: {reason}; name another folder with --data-dir", .path.display())]
    NotAStore {
        /// The folder.
        path: PathBuf,
        /// What is there.
        reason: String,
    },
    /// The index failed and could not be built anew.
    #[error("the index in {} failed ({reason}); stop kiln and start it again to rebuild it from the packs", .path.display())]
    Index {
        /// The index's folder.
        path: PathBuf,
        /// What it said.
        reason: String,
    },
    /// A result names an artefact that is neither stored nor given.
    #[error("the artefact {digest} is not in the store; upload it before its result is reported")]
    MissingArtefact {
        /// The artefact.
        digest: Digest,
    },
    /// A range does not lie within its artefact.
    #[error("bytes {offset}..{end} are asked of the artefact {digest}, which has {bytes}", end = .offset.saturating_add(*.len))]
    OutOfRange {
        /// The artefact.
        digest: Digest,
        /// First byte asked for.
        offset: u64,
        /// Bytes asked for.
        len: u64,
        /// The artefact's size.
        bytes: u64,
    },
    /// Too many or too large artefacts.
    #[error("{what}: {found}, and at most {limit} are allowed")]
    LimitExceeded {
        /// What is limited.
        what: &'static str,
        /// How many there are.
        found: u64,
        /// How many may be.
        limit: u64,
    },
    /// Uploaded bytes are not what their digest says.
    #[error(
        "the upload sent {found} where {expected} was announced; send the bytes from offset {committed_bytes} again"
    )]
    DigestMismatch {
        /// What was announced.
        expected: Digest,
        /// What came.
        found: Digest,
        /// How far the upload counts.
        committed_bytes: u64,
    },
    /// A chunk does not continue its upload.
    #[error(
        "a chunk of {len} bytes came for offset {offset}, but {committed_bytes} of {total_bytes} bytes are there; go on from {committed_bytes}"
    )]
    WrongOffset {
        /// Where the chunk would begin.
        offset: u64,
        /// Its length.
        len: u64,
        /// How far the upload is.
        committed_bytes: u64,
        /// The upload's length.
        total_bytes: u64,
    },
    /// An upload was not begun, or was given up.
    #[error("no upload {id} is under way; begin it again")]
    UnknownUpload {
        /// The upload.
        id: Digest,
    },
    /// An upload's end came too early.
    #[error("the upload {id} has {committed_bytes} of {total_bytes} bytes; send the rest first")]
    IncompleteUpload {
        /// The upload.
        id: Digest,
        /// How far it is.
        committed_bytes: u64,
        /// Its length.
        total_bytes: u64,
    },
    /// A coordinator that was superseded tried to write to the journal.
    #[error("the journal belongs to fence {held}, and {offered} came later to the old one; this coordinator must stop")]
    Fenced {
        /// The newest fence seen.
        held: u64,
        /// The one refused.
        offered: u64,
    },
    /// The journal failed in a way after which nothing can be promised.
    #[error("the journal in {} failed ({reason}), so that nothing more can be acknowledged; start kiln again", .path.display())]
    JournalBroken {
        /// The journal's folder.
        path: PathBuf,
        /// The first failure.
        reason: String,
    },
}

impl StoreError {
    /// An input or output error on a path; a full disk gets its own kind.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Self::DiskFull { path, source },
            _ => Self::Io { action, path, source },
        }
    }

    /// Whether the same call may succeed later without any change by the caller.
    pub fn is_retryable(&self) -> bool {
        matches!(self, Self::Locked { .. } | Self::DiskFull { .. } | Self::OverQuota { .. } | Self::Io { .. })
    }
}
