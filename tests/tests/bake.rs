//! `kiln bake` and the commands around it, as a user runs them.

use kiln_tests::Workplace;
use serde_json::Value;

/// All `_AO` values of a .glb, read by hand: nothing of Kiln's own reader is trusted here.
fn ao_values(glb: &[u8]) -> Vec<f32> {
    let length = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    let document: Value = serde_json::from_slice(&glb[20..20 + length(12)]).unwrap();
    let bin = &glb[28 + length(12)..];
    let mut values = Vec::new();
    for primitive in document["meshes"].as_array().unwrap().iter().flat_map(|m| m["primitives"].as_array().unwrap()) {
        let Some(index) = primitive["attributes"]["_AO"].as_u64() else { continue };
        let accessor = &document["accessors"][index as usize];
        assert_eq!(accessor["componentType"], 5126);
        assert_eq!(accessor["type"], "VEC2");
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let offset = |v: &Value| v["byteOffset"].as_u64().unwrap_or(0) as usize;
        let start = offset(view) + offset(accessor);
        let count = 2 * accessor["count"].as_u64().unwrap() as usize;
        values.extend(bin[start..start + 4 * count].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())));
    }
    values
}

#[test]
fn an_example_is_baked_reported_and_pictured() {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let said = place.succeed(&[
        "bake",
        "level.glb",
        "-o",
        "baked.glb",
        "--quality",
        "low",
        "--preview",
        "p.png",
        "--report",
        "r.json",
        "--backend",
        "cpu",
    ]);
    assert!(said.contains("kiln view baked.glb"), "{said}");
    let values = ao_values(&place.read("baked.glb"));
    assert!(values.len() > 10_000 && values.iter().all(|v| (0.0..=1.0).contains(v)));
    assert!(values.iter().any(|&v| v > 0.95) && values.iter().any(|&v| v < 0.3));
    assert!(place.read("p.png").starts_with(b"\x89PNG"));

    let report = place.json("r.json");
    assert_eq!(report["schema"], 1);
    assert_eq!(report["backend"]["trace"], "cpu");
    assert_eq!(report["cache"]["hits"], 0);
    assert!(report["samples"]["total"].as_u64() > Some(50_000));
    let rmse = report["error_estimate"]["rmse"][0].as_f64().unwrap();
    assert!(rmse > 0.0 && rmse < 0.02, "{rmse}");

    // Again, with other threads: the same bytes, from the store; in another folder: the same bytes, computed.
    place.succeed(&[
        "bake",
        "level.glb",
        "-o",
        "again.glb",
        "--quality",
        "low",
        "--report",
        "r2.json",
        "--backend",
        "cpu",
    ]);
    let again = place.json("r2.json");
    assert_eq!(again["cache"]["misses"], 0);
    assert_eq!(again["cache"]["answered_from_store"], true);
    assert_eq!(place.read("baked.glb"), place.read("again.glb"));
    place.succeed(&[
        "bake",
        "level.glb",
        "-o",
        "one.glb",
        "--quality",
        "low",
        "--threads",
        "1",
        "--data-dir",
        "other",
        "--backend",
        "cpu",
    ]);
    assert_eq!(place.read("baked.glb"), place.read("one.glb"));

    // Another regulariser traces nothing again.
    place.succeed(&[
        "bake",
        "level.glb",
        "-o",
        "smooth.glb",
        "--quality",
        "low",
        "--regularization",
        "3",
        "--report",
        "r3.json",
        "--backend",
        "cpu",
    ]);
    let smooth = place.json("r3.json");
    assert_eq!(smooth["cache"]["by_stage"]["trace"]["misses"], 0);
    assert_eq!(smooth["cache"]["by_stage"]["solve"]["hits"], 0);
    assert_ne!(place.read("baked.glb"), place.read("smooth.glb"));

    let difference: Value =
        serde_json::from_str(&place.succeed(&["compare", "baked.glb", "smooth.glb", "--json"])).unwrap();
    let rmse = difference["total"][0]["rmse"].as_f64().unwrap();
    assert!(rmse > 0.0 && rmse < 0.05, "{rmse}");
    place.succeed(&["view", "baked.glb", "-o", "v.png", "--side-by-side", "smooth.glb", "--size", "160x100"]);
    assert!(place.read("v.png").starts_with(b"\x89PNG"));
}

