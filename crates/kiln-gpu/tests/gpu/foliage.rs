//! Rays through foliage on the GPU: against the processor's tracer, against closed forms, and by law.

use crate::scenes::{self, Numbers, TestScene};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_core::{Bounds, FaceGroup, Fog, Foliage as FaceFoliage, FoliageMode, Kernel, Mesh, OpticalDepth};
use kiln_gpu::{GpuDevice, GpuTracer};
use kiln_trace::{
    CosineSums, CpuTracer, CrossingMesh, Foliage, FoliageObject, Hit, KernelRates, MeshBvh, Ray, Scene, SpherePoint,
    SphereSums, SurfaceSample, Tracer, cosine_direction, orthonormal_basis, sobol_point,
};
use std::sync::Arc;

const BOTH: [FoliageMode; 2] = [FoliageMode::Attenuate, FoliageMode::Expected];

type Triangle = [Vec3; 3];

fn crossing_mesh(triangles: &[Triangle], kept: f64) -> Arc<CrossingMesh> {
    let foliage = Some(FaceFoliage::Crossing(OpticalDepth::of_transmittance(kept)));
    let mesh = Mesh {
        positions: triangles.iter().flatten().map(Vec3::to_array).collect(),
        normals: vec![[0.0; 3]; 3 * triangles.len()],
        faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        face_group: vec![0; triangles.len()],
        groups: vec![FaceGroup { occludes: false, foliage, ..FaceGroup::PLAIN }],
    };
    Arc::new(CrossingMesh::build(&mesh).expect("its faces are foliage"))
}

fn placed(mesh: &Arc<CrossingMesh>, world_from_object: DAffine3) -> FoliageObject {
    FoliageObject::Crossings { mesh: Arc::clone(mesh), world_from_object }
}

fn fog(min: DVec3, max: DVec3, density_per_m: f64, world_from_object: DAffine3) -> FoliageObject {
    FoliageObject::Fog { fog: Fog { bounds: Bounds { min, max }, density_per_m }, world_from_object }
}

/// Fog without end between two heights.
fn slab(bottom: f64, top: f64, density_per_m: f64) -> FoliageObject {
    let far = 20_000.0;
    fog(DVec3::new(-far, bottom, -far), DVec3::new(far, top, far), density_per_m, DAffine3::IDENTITY)
}

/// A wide square across the y axis.
fn ceiling(y: f32, half: f32) -> [Triangle; 2] {
    let at = |x: f32, z: f32| Vec3::new(x * half, y, z * half);
    [[at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)], [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]]
}

fn up(y: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::Y * y)
}

fn scene(opaque: &TestScene, foliage: &[FoliageObject], mode: FoliageMode) -> Arc<Scene> {
    let meshes = opaque.meshes.iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
    Arc::new(Scene::build(meshes, &opaque.objects).with_foliage(Foliage::build(foliage, mode)))
}

fn nothing() -> TestScene {
    TestScene::new("nothing", &[], Vec::new())
}

fn wall(y: f32, half: f32) -> TestScene {
    // Its front is seen from below.
    scenes::square("wall", Vec3::Y * y, Vec3::X * half, Vec3::Z * half)
}

fn on(device: Arc<GpuDevice>, scene: &Scene) -> GpuTracer {
    GpuTracer::new(device, scene).expect("the scene fits")
}

fn gather(tracer: &dyn Tracer, samples: &[SurfaceSample], kernel: &KernelRates, rays: u32) -> Vec<CosineSums> {
    let mut sums = vec![CosineSums::default(); samples.len()];
    tracer.gather_cosine(samples, kernel, rays, &mut sums).expect("it traces");
    sums
}

fn obscurance(half_distances_m: &[f64]) -> KernelRates {
    KernelRates::new(&Kernel::Obscurance { half_distances_m: half_distances_m.to_vec() })
}

fn occlusion() -> KernelRates {
    KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY })
}

/// Samples at the origin of one ray each, all about +y.
fn upwards(count: usize) -> Vec<SurfaceSample> {
    let mut numbers = Numbers(41);
    (0..count).map(|_| scenes::free_sample(Vec3::ZERO, Vec3::Y, numbers.scramble())).collect()
}

/// The direction of the one ray of a sample.
fn direction_of(sample: &SurfaceSample) -> Vec3 {
    cosine_direction(sobol_point(sample.first_index, sample.scramble), sample.normal, orthonormal_basis(sample.normal))
}

