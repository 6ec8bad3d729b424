//! Very many of something.

use super::{
    Check, Size,
    shapes::{distance, distance_from, mesh, quadrature, samples, solve, solve_by},
};
use crate::solve::signal::noise;
use glam::{DAffine3, DVec3};
use kiln_solve::{SolveError, SolverParams};

/// Components of one triangle, each with a value of its own.
pub(super) fn tiny_components(size: Size) -> Result<Vec<Check>, SolveError> {
    let count = size.pick(20_000, 1_000_000u32);
    let corners = (0..count).flat_map(|i| [(0.0, 0.0), (0.4, 0.0), (0.0, 0.4)].map(|(dx, dy)| (i, dx, dy)));
    let positions = corners.map(|(i, dx, dy)| [(i % 1000) as f32 + dx, (i / 1000) as f32 + dy, 0.0]).collect();
    let mesh = mesh(positions, (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect());
    let found = solve(&mesh, &samples(&mesh, 2, |face, _, _| Some(noise(face as u64))))?;
    let missing = f64::from(count) - found.summary.components as f64;
    let expected = (0..u64::from(3 * count)).map(|v| noise(v / 3) as f32);
    Ok(vec![
        Check::new("components missing", missing, 0.0),
        Check::new("difference", distance(found.values, expected), 1e-5),
    ])
}

/// Values may overshoot those of the two samples by no more than three times what these are apart: samples may lie
/// close together, and corners far from both.
pub(super) fn pairs_with_one_sample(size: Size) -> Result<Vec<Check>, SolveError> {
    let count = size.pick(200, 100_000u32);
    let corners = (0..count).flat_map(|i| [(0.0, 0.0), (0.0, 0.6), (0.6, 0.0), (0.6, 0.6)].map(|d| (i, d)));
    let positions = corners.map(|(i, (dx, dy))| [(i % 300) as f32 + dx, (i / 300) as f32 + dy, 0.0]).collect();
    let faces = (0..4 * count).step_by(4).flat_map(|v| [[v, v + 2, v + 1], [v + 1, v + 2, v + 3]]).collect();
    let mesh = mesh(positions, faces);
    let found = solve(&mesh, &samples(&mesh, 1, |face, _, _| Some(0.45 + 0.1 * noise(face as u64))))?;
    let mut beyond: f64 = 0.0;
    for (patch, values) in found.values.chunks_exact(4).enumerate() {
        let [a, b] = [2 * patch, 2 * patch + 1].map(|face| 0.45 + 0.1 * noise(face as u64));
        let (low, high) = (a.min(b), a.max(b));
        for value in values.iter().map(|v| f64::from(*v)) {
            let overshoot = (low - value).max(value - high) / (high - low + 1e-6);
            beyond = if overshoot > beyond || overshoot.is_nan() { overshoot } else { beyond };
        }
    }
    Ok(vec![Check::new("overshoot over the range", beyond, 3.0)])
}

/// A cone around one vertex.
pub(super) fn one_vertex(size: Size) -> Result<Vec<Check>, SolveError> {
    let count = size.pick(10_000, 100_000u32);
    let rim = (0..count).map(|i| f64::from(i) / f64::from(count) * std::f64::consts::TAU);
    let mut positions = vec![[0.0; 3]];
    positions.extend(rim.map(|angle| [(9.0 * angle.cos()) as f32, (9.0 * angle.sin()) as f32, 0.0]));
    let mesh = mesh(positions, (0..count).map(|i| [0, 1 + i, 1 + (i + 1) % count]).collect());
    let cone = |p: DVec3| 0.9 - 0.05 * p.length();
    let samples = quadrature(&mesh, cone);
    let mut checks = Vec::new();
    let direct = SolverParams { sparse_limit: usize::MAX, ..SolverParams::default() };
    for (what, params) in
        [("by default, from the signal", SolverParams::default()), ("factorised, from the signal", direct)]
    {
        let found = solve_by(&mesh, &samples, DAffine3::IDENTITY, &params)?;
        checks.push(Check::new(what, distance_from(&mesh, &found, cone), 0.05));
    }
    Ok(checks)
}
