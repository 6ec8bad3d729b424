//! Reading a level, the files it refers to and its sidecar from disk: the one place here that touches a disk.

use crate::{SceneError, SidecarText, SourceFiles, cutout::mask_files, document::external_files};
use std::{
    borrow::Cow,
    collections::BTreeMap,
    fs,
    io::Error,
    path::{Path, PathBuf},
};

/// A level as it lies on disk, read whole.
#[derive(Clone, Debug)]
pub struct LevelFiles {
    /// File name of the level.
    pub name: String,
    /// The level and the files it refers to, by path relative to its folder.
    pub files: BTreeMap<String, Vec<u8>>,
    /// Path and text of the sidecar.
    pub sidecar: Option<(String, String)>,
}

/// A level cannot be read from disk.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// A file cannot be read.
    #[error("{} cannot be read ({source}); check the path and its permissions", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: Error,
    },
    /// A sidecar is no text.
    #[error("{} is not UTF-8 text (byte {byte}); save it as UTF-8", path.display())]
    NotText {
        /// The file.
        path: PathBuf,
        /// Offset of the first byte that is none.
        byte: usize,
    },
    /// The level does not name its files as it must.
    #[error(transparent)]
    Level(#[from] SceneError),
}

impl LevelFiles {
    /// Reads the level and everything it needs, images that masks are made of if they are there. The sidecar is the one given, or `LEVEL.kiln.toml` beside the level.
    ///
    /// # Errors
    /// [`ReadError`] with the file that cannot be read.
    pub fn read(level: &Path, sidecar: Option<&Path>) -> Result<Self, ReadError> {
        let name = level.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let bytes = read(level)?;
        let mut files = BTreeMap::new();
        let folder = level.parent().unwrap_or(Path::new(""));
        for path in external_files(&name, &bytes)? {
            let bytes = read(&folder.join(&path))?;
            files.insert(path, bytes);
        }
        // An image that is not there makes a warning of import, not an error.
        for path in mask_files(&name, &bytes)? {
            if let Ok(bytes) = fs::read(folder.join(&path)) {
                files.entry(path).or_insert(bytes);
            }
        }
        files.insert(name.clone(), bytes);
        let sidecar = sidecar.map(Path::to_path_buf).or_else(|| beside(level));
        let sidecar =
            sidecar.map(|path| read_text(&path).map(|text| (path.display().to_string(), text))).transpose()?;
        Ok(Self { name, files, sidecar })
    }

    /// The sidecar, for [`crate::import`].
    pub fn sidecar(&self) -> Option<SidecarText<'_>> {
        self.sidecar.as_ref().map(|(name, text)| SidecarText { name, text })
    }
}

impl SourceFiles for LevelFiles {
    fn read(&self, path: &str) -> Option<Cow<'_, [u8]>> {
        self.files.get(path).map(|bytes| Cow::Borrowed(&bytes[..]))
    }
}

fn beside(level: &Path) -> Option<PathBuf> {
    let path = level.with_extension("kiln.toml");
    path.is_file().then_some(path)
}

fn read(path: &Path) -> Result<Vec<u8>, ReadError> {
    fs::read(path).map_err(|source| ReadError::Unreadable { path: path.to_path_buf(), source })
}

fn read_text(path: &Path) -> Result<String, ReadError> {
    String::from_utf8(read(path)?).map_err(|error| {
        let byte = error.utf8_error().valid_up_to();
        ReadError::NotText { path: path.to_path_buf(), byte }
    })
}
