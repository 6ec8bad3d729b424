//! Where an instance is, as rays see it.

use glam::{DAffine3, DMat3, DVec3};
use kiln_core::Bounds;
use kiln_trace::PositionError;

/// A box, metres relative to the level's origin, that holds the surface of a mesh with the given object-space bounds under
/// a transform, and the origins of rays that start there: with twice what rounding moves a point by, once for the surface
/// and once for the ray. Empty for empty bounds; without limits where the transform gives none.
pub fn seen_bounds(object: &Bounds, world_from_object: &DAffine3) -> Bounds {
    if object.is_empty() {
        return Bounds::EMPTY;
    }
    let m = world_from_object.matrix3;
    let size = object.max - object.min;
    let center = world_from_object.transform_point3(object.center());
    let half = DMat3::from_cols(m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs()) * (0.5 * size);
    let error = PositionError::new(world_from_object).bound(center.abs() + half, size.length());
    let half = half + 2.0 * error;
    if !(center.is_finite() && half.is_finite()) {
        return Bounds { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY };
    }
    Bounds { min: center - half, max: center + half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn the_box_holds_the_corners_and_little_more() {
        let object = Bounds { min: DVec3::new(-1.0, 0.0, 2.0), max: DVec3::new(3.0, 5.0, 2.5) };
        let place = DAffine3::from_scale_rotation_translation(
            DVec3::new(1.0, -2.0, 0.5),
            DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 1.0, -2.0),
            DVec3::new(700.0, -3.0, 40.0),
        );
        let mut corners = Bounds::EMPTY;
        for i in 0..8 {
            let at = DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
            corners.add(place.transform_point3(object.min + at * (object.max - object.min)));
        }
        let seen = seen_bounds(&object, &place);
        assert!(seen.min.cmplt(corners.min).all() && seen.max.cmpgt(corners.max).all());
        assert!((corners.min - seen.min).max(seen.max - corners.max).max_element() < 0.02);
    }

    #[test]
    fn what_is_not_there_and_what_is_everywhere() {
        assert!(seen_bounds(&Bounds::EMPTY, &DAffine3::IDENTITY).is_empty());
        let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
        let unit = Bounds { min: DVec3::ZERO, max: DVec3::ONE };
        assert_eq!(seen_bounds(&unit, &flat).max, DVec3::INFINITY);
    }
}
