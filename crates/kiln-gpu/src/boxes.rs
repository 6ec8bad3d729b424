//! The boxes that ray queries find: one for each run of triangles of a mesh, grown by what rounding may do to a ray.
//!
//! # The margin
//!
//! A ray that our own test says hits a triangle must enter the triangle's box in the hardware's arithmetic. Two things are
//! rounded on the way there: our ray in object space, which [`kiln_trace::PositionError`] bounds by 16 units of 2⁻²⁴ of the terms that are summed, and
//! the hardware's, which no vendor bounds. The sum of both is *assumed* to be at most 2⁻¹⁸ (64 units of 2⁻²⁴) of
//!
//! `|M⁻¹| |M| (|M⁻¹| (w + |T|) + |t| + b)`
//!
//! along each axis of object space, where `M` and `T` take an instance to the world and `M⁻¹` and `t` back, `w` is the greatest coordinate of a ray's
//! origin or of a point of the scene, and `b` that of the mesh. Inside the parentheses is the sum of all terms on a ray's way into
//! object space; the factor before it is what inverting a matrix in f32 may add (Higham 2002, "Accuracy and Stability of
//! Numerical Algorithms", 14.1). Where several instances share a mesh the greatest of their margins counts.
//!
//! Origins that lie further out than `w` are refused before they are traced: our own rounding grows with the distance, too.

use crate::layout::Layout;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use kiln_trace::{BvhChild, MeshBvh, Place, Scene};
use std::ops::Range;

/// Bound on what rounding does to a ray, relative to the terms that are summed.
const ROUNDING: f64 = 1.0 / 262_144.0;
/// Rays may start so many times further out than the scene reaches,
const ORIGIN_FACTOR: f64 = 4.0;
/// or so far, metres, where that is more.
const LEAST_REACH_M: f64 = 64.0;

/// Least and greatest corner, as the driver reads them.
pub(crate) type BoxCorners = [[f32; 3]; 2];

/// An instance as ray queries see it.
pub(crate) struct PlacedMesh {
    pub(crate) index: u32,
    pub(crate) mesh: usize,
    /// Rows.
    pub(crate) world_from_object: [f32; 12],
}

/// What acceleration structures of a scene are made of.
pub(crate) struct Boxes<'a> {
    scene: &'a Scene,
    layout: &'a Layout<'a>,
    /// The instances that a ray can hit.
    pub(crate) placed: Vec<PlacedMesh>,
    /// Margin of each mesh's boxes; `None` where no instance that can be hit has it.
    margins: Vec<Option<DVec3>>,
    /// Greatest coordinate of a ray's origin, metres.
    pub(crate) origin_reach: f32,
}

impl<'a> Boxes<'a> {
    #[expect(clippy::cast_possible_truncation, reason = "the driver's transforms are f32, which the margin allows for")]
    pub(crate) fn of(scene: &'a Scene, layout: &'a Layout<'a>) -> Self {
        let reach = origin_reach(scene);
        let mut margins = vec![None; scene.meshes.len()];
        let mut placed = Vec::with_capacity(layout.top.leaf_records.len());
        for &(_, index) in &layout.top.leaf_records {
            let instance = &scene.instances[index as usize];
            let mesh = instance.mesh();
            let object_from_world = affine(&instance.place);
            let own = margin(&object_from_world, reach, extent(&scene.meshes[mesh]));
            let shared = margins[mesh].get_or_insert(own);
            *shared = own.max(*shared);
            let back = object_from_world.inverse();
            let columns = [back.matrix3.x_axis, back.matrix3.y_axis, back.matrix3.z_axis, back.translation];
            let world_from_object = std::array::from_fn(|i| columns[i % 4][i / 4] as f32);
            placed.push(PlacedMesh { index, mesh, world_from_object });
        }
        Self { scene, layout, placed, margins, origin_reach: reach as f32 }
    }

