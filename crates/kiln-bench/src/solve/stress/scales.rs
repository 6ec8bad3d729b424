//! Sizes: slivers, scales, distances.

use super::{
    Check, Size,
    shapes::{
        add_face, add_vertex, clean, distance, distance_from, first, grid, iterated, mesh, quadrature, solve, solve_by,
        steps, wave,
    },
};
use glam::{DAffine3, DVec3};
use kiln_core::Mesh;
use kiln_solve::{SolveError, SolverParams};

/// Aspects of slivers; iterations must not grow with them.
const ASPECTS: [f32; 3] = [1e2, 1e4, 1e6];

pub(super) fn sliver_column(size: Size) -> Result<Vec<Check>, SolveError> {
    let side = size.side();
    let base = iterated(&clean(side), &quadrature(&clean(side), wave))?;
    let mut checks = Vec::new();
    for aspect in ASPECTS {
        // Needles and caps between columns 5 and 5 + 1 / aspect, which is shifted along itself, so that they lean.
        let mut xs = steps(side);
        xs.insert(6, 5.0 + 1.0 / aspect);
        let mut mesh = grid(&xs, &steps(side));
        let row = side as usize;
        mesh.positions[6 * row..7 * row].iter_mut().for_each(|p| p[1] += 0.37);
        let found = iterated(&mesh, &quadrature(&mesh, wave))?;
        let kept = found.values[..6 * row].iter().chain(&found.values[7 * row..]).copied();
        checks.push(Check::new(
            format!("difference at {aspect:.0e}"),
            distance(kept, base.values.iter().copied()),
            0.03,
        ));
        checks.push(growth(found.summary.iterations, base.summary.iterations));
    }
    Ok(checks)
}

pub(super) fn all_slivers(size: Size) -> Result<Vec<Check>, SolveError> {
    let side = size.side();
    let solved = |aspect: f32| {
        let mesh = grid(&steps(side), &steps(side).iter().map(|y| y / aspect).collect::<Vec<_>>());
        let signal = move |p: DVec3| wave(p * DVec3::new(1.0, f64::from(aspect), 1.0));
        let found = iterated(&mesh, &quadrature(&mesh, signal))?;
        Ok((distance_from(&mesh, &found, signal), found.summary.iterations))
    };
    let (_, base) = solved(1.0)?;
    let mut checks = Vec::new();
    for aspect in ASPECTS {
        let (off, iterations) = solved(aspect)?;
        checks.push(Check::new(format!("from the signal at {aspect:.0e}"), off, 0.1));
        checks.push(growth(iterations, base));
    }
    Ok(checks)
}

fn growth(iterations: u64, base: u64) -> Check {
    Check::new("iterations over the clean mesh's", iterations as f64 / base as f64, 2.0)
}

pub(super) fn other_scale(size: Size) -> Result<Vec<Check>, SolveError> {
    let base = solve(&clean(size.side()), &quadrature(&clean(size.side()), wave))?;
    let mut checks = Vec::new();
    for scale in [1e-3f32, 1e4] {
        let mesh = scaled(&clean(size.side()), scale);
        let found = solve(&mesh, &quadrature(&mesh, |p| wave(p / f64::from(scale))))?;
        let off = distance(found.values, base.values.iter().copied());
        checks.push(Check::new(format!("difference at {scale:.0e}"), off, 1e-4));
    }
    Ok(checks)
}

fn scaled(mesh: &Mesh, scale: f32) -> Mesh {
    let positions = mesh.positions.iter().map(|p| p.map(|x| x * scale)).collect();
    Mesh { positions, ..mesh.clone() }
}

/// Scales 1e-3 and 1e4 side by side.
pub(super) fn two_scales(size: Size) -> Result<Vec<Check>, SolveError> {
    let base = solve(&clean(size.side()), &quadrature(&clean(size.side()), wave))?;
    let count = base.values.len();
    let mut both = scaled(&clean(size.side()), 1e-3);
    let (large, first_large) = (scaled(&clean(size.side()), 1e4), count as u32);
    large.positions.iter().for_each(|p| {
        add_vertex(&mut both, [p[0], p[1], 1000.0]);
    });
    large.faces.iter().for_each(|face| add_face(&mut both, face.map(|v| v + first_large)));
    let signal = |p: DVec3| wave(if p.z > 500.0 { DVec3::new(p.x, p.y, 0.0) / 1e4 } else { p / f64::from(1e-3f32) });
    let found = solve(&both, &quadrature(&both, signal))?;
    let clean_values = || base.values.iter().copied();
    Ok(vec![
        Check::new("difference of the small", distance(first(&found, count), clean_values()), 1e-4),
        Check::new("difference of the large", distance(found.values[count..].iter().copied(), clean_values()), 1e-4),
    ])
}

