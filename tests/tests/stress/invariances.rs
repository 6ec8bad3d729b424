//! What must not change the answer, for transforms and orders drawn at random.

use crate::{
    bake::{Outcome, adaptive, bake},
    compare::{Correspondence, Difference, clean_room, difference},
    geometry::{Surface, room},
    instances::copied,
    level::{Level, scaled},
};
use glam::{DAffine3, DQuat, DVec3, EulerRot, dvec3};
use kiln_core::Quality::Low;
use proptest::prelude::*;
use serde_json::json;

fn assert_within(found: &Difference) -> Result<(), TestCaseError> {
    prop_assert!(found.is_within_error(), "{:.5?}, {} times what is expected", found.rmse, found.ratio());
    Ok(())
}

fn rotation() -> impl Strategy<Value = DQuat> {
    prop::array::uniform3(-3.0..3.0).prop_map(|[a, b, c]: [f64; 3]| DQuat::from_euler(EulerRot::YXZ, a, b, c))
}

fn translation() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-2e3..2e3).prop_map(DVec3::from)
}

/// A permutation of `0..count` that a seed gives.
fn order(count: usize, seed: u32) -> Vec<u32> {
    let mut order: Vec<u32> = (0..count as u32).collect();
    order.sort_by_key(|index| (index ^ seed).wrapping_mul(2_654_435_761).rotate_left(seed % 31));
    order
}

/// The surface with vertices and faces in another order, and the corners of faces turned.
fn permuted(surface: &Surface, seed: u32) -> (Surface, Vec<u32>) {
    let vertices = order(surface.positions.len(), seed);
    let mut place = vec![0u32; vertices.len()];
    vertices.iter().zip(0..).for_each(|(old, new)| place[*old as usize] = new);
    let faces = order(surface.faces.len(), seed.wrapping_add(17)).into_iter().map(|face| {
        let mut corners = surface.faces[face as usize].map(|vertex| place[vertex as usize]);
        corners.rotate_left(face as usize % 3);
        corners
    });
    let positions = vertices.iter().map(|old| surface.positions[*old as usize]).collect();
    (Surface { positions, faces: faces.collect() }, place)
}

/// The faces on either side of a plane across x, as two meshes.
fn split(surface: &Surface, x: f64) -> Outcome {
    let mut level = Level::new();
    for side in [surface.filtered(|p| p.x < x), surface.filtered(|p| p.x >= x)] {
        let mesh = level.mesh(&side, false);
        level.node(mesh, json!({}));
    }
    bake(&level, &adaptive(Low, 1.0))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(8) })]

    #[test]
    fn rigid_motion(turn in rotation(), translation in translation(), in_node in any::<bool>()) {
        let world = DAffine3::from_rotation_translation(turn, translation);
        let level = if in_node {
            Level::placed(&room(), json!({"rotation": turn.to_array(), "translation": translation.to_array()}))
        } else {
            Level::of(&copied(&room(), &world))
        };
        let by = Correspondence { moved: &|p| world.transform_point3(p), ..Correspondence::SAME };
        assert_within(&difference(clean_room(Low), &bake(&level, &adaptive(Low, 1.0)), &by))?;
    }

    #[test]
    fn scale_with_the_half_distances(power in -3.0..4.0, in_node in any::<bool>()) {
        let scale = 10f64.powf(power);
        let level = if in_node {
            Level::placed(&room(), scaled(DVec3::splat(scale)))
        } else {
            Level::of(&room().map(|p| p * scale))
        };
        let by = Correspondence { moved: &|p| p * scale, ..Correspondence::SAME };
        assert_within(&difference(clean_room(Low), &bake(&level, &adaptive(Low, scale)), &by))?;
    }

    /// Samples are keyed by what a face is, not by where it stands in the file; the mesh is one piece.
    #[test]
    fn order_of_faces_and_vertices(seed in any::<u32>()) {
        let (surface, place) = permuted(&room(), seed);
        let outcome = bake(&Level::of(&surface), &adaptive(Low, 1.0));
        let (clean, case) = (&clean_room(Low).scene.parts[0].ao, &outcome.scene.parts[0].ao);
        for (values, place) in clean.chunks_exact(2).zip(place) {
            prop_assert_eq!(values, &case[2 * place as usize..][..2]);
        }
    }

    #[test]
    fn a_mesh_or_its_two_halves(cut in 1u32..8) {
        let cut = 0.5 * f64::from(cut);
        let by = Correspondence { counts: &|p| (p.x - cut).abs() > 0.6, ..Correspondence::SAME };
        assert_within(&difference(clean_room(Low), &split(&room(), cut), &by))?;
    }

    #[test]
    fn an_instance_or_its_copy(
        turn in rotation(),
        translation in translation(),
        scale in prop::array::uniform3(prop_oneof![-2.0..-0.4, 0.4..2.0]),
    ) {
        let world = DAffine3::from_scale_rotation_translation(DVec3::from(scale), turn, translation);
        let node = json!({"scale": scale, "rotation": turn.to_array(), "translation": translation.to_array()});
        // Other geometry, as near as it can be without cutting through the room.
        let lowest = copied(&room(), &world).positions.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let table = Surface::cuboid(dvec3(-4.0, -1.5, -4.0), dvec3(4.0, -0.5, 4.0));
        let table = table.map(|p| p + dvec3(translation.x, lowest, translation.z));
        let level = |surface: &Surface, node: serde_json::Value| {
            let mut level = Level::placed(surface, node);
            let mesh = level.mesh(&table, false);
            level.node(mesh, json!({}));
            bake(&level, &adaptive(Low, 1.0))
        };
        let (copy, instance) = (level(&copied(&room(), &world), json!({})), level(&room(), node));
        assert_within(&difference(&copy, &instance, &Correspondence::SAME))?;
    }
}
