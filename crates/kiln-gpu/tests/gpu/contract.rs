//! The GPU tracer against the CPU tracer, to the bounds of their contract.

use crate::scenes::{self, Numbers, TestScene};
use glam::Vec3;
use kiln_core::Kernel;
use kiln_gpu::GpuTracer;
use kiln_trace::{CosineSums, CpuTracer, Hit, KernelRates, Ray, SurfaceSample, Tracer};

const SAMPLES: usize = 8192;
const RAYS: u32 = 32;

fn obscurance() -> KernelRates {
    KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] })
}

fn gather(tracer: &dyn Tracer, samples: &[SurfaceSample], rates: &KernelRates, rays: u32) -> Vec<CosineSums> {
    let mut sums = vec![CosineSums::default(); samples.len()];
    tracer.gather_cosine(samples, rates, rays, &mut sums).expect("it traces");
    sums
}

fn tracers(scene: &TestScene) -> (CpuTracer, GpuTracer) {
    let built = scene.build();
    let gpu = GpuTracer::new(crate::device(), &built).expect("the scene fits");
    (CpuTracer::new(built), gpu)
}

/// 99.5 % of samples within 2e-3, all within 4/N; validity differs on at most one sample in 10,000.
fn check(name: &str, cpu: &[CosineSums], gpu: &[CosineSums], rates: &KernelRates, rays: u32) {
    let (mut far, mut differing_validity) = (0, 0);
    for (c, g) in cpu.iter().zip(gpu) {
        for channel in 0..rates.channels {
            let error = (c.ao(channel) - g.ao(channel)).abs();
            assert!(error <= 4.0 / f64::from(rays), "{name}: {error} in channel {channel}\ncpu {c:?}\ngpu {g:?}");
            far += usize::from(error > 2e-3);
        }
        assert_eq!(c.values[rates.channels..], g.values[rates.channels..], "{name}: a channel that is not used");
        differing_validity += usize::from((c.back_face_fraction() > 0.25) != (g.back_face_fraction() > 0.25));
    }
    assert!(far <= cpu.len() * rates.channels / 200, "{name}: {far} of {} samples differ", cpu.len());
    assert!(differing_validity <= cpu.len() / 10_000 + 1, "{name}: validity of {differing_validity} samples differs");
}

#[test]
fn agrees_with_the_cpu_on_every_scene() {
    for scene in scenes::all() {
        let (cpu, gpu) = tracers(&scene);
        let samples = scene.samples(SAMPLES, RAYS);
        let rates = obscurance();
        let (c, g) = (gather(&cpu, &samples, &rates, RAYS), gather(&gpu, &samples, &rates, RAYS));
        check(scene.name, &c, &g, &rates, RAYS);
        // The scenes do what they are for: rays hit, and backs are seen where they should be.
        let ao = c.iter().map(|s| s.ao(0)).sum::<f64>() / c.len() as f64;
        assert_eq!(ao < 0.999, scene.name != "nothing" && scene.name != "ball from outside", "{}: {ao}", scene.name);
    }
}

#[test]
fn agrees_for_any_number_of_rays_and_samples() {
    let scene = &scenes::all()[4];
    assert_eq!(scene.name, "instanced soup");
    let (cpu, gpu) = tracers(scene);
    let cases =
        [(1, 100), (2, 37), (4, 64), (8, 5), (16, 1), (16, 203), (256, 1), (256, 3), (256, 50), (2048, 2), (16384, 1)];
    for (rays, count) in cases {
        let samples = scene.samples(count, rays);
        for kernel in [
            Kernel::Occlusion { ray_distance_m: f64::INFINITY },
            Kernel::Occlusion { ray_distance_m: 0.5 },
            Kernel::Obscurance { half_distances_m: vec![0.1, 1.0, 10.0, 100.0] },
        ] {
            let rates = KernelRates::new(&kernel);
            let (c, g) = (gather(&cpu, &samples, &rates, rays), gather(&gpu, &samples, &rates, rays));
            check(&format!("{rays} rays, {count} samples"), &c, &g, &rates, rays);
            let total = |sums: &[CosineSums]| sums.iter().map(|s| i64::from(s.rays)).sum::<i64>();
            assert!((total(&c) - total(&g)).abs() <= 1, "{rays} rays, {count} samples: not every ray was traced once");
        }
    }
}

#[test]
fn no_samples_is_no_error() {
    let (_, gpu) = tracers(&scenes::all()[0]);
    assert_eq!(gather(&gpu, &[], &obscurance(), 32), []);
    gpu.trace(&[], &mut []).expect("nothing to do");
    gpu.any_hit(&[], &mut []).expect("nothing to do");
}

