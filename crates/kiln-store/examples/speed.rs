//! How fast the store is: `cargo run --release -p kiln-store --example speed`.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement stops where something is wrong")]

use kiln_core::{Digest, JobId, TaskKey};
use kiln_store::{JournalEvent, OpenOptions, Store};
use std::{
    thread,
    time::{Duration, Instant},
};

fn key(index: u64) -> TaskKey {
    TaskKey(Digest::of(&index.to_le_bytes()))
}

fn artefact(seed: u64, len: usize) -> Vec<u8> {
    Digest::of(&seed.to_le_bytes()).0.iter().copied().cycle().take(len).collect()
}

fn timed<T>(what: &str, times: u64, run: impl FnOnce() -> T) -> T {
    let began = Instant::now();
    let value = run();
    let each: Duration = began.elapsed() / u32::try_from(times).unwrap();
    println!("{what}: {:?}, {each:?} each of {times}", began.elapsed());
    value
}

fn main() {
    let folder = tempfile::tempdir_in(".").unwrap();
    let store = Store::open(folder.path(), OpenOptions::default()).unwrap();
    let lease = |lease: u64| -> (Vec<Vec<u8>>, Vec<(TaskKey, Digest)>) {
        let artefacts: Vec<_> = (0..200).map(|i| artefact(1000 * lease + i, 100_000)).collect();
        let results = artefacts.iter().enumerate();
        let results = results.map(|(i, bytes)| (key(1000 * lease + i as u64), Digest::of(bytes))).collect();
        (artefacts, results)
    };
    let leases: Vec<_> = (0..10).map(lease).collect();
    timed("leases of 200 results of 100 KB", 10, || {
        for (artefacts, results) in &leases {
            assert_eq!(store.put_results(artefacts, results).unwrap(), []);
        }
    });
    timed("the same again, all there", 10, || {
        for (artefacts, results) in &leases {
            assert_eq!(store.put_results(artefacts, results).unwrap(), []);
        }
    });
    let small: Vec<_> = (0..300u64).map(|lease| (0..200).map(move |i| 1_000_000 + 200 * lease + i)).collect();
    timed("leases of 200 results of 300 bytes", 300, || {
        for lease in small {
            let keys: Vec<_> = lease.collect();
            let artefacts: Vec<_> = keys.iter().map(|i| artefact(*i, 300)).collect();
            let results: Vec<_> = keys.iter().zip(&artefacts).map(|(i, bytes)| (key(*i), Digest::of(bytes))).collect();
            store.put_results(&artefacts, &results).unwrap();
        }
    });
    let keys: Vec<_> = (0..60_000).map(|i| key(1_000_000 + i)).collect();
    let found = timed("lookups of results", 60_000, || store.results(&keys).unwrap());
    assert!(found.iter().all(Option::is_some));
    let absent: Vec<_> = (0..60_000).map(|i| key(9_000_000 + i)).collect();
    let none = timed("lookups of results that are not there", 60_000, || store.results(&absent).unwrap());
    assert!(none.iter().all(Option::is_none));
    timed("reads of 300 bytes", 20_000, || {
        found[..20_000].iter().flatten().for_each(|digest| assert!(store.get(digest).unwrap().is_some()));
    });
    timed("reads of 100 KB", 2000, || {
        leases.iter().flat_map(|(_, results)| results).for_each(|(_, digest)| {
            assert!(store.get(digest).unwrap().is_some());
        });
    });
    let fence = store.take_fence().unwrap();
    let event = |job| [JournalEvent::JobPaused(JobId(job))];
    timed("appends one by one", 200, || (0..200).for_each(|job| store.journal_append(fence, &event(job)).unwrap()));
    timed("appends from 16 threads", 1600, || {
        thread::scope(|scope| {
            for _ in 0..16 {
                scope.spawn(|| (0..100).for_each(|job| store.journal_append(fence, &event(job)).unwrap()));
            }
        });
    });
    println!("{:?}", timed("usage", 1, || store.usage().unwrap()));
    timed("closing", 1, || drop(store));
    let store = timed("opening after a clean end", 1, || Store::open(folder.path(), OpenOptions::default()).unwrap());
    drop(store);
    std::fs::remove_file(folder.path().join("index.clean")).unwrap();
    let store = timed("opening after a crash", 1, || Store::open(folder.path(), OpenOptions::default()).unwrap());
    drop(store);
    std::fs::remove_dir_all(folder.path().join("index")).unwrap();
    let store = timed("opening without an index", 1, || Store::open(folder.path(), OpenOptions::default()).unwrap());
    assert_eq!(store.results(&keys).unwrap(), found);
}
