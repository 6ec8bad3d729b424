//! Faces that are not as they should be.

use super::{
    Check, Size,
    shapes::{add_face, add_vertex, clean, distance, distance_from, first, mesh, quadrature, solve, wave},
};
use kiln_core::{Mesh, Solution};
use kiln_solve::SolveError;

fn solve_wave(mesh: &Mesh) -> Result<Solution, SolveError> {
    solve(mesh, &quadrature(mesh, wave))
}

/// The clean mesh and its answer.
fn base(size: Size) -> Result<(Mesh, Solution), SolveError> {
    let mesh = clean(size.side());
    let solution = solve_wave(&mesh)?;
    Ok((mesh, solution))
}

/// How far a harmed mesh's answer is from the clean one's, at the clean mesh's vertices.
fn off(mesh: &Mesh, base: &Solution) -> Result<f64, SolveError> {
    Ok(distance(first(&solve_wave(mesh)?, base.values.len()), base.values.iter().copied()))
}

pub(super) fn without_area(size: Size) -> Result<Vec<Check>, SolveError> {
    let (mut mesh, base) = base(size)?;
    let count = base.values.len() as u32;
    for v in (0..count - 2).step_by(7) {
        // On one vertex, on two, and on three in a line.
        add_face(&mut mesh, [v, v, v]);
        add_face(&mut mesh, [v, v + 1, v + 1]);
        let lonely = add_vertex(&mut mesh, [3.0, 3.0, 0.0]);
        add_face(&mut mesh, [lonely, lonely, v]);
    }
    let side = size.side();
    for column in 0..side {
        add_face(&mut mesh, [column * side, column * side + 1, column * side + 2]);
    }
    Ok(vec![Check::new("difference", off(&mesh, &base)?, 0.0)])
}

pub(super) fn twice(size: Size) -> Result<Vec<Check>, SolveError> {
    let (mut mesh, base) = base(size)?;
    for face in (0..mesh.faces.len()).step_by(23) {
        let [a, b, c] = mesh.faces[face];
        add_face(&mut mesh, [b, c, a]);
    }
    Ok(vec![Check::new("difference", off(&mesh, &base)?, 0.02)])
}

pub(super) fn unused_vertices(size: Size) -> Result<Vec<Check>, SolveError> {
    let (mut mesh, base) = base(size)?;
    let near: Vec<u32> = (0..base.values.len() as u32).step_by(11).collect();
    for &v in &near {
        let [x, y, _] = mesh.positions[v as usize];
        add_vertex(&mut mesh, [x + 0.1, y - 0.1, 0.2]);
    }
    let found = solve_wave(&mesh)?;
    let count = base.values.len();
    let kept = distance(first(&found, count), base.values.iter().copied());
    let nearest = near.iter().map(|v| base.values[*v as usize]);
    let filled = distance(found.values[count..].iter().copied(), nearest);
    Ok(vec![Check::new("difference", kept, 0.0), Check::new("from the nearest vertex", filled, 0.0)])
}

pub(super) fn fans(size: Size) -> Result<Vec<Check>, SolveError> {
    let (mut mesh, base) = base(size)?;
    let side = size.side();
    let row = side / 2 * side;
    for v in row..row + side - 1 {
        let [x, y, _] = mesh.positions[v as usize];
        let tip = add_vertex(&mut mesh, [x + 0.01, y + 0.5, 1.0]);
        add_face(&mut mesh, [v, v + 1, tip]);
        add_face(&mut mesh, [v, tip, v + 1]);
    }
    Ok(vec![Check::new("difference", off(&mesh, &base)?, 0.05)])
}

pub(super) fn inverted(size: Size) -> Result<Vec<Check>, SolveError> {
    let (mut mesh, base) = base(size)?;
    mesh.faces.iter_mut().step_by(3).for_each(|face| face.swap(1, 2));
    Ok(vec![Check::new("difference", off(&mesh, &base)?, 0.05)])
}

pub(super) fn moebius(size: Size) -> Result<Vec<Check>, SolveError> {
    let count = size.pick(48, 4800u32);
    let mut strip = mesh(Vec::new(), Vec::new());
    for i in 0..count {
        let angle = f64::from(i) / f64::from(count) * std::f64::consts::TAU;
        for side in [-1.0, 1.0] {
            let r = 4.0 + side * (0.5 * angle).cos();
            let p = [r * angle.cos(), r * angle.sin(), side * (0.5 * angle).sin()];
            add_vertex(&mut strip, p.map(|x| x as f32));
        }
    }
    for i in 0..count {
        // The last pair meets the first the other way round.
        let next = |k: u32| if i + 1 == count { 1 - k } else { 2 * i + 2 + k };
        add_face(&mut strip, [2 * i, next(0), 2 * i + 1]);
        add_face(&mut strip, [2 * i + 1, next(0), next(1)]);
    }
    let found = solve_wave(&strip)?;
    Ok(vec![Check::new("from the signal", distance_from(&strip, &found, wave), 0.1)])
}
