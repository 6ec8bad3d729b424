//! A ray in the forms that boxes and triangles are tested with.

use glam::Vec3;

/// Widens a far distance beyond the rounding error of the slab test, 1 + 2γ₃ and a little more (Ize 2013, "Robust BVH ray
/// traversal").
pub(crate) const WIDEN: f32 = 1.000_000_6;

/// Widens the distance of a hit: what is entered this little behind it may tie with it, distances being rounded to 18 bits.
/// It is enough too for the boxes of instances, whose rays are rounded on their way into object space.
pub(crate) const HIT_SLACK: f32 = 1.000_008;

/// Directions shorter than this along an axis count as this long in box tests only, so that no 0 · ∞ occurs.
const LEAST_DIRECTION: f32 = 1e-18;

/// A ray as it is traced through one tree.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TracedRay {
    pub(crate) origin: [f32; 3],
    pub(crate) direction: [f32; 3],
    /// One over the direction.
    pub(crate) inverse: [f32; 3],
    /// Row of a node's bounds that has the near plane of each axis, below 6; the far one is 3 on or back.
    pub(crate) near: [u8; 3],
    /// The axes turned so that z is the direction's longest.
    pub(crate) axes: [u8; 3],
    /// Shear that makes the direction z.
    pub(crate) shear: [f32; 2],
    /// The origin, its axes turned.
    pub(crate) turned_origin: [f32; 3],
}

impl TracedRay {
    #[inline(always)]
    pub(crate) fn new(origin: Vec3, direction: Vec3) -> Self {
        let (origin, d) = (origin.to_array(), direction.to_array());
        let mut inverse = [0.0; 3];
        let mut near = [0; 3];
        for axis in 0..3 {
            let safe = if d[axis].abs() < LEAST_DIRECTION { LEAST_DIRECTION.copysign(d[axis]) } else { d[axis] };
            inverse[axis] = 1.0 / safe;
            near[axis] = axis as u8 + if inverse[axis] < 0.0 { 3 } else { 0 };
        }
        let size = [d[0].abs(), d[1].abs(), d[2].abs()];
        let z = if size[0] > size[1] && size[0] > size[2] {
            0
        } else if size[1] > size[2] {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        // A negative z mirrors; turning the axes back keeps the winding.
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        Self {
            origin,
            direction: d,
            inverse,
            near,
            axes: [x as u8, y as u8, z as u8],
            shear: [d[x] / d[z], d[y] / d[z]],
            turned_origin: [origin[x], origin[y], origin[z]],
        }
    }

    /// Row of the far plane of an axis.
    #[inline(always)]
    pub(crate) fn far(&self, axis: usize) -> usize {
        // The near row is `axis` or `axis` + 3.
        2 * axis + 3 - usize::from(self.near[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_those_of_the_octant() {
        let ray = TracedRay::new(Vec3::ZERO, Vec3::new(1.0, -2.0, 0.0));
        assert_eq!((ray.near, [0, 1, 2].map(|axis| ray.far(axis))), ([0, 4, 2], [3, 1, 5]));
        assert_eq!((ray.axes, ray.shear), ([0, 2, 1], [-0.5, -0.0]));
    }
}
