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
    /// Components of up to this many unknowns get a sparse factorisation, larger ones conjugate gradients: at its
    /// default none, because at no size was faer's factorisation the faster of the two
    /// (docs/benchmarks/solve.md).
    pub sparse_limit: usize,
    /// Most unknowns of a sparse factorisation where conjugate gradients lose their patience, or where most of the
    /// component is holes. Larger ones settle for less.
    pub direct_limit: usize,
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
            dense_limit: 96,
            sparse_limit: 0,
            direct_limit: 400_000,
            sparse_memory_bytes: 1 << 30,
            pcg: PcgParams::default(),
            strong_anchor: 10.0,
        }
    }
}

/// Where more than one in this many unknowns lies in deep holes, all are factorised instead of the holes alone.
const MOSTLY_HOLES: usize = 4;

impl SolverParams {
    fn first_method(&self, system: &ComponentSystem<'_>) -> ComponentMethod {
        let n = system.len();
        if n <= self.dense_limit {
            ComponentMethod::Dense
        } else if n <= self.sparse_limit || (n <= self.direct_limit && self.is_mostly_holes(system)) {
            ComponentMethod::Sparse
        } else {
            ComponentMethod::Pcg
        }
    }

    fn is_mostly_holes(&self, system: &ComponentSystem<'_>) -> bool {
        let deep = system.hole_ring.iter().filter(|ring| **ring > self.pcg.hole_limit).count();
        MOSTLY_HOLES * deep > system.len()
    }
}

/// Room that solves one after another can share, so that tiny components need next to no allocation.
#[derive(Debug, Default)]
pub struct Workspace {
    factor: Vec<f64>,
    residual: Vec<f64>,
}

/// Solves one component and certifies the answer: by the solver for its size, else by sparse Cholesky, else with
/// a stronger anchor; and if nothing holds, the answer is the local averages (no correction).
pub fn solve_component(system: &ComponentSystem<'_>, params: &SolverParams) -> ComponentAnswer {
    solve_component_in(system, params, &mut Workspace::default())
}

/// [`solve_component`] in given room.
pub fn solve_component_in(
    system: &ComponentSystem<'_>,
    params: &SolverParams,
    room: &mut Workspace,
) -> ComponentAnswer {
    let mut chain = Chain { system, params, room, iterations: 0 };
    let first = params.first_method(system);
    let answer = match first {
        ComponentMethod::Dense => {
            let found = dense::solve_with_room(system, &mut chain.room.factor).ok();
            chain.certified(system, found, first)
        }
        ComponentMethod::Sparse => chain.sparse(system, first),
        _ if system.len() <= params.direct_limit => {
            let pcg = PcgParams { max_iterations: params.pcg.patience, ..params.pcg };
            chain.iterated(system, &pcg, pcg.tolerance, first)
        }
        _ => chain.iterated(system, &params.pcg, RESIDUAL_LIMIT, first),
    };
    answer.or_else(|| chain.fall_back(first)).unwrap_or_else(|| chain.averages())
}

/// The attempts at one component.
struct Chain<'a> {
    system: &'a ComponentSystem<'a>,
    params: &'a SolverParams,
    room: &'a mut Workspace,
    iterations: u64,
}

