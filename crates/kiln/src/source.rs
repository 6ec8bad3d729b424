//! Reading a level, the files it refers to and its sidecar from disk.

use crate::failure::Failure;
use bytes::Bytes;
use kiln_core::{BakeSettings, Digest, SourceFile, SourceManifest};
use kiln_scene::{BakedScene, SidecarText, SourceFiles};
use std::{
    borrow::Cow,
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// A level as it lies on disk, read whole.
pub(crate) struct Source {
    /// File name of the level.
    pub(crate) name: String,
    files: BTreeMap<String, Vec<u8>>,
    sidecar: Option<(String, String)>,
}

impl Source {
    /// Reads the level and everything it needs. The sidecar is the one given, or `LEVEL.kiln.toml` beside the level.
    pub(crate) fn read(level: &Path, sidecar: Option<&Path>) -> Result<Self, Failure> {
        let name = level.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let bytes = read(level)?;
        let mut files = BTreeMap::new();
        let folder = level.parent().unwrap_or(Path::new(""));
        for path in kiln_scene::external_files(&name, &bytes).map_err(Failure::refused)? {
            let bytes = read(&folder.join(&path))?;
            files.insert(path, bytes);
        }
        files.insert(name.clone(), bytes);
        let sidecar = sidecar.map(Path::to_path_buf).or_else(|| beside(level));
        let sidecar =
            sidecar.map(|path| read_text(&path).map(|text| (path.display().to_string(), text))).transpose()?;
        Ok(Self { name, files, sidecar })
    }

    /// The sidecar, for the scene crate.
    pub(crate) fn sidecar(&self) -> Option<SidecarText<'_>> {
        self.sidecar.as_ref().map(|(name, text)| SidecarText { name, text })
    }

    /// What to bake with these settings, and the artefacts that it names.
    pub(crate) fn submission(self, settings: BakeSettings) -> (SourceManifest, BTreeMap<Digest, Bytes>) {
        let Self { name, mut files, sidecar } = self;
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
        self.files.get(path).map(|bytes| Cow::Borrowed(&bytes[..]))
    }
}

fn beside(level: &Path) -> Option<PathBuf> {
    let path = level.with_extension("kiln.toml");
    path.is_file().then_some(path)
}

fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    fs::read(path).map_err(|error| {
        Failure::refused(format!("{} cannot be read ({error}); check the path and its permissions", path.display()))
    })
}

fn read_text(path: &Path) -> Result<String, Failure> {
    String::from_utf8(read(path)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Failure::refused(format!("{} is not UTF-8 text (byte {at}); save it as UTF-8", path.display()))
    })
}

/// Reads a baked file back.
pub(crate) fn read_baked(path: &Path) -> Result<BakedScene, Failure> {
    let source = Source::read(path, None)?;
    kiln_scene::read_baked(&source.name, &source)
        .map_err(|error| Failure::refused(format!("{}: {error}", path.display())))
}
