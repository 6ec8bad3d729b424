//! Uploads arrive in chunks, are checked, and go on where they stopped.
#![expect(clippy::unwrap_used, reason = "tests panic where something is wrong")]

use kiln_core::Digest;
use kiln_store::{FaultPoint, OpenOptions, Store, StoreError};
use std::{fs, path::Path};

fn open(folder: &Path) -> Store {
    Store::open(folder, OpenOptions::default()).unwrap()
}

fn artefacts() -> Vec<Vec<u8>> {
    let fill = |seed: u32, len: u32| (0..len).map(|i| (i.wrapping_mul(2_654_435_761) >> 9 ^ seed) as u8).collect();
    vec![fill(1, 0), fill(2, 30_000), fill(3, 1), fill(4, 0), fill(5, 70_000), fill(6, 0)]
}

fn manifest() -> Vec<(Digest, u64)> {
    artefacts().iter().map(|bytes| (Digest::of(bytes), bytes.len() as u64)).collect()
}

fn send(store: &Store, id: &Digest, from: u64, to: u64, chunk: usize) -> Result<u64, StoreError> {
    let stream = artefacts().concat();
    let mut offset = from;
    while offset < to {
        let end = (offset as usize + chunk).min(to as usize);
        offset = store.upload_append(id, offset, &stream[offset as usize..end])?.committed_bytes;
    }
    Ok(offset)
}

fn assert_all_there(store: &Store) {
    for bytes in artefacts() {
        assert_eq!(store.get(&Digest::of(&bytes)).unwrap(), Some(bytes));
    }
}

#[test]
fn chunks_of_any_size() {
    for chunk in [1000, 30_000, 30_001, 1 << 20] {
        let folder = tempfile::tempdir().unwrap();
        let store = open(folder.path());
        let begun = store.upload_begin(&manifest()).unwrap();
        assert_eq!((begun.committed_bytes, begun.total_bytes), (0, 100_001));
        let early = store.upload_finish(&begun.id).unwrap_err();
        assert!(matches!(early, StoreError::IncompleteUpload { committed_bytes: 0, .. }), "{early}");
        send(&store, &begun.id, 0, begun.total_bytes, chunk).unwrap();
        assert!(store.get(&manifest()[1].0).unwrap().is_none(), "nothing is there before the end");
        store.upload_finish(&begun.id).unwrap();
        store.upload_finish(&begun.id).expect("to end it again is no error");
        assert_all_there(&store);
        let again = store.upload_begin(&manifest()).unwrap();
        assert_eq!(again.committed_bytes, again.total_bytes, "all of it is there already");
        store.upload_finish(&again.id).unwrap();
        drop(store);
        assert_all_there(&open(folder.path()));
    }
}

#[test]
fn goes_on_after_a_restart() {
    for stop in [0, 1, 29_999, 30_000, 30_001, 65_000, 100_001] {
        let folder = tempfile::tempdir().unwrap();
        let store = open(folder.path());
        let begun = store.upload_begin(&manifest()).unwrap();
        send(&store, &begun.id, 0, stop, 7777).unwrap();
        drop(store);
        let store = open(folder.path());
        assert!(matches!(store.upload_append(&begun.id, stop, &[1]), Err(StoreError::UnknownUpload { .. })));
        let resumed = store.upload_begin(&manifest()).unwrap();
        assert_eq!((resumed.id, resumed.committed_bytes), (begun.id, stop));
        send(&store, &begun.id, stop, begun.total_bytes, 7777).unwrap();
        store.upload_finish(&begun.id).unwrap();
        assert_all_there(&store);
    }
}

#[test]
fn what_was_damaged_on_disk_is_sent_again() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let begun = store.upload_begin(&manifest()).unwrap();
    send(&store, &begun.id, 0, 80_000, 9999).unwrap();
    drop(store);
    let part = folder.path().join("incoming").join(format!("{}.part", begun.id));
    let mut bytes = fs::read(&part).unwrap();
    let hit = bytes.len() - 80_000 + 12_345;
    bytes[hit] ^= 4;
    fs::write(&part, &bytes).unwrap();
    let store = open(folder.path());
    let resumed = store.upload_begin(&manifest()).unwrap();
    assert_eq!(resumed.committed_bytes, 0, "the first artefact with bytes is damaged");
    send(&store, &begun.id, 0, begun.total_bytes, 9999).unwrap();
    store.upload_finish(&begun.id).unwrap();
    assert_all_there(&store);
}