#[test]
fn closest_hits_are_those_of_the_cpu() {
    for scene in scenes::all() {
        let (cpu, gpu) = tracers(&scene);
        let mut numbers = Numbers(5);
        // From the surfaces, so that rays meet geometry wherever it is; directions of any length.
        let ray = |sample: &SurfaceSample| {
            let t_max = [0.7, 30.0, f32::MAX, f32::INFINITY][(numbers.bits() % 4) as usize];
            Ray { origin: sample.origin, direction: numbers.point() * 3.0, t_max }
        };
        let rays: Vec<Ray> = scene.samples(8192, 32).iter().map(ray).collect();
        let (mut c, mut g) = (vec![Hit::MISS; rays.len()], vec![Hit::MISS; rays.len()]);
        cpu.trace(&rays, &mut c).expect("it traces");
        gpu.trace(&rays, &mut g).expect("it traces");
        let is_far = |(a, b): &(&Hit, &Hit)| !((a.t - b.t).abs() <= 1e-5 * (1.0 + a.t) || a == b);
        let far = c.iter().zip(&g).filter(is_far).count();
        assert!(far <= rays.len() / 1000, "{}: {far} of {} distances differ", scene.name, rays.len());
        // On an edge, and where faces of different shape lie in one plane, rounding decides which one is closest.
        let id = |hit: &Hit| (hit.instance, hit.primitive, hit.back_face);
        let other = c.iter().zip(&g).filter(|(a, b)| id(a) != id(b)).count();
        assert!(other <= rays.len() / 10, "{}: {other} of {} hits are others", scene.name, rays.len());
        assert_eq!(g.iter().any(Hit::is_hit), scene.name != "nothing", "{}", scene.name);
        println!("{}: {far} distances and {other} faces of {} differ", scene.name, rays.len());
    }
}

/// The early-out kernel says what the closest hits say, also where they lie exactly at the ray's end.
#[test]
fn any_hit_is_what_trace_finds() {
    for scene in scenes::all() {
        let (_, gpu) = tracers(&scene);
        let mut numbers = Numbers(8);
        let ray = |sample: &SurfaceSample| {
            let t_max = [0.2, 3.0, f32::INFINITY][(numbers.bits() % 3) as usize];
            Ray { origin: sample.origin, direction: numbers.point() * 2.0, t_max }
        };
        // No multiple of a workgroup's rays.
        let mut rays: Vec<Ray> = scene.samples(5001, 16).iter().map(ray).collect();
        let mut hits = vec![Hit::MISS; rays.len()];
        gpu.trace(&rays, &mut hits).expect("it traces");
        let ends =
            rays.iter().zip(&hits).filter(|(_, hit)| hit.is_hit()).map(|(ray, hit)| Ray { t_max: hit.t, ..*ray });
        let ends: Vec<Ray> = ends.collect();
        rays.extend(ends);
        hits.resize(rays.len(), Hit::MISS);
        gpu.trace(&rays, &mut hits).expect("it traces");
        let mut blocked = vec![false; rays.len()];
        gpu.any_hit(&rays, &mut blocked).expect("it traces");
        let expected: Vec<bool> = hits.iter().map(Hit::is_hit).collect();
        assert!(blocked == expected, "{}", scene.name);
        assert!(blocked.contains(&true) == (scene.name != "nothing") && blocked.contains(&false), "{}", scene.name);
    }
}

/// Counters: a ray that meets nothing reads the first node at least, and one that hits has tested a triangle.
#[test]
fn visits_are_counted() {
    let scene = &scenes::all()[2];
    let (_, gpu) = tracers(scene);
    let rays: Vec<Ray> = (0..100)
        .map(|i| Ray {
            origin: Vec3::X * (i / 50) as f32 * 50.0,
            direction: Vec3::new(1.0, 0.1, 0.01 * i as f32),
            t_max: 1e3,
        })
        .collect();
    let visits = gpu.visits(&rays).expect("it traces");
    // The inner half is in a closed ball, the outer looks away from it.
    assert_eq!((visits.rays, visits.hits, visits.instances), (100, 50, 50));
    assert!(visits.nodes >= 100 + 50 && visits.triangles >= 50 && visits.triangles < 50 * 40, "{visits:?}");
}

