//! The data folder: where things are, how a folder is known to be one, and where damaged files go.
//!
//! ```text
//! format        what the folder is, and of which format
//! lock          locked by the process that has the folder; holds its number
//! packs/        artefacts and results: the truth
//! index/        sled: where each artefact is; can be built anew from the packs
//! incoming/     uploads under way, packs being written
//! journal/      what happened to jobs: the truth
//! quarantine/   damaged files, kept for a look; the oldest go when there are many
//! ```

use crate::StoreError;
use kiln_core::Digest;
use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
    time::{SystemTime, UNIX_EPOCH},
};

/// The format of data folders that this version writes.
const FORMAT: u32 = 1;
const PREAMBLE: &str = "kiln data folder";
const MAX_QUARANTINED: usize = 16;

/// The paths of a data folder.
#[derive(Debug)]
pub(crate) struct Layout {
    root: PathBuf,
    quarantined: AtomicU64,
}

impl Layout {
    pub(crate) fn new(root: &Path) -> Self {
        Self { root: root.to_owned(), quarantined: AtomicU64::new(0) }
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    pub(crate) fn lock(&self) -> PathBuf {
        self.root.join("lock")
    }

    pub(crate) fn packs(&self) -> PathBuf {
        self.root.join("packs")
    }

    pub(crate) fn index(&self) -> PathBuf {
        self.root.join("index")
    }

    pub(crate) fn incoming(&self) -> PathBuf {
        self.root.join("incoming")
    }

    pub(crate) fn journal(&self) -> PathBuf {
        self.root.join("journal")
    }

    pub(crate) fn quarantine(&self) -> PathBuf {
        self.root.join("quarantine")
    }

    fn format(&self) -> PathBuf {
        self.root.join("format")
    }

    /// Refuses a folder that holds something else, before anything is written to it.
    pub(crate) fn check_is_ours(&self) -> Result<(), StoreError> {
        let entries = match fs::read_dir(&self.root) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(error) if error.kind() == io::ErrorKind::NotADirectory => {
                return Err(StoreError::NotAStore { path: self.root.clone(), reason: "it is a file".to_owned() });
            }
            Err(error) => return Err(StoreError::io("list", &self.root)(error)),
        };
        let ours = ["format", "packs", "journal", "lock"];
        let mut other = None;
        for entry in entries {
            let name = entry.map_err(StoreError::io("list", &self.root))?.file_name().to_string_lossy().into_owned();
            if ours.contains(&name.as_str()) {
                return Ok(());
            }
            other = Some(name);
        }
        match other {
            None => Ok(()),
            Some(name) => {
                Err(StoreError::NotAStore { path: self.root.clone(), reason: format!("it holds {name:?} already") })
            }
        }
    }

    /// Makes the folders that are not there, checks the format and notes it.
    pub(crate) fn prepare(&self) -> Result<(), StoreError> {
        for folder in [self.packs(), self.incoming(), self.journal(), self.quarantine()] {
            fs::create_dir_all(&folder).map_err(StoreError::io("create", &folder))?;
        }
        let path = self.format();
        match fs::read_to_string(&path).ok().as_deref().and_then(parse_format) {
            Some(found) if found > FORMAT => {
                return Err(StoreError::NewerFormat { path: self.root.clone(), found, known: FORMAT });
            }
            Some(FORMAT) => return Ok(()),
            _ => {}
        }
        let write = || -> io::Result<()> {
            let temporary = self.root.join("format.new");
            let mut file = File::create(&temporary)?;
            file.write_all(format_text(FORMAT).as_bytes())?;
            file.sync_all()?;
            fs::rename(&temporary, &path)
        };
        write().map_err(StoreError::io("write", &path))?;
        sync_folder(&self.root)
    }

    /// Moves a damaged file or folder out of the way. Where even that fails it is left, with a warning.
    pub(crate) fn set_aside(&self, path: &Path, why: &str) {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let target = self.quarantine().join(self.quarantine_name(&name));
        match fs::rename(path, &target) {
            Ok(()) => tracing::warn!(path = %path.display(), moved_to = %target.display(), why, "damaged: set aside"),
            Err(error) => tracing::warn!(path = %path.display(), why, %error, "damaged, and cannot be set aside"),
        }
        self.prune_quarantine();
    }

