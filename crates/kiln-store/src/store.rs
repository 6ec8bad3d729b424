//! The store: artefacts go in and come out, results are found by task key.

use crate::{
    OpenOptions, ResultConflict, StoreError, Usage,
    catalogue::Catalogue,
    fault::Faults,
    index::Location,
    journal::Journal,
    layout::{Layout, folder_bytes},
    lock::FolderLock,
    pack::{PackHeader, PackTable},
    upload::Uploads,
};
use kiln_core::{Digest, DigestStream, TaskKey};
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    fs,
    io::Read,
    path::Path,
    sync::{Arc, Mutex, PoisonError, RwLock},
};

/// Artefacts that were checked whole are remembered, this many, so that reading one in ranges checks it once.
const REMEMBERED_CHECKS: usize = 64;

/// Results of tasks that have none here.
type NewResults = Vec<(TaskKey, Digest)>;

/// Artefacts, results and the journal in a data folder. Calls block; any number of threads may make them.
#[derive(Debug)]
pub struct Store {
    pub(crate) options: OpenOptions,
    pub(crate) catalogue: Catalogue,
    pub(crate) uploads: Uploads,
    pub(crate) journal: Journal,
    pub(crate) faults: Arc<Faults>,
    /// Writers share it; collection has it alone, so that nothing vanishes between a look and a write.
    pub(crate) gate: RwLock<()>,
    checked: Mutex<VecDeque<Digest>>,
    // Dropped last: the folder is free when all else is closed.
    _lock: FolderLock,
}

impl Store {
    /// Opens a data folder, or makes one. Damaged files are set aside and what can be read of them is kept.
    ///
    /// # Errors
    /// [`StoreError::Locked`] where another process has the folder; [`StoreError::NotAStore`] and
    /// [`StoreError::NewerFormat`] where it holds something else; and where the system fails.
    pub fn open(folder: &Path, options: OpenOptions) -> Result<Self, StoreError> {
        Self::open_with(folder, options, FolderLock::acquire)
    }

    /// Like [`Self::open`], but where another process has the folder, calls `on_wait` once with
    /// [`StoreError::Locked`], and waits until it is free.
    pub fn open_waiting(
        folder: &Path,
        options: OpenOptions,
        on_wait: impl FnOnce(&StoreError),
    ) -> Result<Self, StoreError> {
        Self::open_with(folder, options, |layout| FolderLock::wait(layout, on_wait))
    }

    fn open_with(
        folder: &Path,
        options: OpenOptions,
        lock: impl FnOnce(&Layout) -> Result<FolderLock, StoreError>,
    ) -> Result<Self, StoreError> {
        let layout = Arc::new(Layout::new(folder));
        layout.check_is_ours()?;
        fs::create_dir_all(folder).map_err(StoreError::io("create", folder))?;
        let lock = lock(&layout)?;
        layout.prepare()?;
        let faults = Arc::new(Faults::new(options.fault.clone()));
        Ok(Self {
            journal: Journal::open(layout.clone(), options.journal_segment_bytes, faults.clone())?,
            catalogue: Catalogue::open(layout.clone(), options.index_cache_bytes, faults.clone())?,
            uploads: Uploads::default(),
            faults,
            options,
            gate: RwLock::new(()),
            checked: Mutex::default(),
            _lock: lock,
        })
    }

    /// The data folder.
    pub fn folder(&self) -> &Path {
        self.catalogue.layout.root()
    }

    /// Stores artefacts and returns their digests, in order. Those that are not here yet go into one file; durable
    /// on return.
    pub fn put<B: AsRef<[u8]>>(&self, artefacts: &[B]) -> Result<Vec<Digest>, StoreError> {
        let digests: Vec<_> = artefacts.iter().map(|artefact| Digest::of(artefact.as_ref())).collect();
        self.put_pack(artefacts, &digests, &[])?;
        Ok(digests)
    }

    /// Stores one artefact; durable on return.
    pub fn put_one(&self, artefact: &[u8]) -> Result<Digest, StoreError> {
        let digest = Digest::of(artefact);
        self.put_pack(&[artefact], &[digest], &[])?;
        Ok(digest)
    }

    /// Stores artefacts and results of tasks, which name these artefacts or such as are here already: one file, durable
    /// on return. Of two results of one task the first is kept, as long as its artefact is here; where a later one
    /// differs, it is returned.
    ///
    /// # Errors
    /// [`StoreError::MissingArtefact`] where a result's artefact is neither given nor here; nothing is stored then.
    pub fn put_results<B: AsRef<[u8]>>(
        &self,
        artefacts: &[B],
        results: &[(TaskKey, Digest)],
    ) -> Result<Vec<ResultConflict>, StoreError> {
        let digests: Vec<_> = artefacts.iter().map(|artefact| Digest::of(artefact.as_ref())).collect();
        self.put_pack(artefacts, &digests, results)
    }

