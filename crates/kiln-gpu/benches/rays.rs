//! Rays per second of both tracers, what rays visit, and what the model of rates says. The GPU is the one that `KILN_GPU`
//! names, else a real one, else software.
//!
//! `cargo bench -p kiln-gpu --bench rays` takes scenes made by code. Two files after `--`, positions (three f32 a vertex)
//! and indices (three u32 a face), little-endian, are another scene.

#[path = "../tests/gpu/scenes.rs"]
#[expect(dead_code, reason = "the tests use the rest")]
mod scenes;

use kiln_core::Kernel;
use kiln_gpu::{AdapterChoice, GpuDevice, GpuTracer, model::Roofs};
use kiln_trace::{
    CosineSums, CpuTracer, KernelRates, Ray, SurfaceSample, Tracer, cosine_direction, orthonormal_basis, sobol_point,
};
use scenes::TestScene;
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

/// The rays of samples, as gathering makes them.
fn rays_of(samples: &[SurfaceSample], rays: u32) -> Vec<Ray> {
    let of_sample = |sample: &SurfaceSample| {
        let (sample, basis) = (*sample, orthonormal_basis(sample.normal));
        let direction = move |i| {
            cosine_direction(sobol_point(sample.first_index.wrapping_add(i), sample.scramble), sample.normal, basis)
        };
        (0..rays).map(move |i| Ray { origin: sample.origin, direction: direction(i), t_max: 3000.0 })
    };
    samples.iter().flat_map(of_sample).collect()
}

/// A scene from two files.
fn scene_of_files(positions: &str, indices: &str) -> TestScene {
    let words = |path: &str| {
        let bytes = std::fs::read(path).expect("the file is there");
        bytes.as_chunks::<4>().0.iter().map(|&word| u32::from_le_bytes(word)).collect::<Vec<u32>>()
    };
    let positions: Vec<[f32; 3]> = words(positions).as_chunks::<3>().0.iter().map(|p| p.map(f32::from_bits)).collect();
    scenes::of_faces("files", positions, words(indices).as_chunks::<3>().0.to_vec())
}

#[expect(clippy::print_stdout, reason = "this is what a benchmark is for")]
fn measure(scene: &TestScene, gpu: Option<&std::sync::Arc<GpuDevice>>) {
    let built = scene.build();
    let triangles: usize = scene.objects.iter().map(|object| scene.meshes[object.mesh].faces.len()).sum();
    let cpu = CpuTracer::new(built.clone());
    let on_gpu = gpu.map(|gpu| GpuTracer::new(gpu.clone(), &built).expect("the scene fits"));
    for rays in [16, 256] {
        let samples = scene.samples((1 << 19) / rays as usize, rays);
        let of_cpu = rate(&cpu, &samples, rays);
        let of_gpu = on_gpu.as_ref().map_or(0.0, |tracer| rate(tracer, &samples, rays));
        println!("{:<27} {triangles:>8} {rays:>4} rays: CPU {of_cpu:>6.2}, GPU {of_gpu:>6.2} Mrays/s", scene.name);
    }
    let Some(tracer) = on_gpu else { return };
    let visits = tracer.visits(&rays_of(&scene.samples(8192, 16), 16)).expect("it traces");
    let per_ray = |count: u64| count as f64 / visits.rays as f64;
    let prediction = Roofs::of_kind(tracer.gpu().adapter().kind).predict(&visits, tracer.memory_bytes());
    println!(
        "    {} bytes; a ray visits {:.2} nodes, {:.2} triangles, {:.2} instances: {:.0} bytes, {:.0} instructions; \
         model: {:.1} Mrays/s by {:?}",
        tracer.memory_bytes(),
        per_ray(visits.nodes),
        per_ray(visits.triangles),
        per_ray(visits.instances),
        prediction.bytes_per_ray,
        prediction.instructions_per_ray,
        prediction.rays_per_s / 1e6,
        prediction.limit,
    );
}

#[expect(clippy::print_stdout, reason = "this is what a benchmark is for")]
fn main() {
    let opened = GpuDevice::open(&AdapterChoice::from_env()).expect("the adapter opens");
    let gpu = opened.or_else(|| GpuDevice::open(&AdapterChoice::Software).expect("the adapter opens"));
    println!("GPU: {}", gpu.as_ref().map_or("none".to_owned(), |gpu| gpu.describe()));
    let files: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    let scenes = match files.as_slice() {
        [positions, indices] => vec![scene_of_files(positions, indices)],
        _ => scenes::for_benchmarks(),
    };
    scenes.iter().for_each(|scene| measure(scene, gpu.as_ref()));
}
