//! Every rule that leaves out work in a piece, against the rule being off. What each may change is in docs/skips.md.

mod geometry;

use geometry::{ao, cube, fixed, flat, mesh, square};
use glam::{DAffine3, DVec3, Vec3};
use kiln_bake::{FaceAreas, Piece, density, trace_piece};
use kiln_core::{Bounds, FaceMoments, HalfMoments, Kernel, Mesh, REACH_EPSILON, Sampling, SkipRule, Target};
use kiln_trace::{CpuTracer, MeshBvh, Scene, SceneObject};
use std::sync::Arc;

/// A strip of floor in 64 faces.
fn floor() -> Vec<[Vec3; 3]> {
    (0..32).flat_map(|i| square(Vec3::X * (i as f32 - 15.5), Vec3::Z * 4.0, Vec3::X * 0.5)).collect()
}

struct Place {
    mesh: Mesh,
    tracer: CpuTracer,
}

impl Place {
    /// A mesh that receives, and others around it.
    fn new(mesh: Mesh, others: &[Mesh]) -> Self {
        let bvhs = std::iter::once(&mesh).chain(others).map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
        let object = |mesh| SceneObject { mesh, world_from_object: DAffine3::from_translation(DVec3::Y) };
        let objects: Vec<SceneObject> = (0..=others.len()).map(object).collect();
        Self { mesh, tracer: CpuTracer::new(Arc::new(Scene::build(bvhs, &objects))) }
    }

    fn trace(&self, sampling: &Sampling, off: &[SkipRule]) -> FaceMoments {
        let sampling = &Sampling { no_skip: off.iter().copied().collect(), ..sampling.clone() };
        let place = DAffine3::from_translation(DVec3::Y);
        let density_per_m2 = density(&FaceAreas::new(&self.mesh, &place), sampling);
        let faces = 0..self.mesh.faces.len();
        let occluders_m = Bounds { min: DVec3::new(-16.0, 1.0, -4.0), max: DVec3::new(16.0, 5.0, 4.0) };
        let piece = Piece { mesh: &self.mesh, world_from_object: &place, faces, density_per_m2, sampling, occluders_m };
        trace_piece(&self.tracer, self.tracer.scene(), &piece).expect("a CPU traces")
    }
}

fn sampled(rays_per_sample: u32, half_distances_m: &[f64]) -> Sampling {
    Sampling { mean_samples_per_face: 16.0, seed: 3, ..fixed(rays_per_sample, half_distances_m) }
}

fn adaptive(rmse: f64) -> Sampling {
    let target = Some(Target::named(rmse));
    Sampling { target, mean_samples_per_face: 2.0, max_samples_per_face: 1024, ..sampled(16, &[0.5, 20.0]) }
}

fn halves(moments: &FaceMoments) -> Vec<HalfMoments> {
    (0..moments.face_count()).flat_map(|face| moments.face(face)).collect()
}

/// The floor with a crate on it, and one far away; normals lean as far as they can.
fn two_crates() -> Place {
    let lean = |at: Vec3| Vec3::new(at.x.sin(), 0.05, at.z.cos()).normalize();
    let near = cube(Vec3::new(-14.0, 0.5, 0.0), 0.5);
    let far = cube(Vec3::new(14.0, 1.5, 0.0), 1.5);
    let upright = |_: Vec3| Vec3::ZERO;
    Place::new(mesh(&floor(), false, lean), &[mesh(&near, false, upright), mesh(&far, false, upright)])
}

#[test]
fn empty_hemispheres_are_what_tracing_them_gives() {
    let upper = flat(&cube(Vec3::new(0.0, 3.0, 0.0), 1.0), false);
    let open = Place::new(upper, &[flat(&floor(), false)]);
    for place in [&two_crates(), &open] {
        let adaptive = Sampling { kernel: sampled(16, &[0.2, 0.4]).kernel, ..adaptive(0.02) };
        for sampling in [sampled(1, &[0.2]), sampled(16, &[0.2, 0.4]), adaptive] {
            let (on, off) = (place.trace(&sampling, &[]), place.trace(&sampling, &[SkipRule::Empty]));
            assert_eq!(halves(&on), halves(&off));
            let (on, off) = (on.summary, off.summary);
            assert_eq!((on.samples, on.invalid, off.rays_skipped_empty), (off.samples, off.invalid, 0));
            assert_eq!(on.rays + on.rays_skipped_empty, off.rays);
            assert!(on.rays_skipped_empty > 0 && on.rays > 0, "{on:?}");
        }
    }
    // With one ray, some samples have none above their surface; that they see nothing does not make them valid.
    let slanting = two_crates().trace(&sampled(1, &[0.2]), &[]).summary;
    assert!(slanting.invalid > 0, "{slanting:?}");
}

