//! The index in sled, kept at arm's length: sled may fail or panic on damaged files, so that every call of it is
//! guarded, and its owner can throw it away and build it anew.
//!
//! One tree holds three kinds of record, told apart by the first byte of the key, so that one batch changes them
//! together: `a` + digest → where the artefact is; `r` + task key → the digest of the result; `p` + pack → nothing.

use kiln_core::{Digest, DigestStream, TaskKey};
use std::{
    fs,
    io::ErrorKind,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::{PoisonError, RwLock, RwLockReadGuard},
    time::{Duration, Instant},
};

/// How long a closed index may keep its lock, before it counts as a failure to open it again.
const LOCK_PATIENCE: Duration = Duration::from_secs(5);

/// Where an artefact is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Location {
    pub(crate) pack: Digest,
    pub(crate) offset: u64,
    pub(crate) len: u64,
}

impl Location {
    fn to_bytes(self) -> [u8; 48] {
        let mut bytes = [0; 48];
        bytes[..32].copy_from_slice(self.pack.as_bytes());
        bytes[32..40].copy_from_slice(&self.offset.to_le_bytes());
        bytes[40..].copy_from_slice(&self.len.to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (pack, numbers) = bytes.split_at_checked(32)?;
        let (offset, len) = numbers.split_at_checked(8)?;
        let number = |bytes: &[u8]| bytes.try_into().ok().map(u64::from_le_bytes);
        Some(Self { pack: Digest::from_slice(pack).ok()?, offset: number(offset)?, len: number(len)? })
    }
}

/// A record of the index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Record {
    Artefact(Digest, Location),
    Result(TaskKey, Digest),
    Pack(Digest),
}

const ARTEFACT: u8 = b'a';
const RESULT: u8 = b'r';
const PACK: u8 = b'p';

fn key(tag: u8, digest: &Digest) -> [u8; 33] {
    let mut key = [tag; 33];
    key[1..].copy_from_slice(digest.as_bytes());
    key
}

fn record(key: &[u8], value: &[u8]) -> Option<Record> {
    let (&tag, digest) = key.split_first()?;
    let digest = Digest::from_slice(digest).ok()?;
    match tag {
        ARTEFACT => Some(Record::Artefact(digest, Location::from_bytes(value)?)),
        RESULT => Some(Record::Result(TaskKey(digest), Digest::from_slice(value).ok()?)),
        PACK => Some(Record::Pack(digest)),
        _ => None,
    }
}

/// Changes that are made together.
#[derive(Debug, Default)]
pub(crate) struct Changes(sled::Batch);

impl Changes {
    pub(crate) fn put(&mut self, record: &Record) {
        match record {
            Record::Artefact(digest, location) => self.0.insert(&key(ARTEFACT, digest)[..], &location.to_bytes()[..]),
            Record::Result(task, digest) => self.0.insert(&key(RESULT, &task.0)[..], &digest.as_bytes()[..]),
            Record::Pack(name) => self.0.insert(&key(PACK, name)[..], &[][..]),
        }
    }

    pub(crate) fn remove_artefact(&mut self, digest: &Digest) {
        self.0.remove(&key(ARTEFACT, digest)[..]);
    }

    pub(crate) fn remove_result(&mut self, task: &TaskKey) {
        self.0.remove(&key(RESULT, &task.0)[..]);
    }

    pub(crate) fn remove_pack(&mut self, name: &Digest) {
        self.0.remove(&key(PACK, name)[..]);
    }
}

/// The index did not do what it was asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct IndexFailure {
    /// It could not write, for want of space: it is not damaged.
    pub(crate) disk_full: bool,
    /// Another open database has the lock of its files.
    locked: bool,
    pub(crate) reason: String,
}

/// An open or failed index.
#[derive(Debug)]
pub(crate) struct Index {
    folder: PathBuf,
    cache_bytes: u64,
    database: RwLock<Option<sled::Db>>,
}

impl Index {
    /// An index that is not open yet.
    pub(crate) fn new(folder: PathBuf, cache_bytes: u64) -> Self {
        Self { folder, cache_bytes, database: RwLock::new(None) }
    }

    pub(crate) fn folder(&self) -> &PathBuf {
        &self.folder
    }

    /// Opens the files that are there, or makes new ones.
    pub(crate) fn open(&self) -> Result<(), IndexFailure> {
        let config = sled::Config::new().path(&self.folder).cache_capacity(self.cache_bytes);
        let begun = Instant::now();
        let database = loop {
            match guarded(|| config.open()) {
                // The store's own lock keeps others out: this one is held by threads of a closed sled that still
                // write what was flushed, or by a child that was forked and has not yet become its program.
                Err(failure) if failure.locked && begun.elapsed() < LOCK_PATIENCE => {
                    std::thread::sleep(Duration::from_millis(5));
                }
                other => break other?,
            }
        };
        *self.database.write().unwrap_or_else(PoisonError::into_inner) = Some(database);
        Ok(())
    }

    /// Lets go of the files. After a failure sled is not asked to tidy up, which could fail again: it is left as it
    /// is, at the cost of the memory it holds.
    pub(crate) fn close(&self, failed: bool) {
        let database = self.database.write().unwrap_or_else(PoisonError::into_inner).take();
        let Some(database) = database else { return };
        if failed {
            std::mem::forget(database);
        } else if guarded(|| database.flush().map(|_| drop(database))).is_err() {
            tracing::warn!(folder = %self.folder.display(), "the index could not be closed well");
        }
    }