    fn put_pack<B: AsRef<[u8]>>(
        &self,
        artefacts: &[B],
        digests: &[Digest],
        results: &[(TaskKey, Digest)],
    ) -> Result<Vec<ResultConflict>, StoreError> {
        let _gate = self.gate.read().unwrap_or_else(PoisonError::into_inner);
        let given: BTreeMap<_, _> = digests.iter().copied().zip(artefacts.iter().map(AsRef::as_ref)).collect();
        let mut fresh = Vec::new();
        for (digest, bytes) in given.iter().map(|(digest, bytes)| (*digest, *bytes)) {
            match self.catalogue.location(&digest)? {
                Some(location) => self.catalogue.packs.touch(&location.pack),
                None => fresh.push((digest, bytes)),
            }
        }
        let (new_results, mut conflicts) = self.new_results(results, &given)?;
        if fresh.is_empty() && new_results.is_empty() {
            return Ok(conflicts);
        }
        let table = PackTable {
            entries: fresh.iter().map(|(digest, bytes)| (*digest, bytes.len() as u64)).collect(),
            results: new_results,
        };
        let header = header(table)?;
        self.check_quota(header.pack_bytes().unwrap_or(u64::MAX))?;
        self.catalogue.packs.write(&header, &fresh.iter().map(|(_, bytes)| *bytes).collect::<Vec<_>>())?;
        let late = self.catalogue.commit(&header)?;
        conflicts.extend(late.into_iter().map(|(key, kept, offered)| ResultConflict { key, kept, offered }));
        Ok(conflicts)
    }

    /// The results that are not here yet, one for each task, and those that differ from what is.
    fn new_results(
        &self,
        results: &[(TaskKey, Digest)],
        given: &BTreeMap<Digest, &[u8]>,
    ) -> Result<(NewResults, Vec<ResultConflict>), StoreError> {
        let mut new = BTreeMap::new();
        let mut conflicts = Vec::new();
        for &(key, offered) in results {
            if !given.contains_key(&offered) && self.catalogue.location(&offered)?.is_none() {
                return Err(StoreError::MissingArtefact { digest: offered });
            }
            let kept = match self.catalogue.result(&key)? {
                Some((kept, _)) => kept,
                None => *new.entry(key).or_insert(offered),
            };
            if kept != offered {
                conflicts.push(ResultConflict { key, kept, offered });
            }
        }
        Ok((new.into_iter().collect(), conflicts))
    }

    /// Refuses what would not fit into the quota.
    pub(crate) fn check_quota(&self, wanted_bytes: u64) -> Result<(), StoreError> {
        let Some(quota_bytes) = self.options.quota_bytes else { return Ok(()) };
        let used_bytes = self.catalogue.packs.bytes() + self.uploads.reserved_bytes();
        if used_bytes.saturating_add(wanted_bytes) <= quota_bytes {
            return Ok(());
        }
        Err(StoreError::OverQuota { folder: self.folder().to_owned(), used_bytes, wanted_bytes, quota_bytes })
    }

