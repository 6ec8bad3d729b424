//! Parsing, and tables of reports that are given.

use super::{
    Args, LevelReport,
    kiln::{Bake, Place, Variant},
    plot,
    reference::Reference,
    report::Report,
    rocks, scaling,
    stages::{Kind, rows},
    table,
    targets::Figures,
};
use clap::Parser;
use serde_json::json;
use std::path::Path;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: Args,
}

fn report(seconds: f64, faces: u64) -> Report {
    let time = |seconds: f64, cpu: f64| json!({ "seconds": seconds, "cpu_seconds": cpu });
    let stage = |name: &str, seconds: f64, cpu: f64, parts: serde_json::Value| json!({ "name": name, "seconds": seconds, "cpu_seconds": cpu, "items": 1, "parts": parts });
    let value = json!({
        "level": { "instances": 3, "vertices": 1_500_000, "faces": faces }, "samples": { "total": 7_000_000 },
        "rays": { "traced": 100_000_000 }, "seconds": seconds, "cpu_seconds": 2.0 * seconds - 1.0,
        "peak_memory_bytes": 1u64 << 30, "error_estimate": { "rmse": [0.004, 0.0055] },
        "solve": [{ "unknowns": 1000 }, { "unknowns": 500 }], "meshes": [{ "visible_area_m2": 200.0 }],
        "stages": [
            stage("import", 2.0, 3.0, json!({})),
            stage("plan", 1.0, 1.5, json!({ "loading": time(0.5, 0.75) })),
            stage("trace", 40.0, 88.0, json!({ "building": time(2.0, 4.0), "tracing": time(80.0, 80.0) })),
            stage("solve", 39.0, 5.0, json!({ "loading": time(0.1, 0.25) })),
            stage("export", 1.0, 1.0, json!({})),
        ],
    });
    serde_json::from_value(value).unwrap()
}

fn bake(place: Place, threads: usize, wall_secs: f64) -> Bake {
    let variant = Variant { place, threads };
    Bake { variant, wall_secs, peak_bytes: Some(1 << 30), output: "aa".to_owned(), report: report(50.0, 1_800_000) }
}

fn level(name: &str, bakes: Vec<Bake>) -> LevelReport {
    LevelReport { name: name.to_owned(), made_of: None, bakes, reference: None }
}

#[test]
fn lines_are_parsed() {
    let parse = |line: &[&str]| Line::try_parse_from([&["bake"], line].concat()).map(|line| line.args);
    let args = parse(&["a.glb", "--thread-counts", "2,1,2", "--farm"]).unwrap();
    let names: Vec<String> = args.variants().into_iter().map(Variant::name).collect();
    assert_eq!(names, ["one process, 1 thread", "one process, 2 threads", "coordinator and worker, 2 threads"]);
    assert_eq!(parse(&["a.glb"]).unwrap().variants().len(), 1);
    assert!(parse(&["--instances", "1,10"]).is_ok());
    for bad in [&[][..], &["a.glb", "--thread-counts", "0"], &["a.glb", "--reps", "0"], &["a.glb", "--quality", "best"]]
    {
        assert!(parse(bad).is_err(), "{bad:?}");
    }
}

#[test]
fn rows_add_up_to_the_process() {
    let rows = rows(&report(50.0, 1_800_000));
    let cpu = |kind| rows.iter().find(|row| row.kind == kind).and_then(|row| row.cpu_secs).unwrap();
    assert_eq!([Kind::Import, Kind::Plan, Kind::Load, Kind::Build].map(cpu), [3.0, 0.75, 1.0, 4.0]);
    assert_eq!([Kind::Trace, Kind::Samples, Kind::Solve, Kind::Export].map(cpu), [80.0, 4.0, 4.75, 1.0]);
    assert_eq!((cpu(Kind::Other), cpu(Kind::Total)), (0.5, 99.0));
    let parts: f64 = rows.iter().filter(|row| row.kind != Kind::Total).filter_map(|row| row.cpu_secs).sum();
    assert!((parts - 99.0).abs() < 1e-9, "{parts}");
}

