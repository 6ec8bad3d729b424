//! Artefacts and results go in and come out, over openings and from several threads.
#![expect(clippy::unwrap_used, reason = "tests panic where something is wrong")]

use kiln_core::{Digest, TaskKey};
use kiln_store::{FaultPoint, OpenOptions, ResultConflict, Store, StoreError};
use std::{collections::BTreeSet, path::Path, thread};

fn open(folder: &Path) -> Store {
    Store::open(folder, OpenOptions::default()).unwrap()
}

/// Bytes that differ from seed to seed and do not compress.
fn bytes(seed: u64, len: usize) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..len)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as u8
        })
        .collect()
}

fn key(text: &str) -> TaskKey {
    TaskKey(Digest::of(text.as_bytes()))
}

#[test]
fn what_is_put_is_got() {
    let folder = tempfile::tempdir().unwrap();
    let artefacts = [bytes(1, 100_000), bytes(2, 10), Vec::new(), bytes(1, 100_000)];
    let store = open(folder.path());
    let digests = store.put(&artefacts).unwrap();
    for (digest, artefact) in digests.iter().zip(&artefacts) {
        assert_eq!(store.get(digest).unwrap().as_ref(), Some(artefact));
        assert_eq!(store.size(digest).unwrap(), Some(artefact.len() as u64));
    }
    let usage = store.usage().unwrap();
    assert_eq!((usage.artefacts, usage.packs), (3, 1), "equal artefacts are stored once, together in one file");
    store.put(&artefacts).unwrap();
    assert_eq!(store.usage().unwrap().packs, 1, "what is there is not written again");
    drop(store);
    let store = open(folder.path());
    for (digest, artefact) in digests.iter().zip(&artefacts) {
        assert_eq!(store.get(digest).unwrap().as_ref(), Some(artefact));
    }
    let unknown = Digest::of(b"unknown");
    assert_eq!(store.missing(&[digests[0], unknown, digests[1]]).unwrap(), [unknown]);
    assert_eq!(store.get(&unknown).unwrap(), None);
    assert_eq!(store.size(&unknown).unwrap(), None);
}

#[test]
fn ranges() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let artefact = bytes(3, 5000);
    store.put_one(&bytes(4, 77)).unwrap();
    let digest = store.put_one(&artefact).unwrap();
    for (offset, len) in [(0, 5000), (0, 1), (4999, 1), (17, 1000), (4000, 9999), (5000, 1), (0, u64::MAX)] {
        let end = (offset + len.min(5000)).min(5000) as usize;
        let expected = artefact[offset as usize..end].to_vec();
        assert_eq!(store.read_range(&digest, offset, len).unwrap(), Some(expected), "{offset}+{len}");
    }
    assert!(matches!(store.read_range(&digest, 5001, 1), Err(StoreError::OutOfRange { bytes: 5000, .. })));
    assert_eq!(store.read_range(&Digest::of(b"unknown"), 0, 1).unwrap(), None);
}

#[test]
fn results_name_artefacts() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let (one, two) = (bytes(5, 9000), bytes(6, 20));
    let (first, second) = (Digest::of(&one), Digest::of(&two));
    let results = [(key("a"), first), (key("b"), second), (key("c"), first)];
    assert_eq!(store.put_results(&[&one, &two], &results).unwrap(), []);
    let nowhere = Digest::of(b"nowhere");
    let refused = store.put_results(&[&bytes(7, 5)], &[(key("d"), nowhere)]);
    assert!(matches!(refused, Err(StoreError::MissingArtefact { digest }) if digest == nowhere));
    assert_eq!(store.usage().unwrap().artefacts, 2, "a refused call stores nothing");
    assert_eq!(store.put_results::<&[u8]>(&[], &[(key("e"), second)]).unwrap(), [], "its artefact is there");
    let conflict = ResultConflict { key: key("a"), kept: first, offered: second };
    assert_eq!(store.put_results::<&[u8]>(&[], &[(key("a"), second), (key("b"), second)]).unwrap(), [conflict]);
    let within = store.put_results(&[&one, &two], &[(key("f"), first), (key("f"), second)]).unwrap();
    assert_eq!(within, [ResultConflict { key: key("f"), kept: first, offered: second }]);
    drop(store);
    let store = open(folder.path());
    let keys = ["a", "b", "c", "d", "e", "f"].map(key);
    let expected = [Some(first), Some(second), Some(first), None, Some(second), Some(first)];
    assert_eq!(store.results(&keys).unwrap(), expected);
}

#[test]
fn threads_put_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    thread::scope(|scope| {
        for worker in 0..6u64 {
            let store = &store;
            scope.spawn(move || {
                for round in 0..10 {
                    let own = bytes(worker * 1000 + round, 3000);
                    let shared = bytes(round + 77, 9000);
                    let task = key(&format!("task {round}"));
                    let conflicts = store.put_results(&[&own, &shared], &[(task, Digest::of(&shared))]).unwrap();
                    assert_eq!(conflicts, []);
                    assert_eq!(store.get(&Digest::of(&own)).unwrap(), Some(own));
                }
            });
        }
    });
    let usage = store.usage().unwrap();
    assert_eq!((usage.artefacts, usage.results), (70, 10));
}

