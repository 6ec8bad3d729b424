//! Conjugate gradients with Jacobi's preconditioner, all right-hand sides in one pass over the matrix.
//!
//! Hestenes and Stiefel 1952. Every right-hand side has steps of its own; what they share is the reading of the
//! matrix, which is what costs. Rows are cut into chunks of a fixed size and sums of chunks are added in order,
//! so the number of threads changes no bit. Iteration ends when `max |r_i| / A_ii`, the measure of the
//! certificate, is small enough for every right-hand side, or at a fixed number of iterations.
//!
//! This is the first form of the solver for large components; [`ComponentSystem`] in, corrections out.

use crate::{
    matrix::LowerCsc,
    system::{ComponentSystem, MAX_COLUMNS},
};
use rayon::prelude::*;

/// Rows that one thread works on at a time, and whose sums are added in order.
const CHUNK: usize = 4096;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PcgParams {
    /// Greatest `|r_i| / A_ii` of a converged answer; AO values are in [0, 1].
    pub tolerance: f64,
    /// Iterations after which `settle` is enough. Where faces have samples, 15 to 90 iterations reach the
    /// tolerance; what is left after these is the smooth part of wide holes.
    pub patience: u64,
    /// Greatest `|r_i| / A_ii` of an answer after `patience` iterations.
    pub settle: f64,
    /// Iterations after which to return what there is.
    pub max_iterations: u64,
}

impl Default for PcgParams {
    fn default() -> Self {
        Self { tolerance: 1e-6, patience: 150, settle: 1e-4, max_iterations: 2000 }
    }
}

impl PcgParams {
    /// Whether to go on; not with a residual that is not a number.
    fn goes_on(&self, info: &PcgInfo) -> bool {
        let limit = if info.iterations < self.patience { self.tolerance } else { self.settle };
        info.residual > limit && info.iterations < self.max_iterations
    }
}

/// What conjugate gradients did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PcgInfo {
    /// Iterations.
    pub iterations: u64,
    /// Greatest `|r_i| / A_ii` by the recurrence.
    pub residual: f64,
}

/// Why conjugate gradients cannot begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PcgError {
    /// A diagonal element is not positive.
    #[error("diagonal element {unknown} is not positive: the matrix is not positive definite")]
    Diagonal {
        /// The unknown.
        unknown: usize,
    },
    /// The number of right-hand sides is out of range.
    #[error("{columns} right-hand sides: there must be 1 to {MAX_COLUMNS}")]
    Columns {
        /// The number found.
        columns: usize,
    },
}

/// Solves from 0; the answer may not have converged, which [`PcgInfo::residual`] tells.
pub fn solve(system: &ComponentSystem, params: &PcgParams) -> Result<(Vec<f64>, PcgInfo), PcgError> {
    match system.columns {
        1 => run::<1>(system, params),
        2 => run::<2>(system, params),
        3 => run::<3>(system, params),
        4 => run::<4>(system, params),
        5 => run::<5>(system, params),
        6 => run::<6>(system, params),
        7 => run::<7>(system, params),
        8 => run::<8>(system, params),
        columns => Err(PcgError::Columns { columns }),
    }
}

fn run<const K: usize>(system: &ComponentSystem, params: &PcgParams) -> Result<(Vec<f64>, PcgInfo), PcgError> {
    let n = system.len();
    let matrix = Rows::new(&system.matrix);
    let inverse = (0..n).map(|i| inverse_diagonal(&system.matrix, i)).collect::<Result<Vec<_>, _>>()?;
    let (rhs, _) = system.rhs.as_chunks::<K>();
    let mut iterate = Iterate::new(rhs, &inverse);
    let mut info = PcgInfo { iterations: 0, residual: iterate.residual() };
    while params.goes_on(&info) {
        iterate.step(&matrix, &inverse);
        info = PcgInfo { iterations: info.iterations + 1, residual: iterate.residual() };
    }
    Ok((iterate.x.into_flattened(), info))
}

fn inverse_diagonal(matrix: &LowerCsc, unknown: usize) -> Result<f64, PcgError> {
    let diagonal = matrix.diagonal(unknown);
    if diagonal > 0.0 && diagonal.is_finite() { Ok(1.0 / diagonal) } else { Err(PcgError::Diagonal { unknown }) }
}

/// A symmetric matrix by whole rows, so that each element of a product is one sum in a fixed order.
struct Rows {
    start: Vec<usize>,
    column: Vec<u32>,
    value: Vec<f64>,
}

