//! The folder of packs: how they get there whole, how they are read, and when each was last used.
//!
//! A pack is written under a temporary name, synced, renamed, and the folder synced: a pack with its name is whole.
//! The time of its last use is its file's time of modification, written at most every ten minutes, so that it
//! survives whatever happens to the index.

use crate::{
    StoreError,
    fault::Faults,
    layout::{Layout, sync_folder, unix_ms},
    pack::{PackError, PackHeader},
};
use kiln_core::Digest;
use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, BufReader, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{
        Arc, PoisonError, RwLock,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, SystemTime, UNIX_EPOCH},
};

const TOUCH_EVERY_MS: u64 = 600_000;

/// A pack that is in the folder.
#[derive(Debug)]
pub(crate) struct PackUse {
    pub(crate) bytes: u64,
    used_unix_ms: AtomicU64,
    noted_unix_ms: AtomicU64,
}

impl PackUse {
    pub(crate) fn used_unix_ms(&self) -> u64 {
        self.used_unix_ms.load(Ordering::Relaxed)
    }
}

/// The packs of a store.
#[derive(Debug)]
pub(crate) struct Packs {
    folder: PathBuf,
    incoming: PathBuf,
    known: RwLock<BTreeMap<Digest, Arc<PackUse>>>,
    temporaries: AtomicU64,
    faults: Arc<Faults>,
}

impl Packs {
    /// Lists the folder and removes what was being written when the last process ended.
    pub(crate) fn open(layout: &Layout, faults: Arc<Faults>) -> Result<Self, StoreError> {
        let packs = Self {
            folder: layout.packs(),
            incoming: layout.incoming(),
            known: RwLock::default(),
            temporaries: AtomicU64::new(0),
            faults,
        };
        packs.remove_temporaries()?;
        packs.rescan()?;
        Ok(packs)
    }

    fn remove_temporaries(&self) -> Result<(), StoreError> {
        for entry in fs::read_dir(&self.incoming).map_err(StoreError::io("list", &self.incoming))?.flatten() {
            let path = entry.path();
            if path.extension().is_some_and(|extension| extension == "tmp") {
                fs::remove_file(&path).map_err(StoreError::io("remove", &path))?;
            }
        }
        Ok(())
    }

    /// Reads the folder anew: what is there, how large, and when it was used.
    pub(crate) fn rescan(&self) -> Result<(), StoreError> {
        let mut found = BTreeMap::new();
        for entry in fs::read_dir(&self.folder).map_err(StoreError::io("list", &self.folder))? {
            let entry = entry.map_err(StoreError::io("list", &self.folder))?;
            let name = entry.file_name();
            let name = name.to_str().and_then(|name| name.strip_suffix(".pack"));
            let Some(name) = name.and_then(|name| name.parse::<Digest>().ok()) else { continue };
            let Ok(data) = entry.metadata() else { continue };
            let used = unix_ms(data.modified().unwrap_or(UNIX_EPOCH));
            found.insert(name, Arc::new(PackUse::new(data.len(), used)));
        }
        *self.known.write().unwrap_or_else(PoisonError::into_inner) = found;
        Ok(())
    }

    /// Every pack with its size and time of use, by name.
    pub(crate) fn list(&self) -> Vec<(Digest, Arc<PackUse>)> {
        self.read_known().iter().map(|(name, pack)| (*name, pack.clone())).collect()
    }

    pub(crate) fn contains(&self, name: &Digest) -> bool {
        self.read_known().contains_key(name)
    }

    /// Bytes of all packs.
    pub(crate) fn bytes(&self) -> u64 {
        self.read_known().values().map(|pack| pack.bytes).sum()
    }

    pub(crate) fn path(&self, name: &Digest) -> PathBuf {
        self.folder.join(format!("{name}.pack"))
    }

    /// Writes a pack of artefacts that are in memory, in the order of the header's table; durable on return.
    pub(crate) fn write(&self, header: &PackHeader, artefacts: &[&[u8]]) -> Result<(), StoreError> {
        let count = self.temporaries.fetch_add(1, Ordering::Relaxed);
        let temporary = self.incoming.join(format!("{count}.tmp"));
        let write = || -> io::Result<File> {
            self.faults.pass("pack.create")?;
            let mut file = File::create(&temporary)?;
            file.write_all(&header.bytes)?;
            self.faults.pass("pack.write")?;
            for artefact in artefacts {
                file.write_all(artefact)?;
            }
            Ok(file)
        };
        let written = write().map_err(StoreError::io("write", &temporary));
        let done = written.and_then(|file| self.adopt(&temporary, &file, &header.name));
        if done.is_err() {
            // The first error is the one worth telling; a leftover is removed at the next opening.
            let _ = fs::remove_file(&temporary);
        }
        done
    }

