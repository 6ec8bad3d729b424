//! Visibility regions as a user bakes them, and the pack that an engine loads.

use kiln_runtime::{MovingObject, Pack, SectionKind, TemporalBlend, ao_linear, ao_quadratic};
use kiln_tests::Workplace;
use serde_json::{Value, json};

/// Two regions of the courtyard, and what is above.
const SIDECAR: &str = r#"
half_distances_m = [2.0, 300.0]
[[region]]
id = "west"
min_m = [-8, 0, -8]
max_m = [0, 3.5, 8]
[[region]]
id = "east"
min_m = [0, 0, -8]
max_m = [8, 3.5, 8]
[[region]]
id = "sky"
min_m = [-8, 3.5, -8]
max_m = [8, 9, 8]
[[region]]
id = "nook"
min_m = [8, 0, 0]
max_m = [8.5, 1, 1]
[region_models]
rays_per_point = 256
"#;

fn courtyard() -> Workplace {
    let place = Workplace::new();
    place.succeed(&["example", "courtyard", "-o", "level.glb"]);
    std::fs::write(place.path("level.kiln.toml"), SIDECAR).expect("a file can be written");
    place
}

fn bake(place: &Workplace, output: &str, more: &[&str]) -> Value {
    let bake = ["bake", "level.glb", "-o", output, "--quality", "low", "--backend", "cpu", "--report", "r.json"];
    place.succeed(&[&bake[..], more].concat());
    place.json("r.json")
}

fn items(report: &Value, stage: &str) -> u64 {
    let stages = report["stages"].as_array().expect("a list").clone();
    stages.iter().find(|s| s["name"] == stage).map_or(0, |s| s["items"].as_u64().expect("a count"))
}

#[test]
fn regions_are_modelled_and_an_engine_is_lit_by_them() {
    let place = courtyard();
    let report = bake(&place, "one.glb", &["--threads", "1"]);
    assert!(items(&report, "regions") > 0 && items(&report, "model") == 1);
    let regions = &report["regions"];
    assert_eq!((regions["regions"].as_u64(), regions["absorbed"].as_u64()), (Some(4), Some(1)), "{regions}");
    let energy: Vec<f64> = serde_json::from_value(regions["energy"].clone()).expect("numbers");
    assert!(energy.len() > 1 && energy.is_sorted_by(|a, b| a >= b), "{energy:?}");

    let bytes = place.read("one.kiln");
    let sizes = report["pack"]["by_kind"].as_object().expect("sizes");
    assert!(sizes.contains_key("region models (engine)") && report["pack"]["bytes"] == bytes.len() as u64, "{sizes:?}");
    let pack = Pack::new(&bytes).expect("it is a pack");
    assert_eq!((pack.region_count(), pack.model_count()), (4, 3));
    assert_eq!(pack.region(3).expect("the nook").model, pack.region(1).expect("its neighbour").model);
    // Everything else that the bake made is there, too.
    let sets: usize = pack.count(SectionKind::VertexSets);
    assert!(sets >= 41, "{sets} vertex sets");
    // Above is brighter than amid the columns, and brighter upwards than downwards.
    let up = |id: &str, point: [f64; 3], normal: [f32; 3]| {
        let region = pack.region_with_id(id).expect("it is there");
        let coefficients = pack.full_at(region, pack.meta().local(point), 1).expect("a model");
        ao_quadratic(coefficients, normal)
    };
    let (sky, yard) = (up("sky", [0.0, 8.0, 0.0], [0.0, 1.0, 0.0]), up("east", [5.0, 1.0, 0.0], [0.0, 1.0, 0.0]));
    assert!(sky > 0.9 && yard < sky && up("sky", [0.0, 8.0, 0.0], [0.0, -1.0, 0.0]) < 0.6, "{sky} {yard}");
    // An object that goes from west to east has no jump.
    let (mut object, mut before) = (MovingObject::new(), None);
    for step in 0..400 {
        let point = pack.meta().local([-7.0 + 0.035 * f64::from(step), 1.5, 3.0]);
        let shown = object.update(&pack, point, 1.0 / 60.0, TemporalBlend::default()).expect("a region");
        let ao = ao_linear(shown, [0.0, 1.0, 0.0]);
        assert!(before.is_none_or(|before: f32| (ao - before).abs() < 0.03), "step {step}: {before:?} {ao}");
        before = Some(ao);
    }
    assert_eq!(object.region(), pack.region_with_id("east"));

    // Threads change nothing, and smoothing alone is done anew when it changes.
    bake(&place, "two.glb", &["--threads", "2", "--data-dir", "other"]);
    assert!(bytes == place.read("two.kiln"), "the number of threads changes the pack");
    std::fs::write(place.path("level.kiln.toml"), format!("{SIDECAR}smoothing = 0.0\n")).expect("a file");
    let report = bake(&place, "unsmoothed.glb", &["--pack", "plain.kiln"]);
    let misses = |stage: &str| report["cache"]["by_stage"][stage]["misses"].as_u64();
    assert_eq!((misses("regions"), misses("trace"), misses("model")), (Some(0), Some(0), Some(1)));
    assert_eq!(report["regions"]["errors"][0]["smoothed"], report["regions"]["errors"][0]["refined"]);

    // What the models say beside what is traced.
    let points = json!({ "points": [{ "position": [0.0, 8.0, 0.0], "normal": [0.0, -2.0, 0.0] }] });
    std::fs::write(place.path("points.json"), points.to_string()).expect("a file can be written");
    let probe = ["probe", "level.glb", "--points", "points.json", "--pack", "one.kiln", "--backend", "cpu", "--json"];
    let probed: Value = serde_json::from_str(&place.succeed(&probe)).expect("JSON");
    let point = &probed["points"][0];
    let close = |channel: usize| {
        let [traced, model] = [&point["ao"], &point["model"]["ao"]].map(|ao| ao[channel].as_f64().expect("a number"));
        (traced - model).abs() < 0.15
    };
    assert!(
        point["model"]["region"] == "sky" && point["model"]["distance_m"] == 0.0 && close(0) && close(1),
        "{point}"
    );

    let path = json!({ "points": [[-6.0, 1.2, -5.0], [6.0, 1.2, 5.0]], "pictures": 3 });
    std::fs::write(place.path("path.json"), path.to_string()).expect("a file can be written");
    let fly =
        ["view", "one.glb", "--fly", "path.json", "--pack", "one.kiln", "--pack", "plain.kiln", "-o", "strip.png"];
    let said = place.succeed(&[&fly[..], &["--size", "64x48", "--json"]].concat());
    let flight: Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!((flight["rows"].as_array().map(Vec::len), &flight["crossings"]), (Some(5), &json!([1, 1])));
    let step = |row: usize| flight["rows"][row]["greatest_step"].as_f64().expect("a number");
    assert!(step(2) < 0.5 * step(1) && step(4) < 0.5 * step(3), "{flight}");
    assert!(place.read("strip.png").starts_with(b"\x89PNG"));
}

