//! Meshes and settings that the tests of pieces share.

use glam::Vec3;
use kiln_core::{FaceGroup, HalfMoments, Kernel, Mesh, Sampling};
use std::collections::BTreeSet;

/// Triangles, each with corners of its own that have these normals; a normal of zero is the face's.
pub(crate) fn mesh(triangles: &[[Vec3; 3]], double_sided: bool, normal: impl Fn(Vec3) -> Vec3) -> Mesh {
    let group = FaceGroup { double_sided, ..FaceGroup::PLAIN };
    let corners = || triangles.iter().flatten();
    Mesh {
        positions: corners().map(Vec3::to_array).collect(),
        normals: corners().map(|corner| normal(*corner).to_array()).collect(),
        faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        face_group: vec![0; triangles.len()],
        groups: vec![group],
        ..Mesh::default()
    }
}

/// Triangles with the normals of their faces.
pub(crate) fn flat(triangles: &[[Vec3; 3]], double_sided: bool) -> Mesh {
    mesh(triangles, double_sided, |_| Vec3::ZERO)
}

/// A square of two faces in the plane spanned by u and v, seen from u × v.
pub(crate) fn square(center: Vec3, u: Vec3, v: Vec3) -> [[Vec3; 3]; 2] {
    let [a, b, c, d] = [center - u - v, center + u - v, center + u + v, center - u + v];
    [[a, b, c], [a, c, d]]
}

pub(crate) fn cube(center: Vec3, half: f32) -> Vec<[Vec3; 3]> {
    let axes = [Vec3::X, Vec3::Y, Vec3::Z].map(|a| a * half);
    let side = |i: usize, sign: f32| square(center + axes[i] * sign, axes[(i + 1) % 3] * sign, axes[(i + 2) % 3]);
    (0..3).flat_map(|i| [side(i, 1.0), side(i, -1.0)]).flatten().collect()
}

/// The same number of samples, by area, whatever they find: 8 on average.
pub(crate) fn fixed(rays_per_sample: u32, half_distances_m: &[f64]) -> Sampling {
    Sampling {
        target: None,
        kernel: Kernel::Obscurance { half_distances_m: half_distances_m.to_vec() },
        rays_per_sample,
        mean_samples_per_face: 8.0,
        density_per_m2: None,
        min_samples_per_face: 2,
        max_samples_per_face: 64,
        back_face_limit: 0.25,
        seed: 7,
        foliage: kiln_core::FoliageMode::default(),
        ground_plane_y_m: None,
        no_skip: BTreeSet::new(),
    }
}

/// Mean of a half's values.
pub(crate) fn ao(half: &HalfMoments, channel: usize) -> f64 {
    half.phi_f[channel].iter().sum::<f64>() / f64::from(half.valid)
}
