//! Import: source files to a level and its meshes.

use crate::{Artefacts, TaskError, TaskOutput};
use kiln_core::{Class, Digest, FoliageMode, Mesh, SourceFile, SourceManifest, codec};
use kiln_scene::{Import, MeshBlob, SidecarText, SourceFiles};
use rayon::prelude::*;
use std::{
    borrow::Cow,
    collections::{BTreeMap, HashMap},
};

/// Files of a source, loaded from artefacts.
pub(super) struct LoadedFiles(BTreeMap<String, Vec<u8>>);

impl LoadedFiles {
    pub(super) fn load(files: &[SourceFile], artefacts: &dyn Artefacts) -> Result<Self, TaskError> {
        let digests: Vec<Digest> = files.iter().map(|file| file.digest).collect();
        let blobs = artefacts.get_many(&digests)?;
        Ok(Self(files.iter().zip(blobs).map(|(file, bytes)| (file.path.clone(), bytes.into())).collect()))
    }
}

impl SourceFiles for LoadedFiles {
    fn read(&self, path: &str) -> Option<Cow<'_, [u8]>> {
        self.0.get(path).map(|bytes| Cow::Borrowed(&bytes[..]))
    }
}

/// The manifest of a source and the name of its level file.
pub(super) fn manifest(source: Digest, artefacts: &dyn Artefacts) -> Result<(SourceManifest, String), TaskError> {
    let manifest: SourceManifest = codec::decode("a source manifest", &artefacts.get(source)?)?;
    let Some(first) = manifest.files.first() else {
        return Err(TaskError::Refused { reason: "the source names no level file".into() });
    };
    let name = first.path.clone();
    Ok((manifest, name))
}

pub(super) fn run(source: Digest, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let (manifest, name) = manifest(source, artefacts)?;
    let files = LoadedFiles::load(&manifest.files, artefacts)?;
    let sidecar = match &manifest.sidecar {
        Some(file) => Some((file.path.clone(), sidecar_text(file, artefacts)?)),
        None => None,
    };
    let sidecar = sidecar.as_ref().map(|(name, text)| SidecarText { name, text });
    let mut import = kiln_scene::import(&name, &files, sidecar, &manifest.settings)
        .map_err(|error| TaskError::Refused { reason: error.to_string() })?;
    place_fog(&mut import)?;
    let attachments = import.meshes.into_iter().map(|mesh| mesh.bytes).collect();
    Ok(TaskOutput { result: codec::encode(&import.level), attachments, rays: 0 })
}

/// Gives shrubs their fog, whose density may have to be measured on their meshes.
fn place_fog(import: &mut Import) -> Result<(), TaskError> {
    let has_shrubs = import.level.counts.classes.get(&Class::Shrub).is_some_and(|faces| *faces > 0);
    if !has_shrubs || import.level.sampling.foliage == FoliageMode::Geometry {
        return Ok(());
    }
    let decode = |blob: &MeshBlob| Ok((blob.digest, codec::decode::<Mesh>("a mesh", &blob.bytes)?));
    let meshes: HashMap<Digest, Mesh> = import.meshes.par_iter().map(decode).collect::<Result<_, TaskError>>()?;
    let digests: Vec<Digest> = import.level.meshes.iter().map(|entry| entry.digest).collect();
    kiln_bake::place_fog(&mut import.level, |index| meshes.get(digests.get(index)?));
    Ok(())
}

fn sidecar_text(file: &SourceFile, artefacts: &dyn Artefacts) -> Result<String, TaskError> {
    let bytes: Vec<u8> = artefacts.get(file.digest)?.into();
    let refused = |error: std::string::FromUtf8Error| TaskError::Refused {
        reason: format!(
            "{} is not UTF-8 text (byte {}); save it as UTF-8",
            file.path,
            error.utf8_error().valid_up_to()
        ),
    };
    String::from_utf8(bytes).map_err(refused)
}
