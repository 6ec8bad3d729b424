//! A program in C that links the runtime: it finds what Rust finds.
#![cfg(unix)]
#![expect(clippy::unwrap_used, reason = "these are tests")]

#[expect(dead_code, reason = "the other tests use the rest")]
#[path = "../runtime/sample.rs"]
mod sample;

use kiln_runtime::{
    MovingObject, Pack, TemporalBlend, ao_linear, ao_quadratic, dither, quantise, tree_ao, write::write,
};
use std::{
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

const CRATE: &str = env!("CARGO_MANIFEST_DIR");

fn run(program: impl AsRef<OsStr>, arguments: &[&str]) -> String {
    let output = Command::new(program.as_ref()).args(arguments).output();
    let output = output.unwrap_or_else(|error| panic!("{} cannot be started: {error}", program.as_ref().display()));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{} {arguments:?}: {errors}", program.as_ref().display());
    String::from_utf8(output.stdout).unwrap()
}

/// The runtime as a library for C. It has a folder of its own, since cargo would else build what depends on it anew.
fn static_library() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c_api");
    let manifest = format!("{CRATE}/Cargo.toml");
    let build = ["rustc", "--quiet", "--lib", "--features", "c-api", "--crate-type", "staticlib", "--locked"];
    let place = ["--manifest-path", &manifest, "--target-dir", folder.to_str().unwrap()];
    run(env!("CARGO"), &[&build[..], &place].concat());
    folder.join("debug/libkiln_runtime.a")
}

fn compile(library: &Path) -> PathBuf {
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c_api_engine");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let source = format!("{CRATE}/tests/c_api/engine.c");
    let include = format!("-I{CRATE}/include");
    let flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", &include, &source, library.to_str().unwrap()];
    run(compiler, &[&flags[..], &["-o", program.to_str().unwrap(), "-lpthread", "-ldl", "-lm"]].concat());
    program
}

/// Numbers as a line of the program's.
fn line(name: &str, values: &[f32]) -> (String, Vec<f32>) {
    (name.to_owned(), values.to_vec())
}

/// What Rust finds, name by name.
fn expected(pack: &Pack<'_>) -> Vec<(String, Vec<f32>)> {
    let (point, normal) = ([5.0, 1.0, 3.5], [0.0, 0.6, 0.8]);
    let mut engine = pack.engine_at(1, point).unwrap();
    let full = pack.full_at(1, point, 1).unwrap();
    let mut object = MovingObject::new();
    let blend = TemporalBlend::default();
    object.update(pack, [1.0; 3], 0.0, blend);
    let moved = object.update(pack, point, 0.05, blend).unwrap();
    let tree = pack.tree_instance(12, None).unwrap();
    let place = [0.5, -1.0, 0.25];
    let trees = [tree.numbers(1).unwrap(), tree.blend()].map(|numbers| tree_ao(0.75, numbers, place));
    let mut lines = vec![
        line("box", &pack.region(1).unwrap().min),
        line("engine", &engine),
        line("full", &full),
        line("ao", &[ao_linear(engine, normal), ao_quadratic(full, normal)]),
        line("moved", &moved),
        line("last", &[1.0, 0.125]),
        line("tree", &trees),
        line("scalar", &[0.9, 0.4, 0.0, 0.0]),
        line("remap", &[pack.meta().remap().apply(0.25)]),
    ];
    engine = blend.blend(engine, *full.first_chunk().unwrap(), 0.1);
    lines.push(line("halfway", &engine));
    lines
}

#[test]
fn an_engine_in_c_finds_what_rust_finds() {
    let bytes = write(&sample::all()).unwrap();
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c_api.kiln");
    fs::write(&path, &bytes).unwrap();
    let output = run(compile(&static_library()), &[path.to_str().unwrap()]);
    let lines: Vec<&str> = output.lines().collect();
    for (name, values) in expected(&Pack::new(&bytes).unwrap()) {
        let found = lines.iter().find_map(|line| line.strip_prefix(&format!("{name} "))).expect(&name);
        let found: Vec<f32> = found.split(' ').map(|number| number.parse().unwrap()).collect();
        let is_near = found.iter().zip(&values).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(is_near && found.len() == values.len(), "{name}: {found:?} in place of {values:?}");
    }
    let dither = dither(17, 4, 2);
    let five_bits = format!("five bits {dither} {} 1", quantise(0.71, dither));
    for wanted in [
        "null 1 1",
        "not open 2",
        "cut off 5",
        "no pack 3",
        "error this is no Kiln pack: it does not begin",
        "no error .",
        "status the pack is not open",
        "open 0",
        "info 2 4 3 300 -2048",
        "records 68 3 1",
        "at 0 1 0",
        "kitchen 0 1",
        "no channel 7",
        "to 1",
        "vertices 0 3 1 24",
        "none 7",
        "block 0 1 2",
        &five_bits,
        "half 0.5",
        "closed 2",
        "version 65536",
    ] {
        assert!(lines.contains(&wanted), "no line {wanted:?} in\n{output}");
    }
}

#[test]
fn the_header_is_good_for_cpp() {
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
    let header = format!("{CRATE}/include/kiln_runtime.h");
    run(compiler, &["-x", "c++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", &header]);
}
