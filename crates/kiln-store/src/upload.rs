//! Uploads: artefacts that come in chunks, checked as they come, resumable where they stopped.
//!
//! An upload is announced by its manifest, the digests and sizes of its artefacts, whose bytes follow one after the
//! other. It is written as the pack that it will be, under its id in `incoming/`, so that ending it is a sync and a
//! rename. What is there of an upload after a crash is found by announcing it again: the bytes are read and checked,
//! and it goes on after the last good one.

use crate::{
    Store, StoreError,
    pack::{PackHeader, PackTable},
    store,
};
use kiln_core::{Digest, DigestStream};
use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Read, Seek, SeekFrom, Write},
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant, SystemTime},
};

/// How far an upload is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UploadState {
    /// Names the upload; equal manifests have equal ids.
    pub id: Digest,
    /// Bytes that are there; the next chunk goes on from here.
    pub committed_bytes: u64,
    /// Bytes in all.
    pub total_bytes: u64,
}

/// The uploads under way.
#[derive(Debug, Default)]
pub(crate) struct Uploads {
    sessions: Mutex<BTreeMap<Digest, Arc<Mutex<Session>>>>,
}

impl Uploads {
    fn sessions(&self) -> MutexGuard<'_, BTreeMap<Digest, Arc<Mutex<Session>>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn find(&self, id: &Digest) -> Result<Arc<Mutex<Session>>, StoreError> {
        self.sessions().get(id).cloned().ok_or(StoreError::UnknownUpload { id: *id })
    }

    /// Bytes that the uploads will have.
    pub(crate) fn reserved_bytes(&self) -> u64 {
        let sessions: Vec<_> = self.sessions().values().cloned().collect();
        sessions.iter().map(|session| lock(session).total_bytes).sum()
    }
}

fn lock(session: &Mutex<Session>) -> MutexGuard<'_, Session> {
    session.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One upload: the file, and the check of the artefact that is coming in.
#[derive(Debug)]
struct Session {
    header: PackHeader,
    path: PathBuf,
    file: File,
    committed_bytes: u64,
    total_bytes: u64,
    /// The artefact that is coming in, what is there of it, and its digest so far.
    entry: usize,
    entry_bytes: u64,
    stream: DigestStream,
    last_used: Instant,
    /// Ended or given up, while another thread still had it.
    closed: bool,
}

impl Session {
    /// Opens or makes the file, and checks what is there of an earlier attempt.
    fn open(header: PackHeader, path: PathBuf, total_bytes: u64) -> Result<Self, StoreError> {
        let file = File::options().read(true).write(true).create(true).truncate(false).open(&path);
        let file = file.map_err(StoreError::io("open", &path))?;
        let mut session = Self {
            header,
            path,
            file,
            committed_bytes: 0,
            total_bytes,
            entry: 0,
            entry_bytes: 0,
            stream: DigestStream::default(),
            last_used: Instant::now(),
            closed: false,
        };
        session.recover().map_err(StoreError::io("read", &session.path))?;
        Ok(session)
    }

    fn recover(&mut self) -> io::Result<()> {
        let mut found = Vec::new();
        (&self.file).take(self.header.bytes.len() as u64).read_to_end(&mut found)?;
        if found != self.header.bytes {
            self.file.set_len(0)?;
            self.file.rewind()?;
            self.file.write_all(&self.header.bytes)?;
        }
        let mut buffer = vec![0; 1 << 18];
        while self.committed_bytes < self.total_bytes {
            let room = usize::try_from(self.total_bytes - self.committed_bytes).unwrap_or(usize::MAX);
            let read = self.file.read(&mut buffer[..room.min(1 << 18)])?;
            if read == 0 || self.take(&buffer[..read]).is_err() {
                break;
            }
        }
        let _ = self.take(&[]);
        self.file.set_len(self.header.bytes.len() as u64 + self.committed_bytes)
    }

    /// Writes a chunk where the last ended. What was written of one that fails does not count.
    fn write(&mut self, chunk: &[u8]) -> io::Result<()> {
        let end = self.header.bytes.len() as u64 + self.committed_bytes;
        let written = self.file.seek(SeekFrom::Start(end)).and_then(|_| self.file.write_all(chunk));
        if written.is_err() {
            self.file.set_len(end)?;
        }
        written
    }