    /// The boxes of a mesh, in the order of its table; none where no instance can be hit.
    pub(crate) fn of_mesh(&self, mesh: usize) -> Vec<BoxCorners> {
        let Some(margin) = self.margins[mesh] else { return Vec::new() };
        let tree = &self.layout.meshes[mesh];
        let bvh = &self.scene.meshes[mesh];
        let grown = |run: Range<u32>| {
            let triangles = &tree.leaves[run.start as usize..run.end as usize];
            let corners = triangles.iter().flat_map(|&triangle| bvh.triangle(triangle).0);
            let inside = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            let (min, max) = corners.fold(inside, |(min, max), corner| (min.min(corner), max.max(corner)));
            outwards(min.as_dvec3() - margin, max.as_dvec3() + margin)
        };
        tree.runs().map(grown).collect()
    }

    /// Meshes, whether they have boxes or not.
    pub(crate) fn mesh_count(&self) -> usize {
        self.margins.len()
    }
}

/// Rounds corners to f32 so that nothing is lost.
#[expect(clippy::cast_possible_truncation, reason = "the next number is further out")]
fn outwards(min: DVec3, max: DVec3) -> BoxCorners {
    let low = min.to_array().map(|x| (x as f32).next_down().max(f32::MIN));
    let high = max.to_array().map(|x| (x as f32).next_up().min(f32::MAX));
    [low, high]
}

/// How far from the level's origin rays may start, along any axis, metres; so do rays that start on or around foliage.
fn origin_reach(scene: &Scene) -> f64 {
    let roots = (!scene.is_empty()).then(|| scene.children(0)).into_iter().flatten();
    let foliage = scene.foliage().into_iter().flat_map(|foliage| foliage.children(0));
    let farthest = |child: BvhChild| child.min.abs().max(child.max.abs()).max_element();
    let greatest = roots.chain(foliage).map(farthest).fold(0f32, f32::max);
    (ORIGIN_FACTOR * f64::from(greatest)).clamp(LEAST_REACH_M, f64::from(f32::MAX))
}

/// Greatest absolute coordinate along each axis, object space.
fn extent(mesh: &MeshBvh) -> DVec3 {
    mesh.bounds.min.abs().max(mesh.bounds.max.abs())
}

fn affine(place: &Place) -> DAffine3 {
    let [x, y, z] = place.object_from_world.map(|row| row.map(f64::from));
    let column = |i: usize| DVec3::new(x[i], y[i], z[i]);
    DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
}

/// See the module's documentation.
fn margin(object_from_world: &DAffine3, reach: f64, extent: DVec3) -> DVec3 {
    let abs = |m: DMat3| DMat3::from_cols(m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs());
    let back = object_from_world.inverse();
    let (into, out) = (abs(object_from_world.matrix3), abs(back.matrix3));
    let terms = into * (DVec3::splat(reach) + back.translation.abs()) + object_from_world.translation.abs() + extent;
    into * (out * terms) * ROUNDING
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn margins_follow_scale_and_place() {
        let at = |scale: f64, place: f64| {
            let out = DAffine3::from_scale_rotation_translation(
                DVec3::splat(scale),
                DQuat::from_rotation_z(0.3),
                DVec3::X * place,
            );
            margin(&out.inverse(), 100.0, DVec3::ONE).max_element()
        };
        let (near, far, small) = (at(1.0, 0.0), at(1.0, 1e5), at(0.01, 0.0));
        assert!((64.0..1024.0).contains(&(near / (100.0 * 2f64.powi(-24)))), "{near}");
        assert!(far > 500.0 * near && small > 50.0 * near, "{near} {far} {small}");
        let identity = margin(&DAffine3::IDENTITY, 100.0, DVec3::ONE);
        assert_eq!(identity, DVec3::splat(101.0 / 262_144.0));
    }

    #[test]
    fn boxes_are_rounded_outwards() {
        let [low, high] = outwards(DVec3::splat(0.1), DVec3::splat(1e39));
        assert!(f64::from(low[0]) < 0.1 && high[1] == f32::MAX);
    }
}
