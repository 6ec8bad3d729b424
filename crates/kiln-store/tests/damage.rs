//! Whatever happens to the files of a data folder, it opens, serves what can still be read, and reports the rest as
//! missing.
#![expect(clippy::unwrap_used, reason = "tests panic where something is wrong")]

use kiln_core::{Digest, JobId, TaskKey};
use kiln_store::{Fence, JournalEvent, OpenOptions, Store, SubmittedJob};
use std::{
    fs,
    path::{Path, PathBuf},
};

fn open(folder: &Path) -> Store {
    Store::open(folder, OpenOptions::default()).unwrap()
}

fn bytes(seed: u32, len: u32) -> Vec<u8> {
    (0..len).map(|i| (i.wrapping_mul(2_654_435_761).wrapping_add(seed.wrapping_mul(40_503)) >> 11) as u8).collect()
}

const PACKS: u32 = 4;
const EACH: u32 = 5;

fn artefact(pack: u32, index: u32) -> Vec<u8> {
    bytes(100 * pack + index, 500 + 9000 * (index % 2))
}

fn key(pack: u32, index: u32) -> TaskKey {
    TaskKey(Digest::of(&[pack as u8, index as u8, 7]))
}

fn events() -> Vec<JournalEvent> {
    (1..=6).map(submitted).collect()
}

