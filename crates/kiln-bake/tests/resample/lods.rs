//! Laws of moments that are read for LODs.

use crate::shapes::{Full, Part, bumpy_torus, detailed, plane, sampling, terrain, turned};
use glam::{DAffine3, DQuat, DVec3};
use kiln_bake::{FaceAreas, Piece, density, read_at_vertices, resample_lod};
use kiln_core::{Bounds, FaceMoments, Mesh, Sampling, Solution, SolveSettings};
use kiln_solve::SolveInput;
use std::ops::Range;

/// Reads all faces of a LOD.
pub(crate) fn read(full: &Full, lod: &Mesh, place: &DAffine3, sampling: &Sampling) -> FaceMoments {
    read_faces(full, lod, place, sampling, 0..lod.faces.len())
}

fn read_faces(full: &Full, lod: &Mesh, place: &DAffine3, sampling: &Sampling, faces: Range<usize>) -> FaceMoments {
    let density_per_m2 = density(&FaceAreas::new(lod, place), sampling);
    let piece =
        Piece { mesh: lod, world_from_object: place, faces, density_per_m2, sampling, occluders_m: Bounds::EMPTY };
    resample_lod(&full.tracer(), &full.baked(), &piece).expect("a CPU traces")
}

/// Vertex values of a LOD.
pub(crate) fn solve(lod: &Mesh, place: &DAffine3, moments: &FaceMoments) -> Solution {
    let settings = SolveSettings::default();
    kiln_solve::solve(&SolveInput { mesh: lod, world_from_object: *place, moments, settings: &settings })
        .expect("it fits")
}

fn fitted(full: &Full, lod: &Mesh, place: &DAffine3) -> Vec<f32> {
    solve(lod, place, &read(full, lod, place, &sampling())).values
}

/// A slab that is open at its rim: its top has one value, its bottom another.
fn slab(thickness: f64, top: f32, bottom: f32) -> Full {
    let part = |mesh: Mesh, value: f32| {
        let values = Some(vec![value; mesh.positions.len()]);
        Part { mesh, place: DAffine3::IDENTITY, values }
    };
    let parts = vec![part(plane(2.0, 0.5 * thickness), top), part(turned(&plane(2.0, -0.5 * thickness)), bottom)];
    Full { parts, channels: 1 }
}

#[test]
fn a_constant_stays() {
    for (full, lods) in [(terrain(32), [terrain(16), terrain(8)]), (bumpy_torus(32), [bumpy_torus(16), bumpy_torus(8)])]
    {
        for value in [0.0f32, 0.37, 1.0] {
            let full = Full::one(full.clone(), DAffine3::IDENTITY, |_| f64::from(value));
            for lod in &lods {
                let values = fitted(&full, lod, &DAffine3::IDENTITY);
                // Moments are kept in f32.
                assert!(values.iter().all(|x| (x - value).abs() <= 2e-7), "{value}");
                let (tracer, baked) = (full.tracer(), full.baked());
                let read = read_at_vertices(&tracer, &baked, lod, &DAffine3::IDENTITY, 16, 1).expect("a CPU traces");
                let mut of_hits = read.values.iter().zip(&read.hits).filter(|(_, hits)| **hits > 0).peekable();
                assert!(of_hits.peek().is_some() && of_hits.all(|(x, _)| *x == value));
            }
        }
    }
}

#[test]
fn a_linear_function_is_read_from_inside_and_outside() {
    let linear = |p: DVec3| 0.5 + 0.1 * p.x - 0.15 * p.z;
    let full = Full::one(plane(2.0, 0.0), DAffine3::IDENTITY, linear);
    for (height, most) in [(0.0, 1e-4), (1e-3, 2e-4), (-1e-3, 2e-4), (0.05, 4e-3), (-0.05, 4e-3)] {
        // Smaller than the full mesh, whose rim would be read from one side only.
        let lod = plane(1.5, height);
        let moments = read(&full, &lod, &DAffine3::IDENTITY, &sampling());
        assert_eq!(moments.summary.invalid, 0, "{height}");
        for face in 0..lod.faces.len() {
            let [a, b, c] = lod.corners(face).map(|corner| linear(corner.as_dvec3()));
            for half in moments.face(face) {
                let [aa, bb, cc, ab, ac, bc] = half.phi_phi;
                let expected = [aa * a + ab * b + ac * c, ab * a + bb * b + bc * c, ac * a + bc * b + cc * c];
                for (sum, expected) in half.phi_f[0].iter().zip(expected) {
                    let off = (sum - expected).abs() / f64::from(half.valid);
                    assert!(off < most, "{height}: {off}");
                }
            }
        }
    }
}

