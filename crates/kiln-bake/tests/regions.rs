//! What is seen in regions whose AO is known, and which of their points are valid.

#[expect(dead_code, reason = "other tests use the rest")]
mod geometry;

use geometry::{cube, flat, square};
use glam::{DAffine3, DVec3, Vec3};
use kiln_bake::{RegionGather, gather_regions};
use kiln_core::{Bounds, CANDIDATES, CandidateBits, Kernel, Region, RegionSamples, RegionSettings};
use kiln_trace::{CpuTracer, HARMONICS, KernelRates, MeshBvh, Scene, SceneObject, quadratic_harmonics};
use std::sync::Arc;

fn tracer(triangles: &[[Vec3; 3]], double_sided: bool) -> CpuTracer {
    let mesh = Arc::new(MeshBvh::build(&flat(triangles, double_sided)));
    let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
    CpuTracer::new(Arc::new(Scene::build(vec![mesh], &[object])))
}

fn settings(kernel: &Kernel) -> RegionGather {
    let (settings, kernel) = (RegionSettings::default(), KernelRates::new(kernel));
    RegionGather { kernel, settings, is_adaptive: false, seed: 3 }
}

fn obscurance() -> Kernel {
    Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] }
}

fn region(min: [f64; 3], max: [f64; 3]) -> Region {
    let bounds = Bounds { min: DVec3::from_array(min), max: DVec3::from_array(max) };
    Region { id: "r".into(), bounds, valid: None }
}

fn gather(tracer: &CpuTracer, regions: &[Region]) -> RegionSamples {
    let samples = gather_regions(tracer, regions, &settings(&obscurance())).expect("a CPU traces");
    samples.check(regions.len(), 2).expect("it is what a task gives");
    samples
}

/// AO of the n-th valid point about a normal.
fn ao(samples: &RegionSamples, point: usize, channel: usize, normal: Vec3) -> f64 {
    let at = (point * samples.channels as usize + channel) * HARMONICS;
    let coefficients = &samples.values[at..at + HARMONICS];
    coefficients.iter().zip(quadratic_harmonics(normal)).map(|(c, y)| f64::from(c * y)).sum()
}

#[test]
fn an_open_sky_is_one_for_all_normals() {
    let tracer = tracer(&square(Vec3::splat(1e6), Vec3::X, Vec3::Y), false);
    let samples = gather(&tracer, &[region([0.0; 3], [4.0; 3])]);
    assert_eq!((samples.valid[0], samples.dropped[0], samples.rays), (CandidateBits::ALL, 0, 512 * 1024));
    for (point, normal) in [(0, Vec3::X), (511, Vec3::NEG_Y), (100, Vec3::new(0.6, 0.0, 0.8))] {
        assert!((ao(&samples, point, 1, normal) - 1.0).abs() < 1e-5);
    }
}

/// Pure occlusion over an endless plane: (1 + n·up) / 2, of which the quadratic functions have no part.
#[test]
fn a_ground_plane_is_linear() {
    let tracer = tracer(&square(Vec3::ZERO, Vec3::Z * 1e5, Vec3::X * 1e5), false);
    let occlusion = settings(&Kernel::Occlusion { ray_distance_m: 1e6 });
    let samples = gather_regions(&tracer, &[region([0.0, 0.5, 0.0], [4.0, 2.0, 4.0])], &occlusion).unwrap();
    for normal in [Vec3::Y, Vec3::NEG_Y, Vec3::X, Vec3::new(0.0, 0.6, 0.8)] {
        let expected = f64::from((1.0 + normal.y) / 2.0);
        assert!((ao(&samples, 77, 0, normal) - expected).abs() < 0.01, "{normal}");
    }
    let quadratic = samples.values.chunks(HARMONICS).flat_map(|c| &c[4..]).fold(0.0f32, |most, c| most.max(c.abs()));
    assert!(quadratic < 0.03, "{quadratic}");
}

/// The paper's reason for validity: what is behind a slanted wall is another place.
#[test]
fn what_is_behind_a_slanted_wall_is_not_valid() {
    // From corner to corner, seen from both sides, but for a corner that leaves more of the box on one side.
    let wall = square(Vec3::new(4.4, 2.0, 4.4), Vec3::new(-20.0, 0.0, 20.0), Vec3::Y * 20.0);
    let tracer = tracer(&wall, true);
    let region = region([0.0; 3], [8.0, 4.0, 8.0]);
    let samples = gather(&tracer, std::slice::from_ref(&region));
    let is_before = |index: &usize| region.candidate(*index).x + region.candidate(*index).z < 8.8;
    let expected: Vec<usize> = (0..CANDIDATES).filter(is_before).collect();
    assert_eq!(samples.valid[0].iter().collect::<Vec<_>>(), expected);
}

