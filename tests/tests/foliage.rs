//! Foliage as a user bakes it: what trees and shrubs get, what it depends on, and what is left out without them.

use kiln_scene::{BakedScene, read_baked};
use kiln_tests::Workplace;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Crates stand for trees and pillars for shrubs; rafters are decorators.
const RULES: &str = "[[class]]\nmatch = 'crate*'\nclass = 'tree'\n[[class]]\nmatch = 'pillar*'\nclass = 'shrub'\n\
                     [[class]]\nmatch = 'rafter*'\nclass = 'decorator'\n";

fn planted() -> Workplace {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    std::fs::write(place.path("level.kiln.toml"), RULES).expect("a folder");
    place
}

fn bake(place: &Workplace, output: &str, more: &[&str]) -> Value {
    let bake = ["bake", "level.glb", "-o", output, "--quality", "low", "--backend", "cpu", "--report", "r.json"];
    place.succeed(&[&bake[..], &["--half-distance", "0.5,10"], more].concat());
    place.json("r.json")
}

fn items(report: &Value, stage: &str) -> u64 {
    let stages = report["stages"].as_array().expect("a list").clone();
    stages.iter().find(|s| s["name"] == stage).map_or(0, |s| s["items"].as_u64().expect("a count"))
}

fn scene(place: &Workplace, name: &str) -> BakedScene {
    read_baked(name, &BTreeMap::from([(name.to_owned(), place.read(name))])).expect("it was just baked")
}

/// The JSON of a .glb.
fn json_of(place: &Workplace, name: &str) -> Value {
    let glb = place.read(name);
    let length = u32::from_le_bytes(glb[12..16].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&glb[20..20 + length]).expect("a .glb begins with JSON")
}

#[test]
fn trees_get_four_numbers_and_shrubs_one() {
    let place = planted();
    let report = bake(&place, "baked.glb", &[]);
    assert!(items(&report, "points") > 0 && items(&report, "volume") == 0);
    // One model; two runs, as pillars and rafters are reached by different things.
    assert_eq!((items(&report, "fit"), items(&report, "read")), (1, 2));
    assert_eq!((&report["foliage"]["scalars"], &report["foliage"]["models"][0]["instances"]), (&json!(15), &json!(6)));
    let errors = &report["foliage"]["models"][0]["errors"];
    for channel in 0..2 {
        let error = |of: &str| errors[channel][of].as_f64().expect("a number");
        assert!(error("alternated") <= error("local_global") + 1e-9, "{errors}");
    }

    let json = json_of(&place, "baked.glb");
    let nodes = json["nodes"].as_array().expect("a list");
    let with = |prefix: &str| {
        let prefix = prefix.to_owned();
        nodes.iter().filter(move |node| node["name"].as_str().is_some_and(|name| name.starts_with(&prefix)))
    };
    let meshes: Vec<&Value> = with("crate").map(|node| &node["mesh"]).collect();
    assert!(meshes.len() == 6 && meshes.iter().all(|mesh| *mesh == meshes[0]), "all trees share one mesh");
    for node in with("crate") {
        let kiln = &node["extras"]["kiln"];
        assert_eq!(
            (kiln["ao_global"].as_array().map(Vec::len), kiln["ao_global_blend"].as_array().map(Vec::len)),
            (Some(2), Some(4))
        );
    }
    for node in with("pillar").chain(with("rafter")) {
        let ao: Vec<f64> = serde_json::from_value(node["extras"]["kiln"]["ao"].clone()).expect("a number each");
        assert!(ao.len() == 2 && ao.iter().all(|ao| (0.0..=1.0).contains(ao)), "{node}");
    }
    for part in scene(&place, "baked.glb").parts {
        let is_even = part.ao.chunks(2).all(|ao| ao == &part.ao[..2]);
        assert_eq!(part.channels, 2, "{}", part.node);
        assert!(
            is_even == (part.node.starts_with("pillar") || part.node.starts_with("rafter"))
                || part.node.starts_with("crate"),
            "{}",
            part.node
        );
    }
}

#[test]
fn the_volume_says_nearly_what_is_traced_on_trees() {
    let place = planted();
    bake(&place, "traced.glb", &[]);
    let report = bake(&place, "volume.glb", &["--trees", "volume"]);
    assert!(items(&report, "volume") > 0 && items(&report, "points") == 0);
    assert!(report["foliage"]["voxels"].as_u64() > Some(0));
    let mean = |name: &str| {
        let crates = scene(&place, name).parts.into_iter().filter(|part| part.node.starts_with("crate"));
        let all: Vec<f64> = crates.flat_map(|part| part.ao).map(f64::from).collect();
        all.iter().sum::<f64>() / all.len() as f64
    };
    let (traced, volume) = (mean("traced.glb"), mean("volume.glb"));
    assert!((traced - volume).abs() < 0.15 && traced != volume, "{traced} {volume}");
}

