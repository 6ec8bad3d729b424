use super::*;
use crate::{FaultPoint, OpenOptions};
use kiln_core::{Digest, JobId, Lane};
use proptest::prelude::*;
use std::{fs, path::Path, thread};

fn submitted(job: u64) -> JournalEvent {
    JournalEvent::JobSubmitted(SubmittedJob {
        job: JobId(job),
        request_id: format!("request {job}"),
        payload: Digest::of(b"payload"),
        source: Digest::of(b"source"),
        name: "level.glb".to_owned(),
        tenant: "studio".to_owned(),
        priority: 3,
        submitted_unix_ms: 1_700_000_000_000 + job,
        lane: None,
    })
}

fn finished(job: u64) -> JournalEvent {
    let outcome = JobOutcome::Failed { reason: "it was a test".to_owned() };
    JournalEvent::JobFinished { job: JobId(job), outcome, finished_unix_ms: 1_700_000_001_000 }
}

fn open(folder: &Path) -> Journal {
    open_with(folder, OpenOptions { journal_segment_bytes: 4096, fault: None, ..OpenOptions::default() }).unwrap()
}

fn open_with(folder: &Path, options: OpenOptions) -> Result<Journal, StoreError> {
    let layout = Arc::new(Layout::new(folder));
    layout.prepare()?;
    Journal::open(layout, options.journal_segment_bytes, Arc::new(Faults::new(options.fault)))
}

fn events(journal: &Journal) -> Vec<JournalEvent> {
    history::read(&journal.layout.journal()).unwrap().events
}

fn logs(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = fs::read_dir(folder.join("journal")).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

#[test]
fn appends_come_back_over_files_and_openings() {
    let folder = tempfile::tempdir().unwrap();
    let mut written = Vec::new();
    for round in 0..4 {
        let journal = open(folder.path());
        for job in 0..20 {
            let new = [submitted(100 * round + job), finished(100 * round + job)];
            journal.append(Fence(round), &new).unwrap();
            written.extend(new);
        }
        assert_eq!(events(&journal), written);
    }
    assert!(logs(folder.path()).len() > 1, "the journal goes on in further files");
}

#[test]
fn a_fence_keeps_the_old_one_out_over_openings() {
    let folder = tempfile::tempdir().unwrap();
    let journal = open(folder.path());
    journal.append(Fence(3), &[submitted(1)]).unwrap();
    journal.append(Fence(4), &[]).unwrap();
    let refused = |journal: &Journal| {
        matches!(journal.append(Fence(3), &[finished(1)]), Err(StoreError::Fenced { held: 4, offered: 3 }))
    };
    assert!(refused(&journal));
    drop(journal);
    let journal = open(folder.path());
    assert!(refused(&journal));
    assert_eq!(events(&journal), [submitted(1)]);
}

#[test]
fn many_threads_append_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let journal = open(folder.path());
    thread::scope(|scope| {
        for worker in 0..8 {
            let journal = &journal;
            scope.spawn(move || {
                for job in 0..25 {
                    journal.append(Fence(1), &[submitted(worker * 100 + job), finished(worker * 100 + job)]).unwrap();
                }
            });
        }
    });
    let found = events(&journal);
    assert_eq!(found.len(), 400);
    for pair in found.chunks(2) {
        assert_eq!(pair[0].job(), pair[1].job(), "an append is not torn apart");
    }
    for worker in 0..8 {
        let jobs: Vec<_> = found.iter().map(|event| event.job().0).filter(|job| job / 100 == worker).collect();
        assert!(jobs.is_sorted(), "appends of one thread keep their order");
    }
}

