//! A small measurement from end to end, on an example made by code.

use super::{
    markdown,
    measure::{self, Plan},
    points_file,
    report::{Report, SceneReport, json_text},
    scene::BenchScene,
    svg, table,
    variant::Family,
};
use crate::Provenance;
use kiln_scene::{LevelFiles, example};
use std::{collections::BTreeMap, sync::OnceLock};

fn example_scene(name: &str, most_faces: Option<u64>) -> BenchScene {
    let bytes = example::build(name).expect("the example exists");
    let file = format!("{name}.glb");
    let files = LevelFiles { name: file.clone(), files: BTreeMap::from([(file, bytes)]), sidecar: None };
    let imported = BenchScene::import(name, &files, Some(&[0.5, 20.0]), most_faces);
    imported.expect("examples import").expect("examples have faces that receive")
}

fn plan() -> Plan {
    Plan {
        families: Family::ALL.into_iter().collect(),
        seeds: 2,
        points: 300,
        truth_rays: 256,
        reference_rays_per_face: 4096,
        most_rays: 660_000,
    }
}

/// Measured once for all tests of it.
fn measured() -> &'static SceneReport {
    static MEASURED: OnceLock<SceneReport> = OnceLock::new();
    MEASURED.get_or_init(|| {
        let scene = example_scene("double_sided", None);
        let points = measure::true_points(&scene, &plan()).expect("tracing on the CPU does not fail");
        let result = measure::measure(&scene, &plan(), points, &mut |_| ());
        SceneReport::new(result.expect("examples can be baked"))
    })
}

fn report() -> Report {
    Report::new(Provenance::now(), 2, 1.0, vec![measured().clone()])
}

#[test]
fn more_samples_have_less_error() {
    let error = |label: &str, channel: usize| {
        let row = measured().summary.iter().find(|row| row.family == Family::Fixed && row.label == label);
        row.expect("the row is there").estimation[channel].rmse
    };
    for channel in 0..2 {
        assert!(error("16 × 16", channel) < 0.7 * error("2 × 16", channel));
        assert!(error("64 × 16", channel) < 0.9 * error("16 × 16", channel));
    }
}

#[test]
fn every_family_has_rows_and_what_is_left_out_is_named() {
    for family in Family::ALL {
        let rows: Vec<_> = measured().result.rows.iter().filter(|row| row.family == family).collect();
        assert!(!rows.is_empty() && rows.iter().all(|row| row.runs.len() == 2), "{family}");
    }
    assert!(measured().result.left_out.contains(&"fixed 64 × 1024".to_owned()));
    assert_eq!(measured().channels.len(), 2);
    assert!(measured().channels.iter().all(|channel| !channel.calibration.is_empty()));
}

#[test]
fn seeds_differ_and_a_seed_repeats() {
    let scene = example_scene("double_sided", None);
    let moments = |seed| {
        let sampling = super::settings::fixed(&scene, 4, 16, seed);
        super::bake::trace(&scene, scene.tracer(), &sampling).expect("tracing on the CPU does not fail").moments
    };
    assert_eq!(moments(3), moments(3));
    assert_ne!(moments(3), moments(4));
}

#[test]
fn random_directions_are_right_on_average_and_noisier() {
    let row = |family: Family| {
        let row = measured().summary.iter().find(|row| row.family == family && row.label == "4 × 64");
        &row.expect("the row is there").estimation[1]
    };
    assert!(row(Family::Random).rmse > row(Family::Fixed).rmse);
    assert!(row(Family::Random).bias.abs() < 0.01, "{:?}", row(Family::Random));
}

#[test]
fn a_part_of_a_level_is_whole_pieces_of_it() {
    let (whole, part) = (example_scene("courtyard", None), example_scene("courtyard", Some(600)));
    assert!(part.baked_faces() < whole.baked_faces() && part.baked_faces() > 0);
    assert_eq!((whole.baked_faces(), part.face_count), (whole.face_count, whole.face_count));
    for receiver in &part.receivers {
        let all = whole.receivers.iter().find(|r| r.instance == receiver.instance).expect("it is part of the whole");
        for (face, &original) in receiver.faces.iter().enumerate() {
            assert_eq!(receiver.mesh.corners(face), all.mesh.corners(original as usize));
        }
    }
}

#[test]
fn a_reference_has_no_caps() {
    let mut scene = example_scene("double_sided", None);
    for receiver in &mut scene.receivers {
        let mut mesh = kiln_core::Mesh::clone(&receiver.mesh);
        mesh.groups.iter_mut().for_each(|group| group.max_samples_per_face = Some(2));
        receiver.mesh = std::sync::Arc::new(mesh);
    }
    let sampling = super::settings::fixed(&scene, 16, 16, 0);
    let capped = super::bake::trace(&scene, scene.tracer(), &sampling).expect("tracing on the CPU does not fail");
    let uncapped = super::bake::trace_uncapped(&scene, &sampling).expect("tracing on the CPU does not fail");
    assert!(uncapped.summary.samples > 4 * capped.summary.samples);
}

#[test]
fn json_has_every_row_and_reads_back() {
    let text = json_text(&report()).expect("it has no map with keys that are not text");
    let json: serde_json::Value = serde_json::from_str(&text).expect("it was written as JSON");
    let rows = json["scenes"][0]["rows"].as_array().expect("rows are a list");
    for family in Family::ALL {
        assert!(rows.iter().any(|row| row["family"] == family.name()), "{family}");
    }
    assert_eq!(json["scenes"][0]["half_distances_m"], serde_json::json!([0.5, 20.0]));
    assert_eq!(json["seeds"], 2);
}

#[test]
fn the_plot_is_well_formed() {
    let svg = svg::draw(&report().scenes, "a < b & c");
    let mut open: Vec<&str> = Vec::new();
    for tag in svg.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("every tag ends");
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
        } else if !tag.ends_with('/') {
            open.push(tag.split_whitespace().next().expect("a tag has a name"));
        }
    }
    assert!(open.is_empty(), "{open:?}");
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
    assert!(svg.contains("double_sided, 0.5 m: surface error") && svg.contains("a &lt; b &amp; c"));
}

#[test]
fn the_document_and_the_table_have_every_row() {
    let report = report();
    let (document, terminal) = (markdown::document(&report, None), table::scene(&report.scenes[0]));
    let columns = |line: &str| line.matches('|').count();
    let of_rows: Vec<usize> = document.lines().filter(|line| line.contains(" area average |")).map(columns).collect();
    assert!(!of_rows.is_empty() && of_rows.iter().all(|count| *count == 19), "{of_rows:?}");
    assert_eq!(terminal.lines().filter(|line| line.starts_with("average")).count(), of_rows.len());
}

#[test]
fn points_can_be_probed() {
    let scene = example_scene("double_sided", None);
    let points = measure::true_points(&scene, &plan()).expect("tracing on the CPU does not fail");
    let json = points_file::json(&scene, &points, 256);
    let list = json["points"].as_array().expect("points are a list");
    assert!(list.len() > points.len(), "double-sided points have two entries");
    for entry in list {
        let length = |name: &str| entry[name].as_array().map_or(0, Vec::len);
        assert_eq!((length("position"), length("normal"), length("barycentrics"), length("ao")), (3, 3, 3, 2));
    }
}