impl Chain<'_> {
    fn fall_back(&mut self, first: ComponentMethod) -> Option<ComponentAnswer> {
        if first != ComponentMethod::Sparse {
            let answer = self.sparse(self.system, ComponentMethod::SparseFallback);
            if answer.is_some() {
                return answer;
            }
        }
        let strong = self.system.with_anchor(self.params.strong_anchor);
        self.sparse(&strong, ComponentMethod::StrongAnchor)
            .or_else(|| self.iterated(&strong, &self.params.pcg, RESIDUAL_LIMIT, ComponentMethod::StrongAnchor))
    }

    fn sparse(&mut self, system: &ComponentSystem<'_>, method: ComponentMethod) -> Option<ComponentAnswer> {
        let found = sparse::solve(system, self.params.sparse_memory_bytes).ok();
        self.certified(system, found, method)
    }

    /// Conjugate gradients, if they come down to the given residual; counts their iterations.
    fn iterated(
        &mut self,
        system: &ComponentSystem<'_>,
        params: &PcgParams,
        limit: f64,
        method: ComponentMethod,
    ) -> Option<ComponentAnswer> {
        let found = pcg::solve_with_residual(system, params).ok()?;
        self.iterations += found.info.iterations;
        let certificate = Certificate::of_residual(system, &found.x, &found.r);
        let good = found.info.residual <= limit && certificate.holds();
        good.then(|| self.answer(found.x, method, certificate.residual))
    }

    /// The answer, if it has its certificate.
    fn certified(
        &mut self,
        system: &ComponentSystem<'_>,
        found: Option<Vec<f64>>,
        method: ComponentMethod,
    ) -> Option<ComponentAnswer> {
        let correction = found?;
        let certificate = Certificate::with_room(system, &correction, &mut self.room.residual);
        certificate.holds().then(|| self.answer(correction, method, certificate.residual))
    }

    fn averages(&mut self) -> ComponentAnswer {
        let correction = vec![0.0; self.system.rhs.len()];
        let residual = Certificate::new(self.system, &correction).residual;
        self.answer(correction, ComponentMethod::Average, residual)
    }

    fn answer(&self, correction: Vec<f64>, method: ComponentMethod, residual: f64) -> ComponentAnswer {
        ComponentAnswer { correction, method, residual, iterations: self.iterations }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::LowerCsc;
    use std::borrow::Cow;

    /// Second differences of a line with loose ends, which is singular but for the anchor.
    fn loose_line(n: usize, anchor: f64) -> ComponentSystem<'static> {
        let mut matrix = LowerCsc::with_pattern(n, || (1..n as u32).map(|i| [i - 1, i]));
        for i in 1..n as u32 {
            matrix.add(i - 1, i, -1.0);
            matrix.add_diagonal(i as usize, 1.0);
            matrix.add_diagonal(i as usize - 1, 1.0);
        }
        (0..n).for_each(|i| matrix.add_diagonal(i, anchor));
        let rhs = (0..n).map(|i| (i * 31 % 17) as f64 - 8.0).collect();
        ComponentSystem {
            matrix: Cow::Owned(matrix),
            anchor: Cow::Owned(vec![anchor; n]),
            rhs: Cow::Owned(rhs),
            columns: 1,
            hole_ring: Cow::Owned(vec![0; n]),
        }
    }

    #[test]
    fn size_decides() {
        let params = SolverParams { dense_limit: 64, sparse_limit: 100, ..SolverParams::default() };
        let cases = [(64, ComponentMethod::Dense), (65, ComponentMethod::Sparse), (101, ComponentMethod::Pcg)];
        for (n, method) in cases {
            let answer = solve_component(&loose_line(n, 1e-2), &params);
            assert_eq!(answer.method, method);
            assert!(answer.residual <= RESIDUAL_LIMIT, "{answer:?}");
        }
    }

    #[test]
    fn what_is_mostly_holes_is_factorised_if_it_is_small() {
        let mut system = loose_line(1000, 0.3);
        system.hole_ring.to_mut()[..250].fill(6);
        assert_eq!(solve_component(&system, &SolverParams::default()).method, ComponentMethod::Pcg);
        system.hole_ring.to_mut()[250] = 6;
        assert_eq!(solve_component(&system, &SolverParams::default()).method, ComponentMethod::Sparse);
        let small = SolverParams { direct_limit: 999, ..SolverParams::default() };
        assert_eq!(solve_component(&system, &small).method, ComponentMethod::Pcg);
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
        (0..300).for_each(|i| system.matrix.to_mut().add_diagonal(i, -2e-3));
        let answer = solve_component(&system, &SolverParams::default());
        assert_eq!(answer.method, ComponentMethod::StrongAnchor);
    }
}
