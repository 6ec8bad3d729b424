//! What holds whatever the numbers are.

use super::*;

/// Whatever coincides counts as often as it is there: n faces in one place are one of n times the depth, bit for bit, also where
/// there are more distances than a list has room for.
#[test]
fn what_coincides_is_neither_lost_nor_counted_twice() {
    let samples = upwards(512);
    let kernel = obscurance(&[0.7, 5.0]);
    let (places, copies) = (37, 30);
    let depth = |kept: f64| OpticalDepth::of_transmittance(kept).0;
    let thin = 0.999;
    let thick = OpticalDepth(copies * depth(thin)).transmittance();
    assert_eq!(depth(thick), copies * depth(thin));
    let triangles = ceiling(0.0, 50.0);
    let [thin, thick] = [thin, thick].map(|kept| crossing_mesh(&triangles, kept));
    let height = |i: u32| up(0.5 + 0.05 * f64::from(i * 11 % places));
    let many: Vec<FoliageObject> = (0..places * copies).map(|i| placed(&thin, height(i))).collect();
    let few: Vec<FoliageObject> = (0..places).map(|i| placed(&thick, height(i))).collect();
    for mode in BOTH {
        let [many, few] = [&many, &few]
            .map(|objects| gather(&on(crate::device(), &scene(&wall(3.0, 40.0), objects, mode)), &samples, &kernel, 1));
        assert_eq!(many, few, "{mode:?}");
        assert!(many.iter().any(|sums| sums.values[1] > 3000 && sums.values[1] < 50_000), "{mode:?}");
    }
}

#[test]
fn what_has_no_density_is_not_there() {
    let kernel = obscurance(&[2.0, 300.0]);
    let samples = upwards(300);
    let without = gather(&on(crate::device(), &scene(&wall(2.0, 3.0), &[], BOTH[0])), &samples, &kernel, 64);
    for mode in BOTH {
        let clear = placed(&crossing_mesh(&ceiling(1.0, 9.0), 1.0), DAffine3::IDENTITY);
        for objects in [vec![slab(0.0, 1.0, 0.0)], vec![slab(0.0, 1.0, 0.0), clear]] {
            let with = gather(&on(crate::device(), &scene(&wall(2.0, 3.0), &objects, mode)), &samples, &kernel, 64);
            for (a, b) in without.iter().zip(&with) {
                // A unit a ray: sums of stretches are rounded.
                let is_near = (0..2).all(|channel| a.values[channel].abs_diff(b.values[channel]) <= a.rays);
                assert!(is_near && a.rays == b.rays && a.back_faces == b.back_faces, "{mode:?}: {a:?} {b:?}");
                assert!(objects.len() > 1 || a == b, "{mode:?}");
            }
        }
    }
}

#[test]
fn what_is_behind_the_closest_hit_does_not_count() {
    let (kernel, samples) = (obscurance(&[2.0]), upwards(100));
    let leaves = crossing_mesh(&ceiling(3.0, 1e4), 0.5);
    for mode in BOTH {
        let before = [slab(0.5, 1.0, 0.5)];
        let both = [slab(0.5, 1.0, 0.5), slab(2.5, 9.0, 0.5), placed(&leaves, DAffine3::IDENTITY)];
        let [near, far] = [&before[..], &both]
            .map(|objects| gather(&on(crate::device(), &scene(&wall(2.0, 1e5), objects, mode)), &samples, &kernel, 32));
        assert_eq!(near, far, "{mode:?}");
    }
}

/// Bad numbers give some value, and the next rays are none the worse.
#[test]
fn rays_that_are_no_rays_end() {
    let mut numbers = Numbers(19);
    let kernel = obscurance(&[1.0, 1e-3]);
    let objects = things(&mut numbers, 40);
    let good = samples(&mut numbers, 64);
    let bad = [f32::NAN, f32::INFINITY, 1e19, -f32::MAX].map(|x| SurfaceSample { origin: Vec3::X * x, ..good[0] });
    let blind = [Vec3::ZERO, Vec3::NAN].map(|normal| SurfaceSample { normal, geometric: Vec3::Y, ..good[0] });
    for mode in BOTH {
        let tracer = on(crate::device(), &scene(&scenes::all()[3], &objects, mode));
        let expected = gather(&tracer, &good, &kernel, 32);
        let mixed = [&good[..], &bad, &blind].concat();
        let found = gather(&tracer, &mixed, &kernel, 32);
        assert!(found.iter().all(|sums| sums.values.iter().all(|value| *value <= 32 * 65536)), "{mode:?}");
        assert!(found[..64] == expected, "{mode:?}");
    }
}

