//! The matrices of a real level: its geometry, with a made-up signal on it.

use super::{gather::Gathered, signal};
use crate::BenchError;
use kiln_core::{BakeSettings, Mesh, SolveSettings, codec};
use kiln_scene::{LevelFiles, ReadError, SceneError};
use kiln_solve::ComponentSystem;
use std::path::Path;

/// Imports a level with the sidecar beside it and assembles all its instances.
pub(super) fn system(
    path: &Path,
    settings: &SolveSettings,
    columns: usize,
) -> Result<ComponentSystem<'static>, BenchError> {
    let files = LevelFiles::read(path, None).map_err(|error| match error {
        ReadError::Level(source) => refused(path, source),
        other => BenchError::File { path: path.to_path_buf(), reason: other.to_string() },
    })?;
    let import = kiln_scene::import(&files.name, &files, files.sidecar(), &BakeSettings::default());
    let import = import.map_err(|source| refused(path, source))?;
    let mut meshes = Vec::new();
    for entry in &import.level.meshes {
        let blob = import.meshes.iter().find(|blob| blob.digest == entry.digest);
        let blob = blob.ok_or_else(|| failed("the import left out a mesh that the level names"))?;
        meshes.push(codec::decode::<Mesh>("mesh", &blob.bytes).map_err(|error| failed(&error.to_string()))?);
    }
    let wave_m = import.level.bounds.diagonal() / 60.0;
    let mut gathered = Gathered::new(columns);
    for instance in import.level.instances.iter().filter(|instance| instance.receives) {
        let (mesh, world) = (&meshes[instance.mesh as usize], &instance.world_from_object);
        let moments = signal::moments(mesh, world, columns.div_ceil(2), wave_m, |_| true);
        gathered.add(mesh, world, &moments, settings);
    }
    Ok(gathered.finish())
}

fn refused(path: &Path, source: SceneError) -> BenchError {
    BenchError::Import { path: path.to_path_buf(), source }
}

fn failed(reason: &str) -> BenchError {
    BenchError::Failed { step: "import", reason: reason.to_owned() }
}
