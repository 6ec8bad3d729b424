//! Laws of decorators' scalars.

use crate::shapes::{Full, Part, detailed, plane, terrain};
use glam::{DAffine3, DQuat, DVec3};
use kiln_bake::{Decorator, DecoratorScalar, DecoratorSettings, read_decorators};
use kiln_core::Bounds;
use proptest::prelude::*;

fn read(full: &Full, decorators: &[Decorator], directions: u32) -> Vec<DecoratorScalar> {
    let settings = DecoratorSettings { directions, seed: 3 };
    read_decorators(&full.tracer(), &full.baked(), decorators, &settings).expect("a CPU traces")
}

fn at(x: f64, y: f64, z: f64, radius_m: f64) -> Decorator {
    Decorator { anchor_m: DVec3::new(x, y, z), radius_m }
}

fn floor(ao: impl Fn(DVec3) -> f64) -> Full {
    Full::one(plane(100.0, 0.0), DAffine3::IDENTITY, ao)
}

#[test]
fn a_constant_stays_to_the_bit() {
    for value in [0.0f32, 0.37, 1.0] {
        let full = Full::one(terrain(24), DAffine3::IDENTITY, |_| f64::from(value));
        let decorators: Vec<Decorator> = (0..50).map(|i| at(f64::from(i) * 0.3 - 7.0, 0.1, 2.0, 1.5)).collect();
        for scalar in read(&full, &decorators, 256) {
            assert!(scalar.hits >= 8);
            assert_eq!(scalar.ao, [f64::from(value)]);
        }
    }
}

#[test]
fn a_linear_function_is_read_at_the_anchor() {
    let linear = |p: DVec3| 0.5 + 0.002 * p.x - 0.0015 * p.z;
    let full = floor(linear);
    for (x, z) in [(0.0, 0.0), (13.0, -40.0), (-71.5, 22.25)] {
        let anchor = DVec3::new(x, 0.0, z);
        // A surface through the anchor is met there by every ray.
        let [on] = &read(&full, &[at(x, 0.0, z, 0.3)], 256)[..] else { panic!("one decorator") };
        assert_eq!(on.hits, 256);
        assert!((on.ao[0] - linear(anchor)).abs() < 1e-6);
        let [above] = &read(&full, &[at(x, 0.4, z, 1.0)], 256)[..] else { panic!("one decorator") };
        assert!((above.ao[0] - linear(anchor)).abs() < 1e-4, "{}", above.ao[0] - linear(anchor));
    }
}

#[test]
fn hits_are_weighted_by_their_distance_to_the_boundary() {
    // A floor at a depth h below the anchor is met by rays from u with μ = −u_y > a = h / r, after r − h / μ, at
    // h √(1 − μ²) / μ from the foot. For AO = k |x| the mean is k h · 2/π · (ln((1 + s) / a) − 2 s + a arccos a) over
    // (1 − a + a ln a), with s = √(1 − a²): the integrals over μ of the weight times √(1 − μ²) / μ, and of the weight.
    let full = floor(|p| 0.01 * p.x.abs());
    for (depth, radius) in [(5.0, 10.0), (1.0, 10.0), (6.0, 8.0)] {
        let a: f64 = depth / radius;
        let s = (1.0 - a * a).sqrt();
        let above = ((1.0 + s) / a).ln() - 2.0 * s + a * a.acos();
        let expected = 0.01 * depth * std::f64::consts::FRAC_2_PI * above / (1.0 - a + a * a.ln());
        for (directions, part) in [(256, 0.03), (16384, 0.002)] {
            let scalar = &read(&full, &[at(0.0, depth, 0.0, radius)], directions)[0];
            assert!((scalar.ao[0] / expected - 1.0).abs() < part, "{a}: {} {expected}", scalar.ao[0]);
            let hits = 0.5 * (1.0 - a) * f64::from(directions);
            assert!((f64::from(scalar.hits) - hits).abs() < 2.0 + 0.02 * hits, "{} {hits}", scalar.hits);
        }
    }
}

#[test]
fn spheres_grow_until_enough_rays_read() {
    let full = floor(|_| 0.25);
    let depth_and_radius = [(0.5, 1.0), (0.97, 2.0), (1.5, 2.0), (3.0, 4.0), (7.0, 8.0)];
    let decorators: Vec<Decorator> = depth_and_radius.iter().map(|(depth, _)| at(3.0, *depth, 1.0, 1.0)).collect();
    for (scalar, (_, radius)) in read(&full, &decorators, 256).iter().zip(depth_and_radius) {
        assert_eq!((scalar.radius_m, scalar.is_open, &scalar.ao[..]), (radius, false, &[0.25][..]));
        assert!(scalar.hits >= 8);
    }
}

