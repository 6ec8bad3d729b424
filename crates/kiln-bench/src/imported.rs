//! A level as a bake imports it, with its meshes.

use crate::BenchError;
use kiln_core::{BakeSettings, Digest, FoliageMode, Level, Mesh, codec};
use kiln_scene::{LevelFiles, ReadError, SceneError};
use std::{collections::BTreeMap, path::Path, sync::Arc};

/// A level and its meshes, by the indices that instances name.
pub(crate) struct Imported {
    pub(crate) level: Level,
    /// Entries of the same content are one mesh.
    pub(crate) meshes: Vec<Arc<Mesh>>,
}

/// Imports a level with the sidecar beside it and default settings, but that foliage is geometry: what peers trace.
pub(crate) fn import(path: &Path) -> Result<Imported, BenchError> {
    import_as(path, FoliageMode::Geometry)
}

/// Likewise, with foliage as a mode has it.
pub(crate) fn import_as(path: &Path, foliage: FoliageMode) -> Result<Imported, BenchError> {
    let files = LevelFiles::read(path, None).map_err(|error| match error {
        ReadError::Level(source) => refused(path, source),
        other => BenchError::File { path: path.to_path_buf(), reason: other.to_string() },
    })?;
    let settings = BakeSettings { foliage, ..BakeSettings::default() };
    let import = kiln_scene::import(&files.name, &files, files.sidecar(), &settings);
    let import = import.map_err(|source| refused(path, source))?;
    let decode = |blob: &kiln_scene::MeshBlob| -> Result<(Digest, Arc<Mesh>), codec::DecodeError> {
        Ok((blob.digest, Arc::new(codec::decode("mesh", &blob.bytes)?)))
    };
    let decoded: Result<BTreeMap<Digest, Arc<Mesh>>, _> = import.meshes.iter().map(decode).collect();
    let decoded = decoded.map_err(|error| failed(&error.to_string()))?;
    let mesh = |entry: &kiln_core::MeshEntry| {
        let found = decoded.get(&entry.digest).cloned();
        found.ok_or_else(|| failed("the import left out a mesh that the level names"))
    };
    let meshes = import.level.meshes.iter().map(mesh).collect::<Result<_, _>>()?;
    Ok(Imported { level: import.level, meshes })
}

fn refused(path: &Path, source: SceneError) -> BenchError {
    BenchError::Import { path: path.to_path_buf(), source }
}

fn failed(reason: &str) -> BenchError {
    BenchError::Failed { step: "import", reason: reason.to_owned() }
}