#[test]
fn beyond_the_reach_no_value_changes_by_more_than_its_epsilon() {
    let sampling = sampled(64, &[0.5, 1.0]);
    let place = two_crates();
    let (on, off) = (place.trace(&sampling, &[]), place.trace(&sampling, &[SkipRule::Reach]));
    let differences = halves(&on).into_iter().zip(halves(&off)).flat_map(|(on, off)| {
        assert_eq!((on.valid, on.taken), (off.valid, off.taken));
        [0, 1].map(|channel| ao(&on, channel) - ao(&off, channel))
    });
    let differences: Vec<f64> = differences.filter(|difference| difference.is_finite()).collect();
    // A miss counts as open, so that what is cut can only be lighter. Sums are rounded to f32.
    assert!(differences.iter().all(|d| (-1e-6..REACH_EPSILON + 1e-6).contains(d)), "{differences:?}");
    assert!(differences.iter().any(|d| *d > 1e-5), "the far crate is seen by nobody");
    assert!(on.summary.rays < off.summary.rays);
    // Rays end after 10 m, and the floor is 32 m long.
    assert_eq!((on.summary.rays_cut, off.summary.rays_cut), (on.summary.rays, 0));
}

#[test]
fn the_distance_of_plain_occlusion_is_no_rule() {
    let sampling = Sampling { kernel: Kernel::Occlusion { ray_distance_m: 3.0 }, ..sampled(16, &[]) };
    let place = two_crates();
    let (on, off) = (place.trace(&sampling, &[]), place.trace(&sampling, &[SkipRule::Reach]));
    assert_eq!(on, off);
    let without_end = Sampling { kernel: Kernel::Occlusion { ray_distance_m: f64::INFINITY }, ..sampling };
    assert_ne!(halves(&place.trace(&without_end, &[])), halves(&on));
}

/// Mean over the faces that can be seen.
fn mean_ao(moments: &FaceMoments, channel: usize) -> f64 {
    let seen: Vec<f64> = halves(moments).iter().filter(|half| half.valid > 0).map(|half| ao(half, channel)).collect();
    seen.iter().sum::<f64>() / seen.len() as f64
}

#[test]
fn buried_faces_are_given_up_and_the_others_are_not() {
    // Half of the floor lies under the back of another one.
    let lid = flat(&square(Vec3::new(-9.0, 0.6, 0.0), Vec3::Z * 5.0, Vec3::X * 7.0), false);
    let wall = flat(&square(Vec3::new(8.0, 1.0, -4.0), Vec3::X * 8.0, Vec3::Y), false);
    let place = Place::new(flat(&floor(), false), &[lid, wall]);
    let (rmse, sampling) = (0.004, adaptive(0.004));
    let (on, off) = (place.trace(&sampling, &[]), place.trace(&sampling, &[SkipRule::Buried]));
    let taken = |moments: &FaceMoments| {
        let all = halves(moments);
        let of = |is_buried: bool| all.iter().filter(move |half| (half.valid == 0) == is_buried);
        let mean = |is_buried| of(is_buried).map(|h| f64::from(h.taken)).sum::<f64>() / of(is_buried).count() as f64;
        (mean(true), mean(false))
    };
    let ((buried_on, _), (buried_off, seen_off)) = (taken(&on), taken(&off));
    assert!(buried_on < 0.7 * buried_off && buried_off > 0.7 * seen_off, "{buried_on} {buried_off} {seen_off}");
    assert!(on.summary.rays < off.summary.rays);
    assert!(on.summary.rays_skipped_buried > 0 && off.summary.rays_skipped_buried == 0, "{:?}", on.summary);
    for channel in 0..2 {
        assert!((mean_ao(&on, channel) - mean_ao(&off, channel)).abs() < 2.0 * rmse);
    }
}

#[test]
fn adaptive_sampling_stays_within_the_error_that_it_aims_for() {
    let wall = flat(&square(Vec3::new(0.0, 1.0, -4.0), Vec3::X * 4.0, Vec3::Y), false);
    let place = Place::new(flat(&floor(), false), &[wall]);
    let rmse = 0.01;
    let on = place.trace(&adaptive(rmse), &[]);
    let off = place
        .trace(&Sampling { mean_samples_per_face: 512.0, max_samples_per_face: 512, ..sampled(16, &[0.5, 20.0]) }, &[]);
    for channel in 0..2 {
        let mean = |moments: &FaceMoments, face| moments.face(face).iter().map(|h| ao(h, channel)).sum::<f64>() / 2.0;
        let squares = (0..64).map(|face| (mean(&on, face) - mean(&off, face)).powi(2));
        let found = (squares.sum::<f64>() / 64.0).sqrt();
        // The target is the error after the solve, which shares the samples of neighbouring faces.
        assert!(found < 3.0 * rmse, "{found}");
    }
    assert!(on.summary.rays_saved_adaptive > 0 && on.summary.rays < off.summary.rays / 4, "{:?}", on.summary);
}
