//! Error of a part of a level against `--quality reference` of the same part, by `kiln compare`.

use super::{
    How, Quality,
    kiln::{Kiln, failed, finish},
};
use crate::BenchError;
use kiln_scene::LevelFiles;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What was found; of errors one number for each half-distance, over the area that can be seen.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Reference {
    pub(super) glob: String,
    pub(super) rmse: Vec<f64>,
    /// The bake's own estimate for the part.
    pub(super) estimated_rmse: Vec<f64>,
    /// Faces of the part, and of the level.
    pub(super) faces: u64,
    pub(super) level_faces: u64,
    /// Area of the part that can be seen.
    pub(super) visible_area_m2: f64,
    /// What both bakes took, wall seconds.
    pub(super) wall_secs: f64,
}

#[derive(Deserialize)]
struct Comparison {
    visible: Visible,
}

#[derive(Deserialize)]
struct Visible {
    total: Vec<Difference>,
}

#[derive(Deserialize)]
struct Difference {
    rmse: f64,
}

impl Reference {
    /// Bakes what matches twice; all of the level occludes.
    pub(super) fn measure(level: &Path, glob: &str, how: How, kiln: &Kiln) -> Result<Self, BenchError> {
        let (mut wall_secs, threads) = (0.0, rayon::current_num_threads());
        let mut bake = |how: How, name: &str| {
            let output = kiln.path(name);
            let baked = kiln.one_process(level, &[&how.options()[..], &["--only", glob]].concat(), threads, &output)?;
            wall_secs += baked.wall_secs;
            Ok::<_, BenchError>((output, baked.report))
        };
        let (part, report) = bake(how, "part.glb")?;
        let (reference, _) = bake(How { quality: Quality::Reference, ..how }, "reference.glb")?;
        kiln.forget()?;
        // Seen area is found on the reference, whatever it is compared with.
        let text = finish(kiln.command("compare").arg("--json").arg(&reference).arg(&part))?;
        let compared: Comparison = serde_json::from_slice(&text)
            .map_err(|error| failed(&format!("kiln compare did not print what was expected: {error}")))?;
        let (faces, level_faces) = faces(&part)?;
        Ok(Self {
            glob: glob.to_owned(),
            rmse: compared.visible.total.iter().map(|difference| difference.rmse).collect(),
            estimated_rmse: report.error_estimate.rmse.clone(),
            faces,
            level_faces,
            visible_area_m2: report.visible_area_m2(),
            wall_secs,
        })
    }
}

/// Faces of a baked file that have values, and all.
fn faces(path: &Path) -> Result<(u64, u64), BenchError> {
    let bad = |reason: String| BenchError::File { path: path.to_path_buf(), reason };
    let files = LevelFiles::read(path, None).map_err(|error| bad(error.to_string()))?;
    let scene = kiln_scene::read_baked(&files.name, &files).map_err(|error| bad(error.to_string()))?;
    let count = |is_counted: fn(usize) -> bool| {
        scene.parts.iter().filter(|part| is_counted(part.channels)).map(|part| part.faces.len() as u64).sum()
    };
    Ok((count(|channels| channels > 0), count(|_| true)))
}