fn transform(numbers: &mut Numbers) -> DAffine3 {
    let scale = numbers.point().as_dvec3().map(|x| x.signum() * (0.3 + 1.7 * x.abs()));
    let [x, y, z] = (numbers.point().as_dvec3() * 3.0).to_array();
    let turn = DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y) * DQuat::from_rotation_z(z);
    DAffine3::from_scale_rotation_translation(scale, turn, numbers.point().as_dvec3() * 2.0)
}

fn soup(numbers: &mut Numbers, count: usize) -> Vec<Triangle> {
    (0..count).map(|_| [0; 3].map(|_| numbers.point())).collect()
}

/// Trees of which several are instances of one mesh, and boxes of fog that overlap, all turned, mirrored and scaled unevenly.
fn things(numbers: &mut Numbers, count: usize) -> Vec<FoliageObject> {
    let meshes = [1, 9, 70].map(|faces| {
        let triangles = soup(numbers, faces);
        crossing_mesh(&triangles, 0.2 + 0.75 * f64::from(numbers.unit()))
    });
    let mut thing = |i: usize| {
        let place = transform(numbers);
        if i.is_multiple_of(2) {
            return placed(&meshes[i / 2 % 3], place);
        }
        let (a, b) = (numbers.point().as_dvec3(), numbers.point().as_dvec3());
        fog(a.min(b) - 1e-3, a.max(b) + 1e-3, 0.01 + 2.0 * f64::from(numbers.unit()), place)
    };
    (0..count).map(&mut thing).collect()
}

fn samples(numbers: &mut Numbers, count: usize) -> Vec<SurfaceSample> {
    let mut sample = |_| {
        let (origin, normal) = (numbers.point() * 3.0, numbers.point().normalize_or(Vec3::Y));
        scenes::free_sample(origin, normal, numbers.scramble())
    };
    (0..count).map(&mut sample).collect()
}

/// Single rays: values within 4 of 65,536 but for one ray in 500, on which rounding decides whether a face is hit or crossed.
#[test]
fn rays_are_worth_what_they_are_on_the_processor() {
    let kernels = [
        obscurance(&[1.5]),
        obscurance(&[0.4, 9.0]),
        obscurance(&[0.2, 1.0, 5.0, 300.0]),
        occlusion(),
        KernelRates::new(&Kernel::Occlusion { ray_distance_m: 1.2 }),
        // Rays without end.
        KernelRates { t_max: f32::MAX, ..obscurance(&[1.0, 1e-3]) },
    ];
    for mode in BOTH {
        for (seed, kernel) in kernels.iter().enumerate() {
            let mut numbers = Numbers(seed as u64 + 100);
            let things = things(&mut numbers, [3, 6, 12, 40, 90, 60][seed]);
            let still = kiln_trace::SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
            let opaque = TestScene::new("soup", &soup(&mut numbers, 3 * seed), vec![still]);
            let built = scene(&opaque, &things, mode);
            let (cpu, gpu) = (CpuTracer::new(Arc::clone(&built)), on(crate::device(), &built));
            let samples = samples(&mut numbers, 8192);
            let (c, g) = (gather(&cpu, &samples, kernel, 1), gather(&gpu, &samples, kernel, 1));
            let differs = |(c, g): &(&CosineSums, &CosineSums)| {
                c.rays != g.rays || c.values.iter().zip(g.values).any(|(c, g)| c.abs_diff(g) > 4)
            };
            let far = c.iter().zip(&g).filter(differs).count();
            assert!(far <= samples.len() / 500, "{mode:?} {seed}: {far} of {} rays", samples.len());
            println!("{mode:?} {seed}: {far} of {} rays differ", samples.len());
            let dimmed = c.iter().filter(|sums| sums.values[0] > 0 && sums.values[0] < 60_000).count();
            assert!(dimmed > samples.len() / 80, "{mode:?} {seed}: only {dimmed} rays go through anything");
            let bias: f64 = c.iter().zip(&g).map(|(c, g)| f64::from(c.values[0]) - f64::from(g.values[0])).sum();
            assert!((bias / (65536.0 * samples.len() as f64)).abs() < 2e-4, "{mode:?} {seed}: biased by {bias}");
        }
    }
}

