//! Meshes made by code and their samples, for the tests of the whole solve.

#![expect(dead_code, reason = "each test program uses a part")]

use glam::{DAffine3, DVec3, Vec3};
use kiln_core::{FaceGroup, FaceMoments, HalfMoments, Mesh, Solution, SolveSettings};
use kiln_solve::{SolveInput, SolverParams, solve_with};

/// A mesh of one receiving group without shading normals.
pub(crate) fn mesh(positions: Vec<[f32; 3]>, faces: Vec<[u32; 3]>) -> Mesh {
    let group = FaceGroup::PLAIN;
    let normals = vec![[0.0; 3]; positions.len()];
    Mesh { normals, face_group: vec![0; faces.len()], groups: vec![group], positions, faces, ..Mesh::default() }
}

/// A grid in the plane z = 0 with the given coordinates of its columns and rows; vertex `(i, j)` is `i * rows + j`.
pub(crate) fn grid(xs: &[f32], ys: &[f32]) -> Mesh {
    let rows = ys.len() as u32;
    let positions = xs.iter().flat_map(|x| ys.iter().map(|y| [*x, *y, 0.0])).collect();
    let quads = (0..xs.len() as u32 - 1).flat_map(|i| (0..rows - 1).map(move |j| i * rows + j));
    let faces = quads.flat_map(|v| [[v, v + rows, v + 1], [v + 1, v + rows, v + rows + 1]]).collect();
    mesh(positions, faces)
}

/// `n` numbers from 0 with steps of 1.
pub(crate) fn steps(n: u32) -> Vec<f32> {
    (0..n).map(|i| i as f32).collect()
}

/// A grid of `n × n` vertices about 1 apart, moved about by up to 0.25 within the plane.
pub(crate) fn jittered(n: u32) -> Mesh {
    let mut mesh = grid(&steps(n), &steps(n));
    for (i, p) in mesh.positions.iter_mut().enumerate() {
        p[0] += 0.25 * (noise(2 * i as u64) - 0.5) as f32 * 2.0;
        p[1] += 0.25 * (noise(2 * i as u64 + 1) - 0.5) as f32 * 2.0;
    }
    mesh
}

/// Noise in [0, 1) by splitmix64.
pub(crate) fn noise(i: u64) -> f64 {
    let mut z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// One sample: its face, number, barycentric coordinates and position in object space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) face: usize,
    pub(crate) number: u64,
    pub(crate) phi: [f64; 3],
    pub(crate) point: DVec3,
}

/// The samples of a face, uniform, keyed by its corners in any order.
pub(crate) fn samples(mesh: &Mesh, face: usize, count: u64) -> impl Iterator<Item = Sample> {
    let corners = mesh.corners(face).map(Vec3::as_dvec3);
    let key = corners.iter().map(|c| c.to_array().map(f64::to_bits).iter().fold(7, |k: u64, b| k.wrapping_mul(31) ^ b));
    let key = key.fold(0, |sum: u64, k| sum.wrapping_add(k.wrapping_mul(k | 1)));
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| corners[*a].to_array().map(f64::to_bits).cmp(&corners[*b].to_array().map(f64::to_bits)));
    (0..count).map(move |number| {
        let [u, v] = [0, 1].map(|k| noise(key ^ (2 * number + k)));
        let sorted = if u + v > 1.0 { [u + v - 1.0, 1.0 - u, 1.0 - v] } else { [1.0 - u - v, u, v] };
        let mut phi = [0.0; 3];
        order.iter().zip(sorted).for_each(|(slot, p)| phi[*slot] = p);
        // Summed in the sorted order, so that no bit depends on the order of the corners.
        let point = order.iter().zip(sorted).map(|(slot, p)| corners[*slot] * p).sum();
        Sample { face, number, phi, point }
    })
}

/// Moments of `count` samples in each face, of a function that gives no value where a sample is not valid.
pub(crate) fn moments(mesh: &Mesh, count: u64, f: impl Fn(&Sample) -> Option<f64>) -> FaceMoments {
    let mut moments = FaceMoments::new(1);
    for face in 0..mesh.faces.len() {
        let mut halves = [HalfMoments::default(); 2];
        for sample in samples(mesh, face, count) {
            let half = &mut halves[sample.number as usize % 2];
            match f(&sample) {
                Some(value) => half.add(sample.phi, &[value]),
                None => half.add_invalid(),
            }
        }
        moments.push(&halves);
    }
    moments
}

/// Moments of each half by the midpoints of the sides, whose sums are the integrals of quadratic functions.
pub(crate) fn quadrature(mesh: &Mesh, f: impl Fn(DVec3) -> f64) -> FaceMoments {
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

/// Solves in world = object space.
pub(crate) fn solve(mesh: &Mesh, moments: &FaceMoments, settings: &SolveSettings) -> Solution {
    solve_at(mesh, moments, settings, DAffine3::IDENTITY, &SolverParams::default())
}

/// Solves under a transform with chosen solvers.
pub(crate) fn solve_at(
    mesh: &Mesh,
    moments: &FaceMoments,
    settings: &SolveSettings,
    world_from_object: DAffine3,
    params: &SolverParams,
) -> Solution {
    let solution = solve_with(&SolveInput { mesh, world_from_object, moments, settings }, params)
        .expect("the shapes fit together");
    assert_eq!(solution.values.len(), mesh.positions.len() * moments.channel_count());
    assert!(solution.values.iter().all(|v| (0.0..=1.0).contains(v)), "{:?}", solution.values);
    solution
}

/// Settings with another weight of the regulariser and of the anchor.
pub(crate) fn settings(regularization: f64, anchor: f64) -> SolveSettings {
    SolveSettings { regularization, anchor, ..SolveSettings::default() }
}

/// Every component by conjugate gradients, to the given residual.
pub(crate) fn by_conjugate_gradients(tolerance: f64) -> SolverParams {
    let mut params = SolverParams { dense_limit: 0, sparse_limit: 0, direct_limit: 0, ..SolverParams::default() };
    params.pcg.tolerance = tolerance;
    params.pcg.patience = params.pcg.max_iterations;
    params
}

/// The greatest difference of two sequences.
pub(crate) fn distance(a: impl IntoIterator<Item = f32>, b: impl IntoIterator<Item = f32>) -> f64 {
    a.into_iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}

/// How far the values are from a function of the position, at worst.
pub(crate) fn distance_from(mesh: &Mesh, solution: &Solution, f: impl Fn(DVec3) -> f64) -> f64 {
    let expected = mesh.positions.iter().map(|p| f(DVec3::from(p.map(f64::from))) as f32);
    distance(solution.values.iter().copied(), expected)
}
