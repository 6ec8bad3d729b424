//! A ray in the forms that boxes and triangles are tested with.

use crate::lanes::Lanes;
use glam::Vec3;

/// Widens a far distance beyond the rounding error of the slab test, 1 + 2γ₃ and a little more (Ize 2013, "Robust BVH ray
/// traversal").
pub(crate) const WIDEN: f32 = 1.000_000_6;

/// Widens the distance of a hit: what is entered this little behind it may tie with it, distances being rounded to 18 bits.
/// It is enough too for the boxes of instances, whose rays are rounded on their way into object space.
pub(crate) const HIT_SLACK: f32 = 1.000_008;

/// Boxes are entered no farther than this, in lengths of the direction.
pub(crate) const FARTHEST: f32 = 1e38;

/// Directions shorter than this along an axis count as this long in box tests only, so that no 0 · ∞ occurs.
const LEAST_DIRECTION: f32 = 1e-18;

/// A ray as it is traced through one tree.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TracedRay {
    pub(crate) origin: [f32; 3],
    pub(crate) direction: [f32; 3],
    /// One over the direction.
    pub(crate) inverse: [f32; 3],
}

/// The part of rays that lies in boxes, from near to far, less what is not between the planes of one axis, which are relative
/// to the origins.
#[inline(always)]
pub(crate) fn narrow<V: Lanes>([near, far]: [V; 2], [low, high]: [V; 2], inverse: V) -> [V; 2] {
    // The nearer plane is the one that the direction's sign tells, since roundings are monotonic.
    let (low, high) = (low.mul(inverse), high.mul(inverse));
    [low.min(high).max(near), low.max(high).min(far)]
}

/// One over a coordinate of a direction, finite.
#[inline(always)]
pub(crate) fn inverse_of(d: f32) -> f32 {
    1.0 / if d.abs() < LEAST_DIRECTION { LEAST_DIRECTION.copysign(d) } else { d }
}

impl TracedRay {
    #[inline(always)]
    pub(crate) fn new(origin: Vec3, direction: Vec3) -> Self {
        let (origin, d) = (origin.to_array(), direction.to_array());
        Self { origin, direction: d, inverse: [inverse_of(d[0]), inverse_of(d[1]), inverse_of(d[2])] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverses_are_finite() {
        let ray = TracedRay::new(Vec3::ZERO, Vec3::new(1.0, -2.0, -0.0));
        assert_eq!(ray.inverse, [1.0, -0.5, -1e18]);
    }
}