/// Whole samples and spheres: 99.5 % within 2e-3, all within 4/N, as without foliage.
#[test]
fn sums_are_those_of_the_processor() {
    for mode in BOTH {
        let mut numbers = Numbers(7);
        let things = things(&mut numbers, 60);
        let opaque = &scenes::all()[3];
        let built = scene(opaque, &things, mode);
        let (cpu, gpu) = (CpuTracer::new(Arc::clone(&built)), on(crate::device(), &built));
        let kernel = obscurance(&[2.0, 300.0]);
        for (rays, samples) in [(32, opaque.samples(2048, 32)), (256, samples(&mut numbers, 99))] {
            let (c, g) = (gather(&cpu, &samples, &kernel, rays), gather(&gpu, &samples, &kernel, rays));
            let error = |(c, g): (&CosineSums, &CosineSums)| {
                [0, 1].map(|channel| (c.ao(channel) - g.ao(channel)).abs()).into_iter().fold(0.0, f64::max)
            };
            let errors: Vec<f64> = c.iter().zip(&g).map(error).collect();
            assert!(errors.iter().all(|error| *error <= 4.0 / f64::from(rays)), "{mode:?}: {errors:?}");
            let far = errors.iter().filter(|error| **error > 2e-3).count();
            assert!(far <= samples.len() / 200, "{mode:?}: {far} of {}", samples.len());
        }
        let point = |_| SpherePoint { origin: numbers.point() * 3.0, scramble: numbers.scramble() };
        let points: Vec<SpherePoint> = (0..200).map(point).collect();
        let [c, g] = [&cpu as &dyn Tracer, &gpu].map(|tracer| {
            let mut sums = vec![SphereSums::default(); points.len()];
            tracer.gather_sphere(&points, &kernel, 256, &mut sums).expect("it traces");
            sums
        });
        let mut far = 0;
        for (c, g) in c.iter().zip(&g) {
            assert_eq!((c.basis, c.rays), (g.basis, g.rays));
            for channel in 0..2 {
                let pairs = c.coefficients(channel).into_iter().zip(g.coefficients(channel));
                let error = pairs.map(|(c, g)| (c - g).abs()).fold(0.0, f64::max);
                // A ray counts for 4 pi / 256 times a function that is at most 0.63.
                assert!(error < 4.0 * 0.031, "{mode:?}: {error}");
                far += usize::from(error > 5e-3);
            }
        }
        assert!(far <= points.len() * 2 / 100, "{mode:?}: {far}");
    }
}

/// What a ray is worth between layers at heights `1 + step · i`, in f64.
fn through_layers(cosine: f64, layers: usize, step: f64, kept: f64, half_distance: Option<f64>) -> f64 {
    let Some(d) = half_distance else { return kept.powi(layers as i32) };
    let rho = |t: f64| 1.0 - (-t / d).exp2();
    let at = |i: usize| (1.0 + step * i as f64) / cosine;
    let absorbed = (0..layers).map(|i| kept.powi(i as i32) * (1.0 - kept) * rho(at(i)));
    absorbed.sum::<f64>() + kept.powi(layers as i32)
}

/// More layers than a list has room for, in trees of their own and in one: the closed form, to 4 of 65,536.
#[test]
fn layers_beyond_the_list_are_not_lost() {
    let samples = upwards(256);
    for layers in [1usize, 15, 16, 17, 31, 32, 33, 200] {
        let step = 0.01;
        // In no order of their height.
        let shuffled = (0..layers).map(|i| (i * 89 + 5) % layers);
        let height = |i: usize| 1.0 + step * i as f64;
        let flat = crossing_mesh(&ceiling(0.0, 9e3), 0.99);
        let one: Vec<Triangle> = (0..layers).flat_map(|i| ceiling(height(i) as f32, 9e3)).collect();
        let apart: Vec<FoliageObject> = shuffled.map(|i| placed(&flat, up(height(i)))).collect();
        let together = vec![placed(&crossing_mesh(&one, 0.99), DAffine3::IDENTITY)];
        for (objects, mode) in [(&apart, BOTH[0]), (&apart, BOTH[1]), (&together, BOTH[0]), (&together, BOTH[1])] {
            let tracer = on(crate::device(), &scene(&nothing(), objects, mode));
            for half_distance in [None, Some(1.0), Some(20.0)] {
                let kernel = half_distance.map_or_else(occlusion, |d| obscurance(&[d, 300.0]));
                for (sample, sums) in samples.iter().zip(gather(&tracer, &samples, &kernel, 1)) {
                    let cosine = f64::from(direction_of(sample).y);
                    // Rays at the horizon pass by, or end before.
                    if sums.rays == 0 || cosine < 0.01 {
                        continue;
                    }
                    let kept = OpticalDepth::of_transmittance(0.99).transmittance();
                    let d = if mode == FoliageMode::Attenuate { None } else { half_distance };
                    let expected = 65536.0 * through_layers(cosine, layers, step, kept, d);
                    let found = f64::from(sums.values[0]);
                    assert!(
                        (found - expected).abs() < 4.0,
                        "{mode:?} {layers} {half_distance:?} {cosine}: {found} {expected}"
                    );
                }
            }
        }
    }
}

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

