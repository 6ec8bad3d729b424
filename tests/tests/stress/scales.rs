//! Scale and place: from a thousandth to ten thousand times the size, and up to 10⁷ m from the origin.

use crate::{
    bake::{adaptive, bake},
    compare::{Correspondence, assert_same, clean_room, difference},
    geometry::{Surface, room},
    level::{Level, at, scaled},
};
use glam::{DQuat, DVec3, dvec3};
use kiln_core::Quality::Medium;

#[test]
fn scale_in_positions_and_in_nodes() {
    for scale in [1e-3, 0.1, 1e2, 1e4] {
        let settings = adaptive(Medium, scale);
        let in_positions = bake(&Level::of(&room().map(|p| p * scale)), &settings);
        let in_node = bake(&Level::placed(&room(), scaled(DVec3::splat(scale))), &settings);
        let by = Correspondence { moved: &|p| p * scale, ..Correspondence::SAME };
        difference(clean_room(Medium), &in_positions, &by).assert_within_error(&format!("positions × {scale}"));
        difference(clean_room(Medium), &in_node, &by).assert_within_error(&format!("node × {scale}"));
    }
}

#[test]
fn a_level_moved_by_whole_origins_is_the_same_level() {
    // The local origin moves in steps of 1,024 m: relative to it nothing has moved.
    for offset in [dvec3(1024.0, 0.0, 0.0), dvec3(9766.0, -9766.0, 9000.0) * 1024.0] {
        let moved = bake(&Level::placed(&room(), at(offset)), &adaptive(Medium, 1.0));
        assert_same(clean_room(Medium), &moved, &format!("{offset}"));
    }
}

#[test]
fn any_other_offset_by_a_node_changes_no_more_than_the_samples() {
    for offset in [dvec3(1e7, 1e7, -1e7), dvec3(-1e7 + 0.3, 12.7, 1e6 + 0.1)] {
        let moved = bake(&Level::placed(&room(), at(offset)), &adaptive(Medium, 1.0));
        let by = Correspondence { moved: &|p| p + offset, ..Correspondence::SAME };
        difference(clean_room(Medium), &moved, &by).assert_within_error(&format!("{offset}"));
    }
}

/// A room out of the axes, `scale` times as large, as f32 positions at an offset hold it; relative to the offset.
fn rounded_room(scale: f64, offset: DVec3) -> Surface {
    let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.4, 0.3, 0.2);
    room().map(|p| (turn * (p * scale) + offset).as_vec3().as_dvec3() - offset)
}

#[test]
fn an_offset_in_positions_loses_what_f32_lost_and_no_more() {
    // Steps of f32 at these offsets: 2⁻¹³, 2⁻⁷ and 1 m.
    for (scale, offset) in [(1.0, dvec3(1e3, -1e3, 1e3)), (1.0, dvec3(1e5, 1e5, -1e5)), (32.0, dvec3(1e7, 0.0, -1e7))] {
        let rounded = rounded_room(scale, offset);
        let clean = bake(&Level::of(&rounded), &adaptive(Medium, scale));
        let far = bake(&Level::of(&rounded.map(|p| p + offset)), &adaptive(Medium, scale));
        let by = Correspondence { moved: &|p| p + offset, ..Correspondence::SAME };
        difference(&clean, &far, &by).assert_within_error(&format!("{offset}"));
        // A node that takes the offset back leaves the same place in the world.
        let back = bake(&Level::placed(&rounded.map(|p| p + offset), at(-offset)), &adaptive(Medium, scale));
        difference(&clean, &back, &Correspondence::SAME).assert_within_error(&format!("{offset} and back"));
    }
}
