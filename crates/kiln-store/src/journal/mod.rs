//! The journal: what happened to jobs, appended, checksummed, and synced in groups.
//!
//! An append is written under a lock, then synced by whichever waiting thread comes first, on behalf of all that were
//! written by then: many appends at once cost one or two syncs. A new file is begun at the first append after
//! opening, and when one is large; at opening, old files are replaced by a snapshot of what they amount to. The
//! files are described in [`segment`], their succession in [`history`].

mod event;
mod history;
mod segment;

pub use event::{Fence, JobOutcome, JournalEvent, SubmittedJob};

use crate::{
    Store, StoreError,
    fault::Faults,
    layout::{Layout, sync_folder},
};
use segment::{HEADER, Payload, SegmentHeader, SegmentKind, encode_append, encode_header};
use std::{
    fs::File,
    io::{self, Write},
    path::PathBuf,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
};

/// Old files of more than this, or more than [`COMPACT_FILES`] of them, are replaced by a snapshot at opening.
const COMPACT_BYTES: u64 = 1 << 20;
const COMPACT_FILES: usize = 8;

#[derive(Debug)]
pub(crate) struct Journal {
    layout: Arc<Layout>,
    segment_bytes: u64,
    faults: Arc<Faults>,
    state: Mutex<State>,
    synced: Condvar,
}

#[derive(Debug)]
struct State {
    /// The log that appends go to, and its length; none until the first append.
    log: Option<(Arc<File>, PathBuf, u64)>,
    next_sequence: u64,
    fence: Fence,
    /// Bytes written and bytes known to be durable, since opening.
    written: u64,
    durable: u64,
    syncing: bool,
    /// After a failure that leaves it open what is on the disk, nothing is acknowledged.
    broken: Option<String>,
}

