//! The device's rays and values against the CPU's functions.

use crate::scenes::{Numbers, free_sample};
use glam::Vec3;
use kiln_core::Kernel;
use kiln_trace::{KernelRates, SurfaceSample, cosine_direction, orthonormal_basis, sobol_point};

fn samples(count: usize, rays: u32) -> Vec<SurfaceSample> {
    let mut numbers = Numbers(u64::from(rays));
    let special = [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::NEG_Y, Vec3::new(1e-4, 0.0, -1.0)];
    (0..count)
        .map(|i| {
            let normal = special.get(i).copied().unwrap_or_else(|| numbers.point()).normalize();
            let first_index = rays.wrapping_mul(numbers.bits() as u32);
            SurfaceSample { first_index, ..free_sample(Vec3::ZERO, normal, numbers.scramble()) }
        })
        .collect()
}

/// Units of the last place of 1: a unit vector's error is absolute.
fn ulps(a: Vec3, b: Vec3) -> f32 {
    (a - b).abs().max_element() / f32::EPSILON
}

/// Every index once; the cells are those of the unit square, the same for every sample; directions to 4 ULP.
#[test]
fn rays_are_those_of_the_cpu() {
    for (count, rays) in
        [(1, 1), (40, 2), (9, 8), (100, 16), (64, 32), (1, 32), (3, 128), (40, 256), (8, 4096), (1, 32768)]
    {
        let samples = samples(count, rays);
        let probed = crate::device().probe_rays(&samples, rays).expect("it runs");
        let mut worst = 0f32;
        let mut column_of_cell: Vec<Option<[u32; 2]>> = Vec::new();
        for (sample, rays_of_sample) in samples.iter().zip(&probed) {
            let mut seen = vec![false; rays as usize];
            let basis = orthonormal_basis(sample.normal);
            let cells = rays_of_sample.iter().map(|ray| ray.cell).max().unwrap_or(0) + 1;
            column_of_cell.resize(cells as usize, None);
            let bits = cells.ilog2();
            let grid = [1u32 << bits.div_ceil(2), 1u32 << (bits / 2)];
            for ray in rays_of_sample {
                let i = ray.index.wrapping_sub(sample.first_index);
                assert!(i < rays && !seen[i as usize], "index {i} of {rays}");
                seen[i as usize] = true;
                let point = sobol_point(ray.index, sample.scramble);
                let place = [0, 1].map(|axis| (point[axis] * grid[axis] as f32) as u32);
                assert_eq!(*column_of_cell[ray.cell as usize].get_or_insert(place), place, "cell {}", ray.cell);
                worst = worst.max(ulps(ray.direction, cosine_direction(point, sample.normal, basis)));
            }
        }
        println!("{rays} rays, {count} samples: {worst} ULP");
        assert!(worst <= 4.0, "{worst} ULP at {rays} rays");
    }
}

/// The cones of 32 are narrow: neighbours that look the same way take directions near each other.
#[test]
fn cones_are_narrow() {
    for (rays, widest_mean_degrees) in [(32, 50.0), (256, 25.0)] {
        let mut samples = samples(64, rays);
        samples.iter_mut().for_each(|sample| sample.normal = Vec3::Z);
        let probed = crate::device().probe_rays(&samples, rays).expect("it runs");
        let mut half_angles = Vec::new();
        for group in probed.chunks(8) {
            for cell in 0..rays / 4 {
                let in_cell = |ray: &&kiln_gpu::ProbedRay| ray.cell == cell;
                let cone: Vec<Vec3> = group.iter().flatten().filter(in_cell).map(|ray| ray.direction).collect();
                assert_eq!(cone.len(), 32);
                let axis = cone.iter().sum::<Vec3>().normalize();
                half_angles
                    .push(cone.iter().map(|d| d.dot(axis).clamp(-1.0, 1.0).acos().to_degrees()).fold(0.0, f32::max));
            }
        }
        let mean = half_angles.iter().sum::<f32>() / half_angles.len() as f32;
        println!("{rays} rays: mean half-angle {mean} degrees");
        assert!(mean < widest_mean_degrees, "{mean} degrees at {rays} rays");
    }
}

#[test]
fn values_are_those_of_the_cpu() {
    let device = crate::device();
    let mut distances: Vec<f32> = (0..20_000).map(|i| 0.01 * i as f32).collect();
    distances.extend([0.0, 1e-30, 3e38, 47.99, 48.0, 7200.0]);
    for kernel in [
        Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] },
        Kernel::Obscurance { half_distances_m: vec![0.01, 0.5, 7.0, 1e4] },
        Kernel::Occlusion { ray_distance_m: 5.0 },
    ] {
        let rates = KernelRates::new(&kernel);
        let values = device.probe_hit_values(&rates, &distances).expect("it runs");
        assert_eq!(values.len(), distances.len());
        for (&t, value) in distances.iter().zip(&values) {
            for channel in 0..4 {
                let expected = if channel < rates.channels { rates.hit_value(channel, t) } else { 0 };
                assert!(value[channel].abs_diff(expected) <= 1, "{t} m, channel {channel}: {value:?}, {expected}");
            }
        }
    }
}
