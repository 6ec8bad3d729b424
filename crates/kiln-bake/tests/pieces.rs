//! Laws of trace tasks, on scenes made here.

mod geometry;

use geometry::{ao, cube, fixed, flat, square};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_bake::{FaceAreas, Piece, ProbePoint, density, probe, trace_piece};
use kiln_core::{Bounds, Digest, FaceMoments, Kernel, Mesh, Sampling, Target};
use kiln_trace::{CpuTracer, MeshBvh, Scene, SceneObject};
use std::sync::Arc;

struct Fixture {
    meshes: Vec<Mesh>,
    places: Vec<(usize, DAffine3)>,
}

impl Fixture {
    fn tracer(&self) -> CpuTracer {
        let bvhs = self.meshes.iter().map(|m| Arc::new(MeshBvh::build(m))).collect();
        let objects: Vec<SceneObject> =
            self.places.iter().map(|&(mesh, world_from_object)| SceneObject { mesh, world_from_object }).collect();
        CpuTracer::new(Arc::new(Scene::build(bvhs, &objects)))
    }

    fn trace(&self, instance: usize, faces: std::ops::Range<usize>, sampling: &Sampling) -> FaceMoments {
        let (mesh, place) = &self.places[instance];
        let mesh = &self.meshes[*mesh];
        let density_per_m2 = density(&FaceAreas::new(mesh, place), sampling);
        let tracer = self.tracer();
        let piece =
            Piece { mesh, world_from_object: place, faces, density_per_m2, sampling, occluders_m: Bounds::EMPTY };
        trace_piece(&tracer, tracer.scene(), &piece).expect("a CPU traces")
    }
}

/// A floor with crates that stand in each other, one of them mirrored and stretched.
fn crates() -> Fixture {
    let place =
        |s: DVec3, angle: f64, t: DVec3| DAffine3::from_scale_rotation_translation(s, DQuat::from_rotation_y(angle), t);
    Fixture {
        meshes: vec![
            flat(&square(Vec3::ZERO, Vec3::Z * 5.0, Vec3::X * 5.0), false),
            flat(&cube(Vec3::ZERO, 0.5), false),
        ],
        places: vec![
            (0, DAffine3::IDENTITY),
            (1, place(DVec3::ONE, 0.3, DVec3::new(0.0, 0.4, 0.0))),
            (1, place(DVec3::new(-1.0, 1.5, 0.7), 1.0, DVec3::new(0.6, 0.6, 0.2))),
        ],
    }
}

#[test]
fn pieces_make_the_whole() {
    let scene = crates();
    let sampling = fixed(16, &[0.5, 20.0]);
    for instance in 0..3 {
        let faces = scene.meshes[scene.places[instance].0].faces.len();
        let whole = scene.trace(instance, 0..faces, &sampling);
        let mut parts = FaceMoments::new(2);
        for face in 0..faces {
            parts.append(&scene.trace(instance, face..face + 1, &sampling));
        }
        assert_eq!(whole, parts);
    }
}

#[test]
fn faces_keep_their_moments_when_others_come_or_go() {
    let mut scene = crates();
    let sampling = fixed(16, &[0.5, 20.0]);
    let before = scene.trace(1, 0..12, &sampling);
    // Reversing the faces of the crate reverses the moments, and changes nothing else.
    {
        let part = &mut scene.meshes[1].faces;
        part.reverse();
    }
    let after = scene.trace(1, 0..12, &sampling);
    for face in 0..12 {
        assert_eq!(before.face(face), after.face(11 - face));
    }
}

#[test]
fn halves_are_independent_and_unbiased() {
    // A floor under a large parallel ceiling at height 2: AO = 1 − 2 E3(ln 2) at d = 2 is .6646399464.
    let floor = square(Vec3::ZERO, Vec3::Z * 0.5, Vec3::X * 0.5);
    let ceiling = square(Vec3::Y * 2.0, Vec3::X * 2000.0, Vec3::Z * 2000.0);
    let scene = Fixture {
        meshes: vec![flat(&floor, false), flat(&ceiling, false)],
        places: vec![(0, DAffine3::IDENTITY), (1, DAffine3::IDENTITY)],
    };
    let mut sampling = fixed(32, &[2.0]);
    sampling.density_per_m2 = Some(128.0);
    let mut errors = Vec::new();
    for seed in 0..40 {
        sampling.seed = seed;
        let moments = scene.trace(0, 0..2, &sampling);
        for face in 0..2 {
            let halves = moments.face(face);
            assert_eq!(halves.map(|h| (h.valid, h.taken)), [(32, 32); 2]);
            errors.push(halves.map(|h| ao(&h, 0) - 0.664_639_946_4));
        }
    }
    let n = errors.len() as f64;
    let mean = |f: &dyn Fn(&[f64; 2]) -> f64| errors.iter().map(f).sum::<f64>() / n;
    let variance = mean(&|e| 0.5 * (e[0] * e[0] + e[1] * e[1]));
    assert!(variance.sqrt() < 2e-3, "{}", variance.sqrt());
    assert!(mean(&|e| 0.5 * (e[0] + e[1])).abs() < 4.0 * (variance / (2.0 * n)).sqrt() + 5e-6);
    // Correlation of the halves is within four standard errors of none.
    assert!((mean(&|e| e[0] * e[1]) / variance).abs() < 4.0 / n.sqrt());
}

