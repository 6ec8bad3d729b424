//! Conjugate gradients for large components: f32 inside, f64 around.
//!
//! The recurrence (`iterate`) runs in f32 on the scaled matrix (`scaled`), which halves what it
//! reads; its answer is added in f64 and the residual formed anew in f64 from the matrix itself, and where that is
//! not yet small enough the recurrence starts again for what is left (iterative refinement, Wilkinson 1963). So
//! nothing of f32 is ever taken on trust. Iteration ends when `max |r_i| / A_ii`, the measure of the certificate,
//! is small enough for every right-hand side, or at a fixed number of iterations. Deep holes are factorised
//! (`schwarz`).

use crate::{
    columns::{ForColumns, for_columns},
    iterate::Iterate,
    scaled::ScaledRows,
    schwarz::HoleBlocks,
    system::{ComponentSystem, MAX_COLUMNS},
};

/// The recurrence goes on to this fraction of the residual asked for: in f32 it differs from the true one.
const INNER: f64 = 0.9;
/// A round that leaves more than this fraction of the residual is the last.
const LEAST_GAIN: f64 = 0.5;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PcgParams {
    /// Greatest `|r_i| / A_ii` of a converged answer; AO values are in [0, 1].
    pub tolerance: f64,
    /// Iterations after which `settle` is enough. Where faces have samples, 10 to 90 iterations reach the
    /// tolerance; what is left after these is the smooth part of holes too wide to be factorised.
    pub patience: u64,
    /// Greatest `|r_i| / A_ii` of an answer after `patience` iterations.
    pub settle: f64,
    /// Iterations after which to return what there is.
    pub max_iterations: u64,
    /// Depth in edges to which holes do no harm; deeper ones are factorised.
    pub hole_limit: u32,
    /// Most bytes of the factor of holes; where it would take more, they are iterated over.
    pub hole_memory_bytes: u64,
}

impl Default for PcgParams {
    fn default() -> Self {
        Self {
            tolerance: 1e-6,
            patience: 150,
            settle: 1e-4,
            max_iterations: 2000,
            hole_limit: 2,
            hole_memory_bytes: 1 << 30,
        }
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
    /// Greatest `|r_i| / A_ii`.
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
pub fn solve(system: &ComponentSystem<'_>, params: &PcgParams) -> Result<(Vec<f64>, PcgInfo), PcgError> {
    solve_with_residual(system, params).map(|found| (found.x, found.info))
}

/// An answer and its residual `r0 − A x`, formed in f64 from the matrix itself.
pub(crate) struct Found {
    pub(crate) x: Vec<f64>,
    pub(crate) r: Vec<f64>,
    pub(crate) info: PcgInfo,
}

/// [`solve`], with the residual that a certificate needs.
pub(crate) fn solve_with_residual(system: &ComponentSystem<'_>, params: &PcgParams) -> Result<Found, PcgError> {
    let columns = system.columns;
    for_columns(columns, Solve { system, params }).unwrap_or(Err(PcgError::Columns { columns }))
}

struct Solve<'a> {
    system: &'a ComponentSystem<'a>,
    params: &'a PcgParams,
}

impl ForColumns for Solve<'_> {
    type Output = Result<Found, PcgError>;

    fn run<const K: usize>(self) -> Self::Output {
        run::<K>(self.system, self.params)
    }
}

fn run<const K: usize>(system: &ComponentSystem<'_>, params: &PcgParams) -> Result<Found, PcgError> {
    let matrix = ScaledRows::new(&system.matrix).map_err(|bad| PcgError::Diagonal { unknown: bad.unknown })?;
    // Without memory for the factor the holes are iterated over like the rest.
    let holes = HoleBlocks::new(system, &matrix, params.hole_limit, params.hole_memory_bytes).ok().flatten();
    let mut iterate = Iterate::<K>::new(&matrix, holes.as_ref());
    let mut x = vec![0.0; system.rhs.len()];
    let mut r = system.rhs.to_vec();
    let mut info = PcgInfo { iterations: 0, residual: residual(system, &r) };
    let mut last = f64::INFINITY;
    while params.goes_on(&info) && info.residual <= LEAST_GAIN * last {
        last = info.residual;
        iterate.start(r.as_chunks::<K>().0);
        // A little beyond, so that rounding does not ask for another round.
        let mut inner = PcgInfo { residual: iterate.residual().into(), ..info };
        while params.goes_on(&PcgInfo { residual: inner.residual / INNER, ..inner }) {
            iterate.step();
            inner = PcgInfo { iterations: inner.iterations + 1, residual: iterate.residual().into() };
        }
        for ((x, dx), scale) in x.as_chunks_mut::<K>().0.iter_mut().zip(&iterate.x).zip(&matrix.scale) {
            (0..K).for_each(|c| x[c] += f64::from(dx[c]) * scale);
        }
        r.copy_from_slice(&system.rhs);
        system.matrix.subtract_product(K, &x, &mut r);
        info = PcgInfo { iterations: inner.iterations, residual: residual(system, &r) };
    }
    Ok(Found { x, r, info })
}

