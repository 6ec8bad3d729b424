//! What building a scene's BVHs takes.

use super::case::{Case, Input, RayCounts};
use crate::{BenchError, clock::Stopwatch, memory::status_kib};
use serde::{Deserialize, Serialize};
use std::{path::PathBuf, process::Command};

/// What a build took and left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Build {
    /// Threads that it could use.
    pub(super) threads: usize,
    /// Distinct meshes.
    pub(super) meshes: usize,
    /// Placements of them.
    pub(super) instances: usize,
    /// Triangles of the distinct meshes.
    pub(super) mesh_triangles: u64,
    /// Triangles of all placements.
    pub(super) triangles: u64,
    /// Wall seconds, the least of the runs.
    pub(super) wall_secs: f64,
    /// Processor seconds, the least of the runs.
    pub(super) cpu_secs: f64,
    /// Nodes, triangles and instances as they are traced, bytes.
    pub(super) bvh_bytes: u64,
    /// What the process's peak rose by in the first run, with the BVHs in it, bytes; 0 where the system does not tell.
    pub(super) peak_bytes: u64,
}

impl Build {
    /// Bytes for each triangle of the distinct meshes.
    pub(super) fn bytes_per_triangle(&self) -> f64 {
        self.bvh_bytes as f64 / self.mesh_triangles.max(1) as f64
    }

    /// Builds a case `reps` times with the threads of the current pool.
    pub(super) fn of(case: &Case, reps: usize) -> Self {
        let mut build = Self {
            threads: rayon::current_num_threads(),
            meshes: case.meshes.len(),
            instances: case.objects.len(),
            mesh_triangles: case.meshes.iter().map(|mesh| mesh.faces.len() as u64).sum(),
            triangles: case.triangles(),
            wall_secs: f64::INFINITY,
            cpu_secs: f64::INFINITY,
            bvh_bytes: 0,
            peak_bytes: 0,
        };
        for rep in 0..reps.max(1) {
            let before = (rep == 0).then(start_peak);
            let watch = Stopwatch::start();
            let scene = case.build();
            let cost = watch.read();
            if let Some(before) = before {
                build.peak_bytes = 1024 * status_kib("VmHWM:").saturating_sub(before);
            }
            build.wall_secs = build.wall_secs.min(cost.wall_secs);
            build.cpu_secs = build.cpu_secs.min(cost.cpu_secs);
            build.bvh_bytes = scene.memory_bytes() as u64;
        }
        build
    }
}

/// Lets the system forget this process's peak so far; tells what it uses now, KiB. Where it cannot forget, the peak is
/// that since the start, and what the build adds to it is too little rather than too much.
fn start_peak() -> u64 {
    let is_reset = std::fs::write("/proc/self/clear_refs", "5").is_ok();
    status_kib(if is_reset { "VmRSS:" } else { "VmHWM:" })
}

/// Where builds are measured: memory only in a process that has done nothing else.
pub(super) enum BuildPlace {
    /// This program in a process of its own, one for each number of threads.
    Process(PathBuf),
    /// Here, for tests: the program is then not this one.
    #[cfg(test)]
    Here,
}

impl BuildPlace {
    /// Processes of this program.
    pub(super) fn process() -> Result<Self, BenchError> {
        std::env::current_exe().map(Self::Process).map_err(|error| failed(&error.to_string()))
    }

    /// Builds a scene.
    pub(super) fn measure(
        &self,
        input: &Input,
        is_flat: bool,
        threads: usize,
        reps: usize,
    ) -> Result<Build, BenchError> {
        match self {
            Self::Process(program) => {
                let mut command = Command::new(program);
                command.args(["bench", "rays", "--build-only"]).arg(input.path());
                command.args(["--threads", &threads.to_string(), "--reps", &reps.to_string()]);
                if is_flat {
                    command.arg("--flatten");
                }
                let output = command.output().map_err(|error| failed(&error.to_string()))?;
                if !output.status.success() {
                    return Err(failed(String::from_utf8_lossy(&output.stderr).trim()));
                }
                let text = String::from_utf8_lossy(&output.stdout);
                serde_json::from_str(text.trim()).map_err(|error| failed(&format!("it printed {text:?} ({error})")))
            }
            #[cfg(test)]
            Self::Here => {
                let pool = super::pool(threads)?;
                let case = load(input, is_flat)?;
                Ok(pool.install(|| Build::of(&case, reps)))
            }
        }
    }
}

/// A scene with hardly a ray, for its build alone.
pub(super) fn load(input: &Input, is_flat: bool) -> Result<Case, BenchError> {
    let case = Case::read(input, RayCounts { points: 1, per_point: 1 })?;
    Ok(if is_flat { case.flatten() } else { case })
}

fn failed(reason: &str) -> BenchError {
    BenchError::Failed { step: "build in a process of its own", reason: reason.to_owned() }
}
