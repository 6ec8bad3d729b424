//! The index kept in step with the packs.
//!
//! A pack is durable before the index knows it, and the index forgets it before it is removed; so the index may
//! lag, and never promises what is not there. After a clean end its checksum stands in the file `index.clean`. Where
//! that is not so (a crash, a damaged index), every pack is held against the index when the store is opened, and what
//! the index lacks is added. Where the index itself cannot be used it is set aside and built anew, also at runtime.

use crate::{
    StoreError,
    fault::Faults,
    index::{Changes, Index, IndexFailure, Location, Record},
    layout::Layout,
    pack::{PackError, PackHeader},
    packs::Packs,
};
use kiln_core::{Digest, TaskKey};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError, RwLock,
        atomic::{AtomicU64, Ordering},
    },
};

/// Packs and the index over them.
#[derive(Debug)]
pub(crate) struct Catalogue {
    pub(crate) layout: Arc<Layout>,
    pub(crate) packs: Packs,
    index: Index,
    /// How often the index was opened: tells a thread whether another has mended it meanwhile.
    openings: AtomicU64,
    /// Held for reading while the index is used, for writing while it is mended: an index that is being built anew
    /// must not be asked what it does not know yet.
    mending: RwLock<()>,
    /// Held while results are compared with the kept ones and written.
    results: Mutex<()>,
    faults: Arc<Faults>,
}

impl Catalogue {
    pub(crate) fn open(layout: Arc<Layout>, cache_bytes: u64, faults: Arc<Faults>) -> Result<Self, StoreError> {
        let packs = Packs::open(&layout, faults.clone())?;
        let index = Index::new(layout.index(), cache_bytes);
        let catalogue = Self {
            layout,
            packs,
            index,
            openings: AtomicU64::new(0),
            mending: RwLock::new(()),
            results: Mutex::new(()),
            faults,
        };
        catalogue.open_index()?;
        Ok(catalogue)
    }

    /// Opens the index and brings it into step; where that fails, builds it anew.
    fn open_index(&self) -> Result<(), StoreError> {
        let noted = fs::read_to_string(self.clean_note()).ok();
        if noted.is_some() {
            fs::remove_file(self.clean_note()).map_err(StoreError::io("remove", self.clean_note()))?;
        }
        let noted = noted.and_then(|noted| noted.trim().parse().ok());
        let opened = self.index.open().and_then(|()| self.reconcile(noted));
        match opened {
            Ok(()) => {
                self.openings.fetch_add(1, Ordering::Release);
                Ok(())
            }
            Err(failure) => self.rebuild(&failure),
        }
    }

    /// Sets the index aside and builds it anew from the packs.
    fn rebuild(&self, failure: &IndexFailure) -> Result<(), StoreError> {
        // A full disk is no damage, and the files are opened again: sled must give them free for that.
        self.index.close(!failure.disk_full);
        if failure.disk_full {
            tracing::warn!(reason = failure.reason, "the index has no room to write: opening it again");
        } else if self.index.exists() {
            self.layout.set_aside(self.index.folder(), &failure.reason);
        }
        let rebuilt = self.index.open().and_then(|()| self.reconcile(None));
        if let Err(failure) = rebuilt {
            self.index.close(true);
            return Err(self.failed(failure));
        }
        self.openings.fetch_add(1, Ordering::Release);
        tracing::warn!(packs = self.packs.list().len(), "the index was built anew from the packs");
        Ok(())
    }

    fn failed(&self, failure: IndexFailure) -> StoreError {
        let path = self.index.folder().clone();
        if failure.disk_full {
            return StoreError::DiskFull { path, source: std::io::Error::other(failure.reason) };
        }
        StoreError::Index { path, reason: failure.reason }
    }

    /// Runs an operation on the index; if the index fails, mends it and tries once more.
    fn with_index<T>(&self, operation: impl Fn(&Index) -> Result<T, IndexFailure>) -> Result<T, StoreError> {
        let (opening, failure) = {
            let _using = self.mending.read().unwrap_or_else(PoisonError::into_inner);
            match operation(&self.index) {
                Ok(value) => return Ok(value),
                Err(failure) => (self.openings.load(Ordering::Acquire), failure),
            }
        };
        {
            let _mending = self.mending.write().unwrap_or_else(PoisonError::into_inner);
            if self.openings.load(Ordering::Acquire) == opening {
                self.rebuild(&failure)?;
            }
        }
        let _using = self.mending.read().unwrap_or_else(PoisonError::into_inner);
        operation(&self.index).map_err(|failure| self.failed(failure))
    }