#[test]
fn figures_are_parts_of_the_threads_time() {
    let figures = Figures::of(&bake(Place::Process, 2, 51.0));
    assert!((figures.busy - 0.99).abs() < 1e-9);
    assert!((figures.rest - (1.0 - 0.8475)).abs() < 1e-9, "{}", figures.rest);
    assert!((figures.handling - 0.0625).abs() < 1e-9, "{}", figures.handling);
    assert!((figures.mrays_per_cpu_second - 1.25).abs() < 1e-9);
    assert_eq!((figures.memory_gib, figures.rmse), (Some(1.0), 0.0055));
}

#[test]
fn tables_say_what_was_found() {
    let bakes = [1.0, 1.1].iter().flat_map(|slow| {
        [bake(Place::Process, 1, 98.0 * slow), bake(Place::Process, 2, 49.0), bake(Place::Farm, 2, 49.0 * slow)]
    });
    let mut report = level("a", bakes.collect());
    report.bakes[2].output = "bb".to_owned();
    report.reference = Some(Reference {
        glob: "rock*".to_owned(),
        rmse: vec![0.0051],
        estimated_rmse: vec![0.0049],
        faces: 18_000,
        level_faces: 1_800_000,
        visible_area_m2: 10.0,
        wall_secs: 600.0,
    });
    let text = table::level(&report);
    for expected in [
        "| BVH build, trees and shrubs too | 2.00 | 4.00 | 4.0 % | 10.5, < 1 |",
        "| Process geometry, 1.50 M V, 1.80 M F | 2.00 | 3.00 | 3.0 % | 2 |",
        "| Total | 50.00 | 99.00 | 100.0 % | 78 |",
        "Ray trace regions for dynamic AO, 0 points |  | 0.00 | 0.0 % | 9.2 for 332.7 k |",
        "- 50.0 s; under 78 s holds",
        "at most 10 % holds (with import, building, export and idling",
        "- threads busy 99.0 %; at least 90 % holds",
        "| one process, 2 threads | 49.00 (49.00–49.00) | 1024 (1024–1024) | 2.100 (2.000–2.200) |  | yes |",
        "| 1.050 (1.000–1.100) | NO |",
        "18.0 k faces, 1.00 % of the level's; 5.00 % of its area",
        "| 1 | 0.0051 | 0.0049 | 0.0040 |",
    ] {
        assert!(text.contains(expected), "{expected} in\n{text}");
    }
}

#[test]
fn cost_is_shown_against_size() {
    let mut small = level("small", vec![bake(Place::Process, 2, 10.0)]);
    small.bakes[0].report = report(10.0, 50_000);
    let made = LevelReport { made_of: Some(3), ..level("rocks_3", vec![bake(Place::Process, 2, 10.0)]) };
    assert_eq!(scaling::table(std::slice::from_ref(&small)), "");
    let levels = [small, level("large", vec![bake(Place::Process, 2, 49.0)]), made];
    let table = scaling::table(&levels);
    assert!(table.contains("| small | 50000 | 3 | 10.00 | 380.0 | 190 | 800 |"), "{table}");
    let svg = plot::draw(&levels, "a < b");
    assert_eq!((svg.matches("<polyline").count(), svg.matches("<circle").count()), (8, 12));
    assert!(svg.contains("a &lt; b") && !svg.contains("NaN") && svg.ends_with("</svg>\n"), "{svg}");
}

#[test]
fn rocks_are_a_level() {
    let bytes = rocks::level(5).unwrap();
    let folder = crate::scratch::Scratch::new("rocks-test").unwrap();
    let path = folder.path().join("rocks.glb");
    std::fs::write(&path, bytes).unwrap();
    let level = crate::imported::import(Path::new(&path)).unwrap().level;
    assert_eq!((level.instances.len(), level.meshes.len()), (6, 2));
    assert_eq!(level.counts.unique_faces, 440 + 2 * 64 * 64);
    assert_eq!(level.counts.faces, 5 * 440 + 2 * 64 * 64);
}