    /// An artefact. Its bytes are checked against the digest; one that is damaged is forgotten, so that it counts as
    /// missing and is made again.
    pub fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(location) = self.catalogue.location(digest)? else { return Ok(None) };
        let bytes = self.catalogue.packs.read(&location.pack, location.offset, location.len)?;
        match bytes {
            Some(bytes) if Digest::of(&bytes) == *digest => {
                self.catalogue.packs.touch(&location.pack);
                Ok(Some(bytes))
            }
            _ => self.damaged(digest, &location).map(|()| None),
        }
    }

    /// Part of an artefact, up to `len` bytes: fewer at its end. The whole is checked at the first of a run of calls.
    ///
    /// # Errors
    /// [`StoreError::OutOfRange`] where `offset` lies beyond the end.
    pub fn read_range(&self, digest: &Digest, offset: u64, len: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(location) = self.catalogue.location(digest)? else { return Ok(None) };
        if offset > location.len {
            return Err(StoreError::OutOfRange { digest: *digest, offset, len, bytes: location.len });
        }
        if !self.is_checked(digest) && !self.check(digest, &location)? {
            return self.damaged(digest, &location).map(|()| None);
        }
        let len = len.min(location.len - offset);
        let bytes = self.catalogue.packs.read(&location.pack, location.offset + offset, len)?;
        if bytes.is_none() {
            self.damaged(digest, &location)?;
        }
        Ok(bytes)
    }

    /// Reads an artefact once from end to end, in little memory.
    fn check(&self, digest: &Digest, location: &Location) -> Result<bool, StoreError> {
        let packs = &self.catalogue.packs;
        let Some(file) = packs.open_at(&location.pack, location.offset, location.len)? else { return Ok(false) };
        let (mut source, mut stream) = (file.take(location.len), DigestStream::default());
        let mut buffer = vec![0; 1 << 18];
        loop {
            match source.read(&mut buffer).map_err(StoreError::io("read", packs.path(&location.pack)))? {
                0 => break,
                read => stream.update(&buffer[..read]),
            }
        }
        let good = stream.finish() == *digest;
        if good {
            packs.touch(&location.pack);
            let mut checked = self.checked.lock().unwrap_or_else(PoisonError::into_inner);
            checked.push_back(*digest);
            if checked.len() > REMEMBERED_CHECKS {
                checked.pop_front();
            }
        }
        Ok(good)
    }

    fn is_checked(&self, digest: &Digest) -> bool {
        self.checked.lock().unwrap_or_else(PoisonError::into_inner).contains(digest)
    }

    fn damaged(&self, digest: &Digest, location: &Location) -> Result<(), StoreError> {
        self.checked.lock().unwrap_or_else(PoisonError::into_inner).retain(|checked| checked != digest);
        let _gate = self.gate.read().unwrap_or_else(PoisonError::into_inner);
        if self.catalogue.location(digest)? != Some(*location) {
            // It was collected meanwhile, or stored anew elsewhere.
            return Ok(());
        }
        tracing::warn!(artefact = %digest, pack = %location.pack, "an artefact is damaged: it counts as missing now");
        self.catalogue.forget_artefact(digest)
    }

    /// The size of an artefact, bytes.
    pub fn size(&self, digest: &Digest) -> Result<Option<u64>, StoreError> {
        Ok(self.catalogue.location(digest)?.map(|location| location.len))
    }

    /// Those of the digests whose artefacts are not here, in order. The others count as used now.
    pub fn missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, StoreError> {
        let mut missing = Vec::new();
        for digest in digests {
            match self.catalogue.location(digest)? {
                Some(location) => self.catalogue.packs.touch(&location.pack),
                None => missing.push(*digest),
            }
        }
        Ok(missing)
    }

    /// The digest of a task's result, if its artefact is here.
    pub fn result(&self, key: TaskKey) -> Result<Option<Digest>, StoreError> {
        let found = self.catalogue.result(&key)?;
        if let Some((_, location)) = &found {
            self.catalogue.packs.touch(&location.pack);
        }
        Ok(found.map(|(digest, _)| digest))
    }

    /// Like [`Self::result`] for many tasks, in order.
    pub fn results(&self, keys: &[TaskKey]) -> Result<Vec<Option<Digest>>, StoreError> {
        let mut used = BTreeSet::new();
        let mut found = Vec::with_capacity(keys.len());
        for key in keys {
            let result = self.catalogue.result(key)?;
            found.push(result.map(|(digest, location)| {
                used.insert(location.pack);
                digest
            }));
        }
        used.iter().for_each(|pack| self.catalogue.packs.touch(pack));
        Ok(found)
    }

    /// Bytes of all packs: nearly all that the folder holds, and known without a look at it.
    pub fn pack_bytes(&self) -> u64 {
        self.catalogue.packs.bytes()
    }

    /// What the folder holds. Walks the index: a matter of a tenth of a second for 100,000 artefacts.
    pub fn usage(&self) -> Result<Usage, StoreError> {
        let (artefacts, results) = self.catalogue.counts()?;
        let layout = &self.catalogue.layout;
        Ok(Usage {
            artefacts,
            results,
            packs: self.catalogue.packs.list().len() as u64,
            pack_bytes: self.catalogue.packs.bytes(),
            incoming_bytes: folder_bytes(&layout.incoming()),
            index_bytes: self.catalogue.index_bytes(),
            journal_bytes: folder_bytes(&layout.journal()),
            quarantine_bytes: folder_bytes(&layout.quarantine()),
        })
    }
}

/// A pack's header, or the refusal of a table that no pack can hold.
pub(crate) fn header(table: PackTable) -> Result<PackHeader, StoreError> {
    let found = (table.entries.len() + table.results.len()) as u64;
    let too_many = || StoreError::LimitExceeded { what: "artefacts of one pack", found, limit: 1 << 26 };
    PackHeader::new(table).filter(|header| header.pack_bytes().is_some()).ok_or_else(too_many)
}