/// Where faces of trees are geometry there is nothing to go through.
#[test]
fn geometry_is_no_foliage() {
    let mut numbers = Numbers(23);
    let (opaque, objects) = (&scenes::all()[3], things(&mut numbers, 20));
    let [with, without] = [&objects[..], &[]].map(|objects| {
        let tracer = on(crate::device(), &scene(opaque, objects, FoliageMode::Geometry));
        (tracer.memory_bytes(), gather(&tracer, &opaque.samples(500, 32), &obscurance(&[1.0]), 32))
    });
    assert!(with == without);
}

/// Hits know of no foliage, and how the geometry is spread over bindings, and subgroups, change nothing.
#[test]
fn the_rest_is_as_without() {
    let mut numbers = Numbers(13);
    let opaque = &scenes::all()[4];
    let things = things(&mut numbers, 50);
    let origins = opaque.samples(4000, 64);
    let kernel = obscurance(&[0.5, 40.0]);
    for mode in BOTH {
        let built = scene(opaque, &things, mode);
        let (with, without) = (on(crate::device(), &built), on(crate::device(), &scene(opaque, &[], mode)));
        assert!(with.memory_bytes() > without.memory_bytes());
        let ray = |sample: &SurfaceSample| Ray { origin: sample.origin, direction: sample.normal, t_max: 1e3 };
        let rays: Vec<Ray> = origins.iter().map(ray).collect();
        let [a, b] = [&with, &without].map(|tracer| {
            let (mut hits, mut blocked) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
            tracer.trace(&rays, &mut hits).expect("it traces");
            tracer.any_hit(&rays, &mut blocked).expect("it traces");
            (hits, blocked)
        });
        assert!(a == b, "{mode:?}");
        let samples = samples(&mut numbers, 500);
        let expected = gather(&with, &samples, &kernel, 64);
        let parted = GpuTracer::with_binding_bytes(crate::device(), &built, with.memory_bytes().div_ceil(4));
        let parted = parted.expect("it fits");
        assert!(parted.binding_count() > 2);
        assert!(gather(&parted, &samples, &kernel, 64) == expected, "{mode:?}: bindings");
        let plain = on(crate::device_without_subgroups(), &built);
        assert!(gather(&plain, &samples, &kernel, 64) == expected, "{mode:?}: subgroups");
    }
}

/// With ray queries the same, bit for bit; also where nothing but foliage is, far from the origin.
#[test]
fn ray_queries_go_through_the_same() {
    let Some(device) = crate::device_with_ray_queries() else { return };
    let mut numbers = Numbers(17);
    let far = DAffine3::from_translation(DVec3::new(500.0, 0.0, -300.0));
    let leaves = crossing_mesh(&ceiling(1.0, 2.0), 0.7);
    let alone = [placed(&leaves, far), fog(DVec3::ZERO, DVec3::ONE, 0.4, far)];
    let things = things(&mut numbers, 50);
    let kernel = obscurance(&[0.5, 40.0]);
    for mode in BOTH {
        for (opaque, objects, shift) in
            [(&scenes::all()[3], &things[..], DVec3::ZERO), (&nothing(), &alone[..], far.translation)]
        {
            let built = scene(opaque, objects, mode);
            let software = GpuTracer::without_ray_queries(device.clone(), &built).expect("the scene fits");
            let hardware = on(device.clone(), &built);
            assert!(hardware.has_ray_queries());
            let mut samples = samples(&mut numbers, 700);
            samples.iter_mut().for_each(|sample| sample.origin += shift.as_vec3());
            let [a, b] = [&software, &hardware].map(|tracer| gather(tracer, &samples, &kernel, 32));
            assert!(a == b, "{mode:?}");
            assert!(a.iter().any(|sums| sums.ao(0) > 0.0 && sums.ao(0) < 0.99), "{mode:?}");
        }
    }
}