/// A hit exactly at the ray's end counts from the front, as on the CPU.
#[test]
fn ties_and_ends_are_those_of_the_cpu() {
    let wall = scenes::square("wall", Vec3::ZERO, Vec3::X, Vec3::Y);
    let (cpu, gpu) = tracers(&wall);
    let ray = |z: f32, t_max: f32| Ray { origin: Vec3::new(0.2, 0.1, z), direction: -Vec3::Z * z.signum(), t_max };
    let rays = [ray(1.0, 1.0), ray(-1.0, 1.0), ray(1.0, 0.999_999), ray(1.0, 1.000_001), ray(-1.0, 1.000_001)];
    let (mut c, mut g) = (vec![Hit::MISS; rays.len()], vec![Hit::MISS; rays.len()]);
    cpu.trace(&rays, &mut c).expect("it traces");
    gpu.trace(&rays, &mut g).expect("it traces");
    assert_eq!(c, g);
    assert_eq!(g.iter().map(Hit::is_hit).collect::<Vec<_>>(), [true, false, false, true, true]);
    assert!(g[4].back_face && !g[3].back_face);

    // A triangle and its mirror image in one place: the front comes first, then the lowest instance.
    let ray = Ray { origin: Vec3::new(0.2, 0.2, 1.0), direction: Vec3::NEG_Z, t_max: 10.0 };
    for order in [[0, 1, 0], [1, 0, 0], [1, 1, 0]] {
        let (cpu, gpu) = tracers(&scenes::mirrored_pair(order));
        let mut hit = [Hit::MISS];
        gpu.trace(&[ray], &mut hit).expect("it traces");
        let first_front = order.iter().position(|&mesh| mesh == 0).expect("there is one") as u32;
        assert_eq!(hit[0], Hit { t: 1.0, instance: first_front, primitive: 0, back_face: false });
        assert_eq!(hit[0], cpu.closest_hit(&ray));
    }
}

/// No ray leaves a closed mesh through its edges.
#[test]
fn closed_meshes_are_watertight() {
    let ball = scenes::hollow_ball(3.0, 40);
    let (_, gpu) = tracers(&ball);
    let mut numbers = Numbers(11);
    let samples: Vec<SurfaceSample> = (0..256)
        .map(|_| scenes::free_sample(numbers.point(), numbers.point().normalize(), numbers.scramble()))
        .collect();
    let rates = KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY });
    let sums = gather(&gpu, &samples, &rates, 1024);
    // Straight at vertices and edges, too.
    let corners: Vec<Vec3> = ball.meshes[0].positions.iter().map(|&p| Vec3::from_array(p)).collect();
    let rays: Vec<Ray> = corners
        .windows(2)
        .flat_map(|pair| [pair[0], (pair[0] + pair[1]) * 0.5])
        .map(|target| Ray { origin: Vec3::ZERO, direction: target, t_max: f32::MAX })
        .collect();
    let mut hits = vec![Hit::MISS; rays.len()];
    gpu.trace(&rays, &mut hits).expect("it traces");
    assert!(sums.iter().all(|s| s.values[0] == 0 && s.back_faces == 0 && s.rays > 1000));
    assert!(hits.iter().all(|hit| hit.is_hit() && !hit.back_face));
}

/// Subgroup operations change no sum.
#[test]
fn sums_are_the_same_without_subgroups() {
    let (with, without) = (crate::device(), crate::device_without_subgroups());
    assert!(!without.has_subgroups());
    if !with.has_subgroups() {
        println!("{} has no subgroup operations: nothing to compare", with.describe());
        return;
    }
    let scene = &scenes::all()[4];
    let built = scene.build();
    let tracers = [with, without].map(|device| GpuTracer::new(device, &built).expect("the scene fits"));
    for (rays, count) in [(1, 70), (2, 37), (8, 5), (16, 2000), (64, 1), (256, 3), (2048, 2)] {
        let samples = scene.samples(count, rays);
        let [a, b] = tracers.each_ref().map(|tracer| gather(tracer, &samples, &obscurance(), rays));
        assert_eq!(a, b, "{rays} rays, {count} samples");
    }
}

/// How the geometry is spread over bindings, what is dispatched together and by which thread changes no result.
#[test]
fn results_do_not_depend_on_dispatches_bindings_or_threads() {
    let scene = &scenes::all()[4];
    let built = scene.build();
    let whole = GpuTracer::new(crate::device(), &built).expect("the scene fits");
    let parted =
        GpuTracer::with_binding_bytes(crate::device(), &built, whole.memory_bytes().div_ceil(4)).expect("it fits");
    assert!(whole.binding_count() == 1 && parted.binding_count() > 2);
    let (samples, rates) = (scene.samples(4000, 64), obscurance());
    let expected = gather(&whole, &samples, &rates, 64);
    assert_eq!(gather(&parted, &samples, &rates, 64), expected);
    // Pieces have other neighbours in their cones.
    let pieces: Vec<CosineSums> = samples.chunks(333).flat_map(|piece| gather(&whole, piece, &rates, 64)).collect();
    assert_eq!(pieces, expected);
    std::thread::scope(|scope| {
        let run = || scope.spawn(|| assert_eq!(gather(&whole, &samples, &rates, 64), expected));
        let threads = [run(), run(), run()];
        threads.into_iter().for_each(|thread| thread.join().expect("no thread panics"));
    });
}