    /// Counts bytes that are in the file, artefact by artefact.
    ///
    /// # Errors
    /// Where an artefact's digest is not what was announced: the upload goes back to its beginning.
    fn take(&mut self, mut bytes: &[u8]) -> Result<(), StoreError> {
        while let Some(&(expected, len)) = self.header.table.entries.get(self.entry) {
            let here = usize::try_from(len - self.entry_bytes).unwrap_or(usize::MAX).min(bytes.len());
            let (now, rest) = bytes.split_at(here);
            self.stream.update(now);
            self.entry_bytes += here as u64;
            self.committed_bytes += here as u64;
            bytes = rest;
            if self.entry_bytes < len {
                break;
            }
            let found = self.stream.finish();
            self.stream = DigestStream::default();
            if found != expected {
                self.committed_bytes -= self.entry_bytes;
                self.entry_bytes = 0;
                return Err(StoreError::DigestMismatch { expected, found, committed_bytes: self.committed_bytes });
            }
            self.entry += 1;
            self.entry_bytes = 0;
        }
        Ok(())
    }

    fn is_complete(&self) -> bool {
        self.entry == self.header.table.entries.len()
    }

    fn state(&self) -> UploadState {
        let (committed_bytes, total_bytes) = (self.committed_bytes, self.total_bytes);
        UploadState { id: self.header.name, committed_bytes, total_bytes }
    }
}

impl Store {
    /// Announces an upload, or finds it again: the digest and size of each artefact, whose bytes follow in this order.
    ///
    /// # Errors
    /// [`StoreError::LimitExceeded`] and [`StoreError::OverQuota`], before anything is allocated for it.
    pub fn upload_begin(&self, manifest: &[(Digest, u64)]) -> Result<UploadState, StoreError> {
        let total_bytes = self.check_limits(manifest)?;
        let header = store::header(PackTable { entries: manifest.to_vec(), results: Vec::new() })?;
        let id = header.name;
        if self.is_stored(&id, manifest)? {
            return Ok(UploadState { id, committed_bytes: total_bytes, total_bytes });
        }
        if let Ok(session) = self.uploads.find(&id) {
            return Ok(lock(&session).state());
        }
        self.check_quota(header.pack_bytes().unwrap_or(u64::MAX))?;
        let mut sessions = self.uploads.sessions();
        if let Some(session) = sessions.get(&id) {
            return Ok(lock(session).state());
        }
        limit("uploads under way", sessions.len() as u64 + 1, self.options.max_uploads as u64)?;
        let path = self.incoming(&id);
        self.faults.pass("upload.create").map_err(StoreError::io("create", &path))?;
        let session = Session::open(header, path, total_bytes)?;
        let state = session.state();
        sessions.insert(id, Arc::new(Mutex::new(session)));
        Ok(state)
    }

    fn incoming(&self, id: &Digest) -> PathBuf {
        self.catalogue.layout.incoming().join(format!("{id}.part"))
    }

    /// The sum of an upload's sizes, if they are within the limits.
    fn check_limits(&self, manifest: &[(Digest, u64)]) -> Result<u64, StoreError> {
        let options = &self.options;
        limit("artefacts of an upload", manifest.len() as u64, options.max_upload_artefacts as u64)?;
        let mut total_bytes = 0u64;
        for (_, bytes) in manifest {
            limit("bytes of an artefact", *bytes, options.max_artefact_bytes)?;
            total_bytes = total_bytes.saturating_add(*bytes);
        }
        limit("bytes of an upload", total_bytes, options.max_upload_bytes)?;
        Ok(total_bytes)
    }