#[test]
fn wrong_bytes_are_refused_and_may_be_sent_again() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = store.upload_begin(&manifest()).unwrap().id;
    send(&store, &id, 0, 30_001, 5000).unwrap();
    let error = store.upload_append(&id, 30_001, &[0; 70_000]).unwrap_err();
    assert!(matches!(error, StoreError::DigestMismatch { committed_bytes: 30_001, .. }), "{error}");
    send(&store, &id, 30_001, 100_001, 5000).unwrap();
    store.upload_finish(&id).unwrap();
    assert_all_there(&store);
}

#[test]
fn chunks_must_follow_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = store.upload_begin(&manifest()).unwrap().id;
    let committed = send(&store, &id, 0, 500, 500).unwrap();
    for (offset, len) in [(0, 10), (499, 10), (501, 10), (500, 200_000), (u64::MAX, 1)] {
        let error = store.upload_append(&id, offset, &vec![0; len]).unwrap_err();
        assert!(matches!(error, StoreError::WrongOffset { committed_bytes: 500, .. }), "{error}");
    }
    send(&store, &id, committed, 100_001, 100_000).unwrap();
    store.upload_finish(&id).unwrap();
    assert_all_there(&store);
}

#[test]
fn limits_hold_before_anything_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let options = OpenOptions {
        max_artefact_bytes: 1000,
        max_upload_bytes: 3000,
        max_upload_artefacts: 5,
        max_uploads: 2,
        ..OpenOptions::default()
    };
    let store = Store::open(folder.path(), options).unwrap();
    let manifest = |count: u8, bytes| (0..count).map(|i| (Digest::of(&[i]), bytes)).collect::<Vec<_>>();
    for bad in [manifest(1, 1001), manifest(4, 1000), manifest(6, 1), manifest(2, u64::MAX)] {
        let error = store.upload_begin(&bad).unwrap_err();
        assert!(matches!(error, StoreError::LimitExceeded { .. }), "{error}");
    }
    store.upload_begin(&manifest(1, 10)).unwrap();
    store.upload_begin(&manifest(2, 10)).unwrap();
    store.upload_begin(&manifest(2, 10)).expect("it is under way");
    assert!(matches!(store.upload_begin(&manifest(3, 10)), Err(StoreError::LimitExceeded { .. })));
    store.upload_abandon(&store.upload_begin(&manifest(1, 10)).unwrap().id).unwrap();
    store.upload_begin(&manifest(3, 10)).unwrap();
    assert_eq!(fs::read_dir(folder.path().join("incoming")).unwrap().count(), 2);
    assert_eq!(store.upload_expire(3600).unwrap(), 0);
    assert_eq!(store.upload_expire(0).unwrap(), 2);
    assert_eq!(fs::read_dir(folder.path().join("incoming")).unwrap().count(), 0);
}

#[test]
fn a_full_disk_keeps_what_was_committed() {
    let folder = tempfile::tempdir().unwrap();
    let fault = FaultPoint::parse("upload.append:3=enospc");
    let store = Store::open(folder.path(), OpenOptions { fault, ..OpenOptions::default() }).unwrap();
    let id = store.upload_begin(&manifest()).unwrap().id;
    let error = send(&store, &id, 0, 100_001, 10_000).unwrap_err();
    assert!(matches!(error, StoreError::DiskFull { .. }), "{error}");
    drop(store);
    let store = open(folder.path());
    assert_eq!(store.upload_begin(&manifest()).unwrap().committed_bytes, 20_000);
    send(&store, &id, 20_000, 100_001, 10_000).unwrap();
    store.upload_finish(&id).unwrap();
    assert_all_there(&store);
}
