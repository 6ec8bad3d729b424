//! Prints how well and how fast models of regions are found, on made-up rooms.
//!
//! `cargo run --release -p kiln-solve --example region_table -- 650`: a row of so many rooms of 512 points and two
//! channels. What is seen in each falls to its walls, unevenly, about a middle that is not the box's, and is noisy.

use glam::DVec3;
use kiln_core::{
    Bounds, CANDIDATES, CandidateBits, REGION_HARMONICS, Region, RegionEdge, RegionSamples, RegionSettings, Regions,
};
use kiln_solve::region::{CenterRule, OPEN_SKY, RegionPoints, fit_region, model_regions};
use std::time::Instant;

const CHANNELS: usize = 2;
const WIDTH: usize = CHANNELS * REGION_HARMONICS;

#[expect(clippy::print_stdout, reason = "its output is what this program is for")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let count = std::env::args().nth(1).map_or(Ok(650), |arg| arg.parse::<u32>())?;
    let regions = rooms(count);
    let samples = samples(&regions);
    let start = Instant::now();
    let values = samples.values.chunks(CANDIDATES * WIDTH);
    let points: Vec<RegionPoints> = (regions.regions.iter().zip(values))
        .map(|(region, values)| RegionPoints::new(region, &CandidateBits::ALL, values, CHANNELS))
        .collect::<Result<_, _>>()?;
    println!("{count} regions; sums of points: {:.1} ms", millis(start));
    for rule in [CenterRule::Mean, CenterRule::Gradient, CenterRule::Points, CenterRule::Best, CenterRule::Refined] {
        let start = Instant::now();
        let errors: f64 =
            points.iter().map(|points| fit_region(points, rule).squared_errors().iter().sum::<f64>()).sum();
        let rmse = (errors / f64::from(count) / CANDIDATES as f64).sqrt();
        println!("{rule:?}: {:.1} ms, error {rmse:.4}", millis(start));
    }
    for smoothing in [0.0, 0.1, 1.0, 10.0] {
        let regions = Regions { settings: RegionSettings { smoothing, ..regions.settings }, ..regions.clone() };
        let start = Instant::now();
        let found = model_regions(&regions, &samples)?;
        let time = millis(start);
        let (summary, errors) = (&found.summary, found.summary.errors[0]);
        println!(
            "β {smoothing:4}: {time:.1} ms on {} threads, {} sweeps, {} held; error {:.4} to {:.4}, jump {:.4} to {:.4}",
            rayon::current_num_threads(),
            summary.sweeps,
            summary.held,
            errors.refined,
            errors.smoothed,
            errors.jump_fitted,
            errors.jump_smoothed
        );
    }
    Ok(())
}

fn millis(start: Instant) -> f64 {
    1e3 * start.elapsed().as_secs_f64()
}

/// Noise in [0, 1) by splitmix64.
fn noise(i: u64) -> f64 {
    let mut z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

fn rooms(count: u32) -> Regions {
    let room = |i: u32| {
        let min = DVec3::new(5.0 * f64::from(i), 0.0, 0.0);
        let bounds = Bounds { min, max: min + DVec3::new(5.0, 4.0, 3.0) };
        Region { id: i.to_string(), bounds, valid: None }
    };
    let door = |i: u32| RegionEdge {
        regions: [i, i + 1],
        area_m2: 2.0 + f64::from(i % 5),
        center: DVec3::new(5.0 * f64::from(i + 1), 2.0, 1.0),
    };
    let edges = (1..count).map(|i| door(i - 1)).collect();
    Regions { regions: (0..count).map(room).collect(), edges, settings: RegionSettings::default() }
}

fn samples(regions: &Regions) -> RegionSamples {
    let count = regions.regions.len();
    let of_region =
        |(r, region): (usize, &Region)| (0..CANDIDATES).flat_map(|i| values(r as u64, region, i)).collect::<Vec<f32>>();
    RegionSamples {
        channels: CHANNELS as u32,
        valid: vec![CandidateBits::ALL; count],
        values: regions.regions.iter().enumerate().flat_map(of_region).collect(),
        dropped: vec![0; count],
        rays: 0,
    }
}

/// All harmonics at a candidate.
fn values(r: u64, region: &Region, index: usize) -> [f32; WIDTH] {
    let middle = region.bounds.center() + 1.5 * (DVec3::new(noise(3 * r), noise(3 * r + 1), noise(3 * r + 2)) - 0.5);
    let offset = region.candidate(index) - middle;
    std::array::from_fn(|k| {
        let seed = 1_000_003 * r + 577 * k as u64;
        let noise = 0.02 * (noise(seed + 31 * index as u64) - 0.5);
        let wave = [0, 1, 2].map(|axis| (0.3 * offset[axis]).abs().powf(1.3)).iter().sum::<f64>();
        let value = match k % REGION_HARMONICS {
            0 => OPEN_SKY * (0.75 - 0.25 * wave),
            harmonic @ 1..4 => -0.15 * offset[[1, 2, 0][harmonic - 1]],
            _ => 0.05 * wave,
        };
        (value + noise) as f32
    })
}
