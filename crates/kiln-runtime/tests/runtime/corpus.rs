//! The fuzzer's seeds, which are kept in the repository: they are what the writer writes today, so that a change of the
//! format is seen.

use crate::{exercise::exercise, sample, versions};
use kiln_runtime::write::{PackData, write};
use std::{fs, path::PathBuf};

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/pack")
}

/// The seeds by their names.
pub(crate) fn made() -> Vec<(&'static str, Vec<u8>)> {
    let everything = write(&sample::all()).expect("it can be written");
    let mut regions = PackData::new(sample::meta(1));
    regions.regions = sample::house();
    regions.regions.models.iter_mut().for_each(|model| model.coefficients.truncate(9));
    let mut engine = PackData::new(sample::meta(2));
    engine.regions = sample::house();
    engine.regions.forms.full = false;
    vec![
        ("empty.kiln", write(&PackData::new(sample::meta(4))).expect("it can be written")),
        ("regions.kiln", write(&regions).expect("it can be written")),
        ("engine.kiln", write(&engine).expect("it can be written")),
        ("newer.kiln", versions::newer(&everything)),
        ("everything.kiln", everything),
    ]
}

/// `KILN_WRITE_CORPUS=1 cargo test -p kiln-runtime corpus` writes them.
#[test]
fn the_corpus_is_what_is_written_today() {
    for (name, bytes) in made() {
        let path = folder().join(name);
        if std::env::var("KILN_WRITE_CORPUS").is_ok_and(|value| value == "1") {
            fs::write(&path, &bytes).expect("it can be stored");
        }
        let kept = fs::read(&path).expect("the seed is in the repository");
        assert!(kept == bytes, "{name} is not what the writer writes: see the test's own comment if that is meant");
        exercise(&kept).expect(name);
    }
}
