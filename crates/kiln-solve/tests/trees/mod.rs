//! A model made by code with samples and signals, for the tests of tree fits.

#![expect(dead_code, reason = "each test program uses a part")]

use crate::shapes::{mesh, noise, samples};
use glam::{DVec3, Vec3};
use kiln_core::{Digest, Mesh};
use kiln_solve::{ModelSample, ModelSamples, SampledLocal, TreeFit};

/// Sheets of `n × n` vertices that stand in all directions through each other, without shared vertices.
pub(crate) fn bush(sheets: u64, n: u32) -> Mesh {
    let (mut positions, mut faces) = (Vec::new(), Vec::new());
    for sheet in 0..sheets {
        let axis = |k: u64| Vec3::from_array([0, 1, 2].map(|i| noise(100 * sheet + 10 * k + i) as f32 * 2.0 - 1.0));
        let (center, across, up) = (0.5 * axis(0), axis(1), axis(2));
        let first = positions.len() as u32;
        for vertex in 0..n * n {
            let [i, j] = [vertex / n, vertex % n].map(|k| k as f32 / (n - 1) as f32 - 0.5);
            positions.push((center + i * across + j * up).to_array());
        }
        for i in 0..n - 1 {
            for v in (0..n - 1).map(|j| first + i * n + j) {
                faces.extend([[v, v + n, v + 1], [v + 1, v + n, v + n + 1]]);
            }
        }
    }
    mesh(positions, faces)
}

/// `count` samples in each face of a mesh, weighed by area.
pub(crate) fn model(mesh: &Mesh, count: u64) -> ModelSamples {
    let mut points = Vec::new();
    for face in 0..mesh.faces.len() {
        let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
        let weight = 0.5 * (b - a).cross(c - a).length() / count as f64;
        points.extend(samples(mesh, face, count).map(|sample| ModelSample {
            face: face as u32,
            phi: sample.phi,
            position: sample.point,
            weight,
        }));
    }
    ModelSamples::new(mesh, &points).expect("samples of the mesh")
}

/// One sample at each of the given positions, of equal weight, all on one face of a mesh with these bounds.
pub(crate) fn points(mesh: &Mesh, positions: &[[f64; 3]]) -> ModelSamples {
    let sample = |p: &[f64; 3]| ModelSample { face: 0, phi: [0.2, 0.3, 0.5], position: DVec3::from(*p), weight: 1.0 };
    ModelSamples::new(mesh, &positions.iter().map(sample).collect::<Vec<_>>()).expect("samples of the mesh")
}

/// Values at vertices within a range, from a seed.
pub(crate) fn values(count: usize, seed: u64, range: [f64; 2]) -> Vec<f32> {
    (0..count as u64).map(|i| (range[0] + (range[1] - range[0]) * noise(seed * 10_007 + i)) as f32).collect()
}

/// Four numbers whose G is within 0.05 to 0.95 in the whole box.
pub(crate) fn globals(seed: u64) -> [f64; 4] {
    let slope = [1, 2, 3].map(|k| 0.4 * (noise(31 * seed + k) - 0.5));
    let room = 0.5 - slope.iter().map(|s| s.abs()).sum::<f64>();
    let y0 = 0.5 + 1.8 * (noise(31 * seed) - 0.5) * room.max(0.0);
    [y0, slope[0], slope[1], slope[2]]
}

pub(crate) fn linear(y: &[f64; 4], u: &[f64; 3]) -> f64 {
    y[0] + y[1] * u[0] + y[2] * u[1] + y[3] * u[2]
}

/// The signal `G L` of known y, one y for each channel.
pub(crate) fn product(samples: &ModelSamples, local: &SampledLocal, y: &[[f64; 4]]) -> Vec<f32> {
    let of_sample =
        |(u, l): (&[f64; 3], &[f64])| l.iter().zip(y).map(|(l, y)| (linear(y, u) * l) as f32).collect::<Vec<_>>();
    samples.unit_positions().iter().zip(local.values().chunks(y.len())).flat_map(of_sample).collect()
}

/// `Σ w (f − G L)²` of a channel for any y, with the weights of equal samples (1).
pub(crate) fn error_of(samples: &ModelSamples, local: &[f64], f: &[f32], y: &[f64; 4]) -> f64 {
    let of = |((u, l), f): ((&[f64; 3], &f64), &f32)| (f64::from(*f) - linear(y, u) * l).powi(2);
    samples.unit_positions().iter().zip(local).zip(f).map(of).sum()
}

/// What every fit must hold.
pub(crate) fn is_bounded(fit: &TreeFit) -> bool {
    let size: f64 = fit.y.iter().map(|y| f64::from(y.abs())).sum();
    size <= kiln_solve::GLOBAL_BOUND && fit.rmse().is_finite() && fit.squared_error >= 0.0 && fit.weight >= 0.0
}

/// A key from a number.
pub(crate) fn key(number: u64) -> Digest {
    Digest::of(&number.to_le_bytes())
}