#[test]
fn an_interrupted_append_is_cut_off_at_every_length() {
    let source = tempfile::tempdir().unwrap();
    let journal = open(source.path());
    journal.append(Fence(1), &[submitted(1)]).unwrap();
    let path = logs(source.path()).remove(0);
    let whole = fs::metadata(&path).unwrap().len() as usize;
    journal.append(Fence(1), &[finished(1), submitted(2)]).unwrap();
    let bytes = fs::read(&path).unwrap();
    for length in (0..bytes.len()).filter(|length| length % 9 == 0 || length.abs_diff(whole) < 3) {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("journal")).unwrap();
        fs::write(folder.path().join("journal").join(path.file_name().unwrap()), &bytes[..length]).unwrap();
        let journal = open(folder.path());
        let kept = if length < whole { vec![] } else { vec![submitted(1)] };
        assert_eq!(events(&journal), kept, "cut to {length} of {} bytes", bytes.len());
        journal.append(Fence(9), &[submitted(7)]).unwrap();
        drop(journal);
        assert_eq!(events(&open(folder.path())), [kept, vec![submitted(7)]].concat());
        let quarantined = fs::read_dir(folder.path().join("quarantine")).unwrap().count();
        assert_eq!(quarantined, 0, "an interrupted append is no damage");
    }
}

#[test]
fn a_full_disk_refuses_an_append_and_loses_none() {
    let folder = tempfile::tempdir().unwrap();
    open(folder.path()).append(Fence(1), &[submitted(1)]).unwrap();
    let fault = FaultPoint::parse("journal.write:2=enospc");
    let journal = open_with(folder.path(), OpenOptions { fault, ..OpenOptions::default() }).unwrap();
    journal.append(Fence(1), &[submitted(2)]).unwrap();
    for _ in 0..2 {
        assert!(matches!(journal.append(Fence(1), &[submitted(3)]), Err(StoreError::DiskFull { .. })));
    }
    assert_eq!(events(&journal), [submitted(1), submitted(2)]);
    drop(journal);
    let journal = open(folder.path());
    journal.append(Fence(1), &[submitted(4)]).unwrap();
    assert_eq!(events(&journal), [submitted(1), submitted(2), submitted(4)]);
}

#[test]
fn a_failed_sync_ends_all_promises() {
    let folder = tempfile::tempdir().unwrap();
    let fault = FaultPoint::parse("journal.sync:2=enospc");
    let journal = open_with(folder.path(), OpenOptions { fault, ..OpenOptions::default() }).unwrap();
    journal.append(Fence(1), &[submitted(1)]).unwrap();
    for _ in 0..2 {
        assert!(matches!(journal.append(Fence(1), &[submitted(2)]), Err(StoreError::JournalBroken { .. })));
    }
}

#[test]
fn the_short_form_says_the_same() {
    let lane = |name: &str| JournalEvent::LaneChosen {
        job: JobId(1),
        lane: Lane { trace: name.to_owned(), solve: "x86_64".to_owned() },
    };
    let long = [
        submitted(1),
        lane("cpu"),
        JournalEvent::JobPaused(JobId(1)),
        JournalEvent::JobResumed(JobId(1)),
        submitted(2),
        JournalEvent::JobPaused(JobId(2)),
        finished(1),
        finished(9),
        submitted(5),
        JournalEvent::JobForgotten(JobId(5)),
    ];
    let short = history::shorten(&long);
    let expected = [
        submitted(1),
        lane("cpu"),
        finished(1),
        submitted(2),
        JournalEvent::JobPaused(JobId(2)),
        JournalEvent::JobForgotten(JobId(9)),
    ];
    assert_eq!(short, expected);
    assert_eq!(history::shorten(&short), short);
}

#[test]
fn opening_shortens_a_long_journal() {
    let folder = tempfile::tempdir().unwrap();
    let small = OpenOptions { journal_segment_bytes: 300, fault: None, ..OpenOptions::default() };
    let journal = open_with(folder.path(), small).unwrap();
    for job in 0..20 {
        journal.append(Fence(2), &[submitted(job)]).unwrap();
        journal.append(Fence(2), &[JournalEvent::JobForgotten(JobId(job))]).unwrap();
    }
    journal.append(Fence(2), &[submitted(200)]).unwrap();
    drop(journal);
    assert!(logs(folder.path()).len() > COMPACT_FILES);
    let journal = open(folder.path());
    assert_eq!(events(&journal), [submitted(200)]);
    assert_eq!(logs(folder.path()).len(), 1);
    assert!(journal.append(Fence(1), &[]).is_err(), "the fence outlives the short form");
    journal.append(Fence(2), &[finished(200)]).unwrap();
    drop(journal);
    assert_eq!(events(&open(folder.path())), [submitted(200), finished(200)]);
}