    /// Keeps a copy of damaged bytes that are about to be cut off or rewritten.
    pub(crate) fn keep_copy(&self, name: &str, bytes: &[u8], why: &str) {
        let target = self.quarantine().join(self.quarantine_name(name));
        match fs::write(&target, bytes) {
            Ok(()) => tracing::warn!(name, copy = %target.display(), why, "damaged: a copy was kept"),
            Err(error) => tracing::warn!(name, why, %error, "damaged, and no copy could be kept"),
        }
        self.prune_quarantine();
    }

    /// A name that sorts by time.
    fn quarantine_name(&self, name: &str) -> String {
        let count = self.quarantined.fetch_add(1, Ordering::Relaxed);
        format!("{:014}-{count:04}-{name}", unix_ms(SystemTime::now()))
    }

    fn prune_quarantine(&self) {
        let Ok(entries) = fs::read_dir(self.quarantine()) else { return };
        let mut paths: Vec<_> = entries.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        for path in &paths[..paths.len().saturating_sub(MAX_QUARANTINED)] {
            let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            if let Err(error) = removed {
                tracing::warn!(path = %path.display(), %error, "cannot remove an old damaged file");
            }
        }
    }
}

fn format_text(format: u32) -> String {
    let line = format!("{PREAMBLE} {format}");
    format!("{line}\n{}\n", Digest::of(line.as_bytes()))
}

/// The format that the file states; none if the file is damaged.
fn parse_format(text: &str) -> Option<u32> {
    let line = text.lines().next()?;
    let format = line.strip_prefix(PREAMBLE)?.trim().parse().ok()?;
    (format_text(format) == text).then_some(format)
}

/// Milliseconds since 1970; 0 for times before.
pub(crate) fn unix_ms(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |since| u64::try_from(since.as_millis()).unwrap_or(u64::MAX))
}

/// Makes the names in a folder durable. Only Unix needs it, and lets a folder be opened.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), StoreError> {
    if cfg!(unix) {
        File::open(folder).and_then(|handle| handle.sync_all()).map_err(StoreError::io("sync", folder))?;
    }
    Ok(())
}

/// Bytes of all files below a folder, as far as they can be read.
pub(crate) fn folder_bytes(folder: &Path) -> u64 {
    let Ok(entries) = fs::read_dir(folder) else { return 0 };
    entries
        .flatten()
        .map(|entry| match entry.metadata() {
            Ok(data) if data.is_dir() => folder_bytes(&entry.path()),
            Ok(data) => data.len(),
            Err(_) => 0,
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_of_something_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        assert!(layout.check_is_ours().is_ok(), "an empty folder will do");
        fs::write(folder.path().join("thesis.tex"), "x").unwrap();
        assert!(matches!(layout.check_is_ours(), Err(StoreError::NotAStore { .. })));
        let file = Layout::new(&folder.path().join("thesis.tex"));
        assert!(matches!(file.check_is_ours(), Err(StoreError::NotAStore { .. })));
    }

    #[test]
    fn formats() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        layout.prepare().unwrap();
        layout.prepare().unwrap();
        fs::write(layout.format(), format_text(FORMAT + 1)).unwrap();
        assert!(matches!(layout.prepare(), Err(StoreError::NewerFormat { .. })));
        fs::write(layout.format(), format_text(FORMAT).replace(" 1\n", " 9\n")).unwrap();
        layout.prepare().expect("a damaged note is written anew");
        assert_eq!(fs::read_to_string(layout.format()).unwrap(), format_text(FORMAT));
    }

    #[test]
    fn quarantine_is_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        layout.prepare().unwrap();
        for _ in 0..3 * MAX_QUARANTINED {
            layout.keep_copy("x", b"damaged", "test");
        }
        assert_eq!(fs::read_dir(layout.quarantine()).unwrap().count(), MAX_QUARANTINED);
    }
}