    /// Brings the index into step with the folder of packs. Where the index is as it was `noted` when it was closed,
    /// only the headers of packs that it does not know are read; otherwise all.
    fn reconcile(&self, noted: Option<Digest>) -> Result<(), IndexFailure> {
        let mut known = BTreeSet::new();
        let mut lost: BTreeMap<Digest, Vec<Digest>> = BTreeMap::new();
        let found = self.index.for_each(|record| match record {
            Record::Pack(name) => {
                known.insert(name);
            }
            Record::Artefact(digest, location) if !self.packs.contains(&location.pack) => {
                lost.entry(location.pack).or_default().push(digest);
            }
            _ => {}
        })?;
        let mut changes = Changes::default();
        for name in known.iter().filter(|name| !self.packs.contains(name)) {
            changes.remove_pack(name);
        }
        for digest in lost.values().flatten() {
            changes.remove_artefact(digest);
        }
        self.index.apply(&changes)?;
        let deep = noted != Some(found);
        if deep && !known.is_empty() {
            tracing::info!("the index was not closed well: it is checked against the packs");
        }
        for (name, _) in self.packs.list() {
            if deep || !known.contains(&name) {
                self.index_pack(&name, known.contains(&name))?;
            }
        }
        Ok(())
    }

    /// Adds what a pack holds and the index lacks.
    fn index_pack(&self, name: &Digest, known: bool) -> Result<(), IndexFailure> {
        let (header, file_bytes) = match self.packs.header(name) {
            Ok(found) => found,
            // What the index knows of it may still be good: each artefact is checked when it is read.
            Err(PackError::Damaged) if known => return Ok(()),
            Err(error @ PackError::Damaged) => {
                self.layout.set_aside(&self.packs.path(name), &error.to_string());
                self.packs.forget(name);
                return Ok(());
            }
            Err(error) => {
                tracing::warn!(pack = %name, %error, "a pack is passed over");
                return Ok(());
            }
        };
        let mut changes = Changes::default();
        for (digest, offset, len) in header.locations(file_bytes) {
            let location = Location { pack: *name, offset, len };
            if self.index.location(&digest)?.is_none_or(|old| old.pack == *name && old != location) {
                changes.put(&Record::Artefact(digest, location));
            }
        }
        for &(task, digest) in &header.table.results {
            if self.index.result(&task)?.is_none() {
                changes.put(&Record::Result(task, digest));
            }
        }
        changes.put(&Record::Pack(*name));
        self.index.apply(&changes)
    }

    /// Where an artefact is.
    pub(crate) fn location(&self, digest: &Digest) -> Result<Option<Location>, StoreError> {
        self.with_index(|index| index.location(digest))
    }

    /// The digest of a task's result, if its artefact is here.
    pub(crate) fn result(&self, task: &TaskKey) -> Result<Option<(Digest, Location)>, StoreError> {
        self.with_index(|index| {
            let Some(digest) = index.result(task)? else { return Ok(None) };
            Ok(index.location(&digest)?.map(|location| (digest, location)))
        })
    }

    /// Notes a pack that is in the folder. Of two results of a task the one that is there already is kept; the
    /// others are returned, with the kept one.
    pub(crate) fn commit(&self, header: &PackHeader) -> Result<Vec<(TaskKey, Digest, Digest)>, StoreError> {
        self.faults.pass("index.update").map_err(StoreError::io("update", self.index.folder()))?;
        let _results = self.results.lock().unwrap_or_else(PoisonError::into_inner);
        let mut conflicts = Vec::new();
        let mut changes = Changes::default();
        for &(task, digest) in &header.table.results {
            match self.result(&task)? {
                Some((kept, _)) if kept == digest => {}
                Some((kept, _)) => conflicts.push((task, kept, digest)),
                None => changes.put(&Record::Result(task, digest)),
            }
        }
        for (digest, offset, len) in header.locations(u64::MAX) {
            changes.put(&Record::Artefact(digest, Location { pack: header.name, offset, len }));
        }
        changes.put(&Record::Pack(header.name));
        self.with_index(|index| index.apply(&changes))?;
        self.faults.pass("index.updated").map_err(StoreError::io("update", self.index.folder()))?;
        Ok(conflicts)
    }

    /// Makes sure that the index knows a pack that is in the folder, also where noting it failed before.
    pub(crate) fn ensure_indexed(&self, name: &Digest) -> Result<(), StoreError> {
        if self.with_index(|index| index.has_pack(name))? {
            return Ok(());
        }
        self.with_index(|_| self.index_pack(name, false))
    }

