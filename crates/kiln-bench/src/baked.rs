//! Baked files for a measurement, by this program in a process of its own.

use crate::BenchError;
use kiln_scene::{BakedPart, BakedScene, LevelFiles};
use serde::Deserialize;
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// A bake that was made.
pub(crate) struct BakedLevel {
    pub(crate) scene: BakedScene,
    pub(crate) report: serde_json::Value,
    pub(crate) path: PathBuf,
}

/// How far one bake is from another, over the area that can be seen.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(crate) struct Difference {
    pub(crate) rmse: f64,
    /// Mean of the first less the second.
    pub(crate) bias: f64,
}

#[derive(Deserialize)]
struct Comparison {
    visible: Visible,
}

#[derive(Deserialize)]
struct Visible {
    total: [Difference; 2],
}

/// Compares two baked files with two half-distances. What can be seen is found on the first.
pub(crate) fn compare(first: &Path, second: &Path) -> Result<[Difference; 2], BenchError> {
    let failed = |reason: String| BenchError::Failed { step: "compare", reason };
    let program = std::env::current_exe().map_err(|error| failed(error.to_string()))?;
    let ended = Command::new(program).args(["compare", "--json"]).arg(first).arg(second).output();
    let ended = ended.map_err(|error| failed(error.to_string()))?;
    let compared: Result<Comparison, _> = serde_json::from_slice(&ended.stdout);
    compared
        .map(|compared| compared.visible.total)
        .map_err(|error| failed(format!("{error}: {}", String::from_utf8_lossy(&ended.stderr).trim())))
}

/// Bakes a level with more options of `kiln bake`, in a folder.
pub(crate) fn bake(level: &Path, options: &[&str], folder: &Path) -> Result<BakedLevel, BenchError> {
    let failed = |reason: String| BenchError::Failed { step: "bake", reason };
    let program = std::env::current_exe().map_err(|error| failed(error.to_string()))?;
    let (output, report) = (folder.join("baked.glb"), folder.join("report.json"));
    let mut command = Command::new(program);
    command.arg("bake").arg(level).args(options).arg("-o").arg(&output).arg("--report").arg(&report);
    command.arg("--no-progress").arg("--data-dir").arg(folder.join("data"));
    for variable in ["KILN_TOKEN", "KILN_COORDINATOR", "KILN_DATA_DIR"] {
        command.env_remove(variable);
    }
    let ended = command.output().map_err(|error| failed(error.to_string()))?;
    if !ended.status.success() {
        return Err(failed(String::from_utf8_lossy(&ended.stderr).trim().to_owned()));
    }
    let bad = |path: &PathBuf, reason: String| BenchError::File { path: path.clone(), reason };
    let text = std::fs::read(&report).map_err(|error| bad(&report, error.to_string()))?;
    let report = serde_json::from_slice(&text).map_err(|error| bad(&report, error.to_string()))?;
    Ok(BakedLevel { scene: read(&output)?, report, path: output })
}

/// Reads a baked file.
fn read(path: &Path) -> Result<BakedScene, BenchError> {
    let bad = |reason: String| BenchError::File { path: path.to_path_buf(), reason };
    let files = LevelFiles::read(path, None).map_err(|error| bad(error.to_string()))?;
    kiln_scene::read_baked(&files.name, &files.files).map_err(|error| bad(error.to_string()))
}

/// Twice the area of a face of a part, square metres.
pub(crate) fn double_area_m2(part: &BakedPart, face: &[u32; 3]) -> f64 {
    let [a, b, c] = face.map(|vertex| part.positions[vertex as usize]);
    (b - a).cross(c - a).length()
}
