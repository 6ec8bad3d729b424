//! Reading a level, the files it refers to and its sidecar from disk.

use crate::failure::Failure;
use bytes::Bytes;
use kiln_core::{BakeSettings, Digest, SourceFile, SourceManifest};
use kiln_scene::{BakedScene, LevelFiles, SidecarText, SourceFiles};
use std::{borrow::Cow, collections::BTreeMap, path::Path};

/// A level as it lies on disk, read whole.
pub(crate) struct Source(LevelFiles);

impl Source {
    /// Reads the level and everything it needs. The sidecar is the one given, or `LEVEL.kiln.toml` beside the level.
    pub(crate) fn read(level: &Path, sidecar: Option<&Path>) -> Result<Self, Failure> {
        LevelFiles::read(level, sidecar).map(Self).map_err(Failure::refused)
    }

    /// File name of the level.
    pub(crate) fn name(&self) -> &str {
        &self.0.name
    }

    /// The sidecar, for the scene crate.
    pub(crate) fn sidecar(&self) -> Option<SidecarText<'_>> {
        self.0.sidecar()
    }

    /// What to bake with these settings, and the artefacts that it names.
    pub(crate) fn submission(self, settings: BakeSettings) -> (SourceManifest, BTreeMap<Digest, Bytes>) {
        let LevelFiles { name, mut files, sidecar } = self.0;
        let mut artefacts = BTreeMap::new();
        let mut add = |path: String, bytes: Vec<u8>| {
            let digest = Digest::of(&bytes);
            artefacts.insert(digest, Bytes::from(bytes));
            SourceFile { path, digest }
        };
        let level = files.remove(&name).unwrap_or_default();
        let mut list = vec![add(name, level)];
        list.extend(files.into_iter().map(|(path, bytes)| add(path, bytes)));
        // Only the file's name: where the sidecar lies must not change the key.
        let sidecar = sidecar.map(|(path, text)| {
            let name = Path::new(&path).file_name().map_or(path.clone(), |name| name.to_string_lossy().into_owned());
            add(name, text.into_bytes())
        });
        (SourceManifest { files: list, sidecar, settings }, artefacts)
    }
}

impl SourceFiles for Source {
    fn read(&self, path: &str) -> Option<Cow<'_, [u8]>> {
        self.0.read(path)
    }
}

/// Reads a baked file back.
pub(crate) fn read_baked(path: &Path) -> Result<BakedScene, Failure> {
    let source = Source::read(path, None)?;
    kiln_scene::read_baked(source.name(), &source)
        .map_err(|error| Failure::refused(format!("{}: {error}", path.display())))
}
