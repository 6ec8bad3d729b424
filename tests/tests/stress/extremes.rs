//! Levels with very little, very much or very different things in them.

use crate::{
    bake::{adaptive, bake, fixed},
    compare::{Correspondence, assert_same, assert_valid, difference, errors_against},
    geometry::{Surface, room},
    level::{Level, at},
};
use glam::{DVec3, dvec3};
use kiln_core::{BakeSettings, Quality};

#[test]
fn an_empty_level() {
    let outcome = bake(&Level::new(), &BakeSettings::default());
    assert!(outcome.scene.parts.is_empty());
    assert_eq!(outcome.summary.trace.samples, 0);
    let mut without_faces = Level::new();
    let surface = Surface { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Z], faces: vec![[0, 1, 1]] };
    let mesh = without_faces.mesh(&surface, false);
    without_faces.node(mesh, serde_json::json!({}));
    let outcome = bake(&without_faces, &BakeSettings::default());
    assert_eq!((outcome.summary.counts.faces, outcome.warned("degenerate_faces")), (0, 1));
}

/// Nothing is in the way, but for the rounding of f32 sums.
fn is_open(values: &[f32]) -> bool {
    !values.is_empty() && values.iter().all(|value| *value >= 1.0 - 2e-6)
}

#[test]
fn a_level_of_one_triangle() {
    let surface = Surface { positions: vec![DVec3::ZERO, DVec3::Z, DVec3::X], faces: vec![[0, 1, 2]] };
    for settings in [BakeSettings::default(), adaptive(Quality::High, 1e3), fixed(2)] {
        let outcome = bake(&Level::of(&surface), &settings);
        assert!(is_open(&outcome.scene.parts[0].ao), "{:?}", outcome.scene.parts[0].ao);
    }
}

/// As many triangles of a few centimetres, none of which touch, looking up.
fn crumbs(count: u32) -> Surface {
    let side = count.isqrt();
    let mut crumbs = Surface::default();
    for index in 0..count {
        let corner = dvec3(f64::from(index % side), 0.0, f64::from(index / side)) * 0.1;
        let positions = vec![corner, corner + DVec3::Z * 0.05, corner + DVec3::X * 0.05];
        crumbs.append(&Surface { positions, faces: vec![[0, 1, 2]] });
    }
    crumbs
}

#[test]
fn twenty_thousand_components_of_one_triangle() {
    // Two metres under a plane without end, as far as the reach of rays goes: the closed form is known.
    let mut level = Level::of(&crumbs(20_000));
    let ceiling = Surface::sheet(dvec3(-3e3, 2.0, -3e3), DVec3::X * 6e3, DVec3::Z * 6e3, [1, 1]);
    let mesh = level.mesh(&ceiling, false);
    level.node(mesh, serde_json::json!({}));
    let settings = BakeSettings {
        half_distances_m: Some(vec![2.0]),
        only: Some("node_0".to_owned()),
        rays_per_sample: Some(16),
        ..fixed(4)
    };
    let outcome = bake(&level, &settings);
    assert_valid(&outcome);
    let solve = &outcome.summary.meshes[0].solve;
    assert_eq!((solve.components, solve.unknowns), (20_000, 60_000));
    let (mean, rmse) = errors_against(&outcome, 0.664_639_946_4);
    assert!(mean.abs() < 5e-4, "{mean}");
    let estimated = outcome.summary.error[0].rmse;
    assert!(rmse < 2.0 * estimated && estimated < 2.0 * rmse, "{rmse}, estimated {estimated}");
}

#[test]
fn a_mesh_that_nobody_can_see() {
    let crate_inside = Surface::cuboid(DVec3::splat(-0.5), DVec3::splat(0.5));
    let shell = Surface::cuboid(DVec3::splat(-2.0), DVec3::splat(2.0));
    let settings = fixed(16);
    let mut alone = Level::of(&shell);
    let clean = bake(&alone, &settings);
    let inner = alone.mesh(&crate_inside, false);
    alone.node(inner, serde_json::json!({}));
    let apart = bake(&alone, &settings);
    assert_same(&clean, &apart, "the shell");
    assert_eq!(apart.warned("buried_instances"), 1);
    // The shell is open to all sides, and it is the nearest surface with values.
    assert!(is_open(&apart.scene.parts[1].ao), "{:?}", apart.scene.parts[1].ao);

    let mut joined = shell;
    joined.append(&crate_inside);
    let joined = bake(&Level::of(&joined), &settings);
    assert_same(&clean, &joined, "the shell of one mesh");
    assert!(is_open(&joined.scene.parts[0].ao), "{:?}", joined.scene.parts[0].ao);

    let nothing_seen = bake(&alone, &BakeSettings { only: Some("node_1".to_owned()), ..settings });
    assert_valid(&nothing_seen);
    assert_eq!(nothing_seen.warned("buried_instances"), 1);
}

#[test]
fn huge_next_to_tiny() {
    let tiny = room().map(|p| p * 1e-3 + dvec3(6.0, 0.0, 0.0));
    let huge = Surface::sheet(dvec3(-5e3, -1e3, -5e3), DVec3::Z * 1e4, DVec3::X * 1e4, [4, 4]);
    let mut all = room();
    all.append(&tiny);
    all.append(&huge);
    let settings = fixed(64);
    let case = bake(&Level::of(&all), &settings);
    // The estimate for the whole is the huge sheet's: hold each part to the error of that part alone.
    for (name, part) in [("room", room()), ("tiny", tiny)] {
        let clean = bake(&Level::of(&part), &settings);
        let found = difference(&clean, &case, &Correspondence::SAME);
        for (rmse, error) in found.rmse.iter().zip(&clean.summary.error) {
            assert!(*rmse <= 3.0 * error.rmse.hypot(error.rmse).max(1e-6), "{name}: {rmse}, estimated {}", error.rmse);
        }
    }
    let far = dvec3(2e4, 0.0, 0.0);
    let mut apart = Level::of(&room());
    let mesh = apart.mesh(&huge, false);
    apart.node(mesh, at(far));
    let clean = bake(&Level::of(&room()), &settings);
    let by = Correspondence { counts: &|p| p.x < 5.0, ..Correspondence::SAME };
    difference(&clean, &bake(&apart, &settings), &by).assert_within_error("beyond the reach");
}
