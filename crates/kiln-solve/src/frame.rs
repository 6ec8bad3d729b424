//! The frame in which one instance is solved: world orientation, about the mesh's own centre, lengths near 1.
//!
//! The instance's translation is left out, so an instance 10⁷ m from the origin is solved exactly as one at the
//! origin; and lengths are divided by a power of two, so squares of areas neither overflow nor vanish.

use glam::{DAffine3, DMat3, DVec3};
use kiln_core::Mesh;

/// From object space to the frame of the solve.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    center: DVec3,
    linear: DMat3,
    cofactor: DMat3,
    /// Metres in one unit of the frame: a power of two.
    pub unit_m: f64,
}

impl Frame {
    /// The frame of an instance of a mesh, or `None` where the transform or the positions leave no finite extent.
    pub fn new(mesh: &Mesh, world_from_object: &DAffine3) -> Option<Self> {
        let bounds = mesh.bounds();
        let matrix = world_from_object.matrix3;
        let scale = power_of_two(matrix.to_cols_array().into_iter().fold(0.0, |max, v| f64::max(max, v.abs())))?;
        let extent = power_of_two((bounds.max - bounds.min).max_element())?;
        let unit_m = scale * extent;
        if !(world_from_object.is_finite() && unit_m.is_normal()) {
            return None;
        }
        let m = matrix * (1.0 / scale);
        let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
        Some(Self { center: bounds.center(), linear: m * (1.0 / extent), cofactor, unit_m })
    }

    /// A position of the mesh in the frame.
    pub fn point(&self, position: [f32; 3]) -> DVec3 {
        self.linear * (DVec3::from(position.map(f64::from)) - self.center)
    }

    /// A unit normal of the mesh in the frame, by the inverse transpose up to a factor; `None` where it is zero,
    /// not finite or lost by a flat transform.
    pub fn normal(&self, normal: [f32; 3]) -> Option<DVec3> {
        (self.cofactor * DVec3::from(normal.map(f64::from))).try_normalize()
    }
}

/// The greatest power of two that is not above a positive normal number.
fn power_of_two(value: f64) -> Option<f64> {
    const EXPONENT: u64 = 0x7ff0_0000_0000_0000;
    (value > 0.0 && value.is_normal()).then(|| f64::from_bits(value.to_bits() & EXPONENT))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh() -> Mesh {
        Mesh { positions: vec![[0.0; 3], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]], faces: vec![[0, 1, 2]], ..Mesh::default() }
    }

    #[test]
    fn translation_changes_no_bit() {
        let near = Frame::new(&mesh(), &DAffine3::from_scale(DVec3::splat(0.7))).unwrap();
        let mut moved = DAffine3::from_scale(DVec3::splat(0.7));
        moved.translation = DVec3::new(1e7, -2e7, 3.0);
        let far = Frame::new(&mesh(), &moved).unwrap();
        assert_eq!(near.point([1.0, 2.0, 3.0]), far.point([1.0, 2.0, 3.0]));
    }

    #[test]
    fn unit_is_the_scale() {
        for scale in [1e-3, 1.0, 1e4, 1e100] {
            let frame = Frame::new(&mesh(), &DAffine3::from_scale(DVec3::splat(scale))).unwrap();
            let edge = (frame.point([3.0, 0.0, 0.0]) - frame.point([0.0; 3])).length();
            assert!((0.5..8.0).contains(&edge), "{edge}");
            assert!((edge * frame.unit_m / (3.0 * scale) - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn normals_follow_the_faces() {
        let skew = DAffine3::from_mat3(DMat3::from_cols(
            DVec3::new(1.0, 0.2, 0.0),
            DVec3::new(0.0, 2.0, 0.3),
            DVec3::new(0.1, 0.0, -3.0),
        ));
        let frame = Frame::new(&mesh(), &skew).unwrap();
        let [a, b, c] = mesh().positions[..].try_into().map(|p: [[f32; 3]; 3]| p.map(|p| frame.point(p))).unwrap();
        let face = (b - a).cross(c - a).normalize();
        assert!(frame.normal([0.0, 0.0, 1.0]).unwrap().distance(face) < 1e-14);
        assert_eq!(frame.normal([0.0; 3]), None);
        assert_eq!(frame.normal([f32::NAN, 0.0, 0.0]), None);
    }

    #[test]
    fn refuses_what_has_no_extent() {
        for matrix in [
            DMat3::ZERO,
            DMat3::from_diagonal(DVec3::splat(f64::NAN)),
            DMat3::from_diagonal(DVec3::splat(f64::INFINITY)),
        ] {
            assert!(Frame::new(&mesh(), &DAffine3::from_mat3(matrix)).is_none());
        }
        assert!(Frame::new(&Mesh::default(), &DAffine3::IDENTITY).is_none());
    }
}