fn submitted(job: u64) -> JournalEvent {
    JournalEvent::JobSubmitted(SubmittedJob {
        job: JobId(job),
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

/// A folder with a few packs and a journal, well closed.
fn fill(folder: &Path) {
    let store = open(folder);
    for pack in 0..PACKS {
        let artefacts: Vec<_> = (0..EACH).map(|index| artefact(pack, index)).collect();
        let results: Vec<_> = (0..EACH).map(|index| (key(pack, index), Digest::of(&artefact(pack, index)))).collect();
        store.put_results(&artefacts, &results).unwrap();
    }
    let fence = store.take_fence().unwrap();
    events().iter().for_each(|event| store.journal_append(fence, std::slice::from_ref(event)).unwrap());
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Every file below a folder, relative to it.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = PathBuf::from(path.file_name().unwrap());
        if path.is_dir() {
            found.extend(files(&path).into_iter().map(|below| name.join(below)));
        } else {
            found.push(name);
        }
    }
    found.sort();
    found
}

/// What of the artefacts is there: those that are must be right, and their results must be found.
fn served(store: &Store) -> usize {
    let mut count = 0;
    for (pack, index) in (0..PACKS).flat_map(|pack| (0..EACH).map(move |index| (pack, index))) {
        let expected = artefact(pack, index);
        let digest = Digest::of(&expected);
        let found = store.get(&digest).unwrap();
        assert!(found.is_none() || found == Some(expected), "wrong bytes are served");
        let is_missing = store.missing(&[digest]).unwrap() == [digest];
        assert_eq!(found.is_none(), is_missing);
        let result = store.result(key(pack, index)).unwrap();
        assert!(result.is_none() || (result == Some(digest) && found.is_some()));
        count += usize::from(found.is_some() && result.is_some());
    }
    count
}

/// Opens a damaged copy twice, sees what is served, and mends it by storing everything again.
fn survive(folder: &Path, file: &Path, what: &str) {
    let all = (PACKS * EACH) as usize;
    let expected = if file.starts_with("packs") { all - EACH as usize } else { all };
    for opening in 0..2 {
        let store = open(folder);
        let count = served(&store);
        assert!(count >= expected, "{what}, opening {opening}: {count} of {all} artefacts are served");
        let found = store.journal_replay().unwrap();
        assert!(
            found.iter().all(|event| events().contains(event) || matches!(event, JournalEvent::JobForgotten(_))),
            "{what}"
        );
        // A flipped bit costs one event at most; a file that is cut short, those behind the cut.
        let kept = if !file.starts_with("journal") {
            6
        } else if what.contains("flipped") {
            5
        } else {
            0
        };
        assert!(found.iter().filter(|event| events().contains(event)).count() >= kept, "{what}: {found:?}");
    }
    let store = open(folder);
    for pack in 0..PACKS {
        let artefacts: Vec<_> = (0..EACH).map(|index| artefact(pack, index)).collect();
        let results: Vec<_> =
            (0..EACH).map(|index| (key(pack, index), Digest::of(&artefacts[index as usize]))).collect();
        assert_eq!(store.put_results(&artefacts, &results).unwrap(), [], "{what}");
    }
    assert_eq!(served(&store), all, "{what}: what was computed again is kept");
    store.journal_append(Fence(9), &[JournalEvent::JobResumed(JobId(1))]).unwrap();
}

#[test]
fn any_file_may_be_damaged_anywhere() {
    let source = tempfile::tempdir().unwrap();
    fill(source.path());
    let files = files(source.path());
    for kind in ["format", "index.clean", "index/db", "packs/", "journal/"] {
        assert!(files.iter().any(|file| file.starts_with(kind.trim_end_matches('/'))), "{kind} is among {files:?}");
    }
    // One pack stands for all, so that the test stays short.
    let first_pack = files.iter().position(|file| file.starts_with("packs")).unwrap();
    let chosen = files.iter().enumerate().filter(|(i, file)| !file.starts_with("packs") || *i == first_pack);
    for (_, file) in chosen {
        let original = fs::read(source.path().join(file)).unwrap();
        let length = original.len();
        for part in 0..6 {
            let at = length * part / 6 + part * 13 % 7;
            for cut in [false, true] {
                let mut damaged = original.clone();
                if cut {
                    damaged.truncate(at);
                } else if let Some(byte) = damaged.get_mut(at) {
                    *byte ^= 1 << part;
                }
                if damaged == original {
                    continue;
                }
                let folder = tempfile::tempdir().unwrap();
                copy(source.path(), folder.path());
                fs::write(folder.path().join(file), damaged).unwrap();
                let how = if cut { "cut" } else { "flipped" };
                survive(folder.path(), file, &format!("{} {how} at {at} of {length}", file.display()));
            }
        }
    }
}

#[test]
fn any_file_may_be_gone() {
    let source = tempfile::tempdir().unwrap();
    fill(source.path());
    for file in files(source.path()) {
        let folder = tempfile::tempdir().unwrap();
        copy(source.path(), folder.path());
        fs::remove_file(folder.path().join(&file)).unwrap();
        survive(folder.path(), &file, &format!("{} gone", file.display()));
    }
    for gone in ["index", "incoming", "quarantine", "packs"] {
        let folder = tempfile::tempdir().unwrap();
        copy(source.path(), folder.path());
        fs::remove_dir_all(folder.path().join(gone)).unwrap();
        let count = served(&open(folder.path()));
        assert_eq!(count, if gone == "packs" { 0 } else { (PACKS * EACH) as usize }, "{gone}");
    }
}

#[test]
fn damage_while_it_is_open_is_noticed_at_the_next_read() {
    let folder = tempfile::tempdir().unwrap();
    fill(folder.path());
    let store = open(folder.path());
    assert_eq!(served(&store), (PACKS * EACH) as usize);
    for file in files(folder.path()).into_iter().filter(|file| file.starts_with("packs")) {
        let path = folder.path().join(file);
        let mut bytes = fs::read(&path).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 0x80;
        fs::write(&path, bytes).unwrap();
    }
    // The artefact at the end of each pack is hit.
    assert_eq!(served(&store), (PACKS * (EACH - 1)) as usize);
    drop(store);
    let store = open(folder.path());
    assert_eq!(served(&store), (PACKS * (EACH - 1)) as usize);
}

#[test]
fn a_range_of_a_damaged_artefact_is_not_served() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let digest = store.put_one(&bytes(1, 100_000)).unwrap();
    let pack = fs::read_dir(folder.path().join("packs")).unwrap().next().unwrap().unwrap().path();
    let mut damaged = fs::read(&pack).unwrap();
    let last = damaged.len() - 1;
    damaged[last] ^= 1;
    fs::write(&pack, damaged).unwrap();
    assert_eq!(store.read_range(&digest, 0, 10).unwrap(), None, "the flipped bit lies elsewhere, and yet");
    assert_eq!(store.missing(&[digest]).unwrap(), [digest]);
}
