//! What can go wrong with a coordinator as a whole, and how the store's errors are told to clients.

use kiln_proto::status;
use kiln_store::StoreError;
use std::{io, sync::Arc, time::Duration};
use tonic::{Code, Status};

/// A coordinator could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The store failed.
    #[error("cannot take over the journal: {0}")]
    Store(#[from] StoreError),
    /// The system gave no thread.
    #[error("cannot start the thread that keeps the store: {0}")]
    Thread(io::Error),
}

/// A coordinator had to stop.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The store cannot promise anything any more.
    #[error("the coordinator stopped: {0}")]
    Store(Arc<StoreError>),
    /// A bug ended the thread that talks to the store.
    #[error(
        "the thread that keeps the store has died by a bug; what was acknowledged is safe: start the coordinator again"
    )]
    Keeper,
    /// Connections could not be accepted.
    #[error("cannot serve: {0}")]
    Transport(#[from] tonic::transport::Error),
    /// A bug ended the dispatcher.
    #[error("the dispatcher ended by a bug: {0}")]
    Dispatcher(tokio::task::JoinError),
    /// The schema for reflection cannot be read.
    #[error("cannot offer reflection: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
}

/// A failure of the store as told to a client.
pub(crate) fn store_status(error: &StoreError) -> Status {
    let message = error.to_string();
    match error {
        StoreError::DiskFull { .. } | StoreError::OverQuota { .. } => {
            status::retry_later(Code::ResourceExhausted, "STORE_FULL", message, Duration::from_secs(30))
        }
        StoreError::WrongOffset { .. } | StoreError::DigestMismatch { .. } | StoreError::UnknownUpload { .. } => {
            status::retry_later(Code::Aborted, "UPLOAD_BROKEN", message, Duration::from_millis(100))
        }
        StoreError::IncompleteUpload { .. } => status::error(Code::FailedPrecondition, "UPLOAD_INCOMPLETE", message),
        StoreError::OutOfRange { .. } => status::error(Code::OutOfRange, "RANGE", message),
        StoreError::LimitExceeded { .. } => status::error(Code::InvalidArgument, "LIMIT_EXCEEDED", message),
        StoreError::MissingArtefact { .. } => status::error(Code::NotFound, "ARTEFACT_MISSING", message),
        _ => {
            tracing::error!(%error, "the store failed");
            status::error(Code::Internal, "STORE_FAILED", message)
        }
    }
}
