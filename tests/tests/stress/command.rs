//! A few of the cases by the `kiln` binary: exit codes and messages.

use crate::{
    geometry::{Surface, room},
    level::{Level, at},
};
use glam::{DVec3, dvec3};
use kiln_tests::Workplace;
use serde_json::json;

const BAKE: [&str; 8] = ["bake", "level.glb", "-o", "baked.glb", "--quality", "low", "--backend", "cpu"];

fn place_with(level: &Level) -> Workplace {
    let place = Workplace::new();
    std::fs::write(place.path("level.glb"), level.glb()).unwrap_or_else(|error| panic!("level.glb: {error}"));
    place
}

#[test]
fn bad_positions_end_with_what_to_do() {
    let mut broken = room();
    broken.positions[3].y = f64::NAN;
    let place = place_with(&Level::of(&broken));
    let said = place.fail(3, &BAKE);
    assert!(said.contains("meshes[0]") && said.contains("--drop-bad-faces"), "{said}");
    assert!(!place.path("baked.glb").exists());
    place.succeed(&[&BAKE[..], &["--drop-bad-faces", "--report", "r.json"]].concat());
    let warnings = place.json("r.json")["warnings"].to_string();
    assert!(warnings.contains("non_finite_faces"), "{warnings}");
    // The output keeps the broken faces, so reading it as a level refuses it, and reading it as a baked file does not.
    place.fail(3, &["check", "baked.glb"]);
    place.succeed(&["compare", "baked.glb", "baked.glb", "--fail-above", "0"]);
}

#[test]
fn a_level_beyond_all_bounds_is_refused() {
    let mut level = Level::of(&room());
    level.node(0, at(dvec3(1e20, 0.0, 0.0)));
    let place = place_with(&level);
    let said = place.fail(3, &BAKE);
    assert!(said.contains("level.glb") && said.contains("metres from the middle"), "{said}");
}

#[test]
fn what_cannot_be_baked_is_left_out_and_said() {
    let mut level = Level::of(&room());
    level.node(0, json!({"name": "flat", "scale": [1, 0, 1]}));
    let flat = Surface { positions: vec![DVec3::ZERO; 3], faces: vec![[0, 1, 2]] };
    let mesh = level.mesh(&flat, false);
    level.node(mesh, json!({"name": "nothing"}));
    let place = place_with(&level);
    place.succeed(&[&BAKE[..], &["--report", "r.json"]].concat());
    let warnings = place.json("r.json")["warnings"].to_string();
    assert!(warnings.contains("flat_instances") && warnings.contains("degenerate_faces"), "{warnings}");
}