#[test]
fn buried_faces_are_invalid_and_mirrored_ones_are_not() {
    let mut scene = crates();
    let mirrored = scene.places.remove(2);
    scene.places.remove(0);
    // A crate of a tenth the size in the middle of another sees back faces only.
    let place = (DVec3::splat(0.1), DQuat::IDENTITY, DVec3::new(0.0, 0.4, 0.0));
    scene.places.push((1, DAffine3::from_scale_rotation_translation(place.0, place.1, place.2)));
    let sampling = fixed(16, &[0.5]);
    let buried = scene.trace(1, 0..12, &sampling);
    assert_eq!(buried.summary.invalid, buried.summary.samples);
    assert!((0..12).all(|face| buried.face(face).iter().all(|h| h.valid == 0 && h.taken > 0)));
    // A mirrored crate in the open is valid everywhere.
    let alone = Fixture { meshes: scene.meshes, places: vec![mirrored] };
    let open = alone.trace(0, 0..12, &sampling);
    assert_eq!(open.summary.invalid, 0);
    assert_eq!(open.summary.rays, 0, "nothing lies above a convex body's faces");
    assert!((0..12).all(|face| open.face(face).iter().all(|h| (ao(h, 0) - 1.0).abs() < 1e-6)));
}

#[test]
fn double_sided_faces_average_their_sides() {
    // A double-sided sheet halfway between floor and open sky; and one that lies under the floor's back on one side.
    let sheet = flat(&square(Vec3::ZERO, Vec3::Z * 0.05, Vec3::X * 0.05), true);
    let floor = flat(&square(Vec3::ZERO, Vec3::Z * 3000.0, Vec3::X * 3000.0), false);
    let at = |y: f64| DAffine3::from_translation(DVec3::Y * y);
    let sampling = fixed(256, &[2.0]);
    let scene = Fixture { meshes: vec![sheet, floor], places: vec![(0, at(2.0)), (1, at(0.0))] };
    let both = scene.trace(0, 0..2, &sampling);
    for half in both.face(0) {
        assert!((ao(&half, 0) - 0.5 * (1.0 + 0.664_64)).abs() < 4e-3, "{}", ao(&half, 0));
    }
    let scene = Fixture { places: vec![(0, at(-2.0)), (1, at(0.0))], ..scene };
    let below = scene.trace(0, 0..2, &sampling);
    for half in below.face(0) {
        assert_eq!(half.valid, half.taken);
        assert!((ao(&half, 0) - 1.0).abs() < 1e-6, "only the side that faces away is valid");
    }
}

#[test]
fn probes_match_closed_forms() {
    // The centre of a sphere is too easy for positions, but not for directions: 1 − 2^(−R/d) up to the tessellation.
    let ceiling = flat(&square(Vec3::Y * 2.0, Vec3::X * 20000.0, Vec3::Z * 20000.0), false);
    let scene = Fixture { meshes: vec![ceiling], places: vec![(0, DAffine3::IDENTITY)] };
    let kernel = Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] };
    let point = ProbePoint { position: DVec3::ZERO, normal: DVec3::Y * 3.0, geometric: None };
    let found = probe(&scene.tracer(), &[point, point], &kernel, 1 << 17, 3).unwrap();
    assert_eq!(found[0], found[1]);
    assert!((found[0].ao[0] - 0.664_639_946_4).abs() < 1e-4 && (found[0].ao[1] - 0.009_107_404_1).abs() < 1e-4);
    let up = probe(&scene.tracer(), &[ProbePoint { normal: -DVec3::Y, ..point }], &kernel, 64, 3).unwrap();
    assert_eq!((up[0].ao.as_slice(), up[0].back_face_fraction), (&[1.0, 1.0][..], 0.0));
}

fn adaptive(rmse: f64) -> Sampling {
    let target = Some(Target::named(rmse));
    Sampling { target, mean_samples_per_face: 2.0, max_samples_per_face: 512, ..fixed(16, &[0.5, 20.0]) }
}

