//! Bakes in processes of their own, so that memory and times are those of a user.

use super::{How, farm::RunningFarm, report::Report};
use crate::BenchError;
use kiln_core::Digest;
use kiln_worker::tasks::Backend;
use serde::Serialize;
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::Instant,
};

/// Where a bake runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Place {
    /// `kiln bake`.
    Process,
    /// `kiln serve`, one `kiln worker`, `kiln submit --wait`.
    Farm,
}

/// A way to bake.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Variant {
    pub(super) place: Place,
    pub(super) threads: usize,
}

impl Variant {
    pub(super) fn name(self) -> String {
        let Self { place, threads } = self;
        let place = match place {
            Place::Process => "one process",
            Place::Farm => "coordinator and worker",
        };
        format!("{place}, {threads} {}", if threads == 1 { "thread" } else { "threads" })
    }
}

/// A bake that was made.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Bake {
    pub(super) variant: Variant,
    /// From the start of the command to its end: submission, bake, the result on disk.
    pub(super) wall_secs: f64,
    /// Greatest resident memory, bytes: of the process, of the coordinator and the worker together. Nothing where the
    /// system does not tell.
    pub(super) peak_bytes: Option<u64>,
    /// Digest of the file.
    pub(super) output: String,
    pub(super) report: Report,
}

/// This program, and a folder to work in.
pub(super) struct Kiln {
    program: PathBuf,
    folder: PathBuf,
    backend: &'static str,
    ray_queries: bool,
}

impl Kiln {
    /// The program that runs.
    pub(super) fn this(folder: &Path, backend: &Backend) -> Result<Self, BenchError> {
        let program = std::env::current_exe().map_err(|error| failed(&error.to_string()))?;
        let ray_queries = matches!(backend, Backend::Gpu(device) if device.has_ray_queries());
        let name = if matches!(backend, Backend::Cpu) { "cpu" } else { "gpu" };
        Ok(Self { program, folder: folder.to_path_buf(), backend: name, ray_queries })
    }

    /// A path in the folder.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// A command of this program that knows of no farm and no folder but those that it is told of.
    pub(super) fn command(&self, name: &str) -> Command {
        let mut command = Command::new(&self.program);
        command.arg(name).args(["--backend", self.backend]);
        // On a farm its workers decide.
        if self.ray_queries && matches!(name, "bake" | "worker") {
            command.arg("--ray-queries");
        }
        for variable in ["KILN_TOKEN", "KILN_COORDINATOR", "KILN_DATA_DIR"] {
            command.env_remove(variable);
        }
        command
    }

    /// Removes all results of earlier bakes.
    pub(super) fn forget(&self) -> Result<(), BenchError> {
        let data = self.path("data");
        let removed = if data.exists() { fs::remove_dir_all(&data) } else { Ok(()) };
        removed.map_err(|error| BenchError::File { path: data, reason: error.to_string() })
    }

    /// Bakes a level from nothing.
    pub(super) fn bake(&self, level: &Path, how: How, variant: Variant) -> Result<Bake, BenchError> {
        self.forget()?;
        let baked = match variant.place {
            Place::Process => self.one_process(level, &how.options(), variant.threads, &self.path("baked.glb")),
            Place::Farm => self.on_farm(level, how, variant),
        }?;
        self.forget()?;
        Ok(baked)
    }

    /// Runs `kiln bake` with more options, its results in the folder `data`, which stays.
    pub(super) fn one_process(
        &self,
        level: &Path,
        options: &[&str],
        threads: usize,
        output: &Path,
    ) -> Result<Bake, BenchError> {
        let report = self.path("report.json");
        let mut command = self.command("bake");
        command.arg(level).args(options).arg("-o").arg(output).arg("--report").arg(&report);
        command.args(["--no-progress", "--threads", &threads.to_string()]).arg("--data-dir").arg(self.path("data"));
        let began = Instant::now();
        finish(&mut command)?;
        let wall_secs = began.elapsed().as_secs_f64();
        let report = read_report(&report)?;
        let variant = Variant { place: Place::Process, threads };
        Ok(Bake { variant, wall_secs, peak_bytes: report.peak_memory_bytes, output: digest(output)?, report })
    }

    fn on_farm(&self, level: &Path, how: How, variant: Variant) -> Result<Bake, BenchError> {
        let farm = RunningFarm::start(self, variant.threads, &self.path("data"))?;
        let (output, report) = (self.path("baked.glb"), self.path("report.json"));
        let mut command = self.command("submit");
        command.arg(level).args(["--wait", "--no-progress"]).args(how.options());
        command.arg("--coordinator").arg(farm.address()).arg("-o").arg(&output).arg("--report").arg(&report);
        let began = Instant::now();
        finish(&mut command)?;
        let wall_secs = began.elapsed().as_secs_f64();
        let peak_bytes = farm.peak_bytes();
        Ok(Bake { variant, wall_secs, peak_bytes, output: digest(&output)?, report: read_report(&report)? })
    }
}

/// Runs a command to its end, and returns what it printed.
pub(super) fn finish(command: &mut Command) -> Result<Vec<u8>, BenchError> {
    let output = command.output().map_err(|error| failed(&error.to_string()))?;
    if output.status.success() {
        return Ok(output.stdout);
    }
    let arguments: Vec<_> = command.get_args().map(|argument| argument.to_string_lossy()).collect();
    let said = String::from_utf8_lossy(&output.stderr);
    Err(failed(&format!("kiln {}: {}: {}", arguments.join(" "), output.status, said.trim())))
}

fn read_report(path: &Path) -> Result<Report, BenchError> {
    let bad = |reason: String| BenchError::File { path: path.to_path_buf(), reason };
    let bytes = fs::read(path).map_err(|error| bad(error.to_string()))?;
    serde_json::from_slice(&bytes).map_err(|error| bad(format!("is no report of this version: {error}")))
}

fn digest(path: &Path) -> Result<String, BenchError> {
    let bytes =
        fs::read(path).map_err(|error| BenchError::File { path: path.to_path_buf(), reason: error.to_string() })?;
    Ok(Digest::of(&bytes).to_string())
}

pub(super) fn failed(reason: &str) -> BenchError {
    BenchError::Failed { step: "bake in a process of its own", reason: reason.to_owned() }
}
