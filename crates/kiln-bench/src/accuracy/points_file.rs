//! The points as a file that `kiln probe --points` reads, and outside tools can.

use super::{
    points::Side,
    scene::BenchScene,
    truth::{SideTruth, TruePoint},
};
use serde_json::{Value, json};

/// One entry for each side of each point. Positions are in world space, metres, already moved off the surface.
pub(super) fn json(scene: &BenchScene, points: &[TruePoint], rays: u32) -> Value {
    let sides = |(index, truth): (usize, &TruePoint)| -> Vec<Value> {
        let receiver = &scene.receivers[truth.point.receiver];
        let face = receiver.faces[truth.point.face];
        let one = |(side, found): (&Side, &SideTruth)| {
            json!({
                "position": (side.origin.as_dvec3() + scene.level.level.origin_m).to_array(),
                "normal": side.normal.to_array(),
                "geometric_normal": side.geometric.to_array(),
                "point": index,
                "instance": receiver.instance,
                "face": face,
                "barycentrics": truth.point.phi,
                "ao": found.ao,
                "back_face_fraction": found.back_face_fraction,
                "valid": found.is_valid,
            })
        };
        truth.point.sides.iter().zip(&truth.sides).map(one).collect()
    };
    let list: Vec<Value> = points.iter().enumerate().flat_map(sides).collect();
    json!({ "scene": scene.name, "half_distances_m": scene.half_distances_m(), "rays": rays, "points": list })
}