/// Mean over the visible area, the two halves of a face weighing the same.
fn mean_ao(scene: &Fixture, moments: &FaceMoments, instance: usize, channel: usize) -> [f64; 2] {
    let (mesh, place) = &scene.places[instance];
    let areas = FaceAreas::new(&scene.meshes[*mesh], place).area_m2;
    let (mut sum, mut visible) = ([0.0; 2], [0.0; 2]);
    for (face, area) in areas.iter().enumerate() {
        for (half, moments) in moments.face(face).iter().enumerate() {
            sum[half] += area * moments.phi_f[channel].iter().sum::<f64>() / f64::from(moments.taken);
            visible[half] += area * f64::from(moments.valid) / f64::from(moments.taken);
        }
    }
    [sum[0] + sum[1], visible[0] + visible[1]].map(|both| both / 2.0 / areas.iter().sum::<f64>())
}

#[test]
fn adaptive_counts_bias_nothing() {
    let scene = crates();
    let exact = scene.trace(0, 0..2, &Sampling { mean_samples_per_face: 512.0, ..fixed(64, &[0.5, 20.0]) });
    let exact = mean_ao(&scene, &exact, 0, 1);
    let seeds = 0..300u64;
    let (mut sum, mut squares) = ([0.0; 2], [0.0; 2]);
    for seed in seeds.clone() {
        let found = mean_ao(&scene, &scene.trace(0, 0..2, &Sampling { seed, ..adaptive(0.03) }), 0, 1);
        for (i, value) in found.into_iter().enumerate() {
            sum[i] += value;
            squares[i] += value * value;
        }
    }
    let n = seeds.count() as f64;
    for i in 0..2 {
        let mean = sum[i] / n;
        let standard_error = ((squares[i] / n - mean * mean) / n).sqrt();
        assert!((mean - exact[i]).abs() < 4.0 * standard_error + 1e-3, "{i}: {mean} ± {standard_error}, {}", exact[i]);
    }
}

#[test]
fn a_finer_target_takes_more_samples_and_errs_less() {
    let scene = crates();
    let rays = [0.1, 0.02, 0.005].map(|rmse| scene.trace(0, 0..2, &adaptive(rmse)).summary.rays);
    assert!(rays[0] < rays[1] && rays[1] < rays[2], "{rays:?}");
    let first = scene.trace(0, 0..2, &adaptive(1.0));
    assert!((0..2).all(|face| first.face(face).iter().all(|half| half.taken == 1)), "{:?}", first.summary);
}

#[test]
fn where_nothing_is_in_reach_no_ray_is_traced() {
    let open = Fixture {
        meshes: vec![flat(&square(Vec3::ZERO, Vec3::Z, Vec3::X), false)],
        places: vec![(0, DAffine3::IDENTITY)],
    };
    let found = open.trace(0, 0..2, &adaptive(1e-4));
    assert_eq!(found.summary.rays, 0);
    assert!((0..2).flat_map(|face| found.face(face)).all(|half| half.valid == half.taken));
}

#[test]
fn the_cap_of_a_class_counts_samples_of_256_rays() {
    let mut scene = crates();
    scene.meshes[0].groups[0].max_samples_per_face = Some(2);
    let found = scene.trace(0, 0..2, &adaptive(0.0005));
    let most = 256 / adaptive(0.0005).rays_per_sample;
    let taken: Vec<u32> = (0..2).flat_map(|face| found.face(face)).map(|half| half.taken).collect();
    assert!(taken.iter().all(|taken| *taken <= most) && taken.contains(&most), "{taken:?}");
}

#[test]
fn buried_faces_get_fewer_samples() {
    let scene = Fixture {
        meshes: vec![flat(&square(Vec3::ZERO, Vec3::Z * 5.0, Vec3::X * 5.0), false), {
            let mut faces = cube(Vec3::ZERO, 0.5);
            faces.extend(square(Vec3::new(0.0, 0.1, 0.0), Vec3::Z * 0.1, Vec3::X * 0.1));
            flat(&faces, false)
        }],
        places: vec![(0, DAffine3::IDENTITY), (1, DAffine3::from_translation(DVec3::Y * 0.5))],
    };
    let found = scene.trace(1, 0..14, &adaptive(0.004));
    let taken = |face: usize| found.face(face).map(|half| half.taken);
    let seen = (0..12).flat_map(taken).max().unwrap();
    assert!(
        (12..14).all(|face| found.face(face).iter().all(|half| half.valid == 0 && half.taken * 4 <= seen)),
        "{seen}"
    );
    assert!(found.summary.rays_skipped_buried > 0 && found.summary.rays_saved_adaptive > 0, "{:?}", found.summary);
}

/// Fails when the output of trace tasks changes: raise `TaskKind::Trace`'s kernel revision, then this digest.
#[test]
fn output_is_what_the_kernel_revision_says() {
    let fixed = crates().trace(2, 0..12, &fixed(16, &[0.5, 20.0])).to_bytes();
    let adaptive = crates().trace(2, 0..12, &adaptive(0.01)).to_bytes();
    let digest = Digest::of(&[fixed, adaptive].concat()).short();
    assert_eq!((kiln_core::TaskKind::Trace.kernel_rev(), digest.as_str()), (9, "9a1799c0"));
}
