//! Levels of detail as a user bakes them.

use kiln_scene::{BakedScene, read_baked};
use kiln_tests::Workplace;
use serde_json::Value;
use std::collections::BTreeMap;

fn bake(place: &Workplace, level: &str, output: &str, more: &[&str]) -> Value {
    let bake = ["bake", level, "-o", output, "--quality", "low", "--backend", "cpu", "--report", "r.json"];
    place.succeed(&[&bake[..], &["--half-distance", "0.5,10"], more].concat());
    place.json("r.json")
}

fn scene(place: &Workplace, name: &str) -> BakedScene {
    read_baked(name, &BTreeMap::from([(name.to_owned(), place.read(name))])).expect("it was just baked")
}

fn items(report: &Value, stage: &str) -> u64 {
    let stages = report["stages"].as_array().expect("a list").clone();
    stages.iter().find(|s| s["name"] == stage).map_or(0, |s| s["items"].as_u64().expect("a count"))
}

#[test]
fn levels_of_detail_get_values_and_change_no_others() {
    let place = Workplace::new();
    place.succeed(&["example", "lods", "-o", "lods.glb"]);
    place.succeed(&["example", "courtyard", "-o", "courtyard.glb"]);
    let with = bake(&place, "lods.glb", "with.glb", &["--threads", "1"]);
    let without = bake(&place, "courtyard.glb", "without.glb", &[]);
    assert!(items(&with, "resample") > 0 && items(&without, "resample") == 0);
    let lods = &with["lods"];
    let count = |what: &str| lods[what].as_u64().expect("a count");
    assert!(count("instances") > 100 && count("invalid") * 100 < count("samples"), "{lods}");
    // Nodes of the one file are written with matrices: positions are off by roundings.
    for channel in 0..2 {
        let rmse = |report: &Value| report["error_estimate"]["rmse"][channel].as_f64().expect("an estimate");
        assert!((rmse(&with) - rmse(&without)).abs() < 1e-5 * rmse(&without));
    }
    let (with, without) = (scene(&place, "with.glb"), scene(&place, "without.glb"));
    assert_eq!(with.lods.len() as u64, count("instances"));
    let values: BTreeMap<&str, &Vec<f32>> = without.parts.iter().map(|part| (part.node.as_str(), &part.ao)).collect();
    assert_eq!(with.parts.len(), without.parts.len());
    for part in &with.parts {
        assert_eq!(part.ao.len(), values[part.node.as_str()].len(), "{}", part.node);
    }
    // A level of detail is about as dark as what it is drawn in place of.
    let mean = |ao: &[f32]| ao.iter().map(|ao| f64::from(*ao)).sum::<f64>() / ao.len() as f64;
    for lod in with.lods.iter().filter(|lod| lod.part.node.ends_with("_lod1")) {
        let full = &with.parts[lod.lod_of[0]];
        let (lower, full) = (mean(&lod.part.ao), mean(&full.ao));
        assert!(lod.part.channels == 2 && (lower - full).abs() < 0.2, "{}: {lower} {full}", lod.part.node);
    }
    let again = bake(&place, "lods.glb", "again.glb", &["--threads", "2", "--data-dir", "other"]);
    assert!(again["rays"]["traced"].as_u64() > Some(0));
    assert!(place.read("with.glb") == place.read("again.glb"), "the number of threads changes the result");
}

#[test]
fn least_squares_are_nearer_than_reading_at_the_vertices() {
    let place = Workplace::new();
    place.succeed(&["example", "lods", "-o", "lods.glb"]);
    let printed = place.succeed(&["bench", "lods", "lods.glb"]);
    let row = printed.lines().find(|line| line.starts_with("| lods ")).expect("a row for the level").to_owned();
    let cells: Vec<&str> = row.split('|').map(str::trim).collect();
    let (pairs, ratio): (u32, f64) = (cells[2].parse().expect("a count"), cells[6].parse().expect("a ratio"));
    assert!(pairs > 100 && ratio < 0.8, "{row}");
    assert_eq!(cells[7], format!("{pairs} of {pairs}"), "{row}");
}

/// Of instanced objects, as of trees: nothing is traced for their levels of detail, which have what the full objects have.
#[test]
fn levels_of_instanced_objects_have_what_the_full_ones_have() {
    let place = Workplace::new();
    place.succeed(&["example", "lods", "-o", "lods.glb"]);
    let sidecar = "[[class]]\nmatch = \"pillar*\"\nclass = \"instanced\"\n";
    std::fs::write(place.path("lods.kiln.toml"), sidecar).expect("a file can be written");
    let report = bake(&place, "lods.glb", "out.glb", &[]);
    let foliage = &report["foliage"];
    let (models, lods) = (foliage["models"].as_array().expect("a list").len() as u64, foliage["lod_models"].as_u64());
    assert!(models > 0 && lods >= Some(models) && items(&report, "fit") == models + lods.unwrap_or(0), "{foliage}");
    let scene = scene(&place, "out.glb");
    let mean = |ao: &[f32], channel: usize| {
        ao.iter().skip(channel).step_by(2).map(|ao| f64::from(*ao)).sum::<f64>() / (ao.len() / 2) as f64
    };
    let pillars: Vec<_> = scene.lods.iter().filter(|lod| lod.part.node.starts_with("pillar")).collect();
    assert!(pillars.len() > 4);
    for lod in pillars {
        let full = &scene.parts[lod.lod_of[0]];
        for channel in 0..2 {
            let (lower, full) = (mean(&lod.part.ao, channel), mean(&full.ao, channel));
            assert!((lower - full).abs() < 0.1, "{}: {lower} {full}", lod.part.node);
        }
    }
}