/// Slabs of fog that overlap, with more beginnings and ends than a list has room for, against f64; the fog of an equal number of
/// boxes in one place is as dense as all.
#[test]
fn fog_is_neither_lost_nor_left_on() {
    let samples = upwards(512);
    let (d, density) = (1.5, 0.02);
    let kernel = obscurance(&[d]);
    let slabs: Vec<[f64; 2]> =
        (0..60).map(|i| [0.1 * f64::from(i * 7 % 60), 0.1 * f64::from(i * 7 % 60) + 1.0]).collect();
    let objects: Vec<FoliageObject> = slabs.iter().map(|[bottom, top]| slab(*bottom, *top, density)).collect();
    for mode in BOTH {
        let tracer = on(crate::device(), &scene(&nothing(), &objects, mode));
        for (sample, sums) in samples.iter().zip(gather(&tracer, &samples, &kernel, 1)) {
            let cosine = f64::from(direction_of(sample).y);
            if sums.rays == 0 || cosine < 0.01 {
                continue;
            }
            let reach = f64::from(kernel.t_max);
            let depth =
                |t: f64| slabs.iter().map(|[a, b]| (t.min(b / cosine) - a / cosine).max(0.0) * density).sum::<f64>();
            let rate = std::f64::consts::LN_2 / d;
            let mut expected = (-depth(reach)).exp();
            if mode == FoliageMode::Expected {
                expected *= (-rate * reach).exp();
                let mut bounds: Vec<f64> =
                    slabs.iter().flatten().map(|y| (y / cosine).min(reach)).chain([0.0, reach]).collect();
                bounds.sort_by(f64::total_cmp);
                for pair in bounds.windows(2).filter(|pair| pair[0] < pair[1]) {
                    let sigma = (depth(pair[1]) - depth(pair[0])) / (pair[1] - pair[0]);
                    let both = rate + sigma;
                    expected += rate / both
                        * (-depth(pair[0]) - rate * pair[0]).exp()
                        * (1.0 - (-both * (pair[1] - pair[0])).exp());
                }
            }
            let found = f64::from(sums.values[0]) / 65536.0;
            assert!((found - expected).abs() < 1e-4, "{mode:?} {cosine}: {found} {expected}");
        }
        // 25 boxes of one density in one place, and one of 25 times as much.
        let [many, one] = [(25, 0.04), (1, 1.0)].map(|(copies, density)| {
            let objects: Vec<FoliageObject> = (0..copies).map(|_| slab(0.5, 1.5, density)).collect();
            gather(&on(crate::device(), &scene(&wall(2.0, 50.0), &objects, mode)), &samples, &kernel, 1)
        });
        let off = many.iter().zip(&one).filter(|(a, b)| a.values[0].abs_diff(b.values[0]) > 26).count();
        assert_eq!(off, 0, "{mode:?}");
    }
}

/// Mean over the cosine-weighted hemisphere of a function of the cosine.
fn over_hemisphere(value: impl Fn(f64) -> f64) -> f64 {
    let steps = 20_000;
    (0..steps).map(|i| ((f64::from(i) + 0.5) / f64::from(steps)).sqrt()).map(value).sum::<f64>() / f64::from(steps)
}

#[test]
fn a_slab_of_fog_is_as_its_closed_form_says() {
    let (thickness, density, height) = (1.0, 0.3, 3.0);
    for (half_distance, with_ceiling) in [(2.0, false), (300.0, false), (2.0, true), (300.0, true)] {
        for mode in BOTH {
            let k = std::f64::consts::LN_2 / half_distance;
            let opaque = if with_ceiling { wall(height as f32, 2e4) } else { nothing() };
            let tracer = on(crate::device(), &scene(&opaque, &[slab(0.0, thickness, density)], mode));
            let kernel = obscurance(&[half_distance]);
            let sample = scenes::free_sample(Vec3::Y * 1e-4, Vec3::Y, Numbers(3).scramble());
            let found = gather(&tracer, &[sample], &kernel, 1 << 14)[0].ao(0);
            let reach = f64::from(kernel.t_max);
            let expected = over_hemisphere(|cosine| {
                let in_fog = (thickness / cosine).min(reach);
                let end = if with_ceiling && height / cosine < reach { height / cosine } else { f64::INFINITY };
                let kept = (-density * in_fog).exp();
                match mode {
                    FoliageMode::Attenuate => kept * (1.0 - (-k * end).exp()),
                    _ => {
                        k / (k + density) * (1.0 - (-(k + density) * in_fog).exp())
                            + kept * ((-k * in_fog).exp() - (-k * end).exp())
                    }
                }
            });
            assert!((found - expected).abs() < 2e-3, "{mode:?} {half_distance} {with_ceiling}: {found} {expected}");
        }
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