    pub(crate) fn location(&self, digest: &Digest) -> Result<Option<Location>, IndexFailure> {
        let value = self.run(|database| database.get(key(ARTEFACT, digest)))?;
        Ok(value.and_then(|value| Location::from_bytes(&value)))
    }

    pub(crate) fn result(&self, task: &TaskKey) -> Result<Option<Digest>, IndexFailure> {
        let value = self.run(|database| database.get(key(RESULT, &task.0)))?;
        Ok(value.and_then(|value| Digest::from_slice(&value).ok()))
    }

    pub(crate) fn has_pack(&self, name: &Digest) -> Result<bool, IndexFailure> {
        self.run(|database| database.contains_key(key(PACK, name)))
    }

    /// Makes all changes or none.
    pub(crate) fn apply(&self, changes: &Changes) -> Result<(), IndexFailure> {
        self.run(|database| database.apply_batch(changes.0.clone()))
    }

    /// Visits every record, in order of kind and key, and returns a digest of all. Records that make no sense are not
    /// visited.
    pub(crate) fn for_each(&self, mut visit: impl FnMut(Record)) -> Result<Digest, IndexFailure> {
        let mut stream = DigestStream::default();
        self.run(|database| {
            for entry in database.iter() {
                let (key, value) = entry?;
                stream.update(&key);
                stream.update(&value);
                if let Some(record) = record(&key, &value) {
                    visit(record);
                }
            }
            Ok(())
        })?;
        Ok(stream.finish())
    }

    /// Digest of all records: what the index should say when it is opened again.
    pub(crate) fn checksum(&self) -> Result<Digest, IndexFailure> {
        self.for_each(drop)
    }

    /// Bytes of its files.
    pub(crate) fn bytes(&self) -> u64 {
        crate::layout::folder_bytes(&self.folder)
    }

    /// Whether files of an index are there.
    pub(crate) fn exists(&self) -> bool {
        fs::exists(&self.folder).unwrap_or(false)
    }

    fn run<T>(&self, operation: impl FnOnce(&sled::Db) -> sled::Result<T>) -> Result<T, IndexFailure> {
        let database: RwLockReadGuard<'_, Option<sled::Db>> =
            self.database.read().unwrap_or_else(PoisonError::into_inner);
        match &*database {
            Some(database) => guarded(|| operation(database)),
            None => Err(IndexFailure { disk_full: false, locked: false, reason: "it is not open".to_owned() }),
        }
    }
}

/// Calls into sled, turning panics into failures.
fn guarded<T>(operation: impl FnOnce() -> sled::Result<T>) -> Result<T, IndexFailure> {
    match catch_unwind(AssertUnwindSafe(operation)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => {
            let disk_full = matches!(&error, sled::Error::Io(error)
                if matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded));
            // sled wraps what the lock said in an error of its own, by text alone.
            let reason = error.to_string();
            Err(IndexFailure { disk_full, locked: reason.contains("could not acquire lock"), reason })
        }
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            Err(IndexFailure {
                disk_full: false,
                locked: false,
                reason: format!("panic: {}", text.unwrap_or("unknown")),
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn digest(text: &str) -> Digest {
        Digest::of(text.as_bytes())
    }

    #[test]
    fn records_go_in_and_come_out() {
        let folder = tempfile::tempdir().unwrap();
        let index = Index::new(folder.path().join("index"), 1 << 20);
        assert!(index.location(&digest("x")).is_err(), "a closed index says so");
        index.open().unwrap();
        let location = Location { pack: digest("pack"), offset: 7, len: u64::MAX };
        let records = [
            Record::Artefact(digest("a"), location),
            Record::Pack(digest("pack")),
            Record::Result(TaskKey(digest("k")), digest("a")),
        ];
        let mut changes = Changes::default();
        records.iter().for_each(|record| changes.put(record));
        index.apply(&changes).unwrap();
        let before = index.checksum().unwrap();
        index.close(false);
        index.open().unwrap();
        assert_eq!(index.checksum().unwrap(), before);
        assert_eq!(index.location(&digest("a")).unwrap(), Some(location));
        assert_eq!(index.result(&TaskKey(digest("k"))).unwrap(), Some(digest("a")));
        assert!(index.has_pack(&digest("pack")).unwrap());
        let mut found = Vec::new();
        index.for_each(|record| found.push(record)).unwrap();
        assert_eq!(found, records);
    }

    #[test]
    fn a_lock_that_is_let_go_of_late_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let index = Index::new(folder.path().join("index"), 1 << 20);
        index.open().unwrap();
        let held = index.database.read().unwrap().clone();
        index.close(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(50));
                drop(held);
            });
            index.open().unwrap();
        });
    }

    #[test]
    fn panics_are_failures() {
        let failure = guarded::<()>(|| panic!("as sled does")).unwrap_err();
        assert!(failure.reason.contains("as sled does") && !failure.disk_full);
        let full = guarded::<()>(|| Err(sled::Error::Io(ErrorKind::StorageFull.into()))).unwrap_err();
        assert!(full.disk_full);
    }
}