#[test]
fn instanced_objects_stop_rays_and_share_their_own_ao() {
    let place = planted();
    std::fs::write(place.path("level.kiln.toml"), "").expect("a folder");
    bake(&place, "opaque.glb", &[]);
    std::fs::write(place.path("level.kiln.toml"), "[[class]]\nmatch = 'pillar*'\nclass = 'instanced'\n")
        .expect("a folder");
    let report = bake(&place, "instanced.glb", &[]);
    assert!(items(&report, "points") > 0);
    assert_eq!(report["foliage"]["models"][0]["instances"], 6);
    let json = json_of(&place, "instanced.glb");
    let nodes = json["nodes"].as_array().expect("a list");
    let pillars: Vec<&Value> =
        nodes.iter().filter(|n| n["name"].as_str().is_some_and(|n| n.starts_with("pillar"))).collect();
    assert!(pillars.len() == 6 && pillars.iter().all(|node| node["mesh"] == pillars[0]["mesh"]));
    let (opaque, instanced) = (scene(&place, "opaque.glb"), scene(&place, "instanced.glb"));
    let (mut sum, mut count) = (0.0, 0.0);
    for (a, b) in opaque.parts.iter().zip(&instanced.parts) {
        if a.node.starts_with("pillar") {
            sum += a.ao.iter().zip(&b.ao).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            count += a.ao.len() as f64;
        } else {
            assert_eq!(a.ao, b.ao, "{}: an instanced object stops rays as an opaque one does", a.node);
        }
    }
    assert!((sum / count).sqrt() < 0.15, "{}", (sum / count).sqrt());
}

#[test]
fn shrubs_without_ground_are_told_of() {
    let place = planted();
    let warnings = |report: &Value| {
        let all = report["warnings"].as_array().expect("a list").clone();
        all.into_iter().filter(|warning| warning["code"] == "open_scalars").collect::<Vec<_>>()
    };
    assert_eq!(warnings(&bake(&place, "all.glb", &[])), [Value::Null; 0]);
    let alone = bake(&place, "alone.glb", &["--only", "rafter*"]);
    assert_eq!((&alone["foliage"]["scalars"], &alone["foliage"]["open_scalars"]), (&json!(9), &json!(9)));
    assert_eq!(warnings(&alone)[0]["count"], 9);
}

#[test]
fn foliage_is_baked_once_and_alike_everywhere() {
    let place = planted();
    bake(&place, "first.glb", &["--threads", "1"]);
    let again = bake(&place, "again.glb", &[]);
    assert_eq!(again["rays"]["traced"], 0);
    let other = bake(&place, "other.glb", &["--threads", "2", "--data-dir", "other"]);
    assert!(other["rays"]["traced"].as_u64() > Some(0));
    assert_eq!(place.read("first.glb"), place.read("again.glb"));
    assert!(place.read("first.glb") == place.read("other.glb"), "the number of threads changes the result");
}

#[test]
fn what_foliage_is_can_be_chosen() {
    let place = planted();
    let mean = |name: &str, mode: &str| {
        let report = bake(&place, name, &["--foliage", mode]);
        let floor = scene(&place, name).parts.into_iter().find(|part| part.node == "floor").expect("a floor");
        (report, floor.ao.iter().step_by(2).map(|ao| f64::from(*ao)).sum::<f64>() / (floor.ao.len() / 2) as f64)
    };
    let (_, expected) = mean("expected.glb", "expected");
    let (_, attenuated) = mean("attenuated.glb", "attenuate");
    let (solid, geometry) = mean("geometry.glb", "geometry");
    // What is far darkens where it is only multiplied.
    assert!(attenuated < expected, "{attenuated} {expected}");
    assert!((expected - geometry).abs() < 0.1 && expected != geometry, "{expected} {geometry}");
    let of_foliage = |report: &Value| ["volume", "points", "fit", "read"].map(|stage| items(report, stage));
    assert_eq!(of_foliage(&solid), [0; 4]);
    // Without foliage there are no such tasks either.
    std::fs::write(place.path("level.kiln.toml"), "").expect("a folder");
    let none = bake(&place, "none.glb", &[]);
    assert_eq!(of_foliage(&none), [0; 4]);
}

/// On the software driver, in both modes. Fits and numbers that come of it are compared as a
/// game would show them.
#[test]
fn a_bake_on_a_card_is_that_of_the_processor() {
    let place = planted();
    for (mode, trees) in [("expected", "traced"), ("attenuate", "volume")] {
        bake(&place, "cpu.glb", &["--foliage", mode, "--trees", trees]);
        let own =
            ["bake", "level.glb", "-o", "gpu.glb", "--quality", "low", "--backend", "gpu", "--report", "gpu.json"];
        let settings = ["--half-distance", "0.5,10", "--trees", trees];
        let arguments = [&own[..], &settings, &["--foliage", mode]].concat();
        let output = place.command(&arguments).env("KILN_GPU", "software").output().expect("it starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && !said.contains("traced on the processor"), "{said}");
        let report = place.json("gpu.json");
        let traced_in = report["backend"]["traced_in"].as_array().expect("the report names lanes").clone();
        assert!(
            traced_in.len() == 1 && traced_in[0].as_str().is_some_and(|lane| lane.starts_with("gpu:")),
            "{traced_in:?}"
        );
        assert!(items(&report, "volume") + items(&report, "points") > 0);
        assert!(items(&report, "fit") == 1 && items(&report, "read") == 2);
        // What differs is what rounding decides: single rays of single samples.
        place.succeed(&["compare", "cpu.glb", "gpu.glb", "--fail-above", "0.002"]);
        let [cpu, gpu] = ["cpu.glb", "gpu.glb"].map(|name| scene(&place, name).parts);
        let differences = cpu.iter().zip(&gpu).flat_map(|(cpu, gpu)| cpu.ao.iter().zip(&gpu.ao));
        let greatest = differences.map(|(cpu, gpu)| (cpu - gpu).abs()).fold(0.0, f32::max);
        assert!(greatest < 0.05, "{mode}: {greatest}");
    }
}
