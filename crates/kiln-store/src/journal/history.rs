//! The journal's folder as it is found, and its short form.
//!
//! Logs are named by the first sequence number in them, snapshots by the one after the last that went into them. The
//! newest good snapshot and the logs from there on are the history; everything older is left over from an
//! interrupted compaction.

use super::{
    Fence, JournalEvent,
    segment::{
        HEADER, MAX_PAYLOAD, Newer, Payload, Scan, SegmentHeader, SegmentKind, VERSION, encode_append, encode_header,
        scan,
    },
};
use crate::{
    StoreError,
    fault::Faults,
    layout::{Layout, sync_folder},
};
use kiln_core::JobId;
use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

/// Snapshots hold this many events in each record.
const EVENTS_PER_RECORD: usize = 1024;

/// All that the journal's files say.
#[derive(Debug, Default)]
pub(super) struct History {
    pub(super) events: Vec<JournalEvent>,
    pub(super) next_sequence: u64,
    pub(super) fence: Option<Fence>,
    /// Files, in order of age, and their bytes together.
    pub(super) files: Vec<PathBuf>,
    pub(super) bytes: u64,
    /// Damaged files other than a torn tail, with what was in them.
    pub(super) damaged: Vec<(PathBuf, Vec<u8>)>,
    /// The last log and the length to cut it to, where an append was interrupted.
    pub(super) torn: Option<(PathBuf, u64)>,
}

struct Segment {
    path: PathBuf,
    named: u64,
    is_snapshot: bool,
    scan: Scan,
    bytes: Vec<u8>,
}

/// The path of a file of the journal.
pub(super) fn path(folder: &Path, kind: SegmentKind, sequence: u64) -> PathBuf {
    let extension = match kind {
        SegmentKind::Log => "log",
        SegmentKind::Snapshot => "snapshot",
    };
    folder.join(format!("{sequence:020}.{extension}"))
}

/// Reads every file of the journal.
pub(super) fn read(folder: &Path) -> Result<History, StoreError> {
    let mut segments = Vec::new();
    for entry in fs::read_dir(folder).map_err(StoreError::io("list", folder))?.flatten() {
        let path = entry.path();
        let is_snapshot = path.extension().is_some_and(|extension| extension == "snapshot");
        let is_log = path.extension().is_some_and(|extension| extension == "log");
        let named = path.file_stem().and_then(|stem| stem.to_str()).and_then(|stem| stem.parse().ok());
        let (Some(named), true) = (named, is_log || is_snapshot) else { continue };
        let bytes = fs::read(&path).map_err(StoreError::io("read", &path))?;
        let newer = |Newer(found)| StoreError::NewerFormat { path: path.clone(), found, known: VERSION };
        let scan = scan(&bytes).map_err(newer)?;
        segments.push(Segment { path, named, is_snapshot, scan, bytes });
    }
    segments.sort_by_key(|segment| (segment.named, !segment.is_snapshot));
    Ok(assemble(segments))
}

fn assemble(segments: Vec<Segment>) -> History {
    let snapshots = || segments.iter().filter(|segment| segment.is_snapshot);
    let newest_good = snapshots().rfind(|segment| !segment.scan.damaged);
    let base = newest_good.or(snapshots().next_back()).map(|segment| (segment.path.clone(), segment.named));
    let start = base.as_ref().map_or(0, |(_, named)| *named);
    let mut history = History { next_sequence: start, ..History::default() };
    let last = segments.last().map(|segment| segment.path.clone());
    for segment in segments {
        let is_base = base.as_ref().is_some_and(|(path, _)| *path == segment.path);
        for append in &segment.scan.appends {
            history.fence = history.fence.max(Some(append.fence));
            let counts = if segment.is_snapshot { is_base } else { append.sequence >= history.next_sequence };
            if counts {
                history.events.extend(append.events.iter().cloned());
            }
            if counts && !segment.is_snapshot {
                history.next_sequence = append.sequence + 1;
            }
        }
        history.bytes += segment.bytes.len() as u64;
        let is_last_log = !segment.is_snapshot && last.as_ref() == Some(&segment.path);
        let unborn = segment.bytes.len() < HEADER;
        if is_last_log && (unborn || (segment.scan.torn && !segment.scan.damaged)) {
            history.torn = Some((segment.path.clone(), segment.scan.good_bytes as u64));
        } else if segment.scan.damaged || segment.scan.torn {
            history.damaged.push((segment.path.clone(), segment.bytes));
        }
        history.files.push(segment.path);
    }
    history
}

