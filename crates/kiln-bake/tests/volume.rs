//! Volumes of scenes whose AO is known, and that they do not depend on how they were made.

#[expect(dead_code, reason = "other tests use the rest")]
mod geometry;

use geometry::{cube, flat, square};
use glam::{DAffine3, DVec3, Vec3};
use kiln_bake::{
    ProbePoint, probe,
    volume::{GatherSettings, Layout, LayoutSettings, Volume, VolumeBatch, VolumeError, gather_batch},
};
use kiln_core::{Bounds, Kernel, codec};
use kiln_trace::{CpuTracer, KernelRates, MeshBvh, Scene, SceneObject};
use std::sync::Arc;

const HALF_DISTANCES: [f64; 2] = [2.0, 20.0];

fn tracer(triangles: &[[Vec3; 3]]) -> CpuTracer {
    let mesh = Arc::new(MeshBvh::build(&flat(triangles, false)));
    let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
    CpuTracer::new(Arc::new(Scene::build(vec![mesh], &[object])))
}

fn kernel() -> Kernel {
    Kernel::Obscurance { half_distances_m: HALF_DISTANCES.to_vec() }
}

fn settings() -> GatherSettings {
    GatherSettings { kernel: KernelRates::new(&kernel()), rays_per_voxel: 1024, back_face_limit: 0.25, seed: 5 }
}

fn layout(min: [f64; 3], max: [f64; 3], spacing_m: f64) -> Layout {
    let bounds = Bounds { min: DVec3::from_array(min), max: DVec3::from_array(max) };
    Layout::new(&[bounds], &LayoutSettings { spacing_m, ..LayoutSettings::default() }).expect("it is small")
}

fn batches(tracer: &CpuTracer, layout: &Layout, voxels: usize) -> Vec<VolumeBatch> {
    let gather = |bricks| gather_batch(tracer, layout, bricks, &settings()).expect("a CPU traces");
    layout.batches(voxels).into_iter().map(gather).collect()
}

fn volume(tracer: &CpuTracer, layout: &Layout) -> Volume {
    Volume::assemble(layout.clone(), 2, &batches(tracer, layout, 4000)).expect("all bricks are there")
}

/// Normals all around.
fn normals() -> Vec<DVec3> {
    let turn = |i: i32| 2.4 * f64::from(i);
    let spiral = (0..60).map(|i| (1.0 - (2.0 * f64::from(i) + 1.0) / 60.0, turn(i)));
    let around = spiral.map(|(y, turn)| {
        let r = (1.0f64 - y * y).sqrt();
        DVec3::new(r * turn.cos(), y, r * turn.sin())
    });
    around.chain([DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_Y]).collect()
}

/// A floor so wide that rays of both half-distances end before its edge.
fn floor(y: f32) -> [[Vec3; 3]; 2] {
    square(Vec3::Y * y, Vec3::Z * 1000.0, Vec3::X * 1000.0)
}

/// `∫ f` over [0, 1] by midpoints.
fn integral(f: impl Fn(f64) -> f64) -> f64 {
    let n = 20_000;
    (0..n).map(|i| f((f64::from(i) + 0.5) / f64::from(n))).sum::<f64>() / f64::from(n)
}

/// AO at height h over an endless plane whose normal has the cosine x with the receiver's: its definition.
fn plane_ao(h: f64, d: f64, x: f64) -> f64 {
    // Directions downwards, by the sine of their angle below the horizon; about the vertical in closed form.
    let s = (1.0 - x * x).max(0.0).sqrt();
    let about = |mu: f64| {
        let (a, b) = (-x * mu, s * (1.0 - mu * mu).sqrt());
        if a >= b {
            std::f64::consts::TAU * a
        } else if a <= -b {
            0.0
        } else {
            let phi = (-a / b).acos();
            2.0 * (a * phi + b * phi.sin())
        }
    };
    1.0 - integral(|mu| about(mu) * (-h / (d * mu)).exp2()) / std::f64::consts::PI
}

