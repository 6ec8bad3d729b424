//! Hardware ray queries against the software traversal: the same hits, answers and sums, bit for bit.

use crate::{
    device_with_ray_queries,
    scenes::{self, Numbers, TestScene},
};
use glam::{DAffine3, DVec3, Vec3};
use kiln_core::Kernel;
use kiln_gpu::{GpuError, GpuTracer};
use kiln_trace::{CosineSums, Hit, KernelRates, Ray, SceneObject, SurfaceSample, TraceError, Tracer};

/// The software traversal and ray queries over a scene, on one device.
struct Both {
    software: GpuTracer,
    hardware: GpuTracer,
}

impl Both {
    fn of(scene: &TestScene) -> Option<Self> {
        let device = device_with_ray_queries()?;
        let built = scene.build();
        let software = GpuTracer::without_ray_queries(device.clone(), &built).expect("the scene fits");
        let hardware = GpuTracer::new(device, &built).expect("the scene fits");
        assert!(hardware.has_ray_queries() && !software.has_ray_queries());
        Some(Self { software, hardware })
    }

    fn tracers(&self) -> [&GpuTracer; 2] {
        [&self.software, &self.hardware]
    }

    /// Compares closest hits and any hits; gives the number of hits.
    fn check_rays(&self, name: &str, rays: &[Ray]) -> usize {
        let [software, hardware] = self.tracers().map(|tracer| hits(tracer, rays));
        let differing: Vec<usize> = (0..rays.len()).filter(|&i| bits(&software[i]) != bits(&hardware[i])).collect();
        let first = differing.first().map(|&i| (rays[i], software[i], hardware[i]));
        assert!(first.is_none(), "{name}: {} of {} hits differ: {first:?}", differing.len(), rays.len());
        let found: Vec<bool> = software.iter().map(Hit::is_hit).collect();
        for tracer in self.tracers() {
            let mut blocked = vec![false; rays.len()];
            tracer.any_hit(rays, &mut blocked).expect("it traces");
            assert!(blocked == found, "{name}: any hit, ray queries: {}", tracer.has_ray_queries());
        }
        found.iter().filter(|is_hit| **is_hit).count()
    }
}

fn bits(hit: &Hit) -> (u32, u32, u32, bool) {
    (hit.t.to_bits(), hit.instance, hit.primitive, hit.back_face)
}

fn hits(tracer: &GpuTracer, rays: &[Ray]) -> Vec<Hit> {
    let mut hits = vec![Hit::MISS; rays.len()];
    tracer.trace(rays, &mut hits).expect("it traces");
    hits
}

fn all() -> Vec<TestScene> {
    scenes::all().into_iter().chain([scenes::strained()]).collect()
}

/// Rays from the surfaces, of lengths from 1e-6 to 1e6, some to points of other surfaces, with ends of all kinds.
fn rays(scene: &TestScene, count: usize) -> Vec<Ray> {
    let mut numbers = Numbers(31);
    let samples = scene.samples(count, 32);
    let ray = |(i, sample): (usize, &SurfaceSample)| {
        let t_max = [0.7, 1.0, 30.0, 3e38, f32::INFINITY][(numbers.bits() % 5) as usize];
        let other = samples[(i * 7919 + 13) % samples.len()].origin;
        let towards = if i % 3 == 0 { other - sample.origin } else { numbers.point() * 3.0 };
        let direction = match i % 5 {
            0 => towards * 10f32.powi((numbers.bits() % 13) as i32 - 6),
            1 => [Vec3::X, Vec3::NEG_Y, Vec3::Z][i % 3],
            _ => towards,
        };
        Ray { origin: sample.origin, direction, t_max }
    };
    samples.iter().enumerate().map(ray).collect()
}

#[test]
fn hits_are_those_of_the_software_traversal() {
    for scene in all() {
        let Some(both) = Both::of(&scene) else { return };
        let mut rays = rays(&scene, 20_001);
        let found = both.check_rays(scene.name, &rays);
        assert_eq!(found > rays.len() / 20, scene.name != "nothing", "{}: {found} hits", scene.name);
        // That end exactly at their hits, and just before.
        let hits = hits(&both.software, &rays);
        for (ray, hit) in rays.iter_mut().zip(&hits).filter(|(_, hit)| hit.is_hit()) {
            ray.t_max = if hit.primitive.is_multiple_of(2) { hit.t } else { hit.t.next_down() };
        }
        both.check_rays(scene.name, &rays);
    }
}

/// From around a scene: at silhouettes, where a box that is too small would lose a hit.
#[test]
fn hits_from_afar_are_those_of_the_software_traversal() {
    for scene in all() {
        let Some(both) = Both::of(&scene) else { return };
        let samples = scene.samples(20_000, 32);
        let mut numbers = Numbers(77);
        let aimed = samples.iter().map(|sample| {
            let from = numbers.point() * [1e-3, 1.0, 40.0][(numbers.bits() % 3) as usize];
            // Along the surface, so that rays graze it.
            let along = from
                - sample.geometric * from.dot(sample.geometric) * [0.0, 1e-5, 1e-2, 1.0][(numbers.bits() % 4) as usize];
            Ray { origin: sample.origin + along, direction: -along, t_max: f32::INFINITY }
        });
        both.check_rays(scene.name, &aimed.collect::<Vec<Ray>>());
    }
}

