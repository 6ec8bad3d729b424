//! A disk that is really full: a file system of a few megabytes in a mount namespace of its own. Where the system
//! does not allow that (it needs Linux and `unshare`), the test says so and only the played failures of the other
//! tests remain.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "tests panic where something is wrong")]

use kiln_core::{Digest, JobId, TaskKey};
use kiln_store::{JournalEvent, OpenOptions, Store, StoreError};
use std::{fs, path::Path, process::Command};

const FOLDER: &str = "KILN_TEST_FULL_DISK";
const NAME: &str = "a_full_disk_loses_nothing_and_recovers";

fn artefact(round: u64) -> Vec<u8> {
    (0..150_000u64).map(|i| (i.wrapping_mul(6_364_136_223_846_793_005) >> 40 ^ round) as u8).collect()
}

fn key(round: u64) -> TaskKey {
    TaskKey(Digest::of(&round.to_le_bytes()))
}

fn is_full(error: &StoreError) -> bool {
    matches!(error, StoreError::DiskFull { .. } | StoreError::JournalBroken { .. })
}

/// Writes until nothing more goes in; returns the rounds that were acknowledged, of artefacts and of events.
fn fill(store: &Store, from: u64) -> (Vec<u64>, Vec<u64>) {
    let fence = store.take_fence().unwrap();
    let (mut put, mut appended) = (Vec::new(), Vec::new());
    let mut refusals = 0;
    for round in from..from + 200 {
        let bytes = artefact(round);
        match store.put_results(&[&bytes], &[(key(round), Digest::of(&bytes))]) {
            Ok(_) => put.push(round),
            Err(error) => {
                assert!(is_full(&error), "{error}");
                refusals += 1;
            }
        }
        match store.journal_append(fence, &vec![JournalEvent::JobPaused(JobId(round)); 500]) {
            Ok(()) => appended.push(round),
            Err(error) => assert!(is_full(&error), "{error}"),
        }
        if refusals == 20 {
            return (put, appended);
        }
    }
    panic!("the disk does not fill up");
}

fn verify(store: &Store, put: &[u64], appended: &[u64]) {
    for round in put {
        assert_eq!(store.result(key(*round)).unwrap(), Some(Digest::of(&artefact(*round))));
        assert_eq!(store.get(&Digest::of(&artefact(*round))).unwrap(), Some(artefact(*round)));
    }
    let events = store.journal_replay().unwrap();
    for round in appended {
        assert_eq!(events.iter().filter(|event| event.job() == JobId(*round)).count(), 500);
    }
}

fn work(disk: &Path) {
    let ballast = disk.join("ballast");
    fs::write(&ballast, vec![1; 2 << 20]).unwrap();
    let folder = disk.join("data");
    let options = || OpenOptions { fault: None, ..OpenOptions::default() };
    let store = Store::open(&folder, options()).unwrap();
    let (mut put, appended) = fill(&store, 0);
    assert!(put.len() > 3 && !appended.is_empty());
    verify(&store, &put, &appended);
    drop(store);
    let store = match Store::open(&folder, options()) {
        Ok(store) => store,
        // Even the index may have no room; what is stored is safe all the same.
        Err(error) => {
            println!("as long as the disk is full: {error}");
            fs::remove_file(&ballast).unwrap();
            Store::open(&folder, options()).unwrap()
        }
    };
    verify(&store, &put, &appended);
    if ballast.exists() {
        fs::remove_file(&ballast).unwrap();
    }
    let bytes = artefact(999);
    store.put_results(&[&bytes], &[(key(999), Digest::of(&bytes))]).expect("there is room again");
    put.push(999);
    verify(&store, &put, &appended);
    drop(store);
    verify(&Store::open(&folder, options()).unwrap(), &put, &appended);
}

#[test]
fn a_full_disk_loses_nothing_and_recovers() {
    if let Ok(disk) = std::env::var(FOLDER) {
        work(Path::new(&disk));
        return;
    }
    let mount_point = tempfile::tempdir().unwrap();
    let script = "mount -t tmpfs -o size=6m tmpfs \"$0\" || exit 42; exec \"$1\" --exact \"$2\" --nocapture";
    let run = Command::new("unshare")
        .args(["--map-root-user", "--mount", "sh", "-c", script])
        .arg(mount_point.path())
        .arg(std::env::current_exe().unwrap())
        .arg(NAME)
        .env(FOLDER, mount_point.path())
        .env("RUST_BACKTRACE", "0")
        .output();
    let output = match run {
        Ok(output) => output,
        Err(error) => return println!("skipped, for want of unshare: {error}"),
    };
    let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    if output.status.code() == Some(42) || said.contains("unshare failed") {
        return println!("skipped, for want of a mount namespace: {said}");
    }
    assert!(output.status.success(), "{said}");
    assert!(said.contains("1 passed"), "{said}");
}
