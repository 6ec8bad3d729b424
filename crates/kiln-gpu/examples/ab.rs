#[path = "../tests/gpu/scenes.rs"]
mod scenes;
use kiln_gpu::*; use kiln_core::Kernel; use kiln_trace::*;
fn cpu_secs() -> f64 { let s = std::fs::read_to_string("/proc/self/stat").unwrap(); let f: Vec<&str> = s.rsplit(')').next().unwrap().split_whitespace().collect(); (f[11].parse::<f64>().unwrap() + f[12].parse::<f64>().unwrap())/100.0 }
fn main() {
    let gpu = GpuDevice::open(&AdapterChoice::Software).unwrap().unwrap();
    let rates = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] });
    for s in scenes::for_benchmarks() {
        let built = s.build();
        let t = GpuTracer::new(gpu.clone(), &built).unwrap();
        for rays in [16,32,256] {
        let samples = s.samples(131072/rays as usize, rays);
        let mut sums = vec![CosineSums::default(); samples.len()];
        t.gather_cosine(&samples[..64], &rates, rays, &mut sums[..64]).unwrap();
        let a = cpu_secs();
        for _ in 0..2 {t.gather_cosine(&samples, &rates, rays, &mut sums).unwrap();}
        let b = cpu_secs();
        print!("{:.2} ", b - a);
        }
    }
    println!();
}
