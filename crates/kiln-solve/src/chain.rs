//! Which solver a component gets, and what follows where its certificate does not hold.

use crate::{
    certificate::{Certificate, RESIDUAL_LIMIT},
    dense, pcg,
    pcg::PcgParams,
    sparse,
    system::{ComponentAnswer, ComponentSystem},
};
use kiln_core::ComponentMethod;

/// How components are solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverParams {
    /// Components of up to this many unknowns get a dense factorisation.
    pub dense_limit: usize,
    /// Components of up to this many unknowns get a sparse factorisation, larger ones conjugate gradients. Where
    /// every face has samples these take some 15 to 90 iterations and are the faster from about 1,000 unknowns.
    pub sparse_limit: usize,
    /// Components with holes deeper than `hole_limit` get a sparse factorisation up to this many unknowns, because
    /// conjugate gradients take hundreds of iterations there; so do others where they lose their patience. Larger
    /// ones settle for less.
    pub direct_limit: usize,
    /// Depth in edges to which holes do no harm to conjugate gradients.
    pub hole_limit: u32,
    /// Most bytes of a sparse factor; where it would take more, the chain goes on without it.
    pub sparse_memory_bytes: u64,
    /// When conjugate gradients stop.
    pub pcg: PcgParams,
    /// How much stronger the anchor is in the last attempt.
    pub strong_anchor: f64,
}

impl Default for SolverParams {
    fn default() -> Self {
        Self {
            dense_limit: 64,
            sparse_limit: 1000,
            direct_limit: 400_000,
            hole_limit: 5,
            sparse_memory_bytes: 1 << 30,
            pcg: PcgParams::default(),
            strong_anchor: 10.0,
        }
    }
}

impl SolverParams {
    fn first_method(&self, system: &ComponentSystem) -> ComponentMethod {
        let n = system.len();
        if n <= self.dense_limit {
            ComponentMethod::Dense
        } else if n <= self.sparse_limit || (system.hole_depth > self.hole_limit && n <= self.direct_limit) {
            ComponentMethod::Sparse
        } else {
            ComponentMethod::Pcg
        }
    }
}

/// Solves one component and certifies the answer: by the solver for its size, else by sparse Cholesky, else with
/// a stronger anchor; and if nothing holds, the answer is the local averages (no correction).
pub fn solve_component(system: &ComponentSystem, params: &SolverParams) -> ComponentAnswer {
    let mut iterations = 0;
    let first = params.first_method(system);
    let found = match first {
        ComponentMethod::Dense => dense::solve(system).ok(),
        ComponentMethod::Sparse => sparse::solve(system, params.sparse_memory_bytes).ok(),
        _ if system.len() <= params.direct_limit => {
            let pcg = PcgParams { max_iterations: params.pcg.patience, ..params.pcg };
            conjugate_gradients(system, &pcg, pcg.tolerance, &mut iterations)
        }
        _ => conjugate_gradients(system, &params.pcg, RESIDUAL_LIMIT, &mut iterations),
    };
    certified(system, found, first, iterations)
        .or_else(|| fall_back(system, params, first, &mut iterations))
        .unwrap_or_else(|| averages(system, iterations))
}

fn fall_back(
    system: &ComponentSystem,
    params: &SolverParams,
    first: ComponentMethod,
    iterations: &mut u64,
) -> Option<ComponentAnswer> {
    if first != ComponentMethod::Sparse {
        let found = sparse::solve(system, params.sparse_memory_bytes).ok();
        let answer = certified(system, found, ComponentMethod::SparseFallback, *iterations);
        if answer.is_some() {
            return answer;
        }
    }
    let strong = system.with_anchor(params.strong_anchor);
    let found = match sparse::solve(&strong, params.sparse_memory_bytes) {
        Ok(found) => Some(found),
        Err(_) => conjugate_gradients(&strong, &params.pcg, RESIDUAL_LIMIT, iterations),
    };
    certified(&strong, found, ComponentMethod::StrongAnchor, *iterations)
}

