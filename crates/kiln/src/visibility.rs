//! What of a baked file can be seen, found by tracing it: no bake leaves that in its file.
//!
//! The parts that have `_AO` are sampled as a bake samples them, with its own code: 16 rays at each sample, which is hidden
//! if more than a quarter of them meet the back of a face (Sloan et al. 2013, section 2.1). The part of a face that can be
//! seen is the part of its samples that are not hidden: a fair estimate, if a coarse one for a face of two samples, and
//! what is weighed by it are sums over many faces.
//!
//! The file is all there is to go by: classes of a sidecar, `--ground-plane` and another `--back-face-limit` are not in it,
//! so all geometry occludes; and rays are spread about the face's own normal.

use crate::{
    failure::Failure,
    one_mesh::{one_mesh, scene_of},
};
use glam::{DAffine3, DVec3};
use kiln_bake::{FaceAreas, Piece, density, trace_piece};
use kiln_core::{BakeSettings, FaceMoments, Kernel, Mesh, Sampling};
use kiln_scene::BakedScene;
use kiln_trace::CpuTracer;
use rayon::prelude::*;

/// Samples in all, so that large levels take seconds and small ones are not coarse.
const SAMPLES: f64 = 262_144.0;

/// Samples per face on average, at least and at most.
const SAMPLES_PER_FACE: [f64; 2] = [2.0, 16.0];

/// Faces that are traced at a time.
const FACES_AT_A_TIME: usize = 1024;

/// The part of each face that can be seen, 0 to 1, for each part of a scene; empty for parts without `_AO`.
pub(crate) fn visible_parts(scene: &BakedScene) -> Result<Vec<Vec<f64>>, Failure> {
    let mesh = one_mesh(scene, center(scene), |part| part.channels > 0);
    let (scene_traced, place) = (scene_of(&mesh), DAffine3::IDENTITY);
    let tracer = CpuTracer::new(scene_traced.clone());
    let sampling = sampling(scene, &mesh);
    let density_per_m2 = density(&FaceAreas::new(&mesh, &place), &sampling);
    let piece = |first: usize| {
        let faces = first..mesh.faces.len().min(first + FACES_AT_A_TIME);
        let piece = Piece {
            mesh: &mesh,
            world_from_object: &place,
            faces,
            density_per_m2,
            sampling: &sampling,
            occluders_m: kiln_core::Bounds::EMPTY,
        };
        trace_piece(&tracer, &scene_traced, &piece)
    };
    let starts: Vec<usize> = (0..mesh.faces.len()).step_by(FACES_AT_A_TIME).collect();
    let pieces: Vec<FaceMoments> =
        starts.into_par_iter().map(piece).collect::<Result<_, _>>().map_err(anyhow::Error::from)?;
    let mut visible = pieces.iter().flat_map(|piece| (0..piece.face_count()).map(|face| visible_part(piece, face)));
    let parts = scene.parts.iter().map(|part| {
        let of_part: Vec<f64> = visible.by_ref().take(part.faces.len()).collect();
        if part.channels > 0 { of_part } else { Vec::new() }
    });
    Ok(parts.collect())
}

/// The part of a face's samples that are valid; 0 for a face that has none.
fn visible_part(moments: &FaceMoments, face: usize) -> f64 {
    let halves = moments.face(face);
    let [valid, taken] = [halves[0].valid + halves[1].valid, halves[0].taken + halves[1].taken];
    if taken > 0 { f64::from(valid) / f64::from(taken) } else { 0.0 }
}

/// The middle of all faces.
fn center(scene: &BakedScene) -> DVec3 {
    let corners = scene.parts.iter().flat_map(|part| part.faces.iter().flatten().map(|&v| part.positions[v as usize]));
    let [low, high] = corners.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[a, b], p| [a.min(p), b.max(p)]);
    let center = 0.5 * (low + high);
    if center.is_finite() { center } else { DVec3::ZERO }
}

/// How the faces are sampled: as many samples on each by its area, their reach that of the bake.
fn sampling(scene: &BakedScene, mesh: &Mesh) -> Sampling {
    let receiving = (0..mesh.faces.len()).filter(|&face| mesh.group(face).receives).count();
    let [least, most] = SAMPLES_PER_FACE;
    let kernel = if scene.half_distances_m.is_empty() {
        Kernel::Occlusion { ray_distance_m: f64::INFINITY }
    } else {
        Kernel::Obscurance { half_distances_m: scene.half_distances_m.clone() }
    };
    Sampling {
        kernel,
        rays_per_sample: 16,
        target: None,
        mean_samples_per_face: (SAMPLES / receiving.max(1) as f64).clamp(least, most),
        density_per_m2: None,
        min_samples_per_face: 2,
        max_samples_per_face: 256,
        back_face_limit: BakeSettings::default().back_face_limit,
        seed: 0,
        foliage: kiln_core::FoliageMode::default(),
        ground_plane_y_m: None,
        no_skip: Default::default(),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use kiln_scene::BakedPart;

    /// A box with outward faces, all values 0.5.
    pub(crate) fn boxed(low: DVec3, high: DVec3) -> BakedPart {
        let positions =
            (0..8).map(|i| DVec3::select(glam::BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), high, low)).collect();
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        BakedPart {
            node: "box".into(),
            mesh: "box".into(),
            primitive: 0,
            positions,
            faces: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
            double_sided: false,
            channels: 1,
            ao: vec![0.5; 8],
            residual_channels: 0,
            residual: Vec::new(),
        }
    }

    pub(crate) fn scene(parts: Vec<BakedPart>) -> BakedScene {
        BakedScene { half_distances_m: vec![2.0], parts, lods: Vec::new(), unreadable: Vec::new() }
    }

    #[test]
    fn what_is_inside_another_box_is_hidden() {
        let outer = boxed(DVec3::splat(-1.0), DVec3::splat(1.0));
        let inner = boxed(DVec3::splat(-0.3), DVec3::splat(0.3));
        let visible = visible_parts(&scene(vec![outer.clone(), inner.clone()])).ok();
        assert_eq!(visible, Some(vec![vec![1.0; 12], vec![0.0; 12]]));
        // Without values nobody asks, but it still hides what is in it.
        let plain = BakedPart { channels: 0, ao: Vec::new(), ..outer.clone() };
        assert_eq!(visible_parts(&scene(vec![plain, inner.clone()])).ok(), Some(vec![vec![], vec![0.0; 12]]));
        // A box that is seen from both sides has no inside that would be hidden.
        let sheet = BakedPart { double_sided: true, ..outer };
        assert_eq!(visible_parts(&scene(vec![sheet, inner])).ok(), Some(vec![vec![1.0; 12]; 2]));
    }

    #[test]
    fn a_box_half_in_the_ground_is_half_hidden_far_from_the_origin() {
        let at = DVec3::new(3e6, -2e6, 0.0);
        let ground = boxed(at - DVec3::new(20.0, 10.0, 20.0), at + DVec3::new(20.0, 0.0, 20.0));
        let half_in = boxed(at - 1.0, at + 1.0);
        let visible = visible_parts(&scene(vec![ground, half_in])).ok().unwrap_or_default();
        let walls: f64 = visible[1][..4].iter().chain(&visible[1][8..]).sum::<f64>() / 8.0;
        assert!((walls - 0.5).abs() < 0.1, "{walls}");
        // The bottom is hidden, the top is not.
        assert_eq!(visible[1][4..8], [0.0, 0.0, 1.0, 1.0]);
        assert!(visible_parts(&scene(Vec::new())).is_ok_and(|parts| parts.is_empty()));
    }
}