#[test]
fn compaction_can_stop_anywhere() {
    for point in ["snapshot.write", "snapshot.rename", "snapshot.remove"] {
        let folder = tempfile::tempdir().unwrap();
        let small = OpenOptions { journal_segment_bytes: 100, fault: None, ..OpenOptions::default() };
        let journal = open_with(folder.path(), small).unwrap();
        (0..12).for_each(|job| journal.append(Fence(1), &[submitted(job), finished(job)]).unwrap());
        let written = events(&journal);
        drop(journal);
        let fault = FaultPoint::parse(&format!("{point}=enospc"));
        let journal = open_with(folder.path(), OpenOptions { fault, ..OpenOptions::default() }).unwrap();
        assert_eq!(events(&journal), written, "{point}");
        journal.append(Fence(1), &[submitted(999)]).unwrap();
        drop(journal);
        let journal = open(folder.path());
        assert_eq!(events(&journal), [written, vec![submitted(999)]].concat(), "{point}");
        assert_eq!(logs(folder.path()).len(), 1, "{point}");
    }
}

#[test]
fn a_later_version_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    drop(open(folder.path()));
    let header = encode_header(&SegmentHeader { kind: SegmentKind::Log, sequence: 0, records: 0 });
    let mut bytes = header.clone();
    bytes[8..12].copy_from_slice(&7u32.to_le_bytes());
    let sum = Digest::of(&bytes[..HEADER - 16]);
    bytes[HEADER - 16..].copy_from_slice(&sum.as_bytes()[..16]);
    fs::write(folder.path().join("journal/00000000000000000000.log"), &bytes).unwrap();
    let error = open_with(folder.path(), OpenOptions::default()).unwrap_err();
    assert!(matches!(error, StoreError::NewerFormat { found: 7, known: 1, .. }), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn whatever_happens_to_the_files_the_rest_is_read(
        hits in proptest::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let journal = open(folder.path());
        thread::scope(|scope| {
            // At once, so that they share their syncs.
            for job in 0..30 {
                let journal = &journal;
                scope.spawn(move || journal.append(Fence(1), &[submitted(job)]).unwrap());
            }
        });
        let written = events(&journal);
        drop(journal);
        for (file, at, how) in &hits {
            let paths = logs(folder.path());
            let path = &paths[file.index(paths.len())];
            let mut bytes = fs::read(path).unwrap();
            let at = at.index(bytes.len().max(1));
            match how % 4 {
                0 => bytes.truncate(at),
                1 => bytes.extend_from_slice(&[*how; 33]),
                _ => if let Some(byte) = bytes.get_mut(at) { *byte ^= 1 << (how % 8) },
            }
            fs::write(path, &bytes).unwrap();
        }
        let journal = open(folder.path());
        let mut found = events(&journal);
        let highest = found.last().cloned();
        if let Some(JournalEvent::JobForgotten(_)) = highest {
            found.pop();
        }
        for event in &found {
            prop_assert!(written.contains(event));
        }
        // A hit costs the append that it hits, and a cut-off file those after the cut.
        let cut = hits.iter().any(|(.., how)| how % 4 == 0);
        prop_assert!(cut || found.len() + hits.len() >= written.len(), "{} of {}", found.len(), written.len());
        journal.append(Fence(1), &[finished(999)]).unwrap();
        drop(journal);
        prop_assert!(events(&open(folder.path())).len() <= written.len() + 2);
    }
}
