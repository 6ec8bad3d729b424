//! The rules that leave out work, as a user turns them off: what `--no-skip` changes, and what the report says. Rules that
//! act within a piece are held against each other in kiln-bake, and levels that are loaded in part in kiln-worker.

use kiln_scene::read_baked;
use kiln_tests::Workplace;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Rays end after 1 m.
const SHORT: [&str; 2] = ["--half-distance", "0.05,0.1"];

/// Bakes `level.glb` at low quality; gives the report.
fn bake(place: &Workplace, output: &str, more: &[&str]) -> Value {
    let bake = ["bake", "level.glb", "-o", output, "--quality", "low", "--backend", "cpu", "--report", "r.json"];
    place.succeed(&[&bake[..], more].concat());
    place.json("r.json")
}

fn example(name: &str) -> Workplace {
    let place = Workplace::new();
    place.succeed(&["example", name, "-o", "level.glb"]);
    place
}

/// All values, by mesh.
fn values(place: &Workplace, name: &str) -> Vec<Vec<f32>> {
    let scene = read_baked(name, &BTreeMap::from([(name.to_owned(), place.read(name))])).expect("it was just baked");
    scene.parts.into_iter().map(|part| part.ao).collect()
}

fn count(report: &Value, section: &str, name: &str) -> u64 {
    report["rays"][section][name].as_u64().unwrap_or_else(|| panic!("{section}.{name} is no count: {report}"))
}

fn saved(report: &Value, rule: &str) -> u64 {
    count(report, "saved_by", rule)
}

/// BVHs of meshes that were read and that were built, of those that are large enough to be kept.
fn bvhs(report: &Value) -> [u64; 2] {
    ["read", "built"].map(|name| report["cache"]["bvhs"][name].as_u64().expect("a count of BVHs"))
}

fn traced(report: &Value) -> u64 {
    report["rays"]["traced"].as_u64().expect("a count of rays")
}

/// Two bakes differ by about the root of the sum of the squares of their errors; estimates are uncertain themselves.
fn assert_within_error(place: &Workplace, on: &Value, off: &Value) {
    let difference = place.succeed(&["compare", "on.glb", "off.glb", "--json"]);
    let difference: Value = serde_json::from_str(&difference).expect("--json prints JSON");
    for channel in 0..2 {
        let found = difference["visible"]["total"][channel]["rmse"].as_f64().expect("a number");
        let error = |report: &Value| report["error_estimate"]["rmse"][channel].as_f64().expect("a number");
        assert!(found <= 2.0 * error(on).hypot(error(off)), "{found} {} {}", error(on), error(off));
    }
}

/// Moves a vertex of a mesh by a centimetre, in the file.
fn edit(glb: &mut [u8], mesh: usize) {
    let length = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| glb[at + i])) as usize;
    let json = length(12);
    let document: Value = serde_json::from_slice(&glb[20..20 + json]).expect("an example's JSON");
    let index = |value: &Value| value.as_u64().expect("an index or an offset") as usize;
    let accessor = &document["accessors"][index(&document["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"])];
    let view = &document["bufferViews"][index(&accessor["bufferView"])];
    let at = 28
        + json
        + view["byteOffset"].as_u64().unwrap_or(0) as usize
        + accessor["byteOffset"].as_u64().unwrap_or(0) as usize;
    let moved = f32::from_le_bytes(std::array::from_fn(|i| glb[at + i])) + 0.01;
    glb[at..at + 4].copy_from_slice(&moved.to_le_bytes());
}

#[test]
fn an_edit_redoes_what_it_can_reach_and_the_result_is_that_of_a_bake_from_nothing() {
    let place = example("courtyard");
    let first = bake(&place, "first.glb", &SHORT);
    assert_eq!(saved(&first, "unchanged_work"), 0);
    let [0, large] = bvhs(&first) else { panic!("{first}") };
    assert!(large > 3);

    let mut level = place.read("level.glb");
    edit(&mut level, 0);
    std::fs::write(place.path("level.glb"), level).expect("the folder can be written");
    let edited = bake(&place, "edited.glb", &SHORT);
    let kept = saved(&edited, "unchanged_work");
    assert!(kept > 0 && traced(&edited) > 0 && edited["cache"]["by_stage"]["trace"]["hits"].as_u64() > Some(0));
    assert_eq!(bvhs(&edited), [large - 1, 1], "the edited mesh alone is built again");

    let anew = bake(&place, "anew.glb", &[&SHORT[..], &["--data-dir", "other"]].concat());
    assert_eq!((traced(&anew), saved(&anew, "unchanged_work")), (traced(&edited) + kept, 0));
    assert_eq!(place.read("edited.glb"), place.read("anew.glb"));
    assert_ne!(place.read("edited.glb"), place.read("first.glb"));

    // With the rule off the same is done again, and the same comes out.
    let again = bake(&place, "again.glb", &[&SHORT[..], &["--no-skip", "unchanged"]].concat());
    assert_eq!((&again["cache"]["hits"], traced(&again)), (&json!(0), traced(&anew)));
    assert_eq!(values(&place, "again.glb"), values(&place, "anew.glb"));
}

#[test]
fn a_moved_node_builds_no_bvh_again() {
    let place = example("courtyard");
    let [0, large] = bvhs(&bake(&place, "first.glb", &SHORT)) else { panic!("there was nothing to read") };
    let mut level = place.read("level.glb");
    let (old, new) = (b"[5.0,0.0,-0.25]", b"[5.5,0.0,-0.25]");
    let at = level.windows(old.len()).position(|bytes| bytes == old).expect("the second arch stands there");
    level[at..at + new.len()].copy_from_slice(new);
    std::fs::write(place.path("level.glb"), level).expect("the folder can be written");
    let moved = bake(&place, "moved.glb", &SHORT);
    assert!(traced(&moved) > 0);
    assert_eq!(bvhs(&moved), [large, 0]);
    // Trees that were read give what trees that were built give.
    let anew = bake(&place, "anew.glb", &[&SHORT[..], &["--data-dir", "other"]].concat());
    assert_eq!(bvhs(&anew), [0, large]);
    assert_eq!(place.read("moved.glb"), place.read("anew.glb"));
}

