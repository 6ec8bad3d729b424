//! A folder for the files of one run.

use crate::BenchError;
use std::path::{Path, PathBuf};

/// A folder for the files of one run, removed with it.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    /// A folder of this process, for one measurement.
    pub(crate) fn new(measurement: &str) -> Result<Self, BenchError> {
        let path = std::env::temp_dir().join(format!("kiln-bench-{measurement}-{}", std::process::id()));
        let reason = |error: std::io::Error| format!("{error}; set TMPDIR to a folder with space");
        std::fs::create_dir_all(&path)
            .map_err(|error| BenchError::File { path: path.clone(), reason: reason(error) })?;
        Ok(Self(path))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A folder of temporary files that stays behind is no reason to fail.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
