//! Spheres on the CPU tracer: as its closest hits have it, and in no order.

use glam::{DAffine3, Vec3};
use kiln_core::{FaceGroup, Kernel, Mesh};
use kiln_trace::{
    CpuTracer, KernelRates, MeshBvh, Path, Scene, SceneObject, SobolScramble, SpherePoint, SphereSums, Tracer,
    gather_sphere_by_rays,
};
use proptest::prelude::*;
use std::sync::Arc;

fn tracer(triangles: &[[Vec3; 3]]) -> CpuTracer {
    let group = FaceGroup::PLAIN;
    let mesh = Mesh {
        positions: triangles.iter().flatten().map(Vec3::to_array).collect(),
        normals: vec![[0.0; 3]; 3 * triangles.len()],
        faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        face_group: vec![0; triangles.len()],
        groups: vec![group],
        ..Mesh::default()
    };
    let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
    CpuTracer::new(Arc::new(Scene::build(vec![Arc::new(MeshBvh::build(&mesh))], &[object])))
}

fn point(origin: Vec3, seed: u32) -> SpherePoint {
    SpherePoint { origin, scramble: SobolScramble([seed, seed.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b]) }
}

fn gather(tracer: &CpuTracer, points: &[SpherePoint], kernel: &KernelRates, rays: u32) -> Vec<SphereSums> {
    let mut sums = vec![SphereSums::default(); points.len()];
    tracer.gather_sphere(points, kernel, rays, &mut sums).expect("a CPU traces");
    sums
}

fn vec3() -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-1f32..1.0).prop_map(Vec3::from_array)
}

/// Two faces of a square that is seen from +z, `side` long.
fn square(side: f32, z: f32) -> [[Vec3; 3]; 2] {
    let half = 0.5 * side;
    let [a, b, c, d] = [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, y]| Vec3::new(x, y, z));
    [[a, b, c], [a, c, d]]
}

proptest! {
    #[test]
    fn sums_are_those_of_the_closest_hits(
        triangles in prop::collection::vec(prop::array::uniform3(vec3()), 1..100),
        origins in prop::collection::vec(vec3(), 1..20),
        k in 0u32..10,
        distance in prop_oneof![Just(f64::INFINITY), 0.1f64..3.0],
    ) {
        let fast = tracer(&triangles);
        let portable = CpuTracer::with_path(fast.scene().clone(), Path::Portable);
        let points: Vec<SpherePoint> = origins.iter().zip(0..).map(|(o, seed)| point(*o, seed)).collect();
        for kernel in [
            Kernel::Obscurance { half_distances_m: vec![0.3, 2.0] },
            Kernel::Occlusion { ray_distance_m: distance },
        ] {
            let kernel = KernelRates::new(&kernel);
            let mut expected = vec![SphereSums::default(); points.len()];
            gather_sphere_by_rays(&fast, &points, &kernel, 1 << k, &mut expected).unwrap();
            prop_assert_eq!(&gather(&fast, &points, &kernel, 1 << k), &expected);
            prop_assert_eq!(&gather(&portable, &points, &kernel, 1 << k), &expected);
            // One point at a time.
            for (point, expected) in points.iter().zip(&expected) {
                prop_assert_eq!(&gather(&fast, &[*point], &kernel, 1 << k)[0], expected);
                prop_assert_eq!(expected.rays, 1 << k);
                prop_assert!(expected.values[0][0] <= expected.basis[0] && expected.values[2] == [0; 9]);
            }
        }
    }
}

#[test]
fn thread_count_changes_nothing() {
    let triangles: Vec<[Vec3; 3]> = (0..40).flat_map(|i| square(0.1 * (i % 7) as f32, 0.3 * i as f32)).collect();
    let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![0.5, 20.0] });
    let points: Vec<SpherePoint> = (0..100).map(|i| point(Vec3::new(0.01, 0.02, 0.1 * i as f32), i)).collect();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| gather(&tracer(&triangles), &points, &kernel, 256))
    };
    let one = run(1);
    assert_eq!(one, run(3));
    assert!(one.iter().all(|sum| sum.values[0][0] < sum.basis[0]));
}

/// Half of the sky is a wall: linear and constant coefficients of a half-space, whatever the half-distance at distance 0.
#[test]
fn a_wall_is_half_of_the_sky() {
    let kernel = KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY });
    let front = tracer(&square(1e6, -1.0));
    let points: Vec<SpherePoint> = (0..16).map(|seed| point(Vec3::ZERO, seed)).collect();
    for sum in gather(&front, &points, &kernel, 1024) {
        let c = sum.coefficients(0);
        // ∫ over the upper half of Y: 2π √(1/4π); π √(3/4π); the quadratic ones are 0.
        let sphere = 4.0 * std::f64::consts::PI;
        let expected = [0.5 * sphere.sqrt(), 0.0, 0.25 * (3.0 * sphere).sqrt(), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert!(c.iter().zip(expected).all(|(c, e)| (c - e).abs() < 0.006), "{c:?} {expected:?}");
        assert_eq!(sum.back_faces, 0);
    }
    // From behind, half of the rays see the back.
    let behind = tracer(&square(1e6, 1.0));
    for sum in gather(&behind, &points, &kernel, 1024) {
        assert!((sum.back_face_fraction() - 0.5).abs() < 0.01, "{sum:?}");
    }
}

/// Taking out what the directions themselves sum to leaves less noise than plain sums have.
#[test]
fn centred_sums_are_less_noisy() {
    let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0] });
    let tracer = tracer(&square(1000.0, -0.5));
    let points: Vec<SpherePoint> = (0..256).map(|seed| point(Vec3::ZERO, seed)).collect();
    let sums = gather(&tracer, &points, &kernel, 1024);
    let spread = |of: &dyn Fn(&SphereSums) -> f64| {
        let values: Vec<f64> = sums.iter().map(of).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
    };
    let weight = 4.0 * std::f64::consts::PI / (65536.0 * 1024.0);
    for i in [1, 2, 3] {
        let plain = spread(&|sum| weight * f64::from(sum.values[0][i]));
        let centred = spread(&|sum| sum.coefficients(0)[i]);
        println!("coefficient {i}: plain {plain:.5}, centred {centred:.5}");
        assert!(centred < 0.9 * plain, "{i}: {centred} {plain}");
    }
}