#[test]
fn what_no_ray_comes_to_is_left_out() {
    let place = example("courtyard");
    let only = [&SHORT[..], &["--only", "crate*"]].concat();
    let on = bake(&place, "on.glb", &only);
    let left_out = |report: &Value, what: &str| report["left_out"][what].as_u64().expect("a count");
    assert!(left_out(&on, "instances_out_of_reach") > 0 && left_out(&on, "faces_out_of_reach") > 0, "{on}");
    assert!(count(&on, "cut_by", "reach") > 0);

    // A back face beyond the reach is not seen, so that what lies deep in a solid may be valid; here everything is.
    let fixed = [&only[..], &["--fixed-samples", "--back-face-limit", "1"]].concat();
    let off = bake(&place, "off.glb", &[&fixed[..], &["--no-skip", "reach"]].concat());
    assert_eq!((left_out(&off, "instances_out_of_reach"), count(&off, "cut_by", "reach")), (0, 0));
    bake(&place, "on.glb", &fixed);
    // Each sample's value differs by at most 1/1024, and least squares may add to that.
    let pairs = values(&place, "on.glb").concat().into_iter().zip(values(&place, "off.glb").concat());
    let most = pairs.map(|(on, off)| (on - off).abs()).fold(0.0, f32::max);
    assert!(most > 0.0 && most < 4.0 / 1024.0, "{most}");
}

#[test]
fn empty_hemispheres_change_no_bit_of_the_values() {
    let place = example("crates");
    let on = bake(&place, "on.glb", &SHORT);
    let off = bake(&place, "off.glb", &[&SHORT[..], &["--no-skip", "empty"]].concat());
    let spared = saved(&on, "empty_hemisphere");
    assert!(spared > 0 && traced(&off) == traced(&on) + spared, "{} {} {spared}", traced(&on), traced(&off));
    assert_eq!(saved(&off, "empty_hemisphere"), 0);
    assert_eq!(values(&place, "on.glb"), values(&place, "off.glb"));
}

#[test]
fn repeated_faces_change_no_more_than_the_error() {
    let place = example("coincident");
    let on = bake(&place, "on.glb", &["--fixed-samples"]);
    let off = bake(&place, "off.glb", &["--fixed-samples", "--no-skip", "duplicates"]);
    let spared = saved(&on, "duplicate_faces");
    assert!(spared > 0 && saved(&off, "duplicate_faces") == 0);
    assert!(traced(&off) > traced(&on), "{} {}", traced(&off), traced(&on));
    let faces = |report: &Value| report["level"]["faces"].as_u64();
    assert!(faces(&off) > faces(&on));
    assert_within_error(&place, &on, &off);
}

#[test]
fn with_every_rule_off_nothing_is_saved() {
    let place = example("crates");
    let on = bake(&place, "on.glb", &[]);
    let off = bake(&place, "off.glb", &["--no-skip", "all"]);
    let counts = off["rays"]["saved_by"].as_object().expect("counts by rule");
    assert!(counts.len() == 5 && counts.values().all(|count| count == 0), "{counts:?}");
    let rules = ["reach", "empty", "buried", "duplicates", "adaptive", "unchanged"];
    assert_eq!(off["settings"]["requested"]["no_skip"], json!(rules));
    // Names are those of the report too.
    let named = bake(&place, "named.glb", &["--no-skip", "empty_hemisphere,buried_faces"]);
    assert_eq!(named["settings"]["requested"]["no_skip"], json!(["empty", "buried"]));
    assert_within_error(&place, &on, &off);
}

#[test]
fn rules_that_do_not_exist_are_named_with_those_that_do() {
    let place = Workplace::new();
    let bake = ["bake", "level.glb", "-o", "x.glb", "--no-skip"];
    let said = place.fail(2, &[&bake[..], &["reech"]].concat());
    assert!(
        ["reech", "reach", "empty", "buried", "duplicates", "adaptive", "unchanged", "all"]
            .iter()
            .all(|n| said.contains(n)),
        "{said}"
    );
    let said = place.fail(2, &[&bake[..], &["all", "--target-rmse", "0.01"]].concat());
    assert!(said.contains("--target-rmse"), "{said}");
}

#[test]
fn what_a_level_lacks_is_no_work() {
    // Nothing in the level receives: there is nothing to trace and nothing to solve.
    let place = example("crates");
    let all = bake(&place, "all.glb", &[]);
    assert_eq!(
        all["left_out"]["absent_classes"],
        json!(["distant", "ignored", "tree", "shrub", "decorator", "instanced"])
    );
    std::fs::write(place.path("level.kiln.toml"), "[[class]]\nmatch = \"*\"\nclass = \"opaque\"\nreceives = false\n")
        .expect("a folder");
    let none = bake(&place, "none.glb", &[]);
    let items = |report: &Value, stage: &str| {
        let stages = report["stages"].as_array().expect("a list").clone();
        stages.iter().find(|s| s["name"] == stage).map_or(0, |s| s["items"].as_u64().expect("a count"))
    };
    assert!(items(&all, "trace") > 0 && items(&all, "solve") > 0);
    assert_eq!((items(&none, "trace"), items(&none, "solve"), traced(&none)), (0, 0, 0));
}
