//! Samples that are missing.

use super::{
    Check, Size,
    shapes::{clean, distance, distance_from, iterated, quadrature, samples, solve, wave},
};
use crate::solve::signal::noise;
use glam::DVec3;
use kiln_solve::SolveError;

pub(super) fn faces_without_samples(size: Size) -> Result<Vec<Check>, SolveError> {
    let mesh = clean(size.side());
    let base = solve(&mesh, &samples(&mesh, 6, |_, _, p| Some(wave(p))))?;
    // About every fiftieth face, and all around every 97th vertex, which then has no sample.
    let bare = |face: usize| mesh.faces[face].iter().any(|v| v % 97 == 0) || noise(face as u64) < 0.02;
    let found = solve(&mesh, &samples(&mesh, 6, |face, _, p| (!bare(face)).then(|| wave(p))))?;
    Ok(vec![Check::new("difference", distance(found.values, base.values), 0.1)])
}

pub(super) fn dropped_samples(size: Size) -> Result<Vec<Check>, SolveError> {
    let mesh = clean(size.side());
    let base = solve(&mesh, &samples(&mesh, 6, |_, _, p| Some(wave(p))))?;
    let valid = |face: usize, number: u64| noise((face as u64) << 8 | number) >= 0.1;
    let found = solve(&mesh, &samples(&mesh, 6, |face, number, p| valid(face, number).then(|| wave(p))))?;
    Ok(vec![Check::new("difference", distance(found.values, base.values), 0.05)])
}

pub(super) fn hole(size: Size) -> Result<Vec<Check>, SolveError> {
    let side = size.side();
    let mesh = clean(side);
    let span = f64::from(side);
    let slope = |p: DVec3| 0.2 + 0.5 * p.x / span;
    let low = f64::from(side / 3);
    let in_hole = |p: DVec3| [p.x, p.y].iter().all(|x| (low..low + 8.0).contains(x));
    let found = solve(&mesh, &samples(&mesh, 6, |_, _, p| (!in_hole(p)).then(|| slope(p))))?;
    // No step between neighbours differs from the slope's own by more than this.
    let at = |i: u32, j: u32| f64::from(found.values[(i * side + j) as usize]);
    let inside = || (side / 3 - 1..side / 3 + 9).flat_map(|i| (side / 3 - 1..side / 3 + 9).map(move |j| (i, j)));
    let bends =
        inside().map(|(i, j)| (at(i + 1, j) - at(i, j) - 0.5 / span).abs().max((at(i, j + 1) - at(i, j)).abs()));
    Ok(vec![
        Check::new("from the slope", distance_from(&mesh, &found, slope), 0.02),
        Check::new("steps beyond the slope", bends.fold(0.0, f64::max), 0.02),
    ])
}

/// Iterations must not grow with the size of holes.
pub(super) fn iterations(size: Size) -> Result<Vec<Check>, SolveError> {
    let side = size.pick(64, 300);
    let mesh = clean(side);
    let base = iterated(&mesh, &samples(&mesh, 4, |_, _, p| Some(wave(p))))?;
    let mut checks = Vec::new();
    for width in size.pick(&[4, 8, 16, 32, 60][..], &[8, 16, 32, 64, 128, 280][..]) {
        let (low, high) = (f64::from(side - width) / 2.0, f64::from(side + width) / 2.0);
        let in_hole = |p: DVec3| [p.x, p.y].iter().all(|x| (low..high).contains(x));
        let found = iterated(&mesh, &samples(&mesh, 4, |_, _, p| (!in_hole(p)).then(|| wave(p))))?;
        let growth = found.summary.iterations as f64 / base.summary.iterations as f64;
        checks.push(Check::new(format!("iterations, width {width}, over those without"), growth, 2.0));
        let residual = found.summary.residual;
        checks.push(Check::new("residual", residual, 1e-6));
    }
    // What is in no hole has its samples still: the clean answer holds there.
    let whole = solve(&mesh, &quadrature(&mesh, wave))?;
    checks.push(Check::new("from the signal without", distance_from(&mesh, &whole, wave), 0.05));
    Ok(checks)
}