/// Rings whose radius grows by a factor, so that triangles keep their shape while their size spans six decades.
pub(super) fn graded(size: Size) -> Result<Vec<Check>, SolveError> {
    let sectors = size.pick(32, 256u32);
    let factor = (std::f64::consts::TAU / f64::from(sectors)).exp();
    let rings = (1e6f64.ln() / factor.ln()).ceil() as u32;
    let radius = |ring: u32| 1e-3 * factor.powi(ring as i32);
    let mut disc = mesh(Vec::new(), Vec::new());
    for (ring, sector) in (0..rings).flat_map(|ring| (0..sectors).map(move |sector| (ring, sector))) {
        let (sin, cos) = (f64::from(sector) / f64::from(sectors) * std::f64::consts::TAU).sin_cos();
        add_vertex(&mut disc, [(radius(ring) * cos) as f32, (radius(ring) * sin) as f32, 0.0]);
    }
    for (ring, sector) in (1..rings).flat_map(|ring| (0..sectors).map(move |sector| (ring, sector))) {
        let next = (sector + 1) % sectors;
        let [a, b] = [sector, next].map(|s| (ring - 1) * sectors + s);
        let [c, d] = [a, b].map(|v| v + sectors);
        add_face(&mut disc, [a, c, b]);
        add_face(&mut disc, [b, c, d]);
    }
    let signal = |p: DVec3| 0.5 + 0.3 * (2.0 * p.y.atan2(p.x)).sin() * (0.8 * p.length().ln()).cos();
    let base = iterated(&clean(size.side()), &quadrature(&clean(size.side()), wave))?;
    let found = iterated(&disc, &quadrature(&disc, signal))?;
    Ok(vec![
        Check::new("from the signal", distance_from(&disc, &found, signal), 0.15),
        growth(found.summary.iterations, base.summary.iterations),
    ])
}

pub(super) fn huge_next_to_tiny(size: Size) -> Result<Vec<Check>, SolveError> {
    let base = solve(&clean(size.side()), &quadrature(&clean(size.side()), wave))?;
    let mut both = scaled(&clean(size.side()), 1e-3);
    let [a, b, c] = [[-1e5, -1e5, 9.0], [1e5, -1e5, 9.0], [0.0, 1e5, 9.0]].map(|p| add_vertex(&mut both, p));
    add_face(&mut both, [a, b, c]);
    let signal = |p: DVec3| if p.z > 5.0 { 0.25 } else { wave(p / f64::from(1e-3f32)) };
    let found = solve(&both, &quadrature(&both, signal))?;
    let count = base.values.len();
    Ok(vec![
        Check::new("difference of the tiny", distance(first(&found, count), base.values), 2e-3),
        Check::new("difference of the huge", distance(found.values[count..].iter().copied(), [0.25; 3]), 1e-6),
    ])
}

/// By the transform, which is f64 and loses nothing, and by the positions, of which f32 keeps multiples of 1 m there.
pub(super) fn far_away(size: Size) -> Result<Vec<Check>, SolveError> {
    let clean = clean(size.side());
    let moments = quadrature(&clean, wave);
    let base = solve(&clean, &moments)?;
    let far = DAffine3::from_translation(DVec3::new(1e7, -1e7, 1e7));
    let moved = solve_by(&clean, &moments, far, &SolverParams::default())?;
    let shift = [1e7, -1e7, 0.0];
    let positions = clean.positions.iter().map(|p| std::array::from_fn(|axis| p[axis] + shift[axis])).collect();
    let stored = solve(&Mesh { positions, ..clean }, &moments)?;
    let off = |values: Vec<f32>| distance(values, base.values.iter().copied());
    Ok(vec![
        Check::new("difference by the transform", off(moved.values), 1e-6),
        Check::new("difference by the positions", off(stored.values), 1e-6),
    ])
}