#[test]
fn values_are_those_of_the_closed_form() {
    // Baked, not probed: a floor under a wide ceiling, all of whose AO is known.
    let place = Workplace::new();
    place.succeed(&["example", "oracle_plane", "-o", "level.glb"]);
    let bake =
        ["bake", "level.glb", "-o", "baked.glb", "--only", "receiver", "--half-distance", "2,300", "--backend", "cpu"];
    let many = ["--density", "1e9", "--max-samples-per-face", "1024"];
    place.succeed(&[&bake[..], &many].concat());
    let values = ao_values(&place.read("baked.glb"));
    assert!(!values.is_empty());
    for (channel, expected, each, mean) in [(0, 0.664_639_946, 4e-3, 2e-4), (1, 0.009_107_404, 2e-3, 1e-4)] {
        let errors: Vec<f64> = values.chunks_exact(2).map(|pair| f64::from(pair[channel]) - expected).collect();
        assert!(errors.iter().all(|error| error.abs() < each), "{errors:?}");
        assert!((errors.iter().sum::<f64>() / errors.len() as f64).abs() < mean, "{errors:?}");
    }
}

#[test]
fn exit_codes_say_what_went_wrong() {
    let place = Workplace::new();
    assert!(place.fail(2, &["bake", "level.glb"]).contains("--output"));
    assert!(place.fail(2, &["example", "nowhere", "-o", "x.glb"]).contains("--list"));
    assert!(place.fail(3, &["bake", "missing.glb", "-o", "x.glb"]).contains("missing.glb"));
    std::fs::write(place.path("broken.glb"), b"glTF\x02\0\0\0\xff\0\0\0").unwrap();
    assert!(place.fail(3, &["check", "broken.glb"]).contains("broken.glb"));
    assert!(place.fail(3, &["bake", "broken.glb", "-o", "x.glb"]).contains("broken.glb"));
    assert!(place.fail(5, &["ls", "--coordinator", "http://127.0.0.1:9"]).contains("kiln serve"));

    place.succeed(&["example", "crates", "-o", "level.glb"]);
    std::fs::write(place.path("level.kiln.toml"), "[gates]\nmax_rmse = 1e-9\n").unwrap();
    let bake = ["bake", "level.glb", "-o", "x.glb", "--quality", "low", "--ci", "--junit", "j.xml", "--backend", "cpu"];
    assert!(place.fail(4, &bake).contains("max_rmse"));
    assert!(String::from_utf8(place.read("j.xml")).unwrap().contains("failures=\"1\""));
    std::fs::write(place.path("level.kiln.toml"), "half_distance_m = [1.0]\n").unwrap();
    assert!(place.fail(3, &["check", "level.glb"]).contains("half_distances_m"));
}

#[test]
fn degenerate_levels_bake() {
    let place = Workplace::new();
    for name in ["empty", "triangle", "coincident", "mirrored", "double_sided", "gpu_instancing", "quantized"] {
        place.succeed(&["example", name, "-o", "level.glb"]);
        place.succeed(&["bake", "level.glb", "-o", "baked.glb", "--quality", "low", "--backend", "cpu"]);
        place.succeed(&["check", "baked.glb", "--json"]);
    }
}

#[test]
fn probes_answer_in_json() {
    let place = Workplace::new();
    place.succeed(&["example", "oracle_plane", "-o", "level.glb"]);
    let points =
        r#"{"points": [{"position": [0, 1, 0], "normal": [0, -1, 0]}, {"position": [0, 3, 0], "normal": [0, 1, 0]}]}"#;
    std::fs::write(place.path("p.json"), points).unwrap();
    let said = place.succeed(&[
        "probe",
        "level.glb",
        "--points",
        "p.json",
        "--half-distance",
        "2,300",
        "--json",
        "--backend",
        "cpu",
    ]);
    let found: Value = serde_json::from_str(&said).unwrap();
    // Above the ceiling there is nothing.
    assert_eq!(found["points"][1]["ao"], serde_json::json!([1.0, 1.0]));
    assert_eq!(found["points"][1]["back_face_fraction"], 0.0);
    assert_eq!(found["points"].as_array().unwrap().len(), 2);
    std::fs::write(place.path("p.json"), r#"{"points": [{"position": [0, 1, 0], "normal": [0, 0, 0]}]}"#).unwrap();
    assert!(place.fail(3, &["probe", "level.glb", "--points", "p.json"]).contains("points[0]"));
}
