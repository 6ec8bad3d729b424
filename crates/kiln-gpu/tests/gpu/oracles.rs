//! The GPU tracer against closed forms: 64 independent scrambles of 1024 rays.

use crate::scenes::{self, Numbers, TestScene};
use glam::Vec3;
use kiln_core::Kernel;
use kiln_gpu::GpuTracer;
use kiln_trace::{CosineSums, KernelRates, SurfaceSample, Tracer};

const SCRAMBLES: usize = 64;
const RAYS: u32 = 1024;

fn check(scene: &TestScene, origin: Vec3, normal: Vec3, expected: [f64; 2]) {
    let tracer = GpuTracer::new(crate::device(), &scene.build()).expect("the scene fits");
    // Every ray counts to its end: the reach would cut those that a distant wall stops.
    let mut rates = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] });
    rates.t_max = f32::MAX;
    let mut numbers = Numbers(2026);
    let samples: Vec<SurfaceSample> =
        (0..SCRAMBLES).map(|_| scenes::free_sample(origin, normal, numbers.scramble())).collect();
    let mut sums = vec![CosineSums::default(); SCRAMBLES];
    tracer.gather_cosine(&samples, &rates, RAYS, &mut sums).expect("it traces");
    for (channel, expected) in expected.into_iter().enumerate() {
        let errors: Vec<f64> = sums.iter().map(|s| s.ao(channel) - expected).collect();
        let mean = errors.iter().sum::<f64>() / SCRAMBLES as f64;
        let rmse = (errors.iter().map(|e| e * e).sum::<f64>() / SCRAMBLES as f64).sqrt();
        assert!(mean.abs() <= 5e-4 && rmse <= 3e-3, "{}: mean error {mean}, RMSE {rmse}", scene.name);
    }
}

/// Facing an infinite plane 2 m away: `1 − 2 E3(k h)`.
#[test]
fn parallel_plane() {
    let plane = scenes::square("plane", Vec3::Z * 2.0, Vec3::Y * 1e6, Vec3::X * 1e6);
    check(&plane, Vec3::ZERO, Vec3::Z, [0.664_639_946_4, 0.009_107_404_1]);
}

/// On the inner surface of a ball of 1 m: `1 − 2 (1 − e^(−c)(1 + c)) / c²`. The ball is of many small faces, whose
/// planes are nearer than the sphere by less than a thousandth of the radius.
#[test]
fn inner_sphere() {
    let ball = scenes::hollow_ball(1.0, 96);
    let point = Vec3::new(0.3, 0.5, 0.2).normalize();
    check(&ball, point * 0.9995, -point, [0.361_326_059_9, 0.003_075_322_3]);
}

/// On a floor, 1 m from an infinite wall: `1 − (2/π)[Ki1(k x) − Ki3(k x)]`.
#[test]
fn infinite_wall() {
    let wall = scenes::square("wall", Vec3::X, Vec3::Z * 1e6, Vec3::Y * 1e6);
    check(&wall, Vec3::ZERO, Vec3::Z, [0.811_674_088_3, 0.509_102_009_5]);
}
