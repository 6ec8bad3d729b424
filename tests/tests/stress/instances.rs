//! Instances: mirrored, stretched and flattened.

use crate::{
    bake::{adaptive, bake},
    compare::{Correspondence, assert_same, clean_room, difference},
    geometry::{Surface, room},
    level::Level,
};
use glam::{DAffine3, DQuat, DVec3, dvec3};
use kiln_core::Quality::Medium;
use serde_json::{Value, json};

/// A node's transform, and the same as a matrix.
fn place(scale: DVec3, turn: DQuat, translation: DVec3) -> (Value, DAffine3) {
    let node = json!({
        "scale": scale.to_array(), "rotation": turn.to_array(), "translation": translation.to_array(),
    });
    (node, DAffine3::from_scale_rotation_translation(scale, turn, translation))
}

/// The surface under a transform, facing as an instance of it does.
pub(crate) fn copied(surface: &Surface, world: &DAffine3) -> Surface {
    let copy = surface.map(|p| world.transform_point3(p));
    if world.matrix3.determinant() < 0.0 { copy.flipped() } else { copy }
}

#[test]
fn mirrored_and_stretched_instances_are_their_copies() {
    let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.7, 0.2, -0.4);
    let scales = [dvec3(-1.0, 1.0, 1.0), dvec3(-1.0, -1.0, -1.0), dvec3(2.0, 0.5, 1.25), dvec3(-3.0, 0.2, 1.0)];
    for scale in scales {
        let (node, world) = place(scale, turn, dvec3(3.0, -2.0, 1.0));
        let instance = bake(&Level::placed(&room(), node), &adaptive(Medium, 1.0));
        let copy = bake(&Level::of(&copied(&room(), &world)), &adaptive(Medium, 1.0));
        difference(&copy, &instance, &Correspondence::SAME).assert_within_error(&format!("{scale}"));
        if scale.abs() == DVec3::ONE {
            let by = Correspondence { moved: &|p| world.transform_point3(p), ..Correspondence::SAME };
            difference(clean_room(Medium), &instance, &by).assert_within_error(&format!("{scale}, unmoved"));
        }
    }
}

#[test]
fn an_instance_without_volume_is_left_out() {
    for scale in [DVec3::ZERO, dvec3(1.0, 0.0, 1.0), dvec3(1e3, 0.0, 0.0)] {
        let mut level = Level::of(&room());
        level.node(0, json!({"scale": scale.to_array(), "translation": [0.5, 0.25, 0.5]}));
        let outcome = bake(&level, &adaptive(Medium, 1.0));
        assert_eq!(outcome.warned("flat_instances"), 1, "{scale}");
        assert_same(clean_room(Medium), &outcome, &format!("{scale}"));
    }
}