impl Rows {
    fn new(lower: &LowerCsc) -> Self {
        let n = lower.len();
        let mut start = vec![0usize; n + 1];
        for j in 0..n {
            let (rows, _) = lower.column(j);
            start[j + 1] += rows.len();
            rows[1..].iter().for_each(|i| start[*i as usize + 1] += 1);
        }
        for i in 0..n {
            start[i + 1] += start[i];
        }
        let mut next = start[..n].to_vec();
        let (mut column, mut value) = (vec![0u32; start[n]], vec![0.0; start[n]]);
        let mut put = |i: usize, j: usize, v: f64| {
            column[next[i]] = j as u32;
            value[next[i]] = v;
            next[i] += 1;
        };
        // Columns in order fill row j below its diagonal before its own column fills the rest: rows are sorted.
        for j in 0..n {
            let (rows, values) = lower.column(j);
            for (&i, &v) in rows.iter().zip(values) {
                put(j, i as usize, v);
                if i as usize != j {
                    put(i as usize, j, v);
                }
            }
        }
        Self { start, column, value }
    }

    fn product<const K: usize>(&self, i: usize, x: &[[f64; K]]) -> [f64; K] {
        let range = self.start[i]..self.start[i + 1];
        let mut sum = [0.0; K];
        for (&j, &value) in self.column[range.clone()].iter().zip(&self.value[range]) {
            let x = &x[j as usize];
            for c in 0..K {
                sum[c] += value * x[c];
            }
        }
        sum
    }
}

/// The vectors of the recurrence: answer, residual, direction and its product with the matrix.
struct Iterate<const K: usize> {
    x: Vec<[f64; K]>,
    r: Vec<[f64; K]>,
    p: Vec<[f64; K]>,
    q: Vec<[f64; K]>,
    sums: Sums<K>,
}

/// `Σ r² / A_ii` and `max |r| / A_ii` of each right-hand side.
#[derive(Clone, Copy)]
struct Sums<const K: usize> {
    rz: [f64; K],
    worst: [f64; K],
}

impl<const K: usize> Sums<K> {
    const ZERO: Self = Self { rz: [0.0; K], worst: [0.0; K] };

    fn add(&mut self, r: &[f64; K], inverse: f64) {
        for ((r, rz), worst) in r.iter().zip(&mut self.rz).zip(&mut self.worst) {
            let z = r * inverse;
            *rz += r * z;
            *worst = greater(*worst, z.abs());
        }
    }

    fn merge(mut self, other: &Self) -> Self {
        for c in 0..K {
            self.rz[c] += other.rz[c];
            self.worst[c] = greater(self.worst[c], other.worst[c]);
        }
        self
    }
}

/// The greater of two, or not a number where one is none.
fn greater(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}

impl<const K: usize> Iterate<K> {
    fn new(rhs: &[[f64; K]], inverse: &[f64]) -> Self {
        let mut sums = Sums::ZERO;
        rhs.iter().zip(inverse).for_each(|(r, inverse)| sums.add(r, *inverse));
        let p = rhs.iter().zip(inverse).map(|(r, inverse)| r.map(|r| r * inverse)).collect();
        Self { x: vec![[0.0; K]; rhs.len()], r: rhs.to_vec(), p, q: vec![[0.0; K]; rhs.len()], sums }
    }

    fn residual(&self) -> f64 {
        self.sums.worst.iter().fold(0.0, |a, b| greater(a, *b))
    }

    fn step(&mut self, matrix: &Rows, inverse: &[f64]) {
        let pq = self.multiply(matrix);
        // A right-hand side that is solved exactly, or whose direction has lost all meaning, stands still.
        let length: [f64; K] = std::array::from_fn(|c| if pq[c] > 0.0 { self.sums.rz[c] / pq[c] } else { 0.0 });
        let sums = self.advance(length, inverse);
        let turn: [f64; K] =
            std::array::from_fn(|c| if self.sums.rz[c] > 0.0 { sums.rz[c] / self.sums.rz[c] } else { 0.0 });
        self.p.par_chunks_mut(CHUNK).zip(self.r.par_chunks(CHUNK)).zip(inverse.par_chunks(CHUNK)).for_each(
            |((p, r), inverse)| {
                for ((p, r), inverse) in p.iter_mut().zip(r).zip(inverse) {
                    *p = std::array::from_fn(|c| r[c] * inverse + turn[c] * p[c]);
                }
            },
        );
        self.sums = sums;
    }