/// What is left of [`plane_ao`] up to the quadratic harmonics, by exponential integrals `E_n`.
fn plane_ao_quadratic(h: f64, d: f64, x: f64) -> f64 {
    let e = |n: i32| integral(|mu| (-h / (d * mu)).exp2() * mu.powi(n - 2));
    1.0 - e(2) / 2.0 + e(3) * x - 5.0 / 32.0 * (3.0 * e(4) - e(2)) * (3.0 * x * x - 1.0)
}

#[test]
fn an_open_sky_is_one() {
    // Something is there, but nowhere near.
    let tracer = tracer(&square(Vec3::splat(1e6), Vec3::X, Vec3::Y));
    let volume = volume(&tracer, &layout([-3.0; 3], [2.0, 4.0, 2.0], 1.0));
    for normal in normals().into_iter().chain([DVec3::ZERO, DVec3::NAN]) {
        let ao = volume.ao_at(DVec3::new(0.3, 2.0, -1.0), normal).unwrap();
        assert!((ao[0] - 1.0).abs() < 1e-6 && (ao[1] - 1.0).abs() < 1e-6 && ao[2..] == [0.0; 2], "{ao:?}");
    }
    let counts = volume.counts();
    assert_eq!((counts.valid, counts.filled), (volume.layout().voxel_count(), 0));
}

#[test]
fn a_plane_is_what_the_closed_form_says() {
    let tracer = tracer(&floor(0.0));
    let volume = volume(&tracer, &layout([-1.0, 1.0, -1.0], [1.0, 5.0, 1.0], 0.5));
    let (mut noise, mut band, mut total) = (0.0f64, 0.0f64, 0.0f64);
    for h in [1.0, 1.3, 2.0, 4.0] {
        for normal in normals() {
            let ao = volume.ao_at(DVec3::new(0.1, h, -0.2), normal).unwrap();
            for (ao, d) in ao.into_iter().zip(HALF_DISTANCES) {
                let (quadratic, exact) = (plane_ao_quadratic(h, d, normal.y), plane_ao(h, d, normal.y));
                // It goes beyond 1; what is reconstructed does not.
                noise = noise.max((ao - quadratic.clamp(0.0, 1.0)).abs());
                band = band.max((quadratic - exact).abs());
                total = total.max((ao - exact).abs());
            }
        }
    }
    println!("plane: from the quadratic closed form {noise:.5}, that from the exact {band:.5}, both {total:.5}");
    // What interpolation and 1,024 rays leave, what the bands beyond the quadratic ones hold, and both.
    assert!(noise < 0.008, "{noise}");
    assert!(band < 0.012, "{band}");
    assert!(total < 0.015, "{total}");
}

#[test]
fn upright_sideways_and_upside_down_over_a_plane() {
    let tracer = tracer(&floor(0.0));
    let volume = volume(&tracer, &layout([-1.0, 1.0, -1.0], [1.0, 3.0, 1.0], 0.5));
    let point = DVec3::new(0.0, 1.5, 0.0);
    let (up, side, down) = (DVec3::Y, DVec3::X, DVec3::NEG_Y);
    let [up, side, down] = [up, side, down].map(|normal| volume.ao_at(point, normal).unwrap()[1]);
    assert!(up > 0.985 && down < side && side < up, "{up} {side} {down}");
    assert!((down - plane_ao(1.5, 20.0, -1.0)).abs() < 0.015, "{down}");
    // The oracle itself: closed from above, and half closed from the side, on the plane.
    assert!((plane_ao(0.0, 20.0, -1.0)).abs() < 1e-4 && (plane_ao(0.0, 20.0, 0.0) - 0.5).abs() < 1e-4);
}

