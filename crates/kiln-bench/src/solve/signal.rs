//! A made-up signal in place of traced rays: smooth, with noise, so that matrices can be had in seconds.

use glam::{DAffine3, DVec3, Vec3};
use kiln_core::{FaceMoments, HalfMoments, Mesh};

/// Samples in each face.
const SAMPLES: u64 = 4;
/// Greatest noise of a sample.
const NOISE: f64 = 0.05;

/// Noisy samples in each face of a signal whose waves are some `wave_m` metres long, in world space; faces where
/// `sampled` is false have none that is valid.
pub(super) fn moments(
    mesh: &Mesh,
    world: &DAffine3,
    channels: usize,
    wave_m: f64,
    sampled: impl Fn(DVec3) -> bool,
) -> FaceMoments {
    let mut moments = FaceMoments::new(channels);
    let mut values = vec![0.0; channels];
    for face in 0..mesh.faces.len() {
        let corners = mesh.corners(face).map(Vec3::as_dvec3);
        let mut halves = [HalfMoments::default(); 2];
        let valid = sampled(world.transform_point3((corners[0] + corners[1] + corners[2]) / 3.0));
        for sample in 0..SAMPLES {
            let half = &mut halves[sample as usize % 2];
            if !valid {
                half.add_invalid();
                continue;
            }
            let key = (face as u64 * SAMPLES + sample) * 8;
            let [u, v] = [0, 1].map(|k| noise(key + k));
            let phi = if u + v > 1.0 { [u + v - 1.0, 1.0 - u, 1.0 - v] } else { [1.0 - u - v, u, v] };
            let p = world.transform_point3(corners.iter().zip(phi).map(|(c, w)| *c * w).sum());
            for (channel, value) in values.iter_mut().enumerate() {
                let p = p * (std::f64::consts::TAU / (wave_m * (1.0 + channel as f64)));
                let noise = NOISE * (2.0 * noise(key + 2 + channel as u64) - 1.0);
                *value = 0.5 + 0.4 * (p.x + 0.3 * p.y).sin() * (0.55 * p.z - 0.2 * p.y).cos() + noise;
            }
            half.add(phi, &values);
        }
        moments.push(&halves);
    }
    moments
}

/// Noise in [0, 1) by splitmix64 (Steele, Lea and Flood 2014).
pub(super) fn noise(i: u64) -> f64 {
    let mut z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}
