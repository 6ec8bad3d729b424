//! Rays per second of both tracers. The GPU is the one that `KILN_GPU` names, else a real one, else software.

#[path = "../tests/gpu/scenes.rs"]
#[expect(dead_code, reason = "the tests use the rest")]
mod scenes;

use kiln_core::Kernel;
use kiln_gpu::{AdapterChoice, GpuDevice, GpuTracer};
use kiln_trace::{CosineSums, CpuTracer, KernelRates, SurfaceSample, Tracer};
use std::time::{Duration, Instant};

/// Rays per second, in millions, of repeated calls for at least `SHORTEST`, after one that warms up.
fn rate(tracer: &dyn Tracer, samples: &[SurfaceSample], rays: u32) -> f64 {
    const SHORTEST: Duration = Duration::from_secs(2);
    let rates = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] });
    let mut sums = vec![CosineSums::default(); samples.len()];
    let mut run = || tracer.gather_cosine(samples, &rates, rays, &mut sums).expect("it traces");
    run();
    let (start, mut calls) = (Instant::now(), 0);
    while start.elapsed() < SHORTEST {
        run();
        calls += 1;
    }
    f64::from(calls) * samples.len() as f64 * f64::from(rays) / start.elapsed().as_secs_f64() / 1e6
}

#[expect(clippy::print_stdout, reason = "this is what a benchmark is for")]
fn main() {
    let chosen = AdapterChoice::from_env();
    let opened = GpuDevice::open(&chosen).expect("the adapter opens");
    let gpu = opened.or_else(|| GpuDevice::open(&AdapterChoice::Software).expect("the adapter opens"));
    println!("GPU: {}", gpu.as_ref().map_or("none".to_owned(), |gpu| gpu.describe()));
    println!("{:<30} {:>9} {:>6} {:>12} {:>12}", "scene", "triangles", "rays", "CPU Mrays/s", "GPU Mrays/s");
    for scene in scenes::for_benchmarks() {
        let built = scene.build();
        let triangles: usize = scene.objects.iter().map(|object| scene.meshes[object.mesh].faces.len()).sum();
        let cpu = CpuTracer::new(built.clone());
        let on_gpu = gpu.as_ref().map(|gpu| GpuTracer::new(gpu.clone(), &built).expect("the scene fits"));
        for rays in [16, 32, 256] {
            let samples = scene.samples((1 << 20) / rays as usize, rays);
            let of_cpu = rate(&cpu, &samples, rays);
            let of_gpu = on_gpu.as_ref().map_or(0.0, |tracer| rate(tracer, &samples, rays));
            println!("{:<30} {triangles:>9} {rays:>6} {of_cpu:>12.2} {of_gpu:>12.2}", scene.name);
        }
    }
}