/// A court with a floor and a crate beside it: values by interpolation are near to what rays find at the very point.
#[test]
fn a_volume_is_near_to_rays_at_the_point() {
    let triangles: Vec<_> = floor(0.0).into_iter().chain(cube(Vec3::new(7.0, 3.0, 0.0), 3.0)).collect();
    let tracer = tracer(&triangles);
    let volume = volume(&tracer, &layout([-2.0, 1.5, -2.0], [2.0, 5.0, 2.0], 1.0));
    let points = [DVec3::new(0.1, 2.3, 0.4), DVec3::new(-1.2, 3.5, 1.7), DVec3::new(1.9, 1.6, -0.3)];
    let pairs = points.iter().flat_map(|p| normals().into_iter().map(move |n| (*p, n)));
    let (mut sum, mut worst, mut count) = (0.0, 0.0f64, 0.0);
    for (position, normal) in pairs {
        let point = ProbePoint { position, normal, geometric: None };
        let direct = probe(&tracer, &[point], &kernel(), 4096, 1).expect("a CPU traces").remove(0).ao;
        let ao = volume.ao_at(position, normal).unwrap();
        for (ao, direct) in ao.iter().zip(direct) {
            sum += (ao - direct).powi(2);
            worst = worst.max((ao - direct).abs());
            count += 1.0;
        }
    }
    println!("court: RMS {:.5}, greatest {worst:.5}", f64::sqrt(sum / count));
    assert!(f64::sqrt(sum / count) < 0.012 && worst < 0.03, "{} {worst}", f64::sqrt(sum / count));
}

#[test]
fn voxels_in_a_block_take_the_values_around_it() {
    // A block of 3 m stands in the middle; voxels inside see backs alone.
    let tracer = tracer(&cube(Vec3::ZERO, 1.5));
    let volume = volume(&tracer, &layout([-3.0; 3], [3.0; 3], 1.0));
    let counts = volume.counts();
    // Three planes of the lattice along each axis lie in the block.
    assert_eq!((counts.filled, counts.averaged, counts.opened), (27, 0, 0));
    assert_eq!(counts.valid + counts.filled, volume.layout().voxel_count());
    let outside = volume.ao_at(DVec3::new(2.4, 0.0, 0.0), DVec3::X).unwrap();
    let inside = volume.ao_at(DVec3::new(0.2, 0.1, 0.3), DVec3::X).unwrap();
    assert!(outside[0] > 0.95 && inside[0] > 0.4, "{outside:?} {inside:?}");
    // Buried as a whole there is nothing to take; what is seen is then the open sky.
    let buried =
        Volume::assemble(layout([-0.2; 3], [0.2; 3], 0.5), 2, &batches(&tracer, &layout([-0.2; 3], [0.2; 3], 0.5), 0));
    let buried = buried.unwrap();
    assert_eq!(buried.counts().opened, buried.layout().voxel_count());
    assert!((buried.ao_at(DVec3::ZERO, DVec3::Y).unwrap()[0] - 1.0).abs() < 1e-6);
}

#[test]
fn batches_order_and_threads_change_nothing() {
    let triangles: Vec<_> = floor(0.1).into_iter().chain(cube(Vec3::new(4.0, 1.0, 0.0), 1.2)).collect();
    let tracer = tracer(&triangles);
    let layout = layout([-3.0, 0.0, -3.0], [6.0, 4.0, 3.0], 1.0);
    let run = |threads: usize, voxels: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut batches = batches(&tracer, &layout, voxels);
            batches.reverse();
            Volume::assemble(layout.clone(), 2, &batches).unwrap()
        })
    };
    let whole = run(1, usize::MAX);
    assert!(whole.counts().filled > 0);
    assert_eq!(run(3, usize::MAX), whole);
    assert_eq!(run(2, 0), whole);
    assert_eq!(run(2, 150), whole);
}

#[test]
fn points_outside_have_no_value() {
    let tracer = tracer(&floor(0.0));
    let volume = volume(&tracer, &layout([1.0; 3], [2.0; 3], 1.0));
    assert!(volume.ao_at(DVec3::splat(1.5), DVec3::Y).is_some());
    for point in [DVec3::splat(20.0), DVec3::new(1.5, 1.5, -1.0), DVec3::NAN, DVec3::splat(1e300)] {
        assert_eq!(volume.ao_at(point, DVec3::Y), None, "{point}");
    }
}

