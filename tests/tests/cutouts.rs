//! Alpha-tested materials as a user bakes them: holes are holes.

use kiln_scene::{BakedScene, read_baked};
use kiln_tests::Workplace;
use serde_json::{Value, json};
use std::collections::BTreeMap;

fn bake(place: &Workplace, level: &str, output: &str, more: &[&str]) -> Value {
    let bake = ["bake", level, "-o", output, "--quality", "low", "--backend", "cpu", "--report", "r.json"];
    place.succeed(&[&bake[..], &["--half-distance", "0.5,10", "--fixed-samples"], more].concat());
    place.json("r.json")
}

/// The floor's values of both half-distances, in turn.
fn floor(place: &Workplace, name: &str) -> Vec<f32> {
    let scene: BakedScene =
        read_baked(name, &BTreeMap::from([(name.to_owned(), place.read(name))])).expect("it was just baked");
    scene.parts.into_iter().find(|part| part.node == "floor").expect("a floor").ao
}

fn rms_difference(one: &[f32], other: &[f32]) -> f64 {
    assert_eq!(one.len(), other.len());
    let squares = one.iter().zip(other).map(|(a, b)| f64::from(a - b).powi(2));
    (squares.sum::<f64>() / one.len() as f64).sqrt()
}

/// A file with the same bytes but for a text of the same length.
fn with_text(place: &Workplace, from: &str, to: &str, old: &str, new: &str) {
    let (mut bytes, old, new) = (place.read(from), old.as_bytes(), new.as_bytes());
    assert_eq!(old.len(), new.len());
    let at = bytes.windows(old.len()).position(|window| window == old).expect("the text is there");
    bytes[at..at + old.len()].copy_from_slice(new);
    std::fs::write(place.path(to), bytes).expect("a folder");
}

#[test]
fn a_texture_with_holes_is_as_geometry_with_holes() {
    let place = Workplace::new();
    place.succeed(&["example", "cutout", "-o", "cutout.glb"]);
    place.succeed(&["example", "cutout_geometry", "-o", "geometry.glb"]);
    // A property that nobody knows leaves the material opaque.
    with_text(&place, "cutout.glb", "whole.glb", "\"alphaMode\"", "\"alphaMake\"");
    let checked: Value = serde_json::from_str(&place.succeed(&["check", "cutout.glb", "--json"])).expect("JSON");
    assert_eq!(checked["masks"], json!({ "faces": 2, "sizes": [[16, 16]] }));

    for mode in ["expected", "attenuate", "geometry"] {
        let mut floors = BTreeMap::new();
        for name in ["cutout", "geometry", "whole"] {
            let output = format!("{name}_{mode}.glb");
            let report = bake(&place, &format!("{name}.glb"), &output, &["--only", "floor", "--foliage", mode]);
            assert_eq!(report["warnings"], json!([]), "{name}");
            floors.insert(name, floor(&place, &output));
        }
        // The floor has the same samples in all three: but for rays at the edges of texels, these are the same.
        let same = rms_difference(&floors["cutout"], &floors["geometry"]);
        let other = rms_difference(&floors["cutout"], &floors["whole"]);
        assert!(same < 1e-3 && other > 0.05, "{mode}: {same} {other}");
    }
}

#[test]
fn plates_themselves_get_values_and_bakes_repeat() {
    let place = Workplace::new();
    place.succeed(&["example", "cutout", "-o", "cutout.glb"]);
    let first = bake(&place, "cutout.glb", "first.glb", &["--threads", "1"]);
    let other = bake(&place, "cutout.glb", "other.glb", &["--threads", "2", "--data-dir", "other"]);
    assert!(first["rays"]["traced"].as_u64() > Some(0) && other["rays"]["traced"] == first["rays"]["traced"]);
    assert!(place.read("first.glb") == place.read("other.glb"), "the number of threads changes the result");
    let again = bake(&place, "cutout.glb", "again.glb", &[]);
    assert_eq!(again["rays"]["traced"], 0);
    // Another cutoff that leaves the mask as it is leaves the meshes as they are, too: nothing is traced again.
    let (old, new) = ("\"name\":\"lattice\",\"alphaMode\"", "\"alphaCutoff\": 1,\"alphaMode\"");
    with_text(&place, "cutout.glb", "cutoff.glb", old, new);
    assert_eq!(bake(&place, "cutoff.glb", "cutoff_baked.glb", &[])["rays"]["traced"], 0);
}