#[test]
fn each_side_of_a_thin_wall_is_read_from_its_own_side() {
    let full = slab(0.02, 0.9, 0.1);
    for (height, above) in [(0.0, 0.9), (0.004, 0.9), (0.03, 0.9), (-0.004, 0.9)] {
        let lod = plane(1.9, height);
        let up = fitted(&full, &lod, &DAffine3::IDENTITY);
        assert!(up.iter().all(|x| (x - above).abs() < 1e-6), "{height}: {up:?}");
    }
    let down = fitted(&full, &turned(&plane(1.9, 0.0)), &DAffine3::IDENTITY);
    assert!(down.iter().all(|x| (x - 0.1).abs() < 1e-6), "{down:?}");
    let mut sheet = plane(1.9, 0.0);
    sheet.groups[0].double_sided = true;
    let moments = read(&full, &sheet, &DAffine3::IDENTITY, &sampling());
    assert!((0..sheet.faces.len()).all(|face| moments.face(face).iter().all(|half| half.valid == half.taken)));
    let both = solve(&sheet, &DAffine3::IDENTITY, &moments).values;
    assert!(both.iter().all(|x| (x - 0.5).abs() < 1e-6), "{both:?}");
}

#[test]
fn what_stands_for_nothing_is_invalid() {
    let full = Full::one(plane(2.0, 0.0), DAffine3::IDENTITY, |_| 0.5);
    let far = plane(1.0, 50.0);
    for lod in [turned(&plane(2.0, 0.01)), far] {
        let moments = read(&full, &lod, &DAffine3::IDENTITY, &sampling());
        assert!(moments.summary.samples > 0 && moments.summary.invalid == moments.summary.samples);
        assert!(
            (0..lod.faces.len()).all(|face| moments.face(face).iter().all(|half| half.valid == 0 && half.taken > 0))
        );
        assert!(solve(&lod, &DAffine3::IDENTITY, &moments).unsampled);
        let (tracer, baked) = (full.tracer(), full.baked());
        let read = read_at_vertices(&tracer, &baked, &lod, &DAffine3::IDENTITY, 16, 1).expect("a CPU traces");
        assert!(read.hits.iter().all(|hits| *hits == 0) && read.values.iter().all(|value| *value == 1.0));
    }
}

#[test]
fn runs_of_faces_make_the_whole_in_any_order_on_any_threads() {
    let full = Full::one(terrain(32), DAffine3::IDENTITY, detailed);
    let (mut lod, here, sampling) = (terrain(8), DAffine3::IDENTITY, sampling());
    let count = lod.faces.len();
    let whole = read(&full, &lod, &here, &sampling);
    let mut parts = FaceMoments::new(1);
    for first in (0..count).step_by(17) {
        parts.append(&read_faces(&full, &lod, &here, &sampling, first..(first + 17).min(count)));
    }
    assert_eq!(whole, parts);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        assert_eq!(whole, pool.install(|| read(&full, &lod, &here, &sampling)));
    }
    lod.faces.reverse();
    let reversed = read(&full, &lod, &here, &sampling);
    assert!((0..count).all(|face| whole.face(face) == reversed.face(count - 1 - face)));
}

#[test]
fn a_small_mesh_far_away_is_read_all_the_same() {
    // At 1,000 m coordinates are 6e-5 m apart, half the least distance that the diagonal of 1 m would give.
    let place = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.08),
        DQuat::from_rotation_x(0.7),
        DVec3::new(950.0, 120.0, -1010.0),
    );
    let full = Full::one(bumpy_torus(24), place, |p| 0.5 + 0.1 * p.x);
    for (lod, most) in [(bumpy_torus(24), 0.0), (bumpy_torus(12), 0.01)] {
        let moments = read(&full, &lod, &place, &sampling());
        let invalid = moments.summary.invalid as f64 / moments.summary.samples as f64;
        assert!(invalid <= most, "{invalid}");
        for (value, position) in solve(&lod, &place, &moments).values.iter().zip(&lod.positions) {
            assert!((value - 0.5 - 0.1 * position[0]).abs() < 0.03, "{value} {position:?}");
        }
    }
}

#[test]
fn moving_all_changes_nothing_but_noise() {
    // Detail that a LOD cannot hold is noise in its values, and another noise wherever the samples are others.
    let smooth = |p: DVec3| 0.5 + 0.4 * (0.2 * p.x).sin() * (0.15 * p.z).cos();
    let (full, lod) = (terrain(64), terrain(16));
    let still = fitted(&Full::one(full.clone(), DAffine3::IDENTITY, smooth), &lod, &DAffine3::IDENTITY);
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.0);
    for scale in [DVec3::splat(1.0), DVec3::splat(0.01), DVec3::new(-1.0, 1.0, 1.0)] {
        let place = DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(300.0, -40.0, 7.0) * scale);
        let moved = fitted(&Full::one(full.clone(), place, smooth), &lod, &place);
        let squares: f64 = still.iter().zip(&moved).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        let off = (squares / still.len() as f64).sqrt();
        assert!(off < 0.01, "{scale}: {off}");
    }
}
