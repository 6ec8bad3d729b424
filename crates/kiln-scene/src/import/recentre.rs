//! Meshes that are modelled far from their own origin, such as a level's parts in world coordinates: rays reach a mesh
//! in f32 of its object space, so that what f32 cannot tell apart there would be lost a second time, on every ray.

use glam::{DVec3, Vec3};
use kiln_core::{Bounds, Mesh};

/// A mesh is moved along an axis on which its centre is more than this many times its extent from its origin.
const FAR: f64 = 64.0;

/// Moves a mesh near its own origin, and returns from where: its instances have to be placed there. Zero along each
/// axis on which it is near already.
///
/// What is subtracted is a multiple of a power of two above the extent, so that no position that a face uses is rounded
/// (its distance has fewer bits than itself), and small edits do not move the mesh.
pub(super) fn recentre(mesh: &mut Mesh, bounds: &mut Bounds) -> DVec3 {
    let center = center(bounds);
    if center == DVec3::ZERO {
        return center;
    }
    for position in &mut mesh.positions {
        let moved = (DVec3::from(position.map(f64::from)) - center).as_vec3();
        // What no face uses may be anywhere.
        *position = if moved.is_finite() { moved } else { Vec3::ZERO }.to_array();
    }
    *bounds = Bounds { min: bounds.min - center, max: bounds.max - center };
    center
}

fn center(bounds: &Bounds) -> DVec3 {
    let extent = if bounds.is_empty() { 0.0 } else { (bounds.max - bounds.min).max_element() };
    if extent <= 0.0 {
        return DVec3::ZERO;
    }
    let step = (extent.log2().ceil() + 1.0).exp2();
    let middle = bounds.center();
    DVec3::select(middle.abs().cmpgt(DVec3::splat(FAR * extent)), (middle / step).round() * step, DVec3::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mesh(positions: Vec<[f32; 3]>) -> (Mesh, Bounds) {
        let mut bounds = Bounds::EMPTY;
        positions.iter().for_each(|p| bounds.add(DVec3::from(p.map(f64::from))));
        (Mesh { positions, ..Mesh::default() }, bounds)
    }

    proptest! {
        #[test]
        fn nothing_is_rounded(
            offset in prop::array::uniform3(-1e7f64..1e7),
            power in -4i32..4,
            points in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 2..20),
        ) {
            let size = 10f64.powi(power);
            let place = |p: &[f64; 3]| (DVec3::from(*p) * size + DVec3::from(offset)).as_vec3().to_array();
            let (original, original_bounds) = mesh(points.iter().map(place).collect());
            let (mut moved, mut bounds) = (original.clone(), original_bounds);
            let center = recentre(&mut moved, &mut bounds);
            for (before, after) in original.positions.iter().zip(&moved.positions) {
                prop_assert_eq!(DVec3::from(before.map(f64::from)), DVec3::from(after.map(f64::from)) + center);
            }
            let extent = (bounds.max - bounds.min).max_element();
            prop_assert!(extent == 0.0 || bounds.center().abs().max_element() <= FAR * extent);
        }
    }

    #[test]
    fn what_is_near_stays() {
        let (mut near, mut bounds) = mesh(vec![[60.0, 0.0, 0.0], [61.0, 1.0, 1.0]]);
        let before = near.clone();
        assert_eq!(recentre(&mut near, &mut bounds), DVec3::ZERO);
        assert_eq!(near, before);
        assert_eq!(recentre(&mut Mesh::default(), &mut Bounds::EMPTY.clone()), DVec3::ZERO);
    }

    #[test]
    fn what_no_face_uses_may_be_anywhere() {
        let (mut far, mut bounds) = mesh(vec![[1e30, 0.0, 0.0], [1.000_01e30, 1e24, 0.0]]);
        far.positions.push([-f32::MAX, 0.0, 0.0]);
        assert!(recentre(&mut far, &mut bounds).x > 0.9e30);
        assert!(far.positions.iter().flatten().all(|coordinate| coordinate.is_finite()));
    }
}