#[test]
fn an_image_beside_the_level_is_looked_at_and_a_missing_one_is_told_of() {
    let place = Workplace::new();
    place.succeed(&["example", "cutout", "-o", "embedded.glb"]);
    let glb = place.read("embedded.glb");
    let length = u32::from_le_bytes(glb[12..16].try_into().expect("four bytes")) as usize;
    let mut json: Value = serde_json::from_slice(&glb[20..20 + length]).expect("a .glb begins with JSON");
    let bin = &glb[28 + length..];
    let view = json["images"][0]["bufferView"].as_u64().expect("an index") as usize;
    let number = |key: &str| json["bufferViews"][view][key].as_u64().expect("a number") as usize;
    let png = bin[number("byteOffset")..][..number("byteLength")].to_vec();
    json["images"][0] = json!({ "uri": "textures/lattice.png" });
    json["buffers"][0]["uri"] = json!("level.bin");
    std::fs::write(place.path("level.bin"), bin).expect("a folder");
    std::fs::write(place.path("level.gltf"), json.to_string()).expect("a folder");

    let report = bake(&place, "level.gltf", "without.glb", &["--only", "floor"]);
    let warnings = report["warnings"].as_array().expect("a list").clone();
    assert_eq!((warnings[0]["code"].as_str(), &warnings[0]["count"]), (Some("alpha_mask"), &json!(2)));
    let subject = warnings[0]["subject"].as_str().expect("a text");
    assert!(subject.contains("lattice") && subject.contains("textures/lattice.png"), "{subject}");

    std::fs::create_dir(place.path("textures")).expect("a folder");
    std::fs::write(place.path("textures/lattice.png"), png).expect("a folder");
    let report = bake(&place, "level.gltf", "with.glb", &["--only", "floor"]);
    let codes = report["warnings"].as_array().expect("a list").iter().map(|w| w["code"].clone());
    assert!(codes.clone().all(|code| code != "alpha_mask"), "{:?}", codes.collect::<Vec<_>>());
    bake(&place, "embedded.glb", "embedded_baked.glb", &["--only", "floor"]);
    assert_eq!(floor(&place, "with.glb"), floor(&place, "embedded_baked.glb"));
    assert!(rms_difference(&floor(&place, "with.glb"), &floor(&place, "without.glb")) > 0.05);
}

#[test]
fn trees_with_a_texture_need_no_guess_at_their_holes() {
    let place = Workplace::new();
    place.succeed(&["example", "cutout", "-o", "cutout.glb"]);
    let baked = |output: &str, rules: &str, mode: &str| {
        std::fs::write(place.path("cutout.kiln.toml"), rules).expect("a folder");
        let report = bake(&place, "cutout.glb", output, &["--only", "floor", "--foliage", mode]);
        assert_eq!(report["warnings"], json!([]));
        floor(&place, output)
    };
    let rule = |class: &str| format!("[[class]]\nmatch = 'plate*'\nclass = '{class}'\n");
    let thin = format!("{}transmittance_per_crossing = 0.5\n", rule("tree"));
    for mode in ["expected", "attenuate", "geometry"] {
        let opaque = baked("opaque.glb", &rule("opaque"), mode);
        let tree = baked("tree.glb", &rule("tree"), mode);
        let thin = baked("thin.glb", &thin, mode);
        assert_eq!(opaque, tree, "{mode}: what is opaque stops rays");
        let mean = |values: &[f32]| values.iter().map(|ao| f64::from(*ao)).sum::<f64>() / values.len() as f64;
        let lighter = mean(&thin) - mean(&tree);
        assert!(if mode == "geometry" { lighter == 0.0 } else { lighter > 0.02 }, "{mode}: {lighter}");
    }
    // All of it: the trees' own numbers, too.
    std::fs::write(place.path("cutout.kiln.toml"), rule("tree")).expect("a folder");
    let report = bake(&place, "cutout.glb", "all.glb", &[]);
    assert_eq!(report["foliage"]["models"][0]["instances"], json!(5));
    // Shrubs: fog that knows of the holes is thinner than that of whole plates.
    with_text(&place, "cutout.glb", "whole.glb", "\"alphaMode\"", "\"alphaMake\"");
    std::fs::write(place.path("whole.kiln.toml"), rule("shrub")).expect("a folder");
    bake(&place, "whole.glb", "whole_fog.glb", &["--only", "floor"]);
    let (holes, whole) = (baked("fog.glb", &rule("shrub"), "expected"), floor(&place, "whole_fog.glb"));
    assert!(holes.iter().sum::<f32>() > whole.iter().sum::<f32>() * 1.01);
}

#[test]
fn cards_leave_scenes_with_holes_to_the_processor() {
    let place = Workplace::new();
    place.succeed(&["example", "cutout", "-o", "cutout.glb"]);
    let bake =
        ["bake", "cutout.glb", "-o", "gpu.glb", "--quality", "low", "--half-distance", "0.5,10", "--fixed-samples"];
    let more = ["--only", "floor", "--backend", "gpu", "--report", "r.json"];
    let output = place.command(&[&bake[..], &more].concat()).env("KILN_GPU", "software").output().expect("kiln starts");
    assert!(output.status.success(), "this test needs a software Vulkan driver: {output:?}");
    assert_eq!(place.json("r.json")["backend"]["traced_in"], json!(["cpu"]));
    self::bake(&place, "cutout.glb", "cpu.glb", &["--only", "floor"]);
    assert_eq!(floor(&place, "gpu.glb"), floor(&place, "cpu.glb"));
}
