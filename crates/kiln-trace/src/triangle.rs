//! Watertight intersection of a ray with four triangles at once.
//!
//! Source: Woop, Benthin and Wald 2013, "Watertight ray/triangle intersection". The edge functions of a shared edge
//! are exact negatives of each other (no fused multiply-add is used), so that no ray slips through; a ray on an edge
//! (a function of exactly 0) hits both faces, so that their double-precision fall-back is not needed. The same
//! arithmetic in the same order is in `traverse.wgsl` of `kiln-gpu`: keep them in sync.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

/// Set in a primitive id whose face counts as front from either side.
pub const TWO_SIDED_BIT: u32 = 1 << 31;

/// Id of an unused lane.
pub const NO_PRIMITIVE: u32 = u32::MAX;

/// Up to four triangles, one in each lane; unused lanes are degenerate and are never hit.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TriangleBlock {
    /// Coordinates by corner, then axis.
    pub corners: [[Vec4; 3]; 3],
    /// Face index in the mesh, with [`TWO_SIDED_BIT`], or [`NO_PRIMITIVE`].
    pub primitives: [u32; 4],
}

const _: () = assert!(size_of::<TriangleBlock>() == 160);

impl TriangleBlock {
    pub(crate) const EMPTY: Self = Self { corners: [[Vec4::ZERO; 3]; 3], primitives: [NO_PRIMITIVE; 4] };

    pub(crate) fn set(&mut self, lane: usize, corners: [Vec3; 3], primitive: u32) {
        for (slots, corner) in self.corners.iter_mut().zip(corners) {
            for axis in 0..3 {
                slots[axis][lane] = corner[axis];
            }
        }
        self.primitives[lane] = primitive;
    }

    pub(crate) fn corner(&self, corner: usize, lane: usize) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|axis| self.corners[corner][axis][lane]))
    }
}

/// A ray in the form that triangles are tested with: the axes turned so that z is the direction's longest, and
/// sheared so that it is the direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShearedRay {
    axes: [usize; 3],
    shear: [f32; 3],
    origin: [f32; 3],
}

impl ShearedRay {
    pub(crate) fn new(origin: Vec3, direction: Vec3) -> Self {
        let size = direction.abs();
        let z = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        // A negative z mirrors; turning the axes back keeps the winding.
        if direction[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let shear = [direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]];
        Self { axes: [x, y, z], shear, origin: [origin[x], origin[y], origin[z]] }
    }

    /// Coordinates of a corner relative to the ray: x and y across it, z along it in units of the direction.
    fn relative(&self, corner: &[Vec4; 3]) -> [Vec4; 3] {
        let [x, y, z] = [0, 1, 2].map(|i| corner[self.axes[i]] - self.origin[i]);
        [x - z * self.shear[0], y - z * self.shear[1], z * self.shear[2]]
    }
}

/// Distances of the hits (anything where the mask is clear), whether each lane is seen from the front, and the mask
/// of lanes that are hit at `0 < t`.
pub(crate) fn intersect(block: &TriangleBlock, ray: &ShearedRay) -> (Vec4, u32, u32) {
    let [a, b, c] = [0, 1, 2].map(|corner| ray.relative(&block.corners[corner]));
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    let least = u.min(v).min(w);
    let greatest = u.max(v).max(w);
    let determinant = u + v + w;
    let inside = least.cmpge(Vec4::ZERO) | greatest.cmple(Vec4::ZERO);
    let t = (u * a[2] + v * b[2] + w * c[2]) / determinant;
    let hit = inside & determinant.cmpne(Vec4::ZERO) & t.cmpgt(Vec4::ZERO);
    (t, determinant.cmpgt(Vec4::ZERO).bitmask(), hit.bitmask())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn one(corners: [Vec3; 3], origin: Vec3, direction: Vec3) -> Option<(f32, bool)> {
        let mut block = TriangleBlock::EMPTY;
        block.set(2, corners, 5);
        let (t, front, hit) = intersect(&block, &ShearedRay::new(origin, direction));
        assert_eq!(hit & !0b100, 0, "an empty lane was hit");
        (hit != 0).then_some((t[2], front & 0b100 != 0))
    }

    #[test]
    fn front_is_counter_clockwise() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        for direction in [Vec3::NEG_Z, Vec3::new(0.1, -0.2, -3.0)] {
            let origin = Vec3::new(0.25, 0.25, 0.0) - direction * 2.0;
            let (t, front) = one(corners, origin, direction).unwrap();
            assert!((t - 2.0).abs() < 1e-6 && front);
            let (t, front) = one(corners, Vec3::new(0.25, 0.25, 0.0) + direction * 2.0, -direction).unwrap();
            assert!((t - 2.0).abs() < 1e-6 && !front);
        }
        assert_eq!(one(corners, Vec3::new(0.25, 0.25, 1.0), Vec3::Z), None);
        assert_eq!(one(corners, Vec3::new(0.75, 0.75, 1.0), Vec3::NEG_Z), None);
    }

    fn point() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-1f32..1.0).prop_map(Vec3::from_array)
    }

    proptest! {
        /// Rays through points of a shared edge, and near it, hit at least one of the two faces.
        #[test]
        fn no_ray_slips_through_a_shared_edge(a in point(), b in point(), c in point(), d in point(), origin in point(), s in 0f32..=1.0) {
            // The two faces must lie on different sides of the plane through the edge and the ray.
            let target = a + (b - a) * s;
            let plane = (b - a).cross(target - origin);
            let side = |p: Vec3| plane.dot(p - a);
            let mirrored = |p: Vec3| a + a - p;
            let c = if side(c) > 0.0 { c } else { mirrored(c) };
            let d = if side(d) < 0.0 { d } else { mirrored(d) };
            prop_assume!(side(c) > 1e-3 && side(d) < -1e-3 && (target - origin).length() > 1e-2);
            prop_assume!((0.001..0.999).contains(&s));
            let direction = target - origin;
            let hits = [one([a, b, c], origin, direction), one([b, a, d], origin, direction)];
            prop_assert!(hits.iter().any(Option::is_some));
        }

        /// A coincident face of opposite winding has bit for bit the same distance.
        #[test]
        fn opposite_faces_tie(a in point(), b in point(), c in point(), origin in point(), direction in point()) {
            prop_assume!(direction.length() > 0.1);
            let one_way = one([a, b, c], origin, direction);
            let other_way = one([a, c, b], origin, direction);
            prop_assert_eq!(one_way.is_some(), other_way.is_some());
        }

        /// Against the plane equation in f64.
        #[test]
        fn distances_match_the_plane(a in point(), b in point(), c in point(), origin in point(), s in 0.05f32..0.9, r in 0.05f32..0.9) {
            prop_assume!(s + r < 0.95);
            let normal = (b - a).as_dvec3().cross((c - a).as_dvec3());
            let target = a + (b - a) * s + (c - a) * r;
            let direction = target - origin;
            let slope = normal.dot(direction.as_dvec3());
            prop_assume!(slope.abs() > 0.02);
            let expected = normal.dot((a - origin).as_dvec3()) / slope;
            let (t, front) = one([a, b, c], origin, direction).expect("aimed inside");
            prop_assert!((f64::from(t) - expected).abs() < 1e-4, "{t} {expected}");
            prop_assert_eq!(front, slope < 0.0);
        }
    }
}