#[test]
fn one_result_wins_a_race() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let conflicts: usize = thread::scope(|scope| {
        let racers: Vec<_> = (0..8u64)
            .map(|racer| {
                let store = &store;
                let artefact = bytes(racer, 100);
                let digest = Digest::of(&artefact);
                scope.spawn(move || store.put_results(&[artefact], &[(key("race"), digest)]).unwrap().len())
            })
            .collect();
        racers.into_iter().map(|racer| racer.join().unwrap()).sum()
    });
    assert_eq!(conflicts, 7);
    let kept = store.result(key("race")).unwrap();
    assert!(kept.is_some());
    drop(store);
    assert_eq!(open(folder.path()).result(key("race")).unwrap(), kept);
}

#[test]
fn a_folder_has_one_owner() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let error = Store::open(folder.path(), OpenOptions::default()).unwrap_err();
    assert!(error.is_retryable());
    assert!(error.to_string().contains(&format!("process {}", std::process::id())), "{error}");
    thread::scope(|scope| {
        let (send, receive) = std::sync::mpsc::channel();
        let waiter = scope.spawn(move || {
            Store::open_waiting(folder.path(), OpenOptions::default(), |_| send.send(()).unwrap()).map(drop)
        });
        receive.recv().expect("the wait is announced");
        drop(store);
        waiter.join().unwrap().unwrap();
    });
}

#[test]
fn a_full_disk_refuses_and_loses_nothing() {
    for point in ["pack.create", "pack.write", "pack.sync", "pack.rename", "pack.folder_sync", "index.update"] {
        let folder = tempfile::tempdir().unwrap();
        let old = open(folder.path()).put_one(&bytes(1, 50_000)).unwrap();
        let fault = FaultPoint::parse(&format!("{point}=enospc"));
        let store = Store::open(folder.path(), OpenOptions { fault, ..OpenOptions::default() }).unwrap();
        let new = bytes(2, 50_000);
        let refused = store.put_results(&[&new], &[(key("new"), Digest::of(&new))]);
        assert!(matches!(refused, Err(StoreError::DiskFull { .. })), "{point}: {refused:?}");
        assert_eq!(store.get(&old).unwrap(), Some(bytes(1, 50_000)), "{point}");
        drop(store);
        let store = open(folder.path());
        assert_eq!(store.get(&old).unwrap(), Some(bytes(1, 50_000)), "{point}");
        store.put_results(&[&new], &[(key("new"), Digest::of(&new))]).unwrap();
        assert_eq!(store.result(key("new")).unwrap(), Some(Digest::of(&new)), "{point}");
        let leftovers = std::fs::read_dir(folder.path().join("incoming")).unwrap().count();
        assert_eq!(leftovers, 0, "{point}");
    }
}

#[test]
fn a_quota_refuses_with_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let options = OpenOptions { quota_bytes: Some(100_000), ..OpenOptions::default() };
    let store = Store::open(folder.path(), options).unwrap();
    store.put_one(&bytes(1, 60_000)).unwrap();
    let error = store.put_one(&bytes(2, 60_000)).unwrap_err();
    assert!(matches!(error, StoreError::OverQuota { quota_bytes: 100_000, .. }), "{error}");
    store.put_one(&bytes(3, 30_000)).unwrap();
    store.put_one(&bytes(1, 60_000)).expect("what is there needs no room");
    let error = store.upload_begin(&[(Digest::of(b"x"), 50_000)]).unwrap_err();
    assert!(matches!(error, StoreError::OverQuota { .. }), "{error}");
}

#[test]
fn collection_keeps_what_lives_and_what_was_used() {
    let folder = tempfile::tempdir().unwrap();
    let options = || OpenOptions { garbage_grace_secs: 0, ..OpenOptions::default() };
    let store = Store::open(folder.path(), options()).unwrap();
    let put = |seed: u64, name: &str| {
        let artefact = bytes(seed, 10_000);
        store.put_results(&[&artefact], &[(key(name), Digest::of(&artefact))]).unwrap();
        thread::sleep(std::time::Duration::from_millis(3));
        Digest::of(&artefact)
    };
    let digests: Vec<_> = (0..6).map(|seed| put(seed, &seed.to_string())).collect();
    store.put_results::<&[u8]>(&[], &[(key("later name of 1"), digests[1])]).unwrap();
    let live = BTreeSet::from([digests[1]]);
    assert_eq!(store.collect_garbage(&live, 1 << 30).unwrap().packs, 0);
    thread::sleep(std::time::Duration::from_millis(3));
    store.get(&digests[0]).unwrap().expect("used last now");
    thread::sleep(std::time::Duration::from_millis(3));
    let collected = store.collect_garbage(&live, 35_000).unwrap();
    assert_eq!((collected.packs, collected.artefacts), (3, 3), "{collected:?}");
    let present = |store: &Store| digests.iter().map(|digest| store.get(digest).unwrap().is_some()).collect::<Vec<_>>();
    assert_eq!(present(&store), [true, true, false, false, false, true]);
    let keys = ["0", "1", "2", "5", "later name of 1"].map(key);
    let results = [Some(digests[0]), Some(digests[1]), None, Some(digests[5]), Some(digests[1])];
    assert_eq!(store.results(&keys).unwrap(), results);
    drop(store);
    let store = Store::open(folder.path(), options()).unwrap();
    assert_eq!(present(&store), [true, true, false, false, false, true]);
    assert_eq!(store.results(&keys).unwrap(), results);
    let all = store.collect_garbage(&live, 0).unwrap();
    assert_eq!(all.packs, 2, "what lives stays at any limit");
    drop(store);
    let careful = Store::open(folder.path(), OpenOptions::default()).unwrap();
    careful.get(&digests[1]).unwrap();
    assert_eq!(careful.collect_garbage(&BTreeSet::new(), 0).unwrap().artefacts, 0, "just used");
}
