//! Other tracers, run as programs on the same files.

use super::{files::Paths, lap::Lap};
use crate::BenchError;
use serde::{Deserialize, Serialize};
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// Runs of each mode within one start of a program, the best of which counts: the first finds caches cold, which Kiln,
/// whose process goes on, does not. Kiln does the same number.
pub(super) const LAPS_PER_START: usize = 2;

/// A program `PROGRAM POS IDX RAYS --stride S --reps R --threads N [--robust] [--out HITS]` that prints lines of JSON: one
/// about itself and its build, then a [`Lap`] for each mode.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    pub(super) program: PathBuf,
    /// Asked not to let rays slip between triangles.
    pub(super) is_robust: bool,
}

/// What it says of itself and its build.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PeerBuild {
    /// Embree's version as one number, 40400 for 4.4.0.
    pub(super) embree: u64,
    pub(super) triangles: u64,
    pub(super) build_seconds: f64,
    /// Memory of its tree, where it tells.
    #[serde(default)]
    pub(super) memory_bytes: Option<u64>,
    /// Greatest memory while building, where it tells.
    #[serde(default)]
    pub(super) peak_bytes: Option<u64>,
}

/// What one start of it came to.
#[derive(Clone, Debug)]
pub(super) struct PeerRun {
    pub(super) build: PeerBuild,
    pub(super) laps: Vec<Lap>,
}

impl Peer {
    /// What tables call it.
    pub(super) fn name(&self) -> &'static str {
        if self.is_robust { "Embree robust" } else { "Embree" }
    }

    /// Builds and traces in a process of its own; writes its hits if asked.
    pub(super) fn run(
        &self,
        paths: &Paths,
        stride: usize,
        threads: usize,
        hits: Option<&Path>,
    ) -> Result<PeerRun, BenchError> {
        let mut command = Command::new(&self.program);
        command.args([&paths.positions, &paths.triangles, &paths.rays]);
        command.args(["--stride", &stride.to_string(), "--reps", &LAPS_PER_START.to_string()]);
        command.args(["--threads", &threads.to_string()]);
        if self.is_robust {
            command.arg("--robust");
        }
        if let Some(hits) = hits {
            command.arg("--out").arg(hits);
        }
        let output = command.output().map_err(|error| self.failed(&format!("{error}; {HOW_TO_BUILD}")))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(self.failed(&format!("it ended with {}: {}; {HOW_TO_BUILD}", output.status, said.trim())));
        }
        parse(&String::from_utf8_lossy(&output.stdout)).map_err(|reason| self.failed(&reason))
    }

    fn failed(&self, reason: &str) -> BenchError {
        BenchError::Failed { step: "comparison program", reason: format!("{}: {reason}", self.program.display()) }
    }
}

/// How to come by a program.
pub(super) const HOW_TO_BUILD: &str =
    "build it by the command at the head of tests/peers/embree.cpp, and set EMBREE_LIB as it says";

fn parse(text: &str) -> Result<PeerRun, String> {
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    let first = lines.next().unwrap_or_default();
    let build = serde_json::from_str(first).map_err(|error| format!("its first line is {first:?} ({error})"))?;
    let lap = |line: &str| serde_json::from_str(line).map_err(|error| format!("it printed {line:?} ({error})"));
    Ok(PeerRun { build, laps: lines.map(lap).collect::<Result<_, _>>()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUILD: &str = r#"{"embree":40400,"triangles":12,"build_seconds":0.5,"threads":1}"#;
    const LAP: &str = r#"{"mode":"closest1","rays":64,"hit_fraction":0.5,"mean_t":1.25,"mrays_per_cpu_second":2.0,"mrays_per_wall_second":1.5}"#;

    #[test]
    fn lines_are_read() {
        let run = parse(&format!("{BUILD}\n{LAP}\n")).unwrap();
        assert_eq!((run.build.embree, run.build.triangles, run.build.memory_bytes), (40_400, 12, None));
        assert_eq!((run.laps.len(), run.laps[0].mode.as_str(), run.laps[0].mean_t), (1, "closest1", Some(1.25)));
    }

    #[test]
    fn other_output_is_quoted() {
        assert!(parse("").unwrap_err().contains("first line is \"\""));
        assert!(parse(&format!("{BUILD}\nhello")).unwrap_err().contains("\"hello\""));
    }

    #[test]
    fn a_program_that_is_not_there_says_how_to_get_it() {
        let peer = Peer { program: PathBuf::from("no-such-folder/peer"), is_robust: false };
        let said = peer.run(&Paths::of(Path::new("x")), 1, 1, None).unwrap_err().to_string();
        assert!(said.contains("no-such-folder/peer") && said.contains("tests/peers/embree.cpp"), "{said}");
    }
}
