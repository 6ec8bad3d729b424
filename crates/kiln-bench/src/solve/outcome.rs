//! What one run of one solver took, as it reports itself.

use crate::BenchError;
use kiln_core::ComponentMethod;
use serde::{Deserialize, Serialize};
use std::{ffi::OsString, path::Path, process::Command};

/// The line of JSON that every measured program prints.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Outcome {
    /// Name of the solver.
    pub(super) solver: String,
    /// CPU seconds of all threads, from the matrix to the answer.
    pub(super) cpu_secs: f64,
    /// Seconds on the wall.
    pub(super) wall_secs: f64,
    /// Resident memory with the input read, KiB.
    pub(super) input_kib: u64,
    /// Peak resident memory of the whole process, KiB.
    pub(super) peak_kib: u64,
    /// Entries of the factor.
    #[serde(default)]
    pub(super) factor_entries: Option<f64>,
    /// Most iterations of a component.
    #[serde(default)]
    pub(super) iterations: Option<u64>,
    /// What solved how many components.
    #[serde(default)]
    pub(super) methods: Vec<(ComponentMethod, u64)>,
}

/// A program that solves a system file.
#[derive(Clone, Debug)]
pub(super) struct Program {
    /// What messages call it.
    pub(super) name: &'static str,
    executable: OsString,
    first: Vec<OsString>,
}

impl Program {
    /// This program.
    pub(super) fn kiln() -> Result<Self, BenchError> {
        let executable = std::env::current_exe().map_err(|error| failed(&error.to_string()))?.into_os_string();
        let first = ["bench", "solve", "--run-one"].map(OsString::from).to_vec();
        Ok(Self { name: "Kiln", executable, first })
    }

    /// A solver of the comparison program.
    pub(super) fn peer(executable: &Path, solver: &'static str) -> Self {
        Self { name: solver, executable: executable.into(), first: vec![solver.into()] }
    }

    /// Solves a system file in a process of its own, with one thread for BLAS: more only spin on these matrices.
    pub(super) fn run(&self, system: &Path, answer: &Path) -> Result<Outcome, BenchError> {
        let mut command = Command::new(&self.executable);
        command.args(&self.first).arg(system).arg(answer).env("OPENBLAS_NUM_THREADS", "1");
        let output = command.output().map_err(|error| failed(&format!("{}: {error}", self.name)))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(failed(&format!("{} ended with {}: {}", self.name, output.status, said.trim())));
        }
        let text = String::from_utf8_lossy(&output.stdout);
        let line = text.lines().last().unwrap_or_default();
        serde_json::from_str(line).map_err(|error| failed(&format!("{} printed {line:?} ({error})", self.name)))
    }
}

fn failed(reason: &str) -> BenchError {
    BenchError::Failed { step: "solver run", reason: reason.to_owned() }
}