#[test]
fn what_reads_nothing_is_open_and_flagged() {
    let full = floor(|_| 0.25);
    let scalar = &read(&full, &[at(3.0, 8.5, 1.0, 1.0)], 256)[0];
    assert_eq!(*scalar, DecoratorScalar { ao: vec![1.0], hits: 0, radius_m: 8.0, is_open: true });
    let bad = [(0.0, 0.0), (0.0, -1.0), (0.0, f64::NAN), (0.0, f64::INFINITY), (f64::NAN, 1.0), (1e39, 1.0)];
    let bad: Vec<Decorator> = bad.iter().map(|(x, radius)| at(*x, 0.0, 0.0, *radius)).collect();
    for scalar in read(&full, &bad, 256) {
        assert_eq!((scalar.ao, scalar.hits, scalar.is_open), (vec![1.0], 0, true));
    }
    assert_eq!(Decorator::new(DVec3::ZERO, &Bounds::EMPTY).radius_m, 0.0);
    let bounds = Bounds { min: DVec3::ZERO, max: DVec3::new(3.0, 4.0, 0.0) };
    assert_eq!(Decorator::new(DVec3::ZERO, &bounds).radius_m, 2.5);
}

#[test]
fn what_has_no_values_stops_rays_and_is_not_read() {
    let mut full = floor(|_| 0.25);
    let open = read(&full, &[at(0.0, 0.5, 0.0, 1.0)], 256)[0].clone();
    assert_eq!((&open.ao[..], open.is_open), (&[0.25][..], false));
    // Rays that would meet the floor from below meet a sheet first, whatever the radius.
    full.parts.push(Part { mesh: plane(100.0, -0.1), place: DAffine3::IDENTITY, values: None });
    let covered = read(&full, &[at(0.0, 0.5, 0.0, 1.0)], 256)[0].clone();
    // Some rays begin between the two.
    assert!(covered.hits > 0 && covered.hits < open.hits);
    full.parts[1].mesh = plane(100.0, -1e-4);
    assert!(read(&full, &[at(0.0, 0.5, 0.0, 1.0)], 256)[0].is_open);
    // A face that does not receive has no values of its own.
    full.parts.pop();
    full.parts[0].mesh.groups[0].receives = false;
    assert!(read(&full, &[at(0.0, 0.5, 0.0, 1.0)], 256)[0].is_open);
}

#[test]
fn every_channel_is_read() {
    let mut full = floor(|_| 0.0);
    full.channels = 2;
    full.parts[0].values = Some([0.25, 0.75].repeat(full.parts[0].mesh.positions.len()));
    assert_eq!(read(&full, &[at(0.0, 0.5, 0.0, 1.0)], 256)[0].ao, [0.25, 0.75]);
    assert_eq!(read(&full, &[at(0.0, 50.0, 0.0, 1.0)], 256)[0].ao, [1.0, 1.0]);
}

#[test]
fn moving_all_changes_nothing_but_noise() {
    let mesh = terrain(32);
    let decorators: Vec<Decorator> = (0..20).map(|i| at(f64::from(i) - 10.0, 0.3, 0.5 * f64::from(i), 2.0)).collect();
    let still = read(&Full::one(mesh.clone(), DAffine3::IDENTITY, detailed), &decorators, 4096);
    for scale in [DVec3::ONE, DVec3::new(1.0, 1.0, -1.0)] {
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.0);
        let place = DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(300.0, -40.0, 7.0));
        let anchors = decorators.iter().map(|of| Decorator { anchor_m: place.transform_point3(of.anchor_m), ..*of });
        let moved = read(&Full::one(mesh.clone(), place, detailed), &anchors.collect::<Vec<_>>(), 4096);
        for (a, b) in still.iter().zip(&moved) {
            assert!((a.ao[0] - b.ao[0]).abs() < 5e-3, "{} {}", a.ao[0], b.ao[0]);
            assert_eq!(a.radius_m, b.radius_m);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn each_scalar_depends_on_its_decorator_alone(
        places in prop::collection::vec((-19.0f64..19.0, -4.0f64..4.0, -19.0f64..19.0, 0.01f64..2.0), 1..40),
        threads in 1usize..5,
        take in 0usize..40,
    ) {
        let full = Full::one(terrain(12), DAffine3::IDENTITY, detailed);
        let decorators: Vec<Decorator> = places.iter().map(|(x, y, z, r)| at(*x, *y, *z, *r)).collect();
        let all = read(&full, &decorators, 64);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let reversed: Vec<Decorator> = decorators.iter().rev().copied().collect();
        let other = pool.install(|| read(&full, &reversed, 64));
        prop_assert!(all.iter().eq(other.iter().rev()));
        let alone = take % decorators.len();
        prop_assert_eq!(&all[alone], &read(&full, &decorators[alone..=alone], 64)[0]);
    }

    #[test]
    fn scalars_are_among_the_values(x in -19.0f64..19.0, y in -2.0f64..2.0, z in -19.0f64..19.0, low in 0.0f64..1.0, high in 0.0f64..1.0) {
        let full = Full::one(terrain(12), DAffine3::IDENTITY, |p| if p.x > 0.0 { low } else { high });
        let scalar = &read(&full, &[at(x, y, z, 1.0)], 64)[0];
        let (least, most) = (low.min(high) - 1e-7, low.max(high) + 1e-7);
        prop_assert!(scalar.is_open && scalar.ao == [1.0] || (least..=most).contains(&scalar.ao[0]));
    }
}