    /// Forgets an artefact whose bytes are damaged.
    pub(crate) fn forget_artefact(&self, digest: &Digest) -> Result<(), StoreError> {
        let mut changes = Changes::default();
        changes.remove_artefact(digest);
        self.with_index(|index| index.apply(&changes))
    }

    /// Every artefact and where it is.
    pub(crate) fn artefacts(&self) -> Result<Vec<(Digest, Location)>, StoreError> {
        self.with_index(|index| {
            let mut found = Vec::new();
            index.for_each(|record| {
                if let Record::Artefact(digest, location) = record {
                    found.push((digest, location));
                }
            })?;
            Ok(found)
        })
    }

    /// Forgets packs with the given artefacts, and all results whose artefact goes with them.
    pub(crate) fn forget_packs(&self, packs: &[Digest], artefacts: &BTreeSet<Digest>) -> Result<(), StoreError> {
        self.with_index(|index| {
            let mut changes = Changes::default();
            artefacts.iter().for_each(|digest| changes.remove_artefact(digest));
            packs.iter().for_each(|pack| changes.remove_pack(pack));
            index.for_each(|record| {
                if let Record::Result(task, digest) = record
                    && artefacts.contains(&digest)
                {
                    changes.remove_result(&task);
                }
            })?;
            index.apply(&changes)
        })
    }

    /// Numbers of artefacts and results.
    pub(crate) fn counts(&self) -> Result<(u64, u64), StoreError> {
        self.with_index(|index| {
            let (mut artefacts, mut results) = (0, 0);
            index.for_each(|record| match record {
                Record::Artefact(..) => artefacts += 1,
                Record::Result(..) => results += 1,
                Record::Pack(_) => {}
            })?;
            Ok((artefacts, results))
        })
    }

    /// Bytes of the index's files.
    pub(crate) fn index_bytes(&self) -> u64 {
        self.index.bytes()
    }

    fn clean_note(&self) -> PathBuf {
        self.layout.root().join("index.clean")
    }
}

impl Drop for Catalogue {
    fn drop(&mut self) {
        let Ok(checksum) = self.index.checksum() else { return };
        self.index.close(false);
        if let Err(error) = fs::write(self.clean_note(), checksum.to_string()) {
            tracing::debug!(%error, "the index will be checked at the next opening");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pack::PackTable;

    fn open(folder: &std::path::Path) -> Catalogue {
        let layout = Arc::new(Layout::new(folder));
        layout.prepare().unwrap();
        Catalogue::open(layout, 1 << 20, Arc::default()).unwrap()
    }

    fn put(catalogue: &Catalogue, artefact: &[u8]) -> Digest {
        let digest = Digest::of(artefact);
        let task = TaskKey(Digest::of(b"task"));
        let table = PackTable { entries: vec![(digest, artefact.len() as u64)], results: vec![(task, digest)] };
        let header = PackHeader::new(table).unwrap();
        catalogue.packs.write(&header, &[artefact]).unwrap();
        catalogue.commit(&header).unwrap();
        digest
    }

    #[test]
    fn an_index_that_fails_is_mended_while_others_use_it() {
        let folder = tempfile::tempdir().unwrap();
        let catalogue = open(folder.path());
        let digest = put(&catalogue, b"kept");
        catalogue.index.close(true);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| assert!(catalogue.location(&digest).unwrap().is_some()));
            }
        });
        assert_eq!(catalogue.openings.load(Ordering::Relaxed), 2, "it is mended once");
        assert_eq!(catalogue.result(&TaskKey(Digest::of(b"task"))).unwrap().map(|(digest, _)| digest), Some(digest));
        let quarantined = fs::read_dir(catalogue.layout.quarantine()).unwrap().count();
        assert_eq!(quarantined, 1, "the failed index is kept for a look");
    }

    #[test]
    fn the_index_learns_of_packs_that_it_missed_and_forgets_those_that_are_gone() {
        let folder = tempfile::tempdir().unwrap();
        let catalogue = open(folder.path());
        let first = put(&catalogue, b"first");
        let location = catalogue.location(&first).unwrap().unwrap();
        // As after a crash between the pack and the index.
        catalogue.forget_packs(&[location.pack], &BTreeSet::from([first])).unwrap();
        let second = put(&catalogue, b"second");
        let gone = catalogue.location(&second).unwrap().unwrap().pack;
        fs::remove_file(catalogue.packs.path(&gone)).unwrap();
        drop(catalogue);
        let catalogue = open(folder.path());
        assert_eq!(catalogue.location(&first).unwrap(), Some(location));
        assert_eq!(catalogue.location(&second).unwrap(), None);
        assert_eq!(catalogue.counts().unwrap().0, 1);
    }
}
