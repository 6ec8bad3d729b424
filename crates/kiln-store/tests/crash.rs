//! A process that is ended at each step of each write: what it acknowledged is there afterwards, whole.
//!
//! The test starts itself anew as the process that is to end, with `KILN_FAILPOINT` set, and reads from its output
//! what was acknowledged.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "tests panic where something is wrong")]

use kiln_core::{Digest, JobId, TaskKey};
use kiln_store::{FaultPoint, JournalEvent, OpenOptions, Store, SubmittedJob};
use std::{
    collections::BTreeSet,
    path::Path,
    process::{Command, Stdio},
};

const FOLDER: &str = "KILN_TEST_CRASH_FOLDER";

fn artefact(round: u32, index: u32) -> Vec<u8> {
    (0..3000 * (index + 1)).map(|i| (i.wrapping_mul(2_654_435_761) >> 13 ^ (round * 31 + index)) as u8).collect()
}

fn key(round: u32) -> TaskKey {
    TaskKey(Digest::of(format!("task {round}").as_bytes()))
}

fn options() -> OpenOptions {
    OpenOptions { journal_segment_bytes: 400, garbage_grace_secs: 0, ..OpenOptions::default() }
}

fn event(round: u32) -> JournalEvent {
    JournalEvent::JobSubmitted(SubmittedJob {
        job: JobId(u64::from(round)),
        request_id: "request".to_owned(),
        payload: Digest::of(b"payload"),
        source: Digest::of(b"source"),
        name: "level.glb".to_owned(),
        tenant: "studio".to_owned(),
        priority: 0,
        submitted_unix_ms: 1_700_000_000_000,
        lane: None,
    })
}

/// The process that is to end: rounds of every kind of write, each announced when it is durable.
fn work(folder: &Path) {
    let store = Store::open(folder, options()).unwrap();
    let fence = store.take_fence().unwrap();
    for round in 0..12 {
        let artefacts = [artefact(round, 0), artefact(round, 1)];
        store.put_results(&artefacts, &[(key(round), Digest::of(&artefacts[1]))]).unwrap();
        println!("put {round}");
        store.journal_append(fence, &[event(round)]).unwrap();
        println!("event {round}");
        let uploaded = artefact(round, 2);
        let upload = store.upload_begin(&[(Digest::of(&uploaded), uploaded.len() as u64)]).unwrap();
        let mut offset = upload.committed_bytes;
        while offset < upload.total_bytes {
            let chunk = &uploaded[offset as usize..][..(uploaded.len() - offset as usize).min(4000)];
            offset = store.upload_append(&upload.id, offset, chunk).unwrap().committed_bytes;
        }
        store.upload_finish(&upload.id).unwrap();
        println!("upload {round}");
        if round == 8 {
            let live = (0..8).flat_map(|round| [0, 1, 2].map(|i| Digest::of(&artefact(round, i)))).collect();
            println!("dropped 8");
            std::thread::sleep(std::time::Duration::from_millis(5));
            store.collect_garbage(&live, 0).unwrap();
        }
    }
}

/// Checks that what was acknowledged is there.
fn verify(folder: &Path, output: &str, what: &str) -> usize {
    let store = Store::open(folder, OpenOptions { fault: None, ..options() }).unwrap();
    let events = store.journal_replay().unwrap();
    let mut acknowledged = 0;
    let lines: BTreeSet<_> = output.lines().filter_map(|line| line.split_once(' ')).collect();
    for (kind, round) in &lines {
        let Ok(round) = round.parse::<u32>() else { continue };
        let collected = lines.contains(&("dropped", "8")) && round == 8;
        let has = |index| {
            let expected = artefact(round, index);
            let found = store.get(&Digest::of(&expected)).unwrap();
            assert!(collected || found == Some(expected), "{what}: artefact {index} of round {round} is lost");
        };
        match *kind {
            "put" => {
                has(0);
                has(1);
                let result = store.result(key(round)).unwrap();
                assert!(collected || result == Some(Digest::of(&artefact(round, 1))), "{what}: a result is lost");
            }
            "event" => assert!(events.contains(&event(round)), "{what}: event {round} is lost"),
            "upload" => has(2),
            _ => continue,
        }
        acknowledged += 1;
    }
    acknowledged
}

#[test]
fn an_end_at_any_step_loses_nothing_acknowledged() {
    if let Ok(folder) = std::env::var(FOLDER) {
        work(Path::new(&folder));
        return;
    }
    let mut ended = 0;
    for (index, point) in FaultPoint::NAMES.iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let mut acknowledged = 0;
        // Several lives of one folder, each ended a little later than the last: leftovers meet leftovers.
        for pass in [1, 2 + index % 3, 7] {
            let output = Command::new(std::env::current_exe().unwrap())
                .args(["--exact", "an_end_at_any_step_loses_nothing_acknowledged", "--nocapture"])
                .env(FOLDER, folder.path())
                .env("KILN_FAILPOINT", format!("{point}:{pass}"))
                .env("RUST_BACKTRACE", "0")
                .stderr(Stdio::null())
                .output()
                .unwrap();
            ended += usize::from(!output.status.success());
            let said = String::from_utf8_lossy(&output.stdout);
            acknowledged += verify(folder.path(), &said, &format!("{point}:{pass}"));
        }
        assert!(acknowledged > 0 || *point == "journal.rotate" || point.starts_with("snapshot"), "{point}");
    }
    assert!(ended >= FaultPoint::NAMES.len(), "{ended} processes were ended");
}
