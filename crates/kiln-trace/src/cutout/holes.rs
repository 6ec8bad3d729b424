//! What a texture says where a ray crosses a face.
//!
//! The place on the face comes from the volumes that the ray's direction spans with two corners each, in f64 from the ray and
//! the corners as they are traced: it owes nothing to the hit's distance, which has 18 bits. What is left is the rounding of
//! the ray's way into object space and of the texture coordinates, which are f32: a hit within some 1e-6 of an edge between
//! texels may be taken for the other side's.

use crate::{mesh_bvh::corner_order, ray::TracedRay, triangle::face_of};
use glam::{DVec3, Vec3};
use kiln_core::{Mask, Mesh};
use std::sync::Arc;

/// Of a face without a texture.
const NONE: u32 = u32::MAX;

/// The holes of a mesh's faces.
#[derive(Debug)]
pub(crate) struct Holes {
    /// For each face of the mesh its index in `faces`, or [`NONE`].
    of_face: Box<[u32]>,
    faces: Vec<TexturedFace>,
    masks: Vec<Arc<Mask>>,
}

#[derive(Clone, Copy, Debug)]
struct TexturedFace {
    /// Of the corners, in the order in which they are traced.
    corners: [[f32; 2]; 3],
    mask: u16,
}

impl Holes {
    /// Of all faces of a mesh that have a mask.
    pub(crate) fn of(mesh: &Mesh) -> Self {
        let mut of_face = vec![NONE; mesh.faces.len()].into_boxed_slice();
        let mut faces = Vec::with_capacity(mesh.cutouts.corners.len());
        for cutout in mesh.cutout_faces() {
            of_face[cutout.face] = faces.len() as u32;
            let (order, _) = corner_order(mesh.corners(cutout.face));
            faces.push(TexturedFace { corners: order.map(|corner| cutout.corners[corner]), mask: cutout.mask });
        }
        Self { of_face, faces, masks: mesh.cutouts.masks.clone() }
    }

    /// Whether a face is there where a ray crosses it; `corners` are in the order in which they are traced.
    pub(crate) fn is_there(&self, primitive: u32, corners: [Vec3; 3], ray: &TracedRay) -> bool {
        let Some(face) = self.faces.get(self.of_face[face_of(primitive) as usize] as usize) else { return true };
        let Some(mask) = self.masks.get(usize::from(face.mask)) else { return true };
        let weights = weights(corners, ray);
        let coordinate = |axis: usize| {
            let [a, b, c] = face.corners.map(|corner| f64::from(corner[axis]));
            weights[0] * a + weights[1] * b + weights[2] * c
        };
        mask.is_opaque([coordinate(0), coordinate(1)])
    }

    /// Memory of the texture coordinates, bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        size_of_val(&*self.of_face) + size_of_val(self.faces.as_slice())
    }
}

/// How much each corner of a triangle counts where the line of a ray goes through it; the sum is 1.
fn weights(corners: [Vec3; 3], ray: &TracedRay) -> [f64; 3] {
    let [origin, direction] = [ray.origin, ray.direction].map(|v| Vec3::from_array(v).as_dvec3());
    let [a, b, c] = corners.map(|corner| corner.as_dvec3() - origin);
    let volume = |p: DVec3, q: DVec3| direction.dot(p.cross(q));
    let [u, v, w] = [volume(b, c), volume(c, a), volume(a, b)];
    let sum = u + v + w;
    [u / sum, v / sum, w / sum]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn weights_are_those_of_the_point_aimed_at(
            corners: [[i8; 3]; 3], origin in prop::array::uniform3(-300f32..300.0), s in 0.0f32..1.0, r in 0.0f32..1.0,
        ) {
            let corners = corners.map(|corner| Vec3::from_array(corner.map(f32::from)));
            let [a, b, c] = corners;
            let (origin, weight_b, weight_c) = (Vec3::from_array(origin), s * (1.0 - r), r);
            let direction = a + (b - a) * weight_b + (c - a) * weight_c - origin;
            let normal = (b - a).cross(c - a);
            prop_assume!(normal.length() > 30.0 && normal.normalize().dot(direction.normalize()).abs() > 0.05);
            let [u, v, w] = weights(corners, &TracedRay::new(origin, direction));
            prop_assert!((u + v + w - 1.0).abs() < 1e-9);
            prop_assert!((v - f64::from(weight_b)).abs() < 1e-3 && (w - f64::from(weight_c)).abs() < 1e-3, "{u} {v} {w}");
        }
    }
}