/// The runtime has no dependency on the tracer, and so constants of its own.
#[test]
fn the_runtime_has_the_tracers_basis() {
    for normal in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.48, 0.6, -0.64], [-0.36, 0.48, 0.8]] {
        let tracers = kiln_trace::quadratic_harmonics(glam::Vec3::from(normal));
        assert_eq!(kiln_runtime::quadratic_harmonics(normal), tracers);
        assert_eq!(kiln_runtime::linear_harmonics(normal), tracers[..4]);
    }
}

#[test]
fn without_regions_there_is_none_of_it() {
    let place = courtyard();
    std::fs::remove_file(place.path("level.kiln.toml")).expect("it is there");
    let report = bake(&place, "out.glb", &[]);
    assert_eq!((items(&report, "regions"), items(&report, "model")), (0, 0));
    assert!(report["regions"].is_null() && report["pack"].is_null() && !place.path("out.kiln").exists());
    bake(&place, "out.glb", &["--pack", "asked.kiln"]);
    let bytes = place.read("asked.kiln");
    let pack = Pack::new(&bytes).expect("it is a pack");
    assert!(pack.region_count() == 0 && pack.count(SectionKind::VertexSets) >= 41);
    let path = json!({ "points": [[0.0, 1.0, 0.0], [1.0, 1.0, 0.0]] });
    std::fs::write(place.path("path.json"), path.to_string()).expect("a file can be written");
    let fly = ["view", "out.glb", "--fly", "path.json", "--pack", "asked.kiln", "-o", "strip.png"];
    assert!(place.fail(3, &fly).contains("no models of visibility regions"));
    std::fs::write(place.path("points.json"), json!({ "points": [] }).to_string()).expect("a file can be written");
    let probe = ["probe", "out.glb", "--points", "points.json", "--pack", "asked.kiln", "--backend", "cpu"];
    assert!(place.fail(3, &probe).contains("no models of regions"));
    let not_a_pack = ["view", "out.glb", "--fly", "path.json", "--pack", "out.glb", "-o", "strip.png"];
    assert!(place.fail(3, &not_a_pack).contains("out.glb: "));
}

#[test]
fn only_takes_regions_by_their_ids() {
    let place = courtyard();
    let report = bake(&place, "out.glb", &["--only", "sky"]);
    assert_eq!((items(&report, "regions"), items(&report, "trace")), (1, 0));
    let bytes = place.read("out.kiln");
    let pack = Pack::new(&bytes).expect("it is a pack");
    assert_eq!((pack.region_count(), pack.region_id(0)), (1, Some("sky")));
    let report = bake(&place, "out.glb", &["--only", "crate*"]);
    assert!(report["regions"].is_null() && items(&report, "trace") > 0);
}