/// Conjugate gradients, if they come down to the given residual; counts their iterations.
fn conjugate_gradients(
    system: &ComponentSystem,
    params: &PcgParams,
    limit: f64,
    iterations: &mut u64,
) -> Option<Vec<f64>> {
    let (found, info) = pcg::solve(system, params).ok()?;
    *iterations += info.iterations;
    (info.residual <= limit).then_some(found)
}

/// The answer, if it has its certificate.
fn certified(
    system: &ComponentSystem,
    found: Option<Vec<f64>>,
    method: ComponentMethod,
    iterations: u64,
) -> Option<ComponentAnswer> {
    let correction = found?;
    let certificate = Certificate::new(system, &correction);
    certificate.holds().then_some(ComponentAnswer { correction, method, residual: certificate.residual, iterations })
}

fn averages(system: &ComponentSystem, iterations: u64) -> ComponentAnswer {
    let correction = vec![0.0; system.rhs.len()];
    let residual = Certificate::new(system, &correction).residual;
    ComponentAnswer { correction, method: ComponentMethod::Average, residual, iterations }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::LowerCsc;

    /// Second differences of a line with loose ends, which is singular but for the anchor.
    fn loose_line(n: usize, anchor: f64) -> ComponentSystem {
        let mut matrix = LowerCsc::with_pattern(n, || (1..n as u32).map(|i| [i - 1, i]));
        for i in 1..n as u32 {
            matrix.add(i - 1, i, -1.0);
            matrix.add_diagonal(i as usize, 1.0);
            matrix.add_diagonal(i as usize - 1, 1.0);
        }
        (0..n).for_each(|i| matrix.add_diagonal(i, anchor));
        let rhs = (0..n).map(|i| (i * 31 % 17) as f64 - 8.0).collect();
        ComponentSystem { matrix, anchor: vec![anchor; n], rhs, columns: 1, hole_depth: 0 }
    }

    #[test]
    fn size_decides() {
        let params = SolverParams { sparse_limit: 100, ..SolverParams::default() };
        let cases = [(64, ComponentMethod::Dense), (65, ComponentMethod::Sparse), (101, ComponentMethod::Pcg)];
        for (n, method) in cases {
            let answer = solve_component(&loose_line(n, 1e-2), &params);
            assert_eq!(answer.method, method);
            assert!(answer.residual <= RESIDUAL_LIMIT, "{answer:?}");
        }
        let holes = ComponentSystem { hole_depth: 6, ..loose_line(1000, 1e-2) };
        assert_eq!(solve_component(&holes, &params).method, ComponentMethod::Sparse);
        let large = SolverParams { direct_limit: 999, ..params };
        assert_eq!(solve_component(&holes, &large).method, ComponentMethod::Pcg);
    }

    #[test]
    fn conjugate_gradients_that_miss_fall_back() {
        let pcg = PcgParams { patience: 2, max_iterations: 2, ..PcgParams::default() };
        let params = SolverParams { dense_limit: 0, sparse_limit: 0, pcg, ..SolverParams::default() };
        let answer = solve_component(&loose_line(300, 1e-2), &params);
        assert_eq!((answer.method, answer.iterations), (ComponentMethod::SparseFallback, 2));
        let exact = sparse::solve(&loose_line(300, 1e-2), u64::MAX).unwrap();
        assert_eq!(answer.correction, exact);
    }

    #[test]
    fn without_memory_or_convergence_the_averages_stay() {
        let pcg = PcgParams { patience: 2, max_iterations: 2, ..PcgParams::default() };
        let params =
            SolverParams { dense_limit: 0, sparse_limit: 0, sparse_memory_bytes: 0, pcg, ..SolverParams::default() };
        let answer = solve_component(&loose_line(300, 1e-2), &params);
        assert_eq!((answer.method, answer.iterations), (ComponentMethod::Average, 4));
        assert!(answer.correction.iter().all(|x| *x == 0.0) && answer.residual > RESIDUAL_LIMIT);
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_gets_a_stronger_anchor() {
        // Indefinite by 1e-3 until the anchor is ten times as strong.
        let mut system = loose_line(300, 1e-3);
        (0..300).for_each(|i| system.matrix.add_diagonal(i, -2e-3));
        let answer = solve_component(&system, &SolverParams::default());
        assert_eq!(answer.method, ComponentMethod::StrongAnchor);
    }
}