    /// Whether an upload is at its end already, here as a pack with all of its artefacts.
    fn is_stored(&self, id: &Digest, manifest: &[(Digest, u64)]) -> Result<bool, StoreError> {
        if !self.catalogue.packs.contains(id) {
            return Ok(false);
        }
        for (digest, _) in manifest {
            if self.catalogue.location(digest)?.is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Takes the next chunk of an upload.
    ///
    /// # Errors
    /// [`StoreError::WrongOffset`] where the chunk does not go on where the last ended, and
    /// [`StoreError::DigestMismatch`] where an artefact turned out wrong: both say from where to go on. Any other error
    /// leaves the upload as it was.
    pub fn upload_append(&self, id: &Digest, offset: u64, chunk: &[u8]) -> Result<UploadState, StoreError> {
        let session = self.uploads.find(id)?;
        let mut session = lock(&session);
        if session.closed {
            return Err(StoreError::UnknownUpload { id: *id });
        }
        session.last_used = Instant::now();
        let UploadState { committed_bytes, total_bytes, .. } = session.state();
        let len = chunk.len() as u64;
        if offset != committed_bytes || len > total_bytes - committed_bytes {
            return Err(StoreError::WrongOffset { offset, len, committed_bytes, total_bytes });
        }
        self.faults.pass("upload.append").map_err(StoreError::io("write", &session.path))?;
        session.write(chunk).map_err(StoreError::io("write", &session.path))?;
        session.take(chunk)?;
        Ok(session.state())
    }

    /// Ends an upload: its artefacts are here, durably, on return. To end it again is no error.
    ///
    /// # Errors
    /// [`StoreError::IncompleteUpload`] where bytes are wanting.
    pub fn upload_finish(&self, id: &Digest) -> Result<(), StoreError> {
        let _gate = self.gate.read().unwrap_or_else(PoisonError::into_inner);
        let session = match self.uploads.find(id) {
            Ok(session) => session,
            Err(_) if self.catalogue.packs.contains(id) => return self.catalogue.ensure_indexed(id),
            Err(error) => return Err(error),
        };
        let mut session = lock(&session);
        if session.closed {
            return self.catalogue.ensure_indexed(id);
        }
        if !session.is_complete() {
            let UploadState { id, committed_bytes, total_bytes } = session.state();
            return Err(StoreError::IncompleteUpload { id, committed_bytes, total_bytes });
        }
        self.faults.pass("upload.finish").map_err(StoreError::io("sync", &session.path))?;
        self.catalogue.packs.adopt(&session.path, &session.file, id)?;
        session.closed = true;
        let committed = self.catalogue.commit(&session.header);
        // Locks are taken in the order sessions, session: this one is given free first.
        drop(session);
        self.uploads.sessions().remove(id);
        committed.map(|_| ())
    }

    /// Gives an upload up and removes what is there of it. One that is not under way is no error.
    pub fn upload_abandon(&self, id: &Digest) -> Result<(), StoreError> {
        if let Some(session) = self.uploads.sessions().remove(id) {
            lock(&session).closed = true;
        }
        remove_if_there(&self.incoming(id))
    }

    /// Gives up the uploads that had no chunk for a time, also those of earlier processes; returns how many.
    pub fn upload_expire(&self, unused_secs: u64) -> Result<usize, StoreError> {
        let unused = Duration::from_secs(unused_secs);
        let sessions: Vec<_> = self.uploads.sessions().iter().map(|(id, session)| (*id, session.clone())).collect();
        let (idle, busy): (Vec<_>, Vec<_>) =
            sessions.into_iter().partition(|(_, session)| lock(session).last_used.elapsed() >= unused);
        let mut expired = idle.len();
        idle.iter().try_for_each(|(id, _)| self.upload_abandon(id))?;
        let folder = self.catalogue.layout.incoming();
        for entry in fs::read_dir(&folder).map_err(StoreError::io("list", &folder))?.flatten() {
            let path = entry.path();
            let is_part = path.extension().is_some_and(|extension| extension == "part");
            let is_busy = busy.iter().any(|(id, _)| self.incoming(id) == path);
            let age = entry.metadata().and_then(|data| data.modified()).ok();
            let age = age.and_then(|time| SystemTime::now().duration_since(time).ok()).unwrap_or_default();
            if is_part && !is_busy && age >= unused {
                remove_if_there(&path)?;
                expired += 1;
            }
        }
        Ok(expired)
    }
}

fn limit(what: &'static str, found: u64, limit: u64) -> Result<(), StoreError> {
    if found <= limit { Ok(()) } else { Err(StoreError::LimitExceeded { what, found, limit }) }
}

fn remove_if_there(path: &PathBuf) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(StoreError::io("remove", path)(error)),
        _ => Ok(()),
    }
}