    /// Makes a file that holds a whole pack part of the folder; durable on return.
    pub(crate) fn adopt(&self, temporary: &Path, file: &File, name: &Digest) -> Result<(), StoreError> {
        let target = self.path(name);
        let bytes = file.metadata().map_err(StoreError::io("read", temporary))?.len();
        let step = |point, action, run: &dyn Fn() -> io::Result<()>| {
            self.faults.pass(point).and_then(|()| run()).map_err(StoreError::io(action, &target))
        };
        step("pack.sync", "sync", &|| file.sync_data())?;
        step("pack.rename", "name", &|| fs::rename(temporary, &target))?;
        step("pack.folder_sync", "sync", &|| Ok(()))?;
        sync_folder(&self.folder)?;
        let pack = Arc::new(PackUse::new(bytes, unix_ms(SystemTime::now())));
        self.known.write().unwrap_or_else(PoisonError::into_inner).insert(*name, pack);
        Ok(())
    }

    /// A pack's header and its file's size.
    pub(crate) fn header(&self, name: &Digest) -> Result<(PackHeader, u64), PackError> {
        let file = File::open(self.path(name))?;
        let bytes = file.metadata()?.len();
        let header = PackHeader::read(&mut BufReader::new(file), bytes)?;
        if header.name == *name { Ok((header, bytes)) } else { Err(PackError::Damaged) }
    }

    /// Bytes of a pack; none if the file is not there or not long enough. Nothing is allocated before that is known.
    pub(crate) fn read(&self, name: &Digest, offset: u64, len: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(source) = self.open_at(name, offset, len)? else { return Ok(None) };
        let mut bytes = Vec::with_capacity(usize::try_from(len).unwrap_or(0));
        let read = source.take(len).read_to_end(&mut bytes).map_err(StoreError::io("read", self.path(name)))?;
        Ok((read as u64 == len).then_some(bytes))
    }

    /// A file at the start of a range that lies within it.
    pub(crate) fn open_at(&self, name: &Digest, offset: u64, len: u64) -> Result<Option<File>, StoreError> {
        let path = self.path(name);
        let mut file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(StoreError::io("open", path)(error)),
        };
        let bytes = file.metadata().map_err(StoreError::io("read", &path))?.len();
        if offset.checked_add(len).is_none_or(|end| end > bytes) {
            return Ok(None);
        }
        file.seek(SeekFrom::Start(offset)).map_err(StoreError::io("read", &path))?;
        Ok(Some(file))
    }

    /// Notes that a pack was used.
    pub(crate) fn touch(&self, name: &Digest) {
        let Some(pack) = self.read_known().get(name).cloned() else { return };
        let now = SystemTime::now();
        let now_ms = unix_ms(now);
        pack.used_unix_ms.store(now_ms, Ordering::Relaxed);
        let noted = pack.noted_unix_ms.load(Ordering::Relaxed);
        let due = now_ms.saturating_sub(noted) > TOUCH_EVERY_MS;
        let noted_by_us =
            due && pack.noted_unix_ms.compare_exchange(noted, now_ms, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        if noted_by_us && let Err(error) = File::open(self.path(name)).and_then(|file| file.set_modified(now)) {
            tracing::debug!(pack = %name, %error, "the time of use could not be noted");
        }
    }

    /// Removes a pack; one that is gone already is no error.
    pub(crate) fn remove(&self, name: &Digest) -> Result<(), StoreError> {
        let path = self.path(name);
        self.faults.pass("garbage.remove").map_err(StoreError::io("remove", &path))?;
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(StoreError::io("remove", path)(error)),
            _ => {
                self.forget(name);
                Ok(())
            }
        }
    }

    /// No longer counts a pack whose file was moved away.
    pub(crate) fn forget(&self, name: &Digest) {
        self.known.write().unwrap_or_else(PoisonError::into_inner).remove(name);
    }

    fn read_known(&self) -> std::sync::RwLockReadGuard<'_, BTreeMap<Digest, Arc<PackUse>>> {
        self.known.read().unwrap_or_else(PoisonError::into_inner)
    }
}

impl PackUse {
    fn new(bytes: u64, used_unix_ms: u64) -> Self {
        Self { bytes, used_unix_ms: AtomicU64::new(used_unix_ms), noted_unix_ms: AtomicU64::new(used_unix_ms) }
    }
}

/// The time by which a pack must have been used last to be collected.
pub(crate) fn before(grace_secs: u64) -> u64 {
    unix_ms(SystemTime::now().checked_sub(Duration::from_secs(grace_secs)).unwrap_or(UNIX_EPOCH))
}