#[test]
fn batches_of_another_volume_are_refused() {
    let tracer = tracer(&floor(0.0));
    let here = layout([-9.0, 1.0, 0.0], [9.0, 2.0, 1.0], 1.0);
    let parts = batches(&tracer, &here, 0);
    assert!(parts.len() > 2);
    let assemble =
        |layout: &Layout, channels, batches: &[VolumeBatch]| Volume::assemble(layout.clone(), channels, batches);
    assert!(assemble(&here, 2, &parts).is_ok());
    assert!(matches!(assemble(&here, 2, &parts[1..]), Err(VolumeError::MissingBrick { .. })));
    assert!(matches!(assemble(&here, 1, &parts), Err(VolumeError::OtherSettings { .. })));
    let twice: Vec<VolumeBatch> = parts.iter().chain(&parts[..1]).cloned().collect();
    assert!(matches!(assemble(&here, 2, &twice), Err(VolumeError::StrayBrick { .. })));
    let finer = layout([-9.0, 1.0, 0.0], [9.0, 2.0, 1.0], 0.5);
    assert!(matches!(assemble(&finer, 2, &parts), Err(VolumeError::OtherSettings { .. })));
    let taller = layout([-9.0, 1.0, 0.0], [9.0, 4.0, 1.0], 1.0);
    assert!(matches!(assemble(&taller, 2, &parts), Err(VolumeError::StrayBrick { .. })));
    let odd = GatherSettings { rays_per_voxel: 1000, ..settings() };
    assert!(matches!(gather_batch(&tracer, &here, 0..1, &odd), Err(VolumeError::Rays { rays: 1000, .. })));
    assert!(matches!(gather_batch(&tracer, &here, 0..99, &settings()), Err(VolumeError::NoSuchBricks { .. })));
}

#[test]
fn artefacts_are_read_as_written_and_others_refused() {
    let tracer = tracer(&floor(0.0));
    let here = layout([-2.0, -1.0, 0.0], [2.0, 2.0, 1.0], 1.0);
    let batch = batches(&tracer, &here, usize::MAX).remove(0);
    assert_eq!(batch.ray_count(), 1024 * here.voxel_count() as u64);
    let read: VolumeBatch = codec::decode("a batch", &codec::encode(&batch)).unwrap();
    assert_eq!(read, batch);
    let whole = Volume::assemble(here, 2, &[read]).unwrap();
    assert_eq!(codec::decode::<Volume>("a volume", &codec::encode(&whole)).unwrap(), whole);

    // As a batch is stored, with one thing changed at a time.
    let stored = |channels: u8, coefficients: &[f32], is_valid: &[bool]| {
        let value = (batch.spacing_m(), channels, batch.bricks(), coefficients, is_valid, batch.ray_count());
        codec::decode::<VolumeBatch>("a batch", &codec::encode(&value)).is_ok()
    };
    let (coefficients, is_valid) = (batch.coefficients(), batch.validity());
    assert!(stored(2, coefficients, is_valid));
    assert!(!stored(1, coefficients, is_valid) && !stored(0, &[], is_valid) && !stored(9, coefficients, is_valid));
    assert!(!stored(2, &coefficients[1..], is_valid) && !stored(2, coefficients, &is_valid[1..]));
    for wrong in [f32::NAN, f32::INFINITY, -9.0] {
        let mut coefficients = coefficients.to_vec();
        coefficients[7] = wrong;
        assert!(!stored(2, &coefficients, is_valid));
    }
    let bytes = codec::encode(&whole);
    assert!((0..bytes.len()).step_by(97).all(|end| codec::decode::<Volume>("a volume", &bytes[..end]).is_err()));
}
