//! Meshes made by code, their samples, and the solve of both.

use crate::solve::signal::noise;
use glam::{DAffine3, DVec3, Vec3};
use kiln_core::{FaceGroup, FaceMoments, HalfMoments, Mesh, Solution, SolveSettings};
use kiln_solve::{SolveError, SolveInput, SolverParams, certificate::RESIDUAL_LIMIT, solve_with};

/// A mesh of one receiving group without shading normals.
pub(super) fn mesh(positions: Vec<[f32; 3]>, faces: Vec<[u32; 3]>) -> Mesh {
    let group = FaceGroup::PLAIN;
    let normals = vec![[0.0; 3]; positions.len()];
    Mesh { normals, face_group: vec![0; faces.len()], groups: vec![group], positions, faces, ..Mesh::default() }
}

/// A grid in the plane z = 0 with the given coordinates of columns and rows; vertex (i, j) is `i * rows + j`.
pub(super) fn grid(xs: &[f32], ys: &[f32]) -> Mesh {
    let rows = ys.len() as u32;
    let positions = xs.iter().flat_map(|x| ys.iter().map(|y| [*x, *y, 0.0])).collect();
    let quads = (0..xs.len() as u32 - 1).flat_map(|i| (0..rows - 1).map(move |j| i * rows + j));
    let faces = quads.flat_map(|v| [[v, v + rows, v + 1], [v + 1, v + rows, v + rows + 1]]).collect();
    mesh(positions, faces)
}

/// `n` numbers from 0 with steps of 1.
pub(super) fn steps(n: u32) -> Vec<f32> {
    (0..n).map(|i| i as f32).collect()
}

/// The clean mesh: a square of `side²` vertices 1 m apart.
pub(super) fn clean(side: u32) -> Mesh {
    grid(&steps(side), &steps(side))
}

pub(super) fn add_face(mesh: &mut Mesh, face: [u32; 3]) {
    mesh.faces.push(face);
    mesh.face_group.push(0);
}

pub(super) fn add_vertex(mesh: &mut Mesh, position: [f32; 3]) -> u32 {
    mesh.positions.push(position);
    mesh.normals.push([0.0; 3]);
    mesh.positions.len() as u32 - 1
}

/// A smooth signal whose waves are some 20 m long.
pub(super) fn wave(p: DVec3) -> f64 {
    0.5 + 0.3 * (0.4 * p.x + 0.3).sin() * (0.3 * p.y - 0.4).cos()
}

/// Samples of a face, of each half, by the midpoints of its sides: their sums are the integrals of quadratic functions.
pub(super) fn quadrature(mesh: &Mesh, f: impl Fn(DVec3) -> f64) -> FaceMoments {
    let mut moments = FaceMoments::new(1);
    for face in 0..mesh.faces.len() {
        let corners = mesh.corners(face).map(Vec3::as_dvec3);
        let mut half = HalfMoments::default();
        for phi in [[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]] {
            half.add(phi, &[f(corners.iter().zip(phi).map(|(c, p)| *c * p).sum())]);
        }
        moments.push(&[half; 2]);
    }
    moments
}

/// `count` samples in each face; none is valid where the function gives no value for face, number and position.
pub(super) fn samples(mesh: &Mesh, count: u64, f: impl Fn(usize, u64, DVec3) -> Option<f64>) -> FaceMoments {
    let mut moments = FaceMoments::new(1);
    for face in 0..mesh.faces.len() {
        let corners = mesh.corners(face).map(Vec3::as_dvec3);
        let mut halves = [HalfMoments::default(); 2];
        for number in 0..count {
            let [u, v] = [0, 1].map(|k| noise((face as u64 * count + number) * 2 + k));
            let phi = if u + v > 1.0 { [u + v - 1.0, 1.0 - u, 1.0 - v] } else { [1.0 - u - v, u, v] };
            let half = &mut halves[number as usize % 2];
            match f(face, number, corners.iter().zip(phi).map(|(c, p)| *c * p).sum()) {
                Some(value) => half.add(phi, &[value]),
                None => half.add_invalid(),
            }
        }
        moments.push(&halves);
    }
    moments
}

/// Solves in world = object space.
pub(super) fn solve(mesh: &Mesh, moments: &FaceMoments) -> Result<Solution, SolveError> {
    solve_by(mesh, moments, DAffine3::IDENTITY, &SolverParams::default())
}

/// Every component by conjugate gradients, whatever its size.
pub(super) fn iterated(mesh: &Mesh, moments: &FaceMoments) -> Result<Solution, SolveError> {
    let params = SolverParams { dense_limit: 0, direct_limit: 0, ..SolverParams::default() };
    solve_by(mesh, moments, DAffine3::IDENTITY, &params)
}

/// Solves at α = 1, where the matrix is worst. An answer without its certificate comes back as not a number.
pub(super) fn solve_by(
    mesh: &Mesh,
    moments: &FaceMoments,
    world_from_object: DAffine3,
    params: &SolverParams,
) -> Result<Solution, SolveError> {
    let settings = SolveSettings { regularization: 1.0, ..SolveSettings::default() };
    let mut solution = solve_with(&SolveInput { mesh, world_from_object, moments, settings: &settings }, params)?;
    let certified = solution.summary.residual <= RESIDUAL_LIMIT;
    if !certified || !solution.values.iter().all(|v| (0.0..=1.0).contains(v)) {
        solution.values.fill(f32::NAN);
    }
    Ok(solution)
}

/// The greatest difference of two sequences; not a number where one value is none.
pub(super) fn distance(a: impl IntoIterator<Item = f32>, b: impl IntoIterator<Item = f32>) -> f64 {
    let differences = a.into_iter().zip(b).map(|(a, b)| f64::from((a - b).abs()));
    differences.fold(0.0, |most, d| if d > most || d.is_nan() { d } else { most })
}

/// How far the values are from a function of the position, at worst.
pub(super) fn distance_from(mesh: &Mesh, solution: &Solution, f: impl Fn(DVec3) -> f64) -> f64 {
    let expected = mesh.positions.iter().map(|p| f(DVec3::from(p.map(f64::from))) as f32);
    distance(solution.values.iter().copied(), expected)
}

/// The first `count` values.
pub(super) fn first(solution: &Solution, count: usize) -> impl Iterator<Item = f32> {
    solution.values[..count].iter().copied()
}