impl Journal {
    /// Reads the folder, cuts an interrupted append off, and replaces old or damaged files by a snapshot.
    pub(crate) fn open(layout: Arc<Layout>, segment_bytes: u64, faults: Arc<Faults>) -> Result<Self, StoreError> {
        let history = history::read(&layout.journal())?;
        if let Some((path, bytes)) = &history.torn {
            tracing::info!(path = %path.display(), bytes, "an interrupted append is cut off the journal");
            let cut =
                || File::options().write(true).open(path).and_then(|file| file.set_len(*bytes).and(file.sync_all()));
            cut().map_err(StoreError::io("cut", path))?;
        }
        let old = history.bytes > COMPACT_BYTES || history.files.len() > COMPACT_FILES;
        if (old || !history.damaged.is_empty())
            && let Err(error) = history::compact(&layout, &history, &faults)
        {
            // The old files say the same, at greater length.
            tracing::warn!(%error, "the journal stays as long as it is");
        }
        let state = State {
            log: None,
            next_sequence: history.next_sequence,
            fence: history.fence.unwrap_or(Fence(0)),
            written: 0,
            durable: 0,
            syncing: false,
            broken: None,
        };
        Ok(Self { layout, segment_bytes, faults, state: Mutex::new(state), synced: Condvar::new() })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn broken(&self, reason: &str) -> StoreError {
        StoreError::JournalBroken { path: self.layout.journal(), reason: reason.to_owned() }
    }

    /// Appends under a fence, durable on return.
    fn append(&self, fence: Fence, events: &[JournalEvent]) -> Result<(), StoreError> {
        let found = events.len() as u64;
        let too_many = StoreError::LimitExceeded { what: "events of one append", found, limit: 1 << 16 };
        let payload = Payload::new(events).ok_or(too_many)?;
        let mut state = self.make_room(self.state(), payload.record_bytes())?;
        // What follows is one step: the lock is not given free before the record is written.
        if fence < state.fence {
            return Err(StoreError::Fenced { held: state.fence.0, offered: fence.0 });
        }
        let record = encode_append(state.next_sequence, fence, &payload);
        self.write(&mut state, &record)?;
        state.fence = fence;
        state.next_sequence += 1;
        state.written += record.len() as u64;
        let target = state.written;
        self.wait_durable(state, target)?;
        self.faults.pass("journal.synced").map_err(StoreError::io("sync", self.layout.journal()))
    }

    /// Makes sure that there is a log with room for a record.
    fn make_room<'a>(
        &'a self,
        mut state: MutexGuard<'a, State>,
        bytes: u64,
    ) -> Result<MutexGuard<'a, State>, StoreError> {
        if let Some(reason) = &state.broken {
            return Err(self.broken(reason));
        }
        let full = |state: &State| {
            state.log.as_ref().is_none_or(|(.., length)| *length > HEADER as u64 && length + bytes > self.segment_bytes)
        };
        if !full(&state) {
            return Ok(state);
        }
        // Whoever waits for the old log waits for its sync: it must not be let go of before.
        let written = state.written;
        state = self.sync_to(state, written)?;
        if full(&state) {
            self.rotate(&mut state)?;
        }
        Ok(state)
    }

    fn rotate(&self, state: &mut State) -> Result<(), StoreError> {
        let folder = self.layout.journal();
        let path = history::path(&folder, SegmentKind::Log, state.next_sequence);
        let header = SegmentHeader { kind: SegmentKind::Log, sequence: state.next_sequence, records: 0 };
        let create = || -> io::Result<File> {
            self.faults.pass("journal.rotate")?;
            let mut file = File::create(&path)?;
            file.write_all(&encode_header(&header))?;
            file.sync_all()?;
            Ok(file)
        };
        let file = create().map_err(StoreError::io("create", &path))?;
        sync_folder(&folder)?;
        state.log = Some((Arc::new(file), path, HEADER as u64));
        Ok(())
    }

    /// Writes a record at the end of the log; of one that fails nothing stays.
    fn write(&self, state: &mut State, record: &[u8]) -> Result<(), StoreError> {
        let Some((file, path, length)) = &mut state.log else { return Err(self.broken("no log is open")) };
        let (first, second) = record.split_at(record.len() / 2);
        let mut writer: &File = file;
        let written = writer
            .write_all(first)
            .and_then(|()| self.faults.pass("journal.write"))
            .and_then(|()| writer.write_all(second));
        match written {
            Ok(()) => {
                *length += record.len() as u64;
                Ok(())
            }
            Err(error) => {
                let undone = file.set_len(*length).and_then(|()| io::Seek::seek(&mut writer, io::SeekFrom::End(0)));
                let failure = StoreError::io("write", path.clone())(error);
                if let Err(error) = undone {
                    state.broken = Some(format!("a write failed and could not be undone: {error}"));
                }
                Err(failure)
            }
        }
    }

    fn wait_durable(&self, state: MutexGuard<'_, State>, target: u64) -> Result<(), StoreError> {
        self.sync_to(state, target).map(drop)
    }

    /// Returns when `target` bytes are durable: syncs, or waits for the thread that does.
    fn sync_to<'a>(
        &'a self,
        mut state: MutexGuard<'a, State>,
        target: u64,
    ) -> Result<MutexGuard<'a, State>, StoreError> {
        loop {
            if state.durable >= target {
                return Ok(state);
            }
            if let Some(reason) = &state.broken {
                return Err(self.broken(reason));
            }
            if state.syncing {
                state = self.synced.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            }
            let Some((file, ..)) = &state.log else { return Err(self.broken("no log is open")) };
            let (file, reached) = (file.clone(), state.written);
            state.syncing = true;
            drop(state);
            let result = self.faults.pass("journal.sync").and_then(|()| file.sync_data());
            state = self.state();
            state.syncing = false;
            match result {
                Ok(()) => state.durable = reached,
                // After a failed sync the system may have dropped what it could not write.
                Err(error) => state.broken = Some(format!("a sync failed: {error}")),
            }
            self.synced.notify_all();
        }
    }
}

impl Store {
    /// Takes the right to write to the journal: whoever had it before is refused from now on, durably.
    pub fn take_fence(&self) -> Result<Fence, StoreError> {
        let fence = Fence(self.journal.state().fence.0 + 1);
        self.journal.append(fence, &[])?;
        Ok(fence)
    }

    /// Appends events, all or none, durable on return. Calls from several threads share their syncs.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] where another took the right to write since; [`StoreError::DiskFull`], after which one
    /// may try again; [`StoreError::JournalBroken`], after which one may not.
    pub fn journal_append(&self, fence: Fence, events: &[JournalEvent]) -> Result<(), StoreError> {
        self.journal.append(fence, events)
    }

    /// Every event since the beginning, or the fewest that say the same. After damage some may be missing: events of
    /// jobs whose submission is not among them are to be passed over, but their numbers not given again.
    pub fn journal_replay(&self) -> Result<Vec<JournalEvent>, StoreError> {
        // Nothing may be half written meanwhile.
        let _state = self.journal.state();
        history::read(&self.journal.layout.journal()).map(|history| history.events)
    }
}

#[cfg(test)]
mod tests;
