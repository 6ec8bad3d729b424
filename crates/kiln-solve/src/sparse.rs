//! Sparse Cholesky by faer (supernodal, AMD ordering) in f64, on one thread: components run in parallel instead.

use crate::{matrix::LowerCsc, system::ComponentSystem};
use faer::{
    Conj, MatMut, Par, Side, Spec,
    dyn_stack::{MemBuffer, MemStack},
    linalg::cholesky::llt::factor::LltRegularization,
    sparse::{
        SparseColMatRef, SymbolicSparseColMatRef,
        linalg::cholesky::{
            CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
        },
    },
};

/// Why a sparse factorisation was not done.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SparseError {
    /// The factor alone would need more memory than allowed.
    #[error("a sparse Cholesky factor would take {needed} bytes, more than {limit}; use conjugate gradients")]
    TooLarge {
        /// Bytes of the factor and its work space.
        needed: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// The ordering or the symbolic factorisation failed.
    #[error("a sparse Cholesky factorisation could not be planned ({reason}); use conjugate gradients")]
    Symbolic {
        /// What faer says.
        reason: String,
    },
    /// The matrix is not positive definite in f64.
    #[error("a sparse Cholesky factorisation failed ({reason}); try a stronger anchor")]
    Numeric {
        /// What faer says.
        reason: String,
    },
    /// The system allocator refused the work space.
    #[error("there is no memory for the {needed} bytes of a sparse Cholesky factorisation")]
    OutOfMemory {
        /// Bytes of the factor and its work space.
        needed: u64,
    },
}

/// Solves by `P A Pᵀ = L Lᵀ`, if that takes at most `limit` bytes.
pub fn solve(system: &ComponentSystem<'_>, limit: u64) -> Result<Vec<f64>, SparseError> {
    let (n, columns) = (system.len(), system.columns);
    let factor = Factor::new(&system.matrix, limit)?;
    let mut by_column: Vec<f64> =
        (0..columns).flat_map(|c| (0..n).map(move |i| (i, c))).map(|(i, c)| system.rhs[i * columns + c]).collect();
    factor.solve_in_place(&mut by_column, columns);
    Ok((0..n).flat_map(|i| (0..columns).map(move |c| (i, c))).map(|(i, c)| by_column[c * n + i]).collect())
}

/// A factorised matrix.
pub(crate) struct Factor {
    symbolic: SymbolicCholesky<u32>,
    values: Vec<f64>,
}

impl Factor {
    /// Factorises, if that takes at most `limit` bytes.
    pub(crate) fn new(matrix: &LowerCsc, limit: u64) -> Result<Self, SparseError> {
        let n = matrix.len();
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &matrix.column_start, None, &matrix.row);
        let params = CholeskySymbolicParams::default();
        let symbolic = factorize_symbolic_cholesky(pattern, Side::Lower, SymmetricOrdering::Amd, params)
            .map_err(|error| SparseError::Symbolic { reason: error.to_string() })?;
        let request = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let needed = 8 * symbolic.len_val() as u64 + request.size_bytes() as u64;
        if needed > limit {
            return Err(SparseError::TooLarge { needed, limit });
        }
        let mut memory = MemBuffer::try_new(request).map_err(|_| SparseError::OutOfMemory { needed })?;
        let mut values = vec![0.0; symbolic.len_val()];
        symbolic
            .factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(pattern, &matrix.value),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Spec::default(),
            )
            .map_err(|error| SparseError::Numeric { reason: format!("{error:?}") })?;
        Ok(Self { symbolic, values })
    }

    /// Solves for right-hand sides by column.
    pub(crate) fn solve_in_place(&self, by_column: &mut [f64], columns: usize) {
        let n = self.symbolic.nrows();
        let mut memory = MemBuffer::new(self.symbolic.solve_in_place_scratch::<f64>(columns, Par::Seq));
        let x = MatMut::from_column_major_slice_mut(by_column, n, columns);
        let llt = LltRef::new(&self.symbolic, &self.values);
        llt.solve_in_place_with_conj(Conj::No, x, Par::Seq, MemStack::new(&mut memory));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::LowerCsc;
    use std::borrow::Cow;

    /// The matrix of second differences of a line of `n`, plus `shift` on the diagonal.
    fn line(n: usize, shift: f64) -> ComponentSystem<'static> {
        let mut matrix = LowerCsc::with_pattern(n, || (1..n as u32).map(|i| [i - 1, i]));
        (0..n).for_each(|i| matrix.add_diagonal(i, 2.0 + shift));
        (1..n as u32).for_each(|i| matrix.add(i - 1, i, -1.0));
        ComponentSystem {
            matrix: Cow::Owned(matrix),
            anchor: Cow::Owned(vec![0.0; n]),
            rhs: Cow::Owned(vec![1.0; 2 * n]),
            columns: 2,
            hole_ring: Cow::Owned(vec![0; n]),
        }
    }

    #[test]
    fn a_line_by_its_closed_form() {
        // −x'' = 1 with x = 0 beyond both ends: x_i = (i + 1)(n − i) / 2.
        let n = 500;
        let x = solve(&line(n, 0.0), u64::MAX).unwrap();
        for (i, pair) in x.chunks_exact(2).enumerate() {
            let expected = 0.5 * ((i + 1) * (n - i)) as f64;
            assert!(pair.iter().all(|v| (v - expected).abs() <= 1e-9 * expected), "{i}: {pair:?}");
        }
    }

    #[test]
    fn refuses_what_is_too_large_or_not_positive_definite() {
        assert!(matches!(solve(&line(500, 0.0), 1000), Err(SparseError::TooLarge { .. })));
        assert!(matches!(solve(&line(500, -1.0), u64::MAX), Err(SparseError::Numeric { .. })));
    }
}