    /// `q = A p`; returns `pᵀ q`.
    fn multiply(&mut self, matrix: &Rows) -> [f64; K] {
        let p = &self.p;
        let chunk_sum = |(chunk, q): (usize, &mut [[f64; K]])| {
            let mut sum = [0.0; K];
            for (offset, q) in q.iter_mut().enumerate() {
                let i = chunk * CHUNK + offset;
                *q = matrix.product(i, p);
                for c in 0..K {
                    sum[c] += p[i][c] * q[c];
                }
            }
            sum
        };
        let sums: Vec<[f64; K]> = self.q.par_chunks_mut(CHUNK).enumerate().map(chunk_sum).collect();
        sums.iter().fold([0.0; K], |total, sum| std::array::from_fn(|c| total[c] + sum[c]))
    }

    /// `x += length p`, `r −= length q`; returns the sums of the new residual.
    fn advance(&mut self, length: [f64; K], inverse: &[f64]) -> Sums<K> {
        let (p, q) = (&self.p, &self.q);
        let chunks = self.x.par_chunks_mut(CHUNK).zip(self.r.par_chunks_mut(CHUNK)).enumerate();
        let sums: Vec<Sums<K>> = chunks
            .map(|(chunk, (x, r))| {
                let mut sums = Sums::ZERO;
                for (offset, (x, r)) in x.iter_mut().zip(r).enumerate() {
                    let i = chunk * CHUNK + offset;
                    for c in 0..K {
                        x[c] += length[c] * p[i][c];
                        r[c] -= length[c] * q[i][c];
                    }
                    sums.add(r, inverse[i]);
                }
                sums
            })
            .collect();
        sums.iter().fold(Sums::ZERO, Sums::merge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Second differences on a line plus 1 on the diagonal, with right-hand sides e_0 and 0.
    fn line(n: usize) -> ComponentSystem {
        let mut matrix = LowerCsc::with_pattern(n, || (1..n as u32).map(|i| [i - 1, i]));
        (0..n).for_each(|i| matrix.add_diagonal(i, 3.0));
        (1..n as u32).for_each(|i| matrix.add(i - 1, i, -1.0));
        let mut rhs = vec![0.0; 2 * n];
        rhs[0] = 1.0;
        ComponentSystem { matrix, anchor: vec![0.0; n], rhs, columns: 2, hole_depth: 0 }
    }

    #[test]
    fn a_line_by_its_closed_form() {
        // −x_{i−1} + 3 x_i − x_{i+1} = 0 has x_i = λ^(i+1) with λ = (3 − √5) / 2, here from x_{-1} = 1.
        let (x, info) = solve(&line(200), &precise(500)).unwrap();
        let lambda = 0.5 * (3.0 - 5f64.sqrt());
        for (i, pair) in x.chunks_exact(2).enumerate().take(30) {
            assert!((pair[0] - lambda.powi(i as i32 + 1)).abs() < 1e-13, "{i}: {pair:?}");
            assert_eq!(pair[1], 0.0);
        }
        assert!(info.iterations < 40 && info.residual <= 1e-14, "{info:?}");
    }

    fn precise(max_iterations: u64) -> PcgParams {
        PcgParams { tolerance: 1e-14, patience: max_iterations, settle: 0.0, max_iterations }
    }

    #[test]
    fn patience_ends() {
        let params = PcgParams { patience: 8, settle: 1e-2, ..precise(500) };
        let (_, info) = solve(&line(200), &params).unwrap();
        assert!(info.iterations == 8 && info.residual > 1e-14 && info.residual <= 1e-2, "{info:?}");
        let (_, info) = solve(&line(200), &PcgParams { patience: 0, ..params }).unwrap();
        assert!(info.iterations < 8 && info.residual > 1e-4 && info.residual <= 1e-2, "{info:?}");
    }

    #[test]
    fn threads_change_no_bit() {
        let mut system = line(3 * CHUNK + 17);
        system.rhs.iter_mut().enumerate().for_each(|(i, b)| *b = ((i * 7919) % 1013) as f64 / 1013.0);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| solve(&system, &PcgParams::default()).unwrap())
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn stops_at_the_limit_and_on_nonsense() {
        assert_eq!(solve(&line(200), &precise(3)).unwrap().1.iterations, 3);
        let mut system = line(4);
        system.rhs[0] = f64::NAN;
        let (_, info) = solve(&system, &PcgParams::default()).unwrap();
        assert!(info.residual.is_nan() && info.iterations == 0, "{info:?}");
        system.matrix.add_diagonal(2, -3.0);
        assert_eq!(solve(&system, &PcgParams::default()), Err(PcgError::Diagonal { unknown: 2 }));
        system.columns = 9;
        assert_eq!(solve(&system, &PcgParams::default()), Err(PcgError::Columns { columns: 9 }));
    }
}
