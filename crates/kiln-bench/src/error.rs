//! Why a measurement did not come to an end.

use std::path::PathBuf;

/// Why a measurement did not come to an end.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// A file cannot be read or written.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// What went wrong, and what to do about it.
        reason: String,
    },
    /// A level is refused at import.
    #[error("{path}: {source}")]
    Import {
        /// The level.
        path: PathBuf,
        /// Why.
        source: kiln_scene::SceneError,
    },
    /// The options do not make sense together.
    #[error("{0}")]
    Usage(String),
    /// A measured step failed.
    #[error("{step}: {reason}")]
    Failed {
        /// The step.
        step: &'static str,
        /// What went wrong.
        reason: String,
    },
}
