//! `kiln bake` and the commands around it, as a user runs them.

use kiln_tests::Workplace;
use serde_json::Value;

/// All `_AO` values of a .glb, read by hand: nothing of Kiln's own reader is trusted here.
fn ao_values(glb: &[u8]) -> Vec<f32> {
    read_ao(glb).expect("a .glb whose `_AO` is VEC2 of f32")
}

fn read_ao(glb: &[u8]) -> Option<Vec<f32>> {
    let length = |at: usize| Some(u32::from_le_bytes(glb.get(at..at + 4)?.try_into().ok()?) as usize);
    let json = length(12)?;
    let document: Value = serde_json::from_slice(glb.get(20..20 + json)?).ok()?;
    let bin = glb.get(28 + json..)?;
    let mut values = Vec::new();
    for primitive in document["meshes"].as_array()?.iter().flat_map(|m| m["primitives"].as_array()).flatten() {
        let Some(index) = primitive["attributes"]["_AO"].as_u64() else { continue };
        let accessor = &document["accessors"][index as usize];
        if accessor["componentType"] != 5126 || accessor["type"] != "VEC2" {
            return None;
        }
        let view = &document["bufferViews"][accessor["bufferView"].as_u64()? as usize];
        let offset = |v: &Value| v["byteOffset"].as_u64().unwrap_or(0) as usize;
        let start = offset(view) + offset(accessor);
        let bytes = bin.get(start..start + 8 * accessor["count"].as_u64()? as usize)?;
        values.extend(bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)));
    }
    Some(values)
}

/// An example baked at low quality, with a picture and a report.
fn baked_courtyard() -> Workplace {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    let said = low(&place, "baked.glb", &["--preview", "p.png", "--report", "r.json"]);
    assert!(said.contains("kiln view baked.glb"), "{said}");
    place
}

fn low(place: &Workplace, output: &str, more: &[&str]) -> String {
    let bake = ["bake", "level.glb", "-o", output, "--quality", "low", "--backend", "cpu"];
    place.succeed(&[&bake[..], more].concat())
}

#[test]
fn an_example_is_baked_reported_and_pictured() {
    let place = baked_courtyard();
    let values = ao_values(&place.read("baked.glb"));
    assert!(values.len() > 10_000 && values.iter().all(|v| (0.0..=1.0).contains(v)));
    assert!(values.iter().any(|&v| v > 0.95) && values.iter().any(|&v| v < 0.3));
    assert!(place.read("p.png").starts_with(b"\x89PNG"));

    let report = place.json("r.json");
    assert_eq!(report["schema"], 3);
    assert_eq!(report["backend"]["trace"], "cpu");
    assert_eq!(report["cache"]["hits"], 0);
    assert!(report["samples"]["total"].as_u64() > Some(50_000));
    let rmse = report["error_estimate"]["rmse"][0].as_f64().unwrap();
    assert!(rmse > 0.0 && rmse < 0.03, "{rmse}");
}

#[test]
fn a_second_bake_does_only_what_is_new() {
    let place = baked_courtyard();
    // The same again is known; in another folder, with other threads, it is computed: the same bytes both times.
    low(&place, "again.glb", &["--report", "r2.json"]);
    let again = place.json("r2.json");
    assert_eq!(again["cache"]["misses"], 0);
    assert_eq!(again["cache"]["answered_from_store"], true);
    assert_eq!(place.read("baked.glb"), place.read("again.glb"));
    low(&place, "one.glb", &["--threads", "1", "--data-dir", "other"]);
    assert_eq!(place.read("baked.glb"), place.read("one.glb"));

    // Another regulariser traces nothing again.
    low(&place, "smooth.glb", &["--regularization", "3", "--report", "r3.json"]);
    let smooth = place.json("r3.json");
    assert_eq!(smooth["cache"]["by_stage"]["trace"]["misses"], 0);
    assert_eq!(smooth["cache"]["by_stage"]["solve"]["hits"], 0);
    assert_ne!(place.read("baked.glb"), place.read("smooth.glb"));

    let difference = place.succeed(&["compare", "baked.glb", "smooth.glb", "--json"]);
    let difference: Value = serde_json::from_str(&difference).unwrap();
    let rmse = difference["total"][0]["rmse"].as_f64().unwrap();
    assert!(rmse > 0.0 && rmse < 0.1, "{rmse}");
    assert!(place.fail(4, &["compare", "baked.glb", "smooth.glb", "--fail-above", "1e-6"]).contains("RMSE"));
    place.succeed(&["compare", "baked.glb", "again.glb", "--fail-above", "0"]);
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
    let many = ["--density", "1e9", "--max-samples-per-face", "64", "--rays", "256"];
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

#[test]
fn a_reader_that_leaves_ends_the_command_in_silence() {
    let place = Workplace::new();
    let mut child = place
        .command(&["example", "--list"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("it starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("it ends");
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}