/// Greatest `|r_i| / A_ii`, or not a number where one is none.
fn residual(system: &ComponentSystem<'_>, r: &[f64]) -> f64 {
    let mut worst = 0.0;
    for (i, r) in r.chunks_exact(system.columns).enumerate() {
        let diagonal = system.matrix.diagonal(i);
        for ratio in r.iter().map(|r| (r / diagonal).abs()) {
            // Not `max`, which would drop what is not a number.
            worst = if ratio > worst || ratio.is_nan() { ratio } else { worst };
        }
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{iterate::CHUNK, matrix::LowerCsc};
    use std::borrow::Cow;

    /// Second differences on a line plus 1 on the diagonal, with right-hand sides e_0 and 0.
    fn line(n: usize) -> ComponentSystem<'static> {
        let mut matrix = LowerCsc::with_pattern(n, || (1..n as u32).map(|i| [i - 1, i]));
        (0..n).for_each(|i| matrix.add_diagonal(i, 3.0));
        (1..n as u32).for_each(|i| matrix.add(i - 1, i, -1.0));
        let mut rhs = vec![0.0; 2 * n];
        rhs[0] = 1.0;
        ComponentSystem {
            matrix: Cow::Owned(matrix),
            anchor: Cow::Owned(vec![0.0; n]),
            rhs: Cow::Owned(rhs),
            columns: 2,
            hole_ring: Cow::Owned(vec![0; n]),
        }
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
        assert!(info.iterations < 90 && info.residual <= 1e-14, "{info:?}");
    }

    fn precise(max_iterations: u64) -> PcgParams {
        PcgParams { tolerance: 1e-14, patience: max_iterations, settle: 0.0, max_iterations, ..PcgParams::default() }
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
        system.rhs.to_mut().iter_mut().enumerate().for_each(|(i, b)| *b = ((i * 7919) % 1013) as f64 / 1013.0);
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
        system.rhs.to_mut()[0] = f64::NAN;
        let (_, info) = solve(&system, &PcgParams::default()).unwrap();
        assert!(info.residual.is_nan() && info.iterations == 0, "{info:?}");
        system.matrix.to_mut().add_diagonal(2, -3.0);
        assert_eq!(solve(&system, &PcgParams::default()), Err(PcgError::Diagonal { unknown: 2 }));
        system.columns = 9;
        assert_eq!(solve(&system, &PcgParams::default()), Err(PcgError::Columns { columns: 9 }));
    }

    /// Fourth differences along a line of `n` but for `hole`, where nothing else is: 1 on the diagonal elsewhere.
    fn line_with_hole(n: usize, hole: std::ops::Range<usize>) -> ComponentSystem<'static> {
        let pairs = || (2..n as u32).flat_map(|i| [[i - 2, i - 1], [i - 1, i], [i - 2, i]]);
        let mut matrix = LowerCsc::with_pattern(n, pairs);
        for i in 1..n as u32 - 1 {
            let row = [(i - 1, 1.0), (i, -2.0), (i + 1, 1.0)];
            let products = (0..3).flat_map(|a| (0..=a).map(move |b| (row[a], row[b])));
            products.for_each(|((i, a), (j, b))| matrix.add(i, j, a * b));
        }
        (0..n).for_each(|i| matrix.add_diagonal(i, if hole.contains(&i) { 1e-5 } else { 1.0 }));
        let ring = |i: usize| if hole.contains(&i) { (i + 1 - hole.start).min(hole.end - i) as u32 } else { 0 };
        ComponentSystem {
            matrix: Cow::Owned(matrix),
            anchor: Cow::Owned(vec![0.0; n]),
            rhs: Cow::Owned((0..n).map(|i| if hole.contains(&i) { 0.0 } else { ((i * 37) % 11) as f64 }).collect()),
            columns: 1,
            hole_ring: (0..n).map(ring).collect(),
        }
    }

    #[test]
    fn iterations_do_not_grow_with_holes() {
        let without = solve(&line_with_hole(600, 0..0), &PcgParams::default()).unwrap().1;
        for width in [20, 60, 200, 400] {
            let system = line_with_hole(600, 100..100 + width);
            let (x, info) = solve(&system, &PcgParams::default()).unwrap();
            assert!(
                info.residual <= 1e-6 && info.iterations <= 2 * without.iterations,
                "{width}: {info:?} {without:?}"
            );
            let direct = crate::sparse::solve(&system, u64::MAX).unwrap();
            let off = x.iter().zip(&direct).fold(0.0, |off: f64, (a, b)| off.max((a - b).abs()));
            let size = direct.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
            assert!(off <= 1e-3 * size, "{width}: {off} of {size}");
        }
        // Iterated over like the rest, the hole takes far longer.
        let plain = PcgParams { hole_limit: u32::MAX, ..PcgParams::default() };
        let (_, info) = solve(&line_with_hole(600, 100..300), &plain).unwrap();
        assert!(info.iterations > 4 * without.iterations, "{info:?} {without:?}");
    }
}