#[test]
fn sums_are_those_of_the_software_traversal() {
    for scene in all() {
        let Some(both) = Both::of(&scene) else { return };
        for (kernel, rays, count) in [
            (Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] }, 32, 2000),
            (Kernel::Occlusion { ray_distance_m: 1.5 }, 256, 100),
            (Kernel::Obscurance { half_distances_m: vec![0.3] }, 1, 700),
        ] {
            let (samples, rates) = (scene.samples(count, rays), KernelRates::new(&kernel));
            let [software, hardware] = both.tracers().map(|tracer| {
                let mut sums = vec![CosineSums::default(); samples.len()];
                tracer.gather_cosine(&samples, &rates, rays, &mut sums).expect("it traces");
                sums
            });
            assert!(software == hardware, "{}: {rays} rays", scene.name);
        }
    }
}

#[test]
fn how_geometry_is_spread_changes_nothing() {
    let scene = scenes::strained();
    let Some(both) = Both::of(&scene) else { return };
    let device = device_with_ray_queries().expect("it was there a moment ago");
    let parted = GpuTracer::with_binding_bytes(device, &scene.build(), both.hardware.memory_bytes().div_ceil(4));
    let parted = parted.expect("the scene fits");
    assert!(parted.binding_count() > 2);
    let rays = rays(&scene, 5000);
    assert_eq!(hits(&parted, &rays), hits(&both.software, &rays));
}

/// A hit that is reported ends the search behind it: of 40 walls, one behind another, rays see few.
#[test]
fn boxes_behind_a_hit_are_left_out() {
    let mut scene = scenes::square("walls", Vec3::ZERO, Vec3::Y * 9.0, Vec3::Z * 9.0);
    let wall = |x: i32| SceneObject { mesh: 0, world_from_object: DAffine3::from_translation(DVec3::X * f64::from(x)) };
    // In no order along the rays.
    scene.objects = (0..40).map(|i| wall(1 + i * 17 % 40)).collect();
    let Some(both) = Both::of(&scene) else { return };
    let mut numbers = Numbers(5);
    let ray = |_| Ray { origin: Vec3::ZERO, direction: Vec3::X + 0.1 * numbers.point(), t_max: f32::INFINITY };
    let rays: Vec<Ray> = (0..4000).map(ray).collect();
    both.check_rays("walls", &rays);
    let visits = both.hardware.visits(&rays).expect("it traces");
    assert_eq!((visits.rays, visits.hits), (4000, 4000));
    assert!(visits.triangles >= 4000 && visits.instances >= 4000, "{visits:?}");
    assert!(visits.nodes < 4000 * 20, "all boxes are 80 for each ray: {visits:?}");
}

#[test]
fn rays_that_are_no_rays_meet_nothing() {
    let Some(both) = Both::of(&scenes::all()[0]) else { return };
    let ray = |origin, direction| Ray { origin, direction, t_max: 10.0 };
    let rays = [
        ray(Vec3::ONE, Vec3::ZERO),
        ray(Vec3::ONE, Vec3::NAN),
        ray(Vec3::NAN, Vec3::X),
        ray(Vec3::ONE, Vec3::X * 1e-42),
    ];
    assert_eq!(hits(&both.hardware, &rays[..3]), [Hit::MISS; 3]);
    both.check_rays("no rays", &rays[..3]);
    hits(&both.hardware, &rays);
}

#[test]
fn origins_out_of_reach_are_refused() {
    let Some(both) = Both::of(&scenes::all()[0]) else { return };
    let ray = |x: f32| [Ray { origin: Vec3::X * x, direction: Vec3::NEG_X, t_max: f32::INFINITY }];
    both.check_rays("in reach", &ray(63.0));
    let error = both.hardware.trace(&ray(1e4), &mut [Hit::MISS]).expect_err("it is too far away");
    assert!(matches!(error, TraceError::OutOfReach { distance_m: 1e4, reach_m: 64.0 }), "{error}");
    assert!(error.to_string().contains("--ray-queries"), "{error}");
    assert!(both.software.trace(&ray(1e4), &mut [Hit::MISS]).is_ok());
    let far = scenes::free_sample(Vec3::X * 1e4, Vec3::X, Numbers(1).scramble());
    let rates = KernelRates::new(&Kernel::Occlusion { ray_distance_m: 1.0 });
    let error = both.hardware.gather_cosine(&[far], &rates, 4, &mut [CosineSums::default()]);
    assert!(matches!(error, Err(TraceError::OutOfReach { .. })));
}

#[test]
fn a_scene_that_does_not_fit_is_an_error() {
    let Some(device) = device_with_ray_queries() else { return };
    let error = GpuTracer::with_binding_bytes(device, &scenes::all()[8].build(), 4096).expect_err("it does not fit");
    assert!(matches!(error, GpuError::Trace(TraceError::TooLarge { .. })), "{error}");
}