#[test]
fn what_is_solid_is_not_valid_and_an_alcove_is() {
    // A closed crate amid the region, and a wall with no thickness that one can look past.
    let screen = square(Vec3::new(1.0, 2.0, 1.0), Vec3::X * 0.6, Vec3::Y * 1.5);
    let triangles: Vec<_> = cube(Vec3::new(5.0, 1.5, 5.0), 1.6).into_iter().chain(screen).collect();
    let region = region([0.0; 3], [8.0, 4.0, 8.0]);
    let samples = gather(&tracer(&triangles, false), std::slice::from_ref(&region));
    let is_in = |index: usize| (region.candidate(index) - DVec3::new(5.0, 1.5, 5.0)).abs().max_element() < 1.6;
    let inside = (0..CANDIDATES).filter(|index| is_in(*index)).count();
    assert!(inside > 20 && samples.valid[0].iter().all(|index| !is_in(index)));
    assert!(samples.valid[0].count() > CANDIDATES - inside - 20, "{}", samples.valid[0].count());
}

#[test]
fn under_the_ground_nothing_is_valid() {
    let tracer = tracer(&square(Vec3::ZERO, Vec3::Z * 1e4, Vec3::X * 1e4), false);
    let samples = gather(&tracer, &[region([0.0, -9.0, 0.0], [4.0, -1.0, 4.0]), region([0.0, 1.0, 0.0], [4.0; 3])]);
    assert_eq!((samples.valid[0].count(), samples.valid[1].count()), (0, CANDIDATES));
    // A box that holds the ground has points above it only.
    let across = region([0.0, -4.0, 0.0], [4.0; 3]);
    let samples = gather(&tracer, std::slice::from_ref(&across));
    let above = (0..CANDIDATES).filter(|index| across.candidate(*index).y > 0.0);
    assert_eq!(samples.valid[0].iter().collect::<Vec<_>>(), above.collect::<Vec<_>>());
}

#[test]
fn given_validity_is_kept_but_for_what_sees_backs() {
    let tracer = tracer(&square(Vec3::ZERO, Vec3::Z * 1e4, Vec3::X * 1e4), false);
    let mut bits = CandidateBits::default();
    [0, 9, 70, 511].into_iter().for_each(|index| bits.insert(index));
    let given = Region { valid: Some(bits), ..region([0.0, -4.0, 0.0], [4.0; 3]) };
    let samples = gather(&tracer, &[given]);
    assert_eq!(samples.valid[0].iter().collect::<Vec<_>>(), [511]);
    assert_eq!((samples.dropped[0], samples.rays), (3, 4 * 1024));
}

/// Fewer rays for each of many points change what is seen by noise alone.
#[test]
fn many_points_need_fewer_rays() {
    let tracer = tracer(&cube(Vec3::new(2.0, 1.0, 2.0), 0.7), false);
    let regions = [region([0.0; 3], [4.0, 3.0, 4.0])];
    let all = gather(&tracer, &regions);
    let settings = RegionGather { is_adaptive: true, ..settings(&obscurance()) };
    let fewer = gather_regions(&tracer, &regions, &settings).unwrap();
    assert_eq!(all.valid, fewer.valid);
    assert!(fewer.rays * 6 < all.rays && fewer.rays >= 1 << 15, "{} of {}", fewer.rays, all.rays);
    let squares = all.values.iter().zip(&fewer.values).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
    let rms = (9.0 * squares / all.values.len() as f64 / (4.0 * std::f64::consts::PI)).sqrt();
    assert!(rms > 0.0 && rms < 0.03, "{rms}");
}

/// Alone, in a batch, or in another order.
#[test]
fn a_region_is_the_same_in_every_batch() {
    let tracer = tracer(&cube(Vec3::new(2.0, 1.0, 2.0), 0.7), false);
    let regions = [region([0.0; 3], [4.0, 3.0, 4.0]), region([3.0, 0.0, 0.0], [6.0, 3.0, 4.0])];
    let both = gather(&tracer, &regions);
    let [a, b] = [0, 1].map(|i| gather(&tracer, &regions[i..=i]));
    assert_eq!([&a.values[..], &b.values].concat(), both.values);
    assert_eq!([a.valid, b.valid].concat(), both.valid);
    assert_eq!(a.rays + b.rays, both.rays);
}