/// What events amount to: the fewest that say the same of every job. Events of jobs that were never submitted, after
/// damage, are left out. That the highest job was forgotten is kept, so that its number is not given again.
pub(super) fn shorten(events: &[JournalEvent]) -> Vec<JournalEvent> {
    #[derive(Default)]
    struct Life {
        submitted: Option<JournalEvent>,
        lane: Option<JournalEvent>,
        paused: Option<JournalEvent>,
        finished: Option<JournalEvent>,
    }
    let mut lives: BTreeMap<JobId, Life> = BTreeMap::new();
    for event in events {
        let life = lives.entry(event.job()).or_default();
        let event = Some(event.clone());
        match event {
            Some(JournalEvent::JobSubmitted(_)) => life.submitted = event,
            Some(JournalEvent::LaneChosen { .. }) => life.lane = event,
            Some(JournalEvent::JobPaused(_)) => life.paused = event,
            Some(JournalEvent::JobResumed(_)) => life.paused = None,
            Some(JournalEvent::JobFinished { .. }) => life.finished = event,
            Some(JournalEvent::JobForgotten(_)) | None => *life = Life::default(),
        }
    }
    let highest = lives.last_key_value().map(|(&job, life)| (job, life.submitted.is_none()));
    let mut short = Vec::new();
    for life in lives.into_values().filter(|life| life.submitted.is_some()) {
        short.extend([life.submitted, life.lane, life.paused, life.finished].into_iter().flatten());
    }
    if let Some((job, true)) = highest {
        short.push(JournalEvent::JobForgotten(job));
    }
    short
}

/// Writes the short form of a history as a snapshot and removes the files it stands for; damaged ones are kept aside.
/// A crash at any point leaves the old files, or the snapshot, whole.
pub(super) fn compact(layout: &Layout, history: &History, faults: &Faults) -> Result<Vec<JournalEvent>, StoreError> {
    let folder = layout.journal();
    let events = shorten(&history.events);
    let target = path(&folder, SegmentKind::Snapshot, history.next_sequence);
    let temporary = folder.join("snapshot.tmp");
    let records = events.len().div_ceil(EVENTS_PER_RECORD).max(1);
    let header =
        SegmentHeader { kind: SegmentKind::Snapshot, sequence: history.next_sequence, records: records as u64 };
    let mut bytes = encode_header(&header);
    // An empty history has one empty record too, which keeps the fence.
    let fence = history.fence.unwrap_or(Fence(0));
    for sequence in 0..records {
        let from = (sequence * EVENTS_PER_RECORD).min(events.len());
        let part = &events[from..(from + EVENTS_PER_RECORD).min(events.len())];
        let found = part.len() as u64;
        let too_many = StoreError::LimitExceeded { what: "bytes of events", found, limit: MAX_PAYLOAD as u64 };
        bytes.extend(encode_append(sequence as u64, fence, &Payload::new(part).ok_or(too_many)?));
    }
    let write = || -> io::Result<()> {
        faults.pass("snapshot.write")?;
        let mut file = File::create(&temporary)?;
        file.write_all(&bytes)?;
        file.sync_all()?;
        faults.pass("snapshot.rename")?;
        fs::rename(&temporary, &target)
    };
    write().map_err(StoreError::io("write", &target))?;
    sync_folder(&folder)?;
    for (path, bytes) in &history.damaged {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        layout.keep_copy(&name, bytes, "a file of the journal cannot be read in full");
    }
    faults.pass("snapshot.remove").map_err(StoreError::io("remove", &folder))?;
    for old in history.files.iter().filter(|old| **old != target) {
        fs::remove_file(old).map_err(StoreError::io("remove", old))?;
    }
    Ok(events)
}
