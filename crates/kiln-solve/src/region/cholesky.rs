//! Cholesky's factorisation of matrices so small that they live on the stack.

/// A pivot below this part of its diagonal element is rounding.
const LEAST_PIVOT: f64 = 1e-13;

/// `A = L Lᵀ`. Unknowns without a pivot have no say, and are 0 in every solution: a row and column of zeros takes an
/// unknown out.
#[derive(Clone, Debug)]
pub(crate) struct Cholesky<const N: usize> {
    /// L below its diagonal.
    lower: [[f64; N]; N],
    /// 1 over the diagonal of L, 0 where there is no pivot.
    inverse: [f64; N],
}

impl<const N: usize> Cholesky<N> {
    /// Factorises a positive semidefinite matrix; its lower triangle is read.
    pub(crate) fn new(matrix: &[[f64; N]; N]) -> Self {
        let (mut lower, mut inverse) = ([[0.0; N]; N], [0.0; N]);
        for j in 0..N {
            let product = |i: usize, lower: &[[f64; N]; N]| (0..j).map(|k| lower[i][k] * lower[j][k]).sum::<f64>();
            let pivot = matrix[j][j] - product(j, &lower);
            if pivot > LEAST_PIVOT * matrix[j][j] {
                inverse[j] = 1.0 / pivot.sqrt();
            }
            for i in j + 1..N {
                lower[i][j] = inverse[j] * (matrix[i][j] - product(i, &lower));
            }
        }
        Self { lower, inverse }
    }

    /// x of `A x = b`.
    pub(crate) fn solve(&self, mut x: [f64; N]) -> [f64; N] {
        for i in 0..N {
            let known: f64 = (0..i).map(|k| self.lower[i][k] * x[k]).sum();
            x[i] = self.inverse[i] * (x[i] - known);
        }
        for i in (0..N).rev() {
            let known: f64 = (i + 1..N).map(|k| self.lower[k][i] * x[k]).sum();
            x[i] = self.inverse[i] * (x[i] - known);
        }
        x
    }

    /// The inverse, 0 in the rows and columns of unknowns without a pivot.
    pub(crate) fn invert(&self) -> [[f64; N]; N] {
        std::array::from_fn(|i| self.solve(std::array::from_fn(|j| f64::from(u8::from(i == j)))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solutions_solve(entries in prop::array::uniform16(-1.0..1.0f64), b in prop::array::uniform4(-1.0..1.0f64)) {
            let entry = |i: usize, j: usize| entries[4 * i + j];
            let product = |i, j| (0..4).map(|k| entry(i, k) * entry(j, k)).sum::<f64>();
            let a: [[f64; 4]; 4] =
                std::array::from_fn(|i| std::array::from_fn(|j| product(i, j) + if i == j { 0.1 } else { 0.0 }));
            let factor = Cholesky::new(&a);
            let (x, inverse) = (factor.solve(b), factor.invert());
            for i in 0..4 {
                let again: f64 = (0..4).map(|j| a[i][j] * x[j]).sum();
                let other: f64 = (0..4).map(|j| inverse[i][j] * b[j]).sum();
                prop_assert!((again - b[i]).abs() < 1e-11 && (other - x[i]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn what_has_no_pivot_is_zero() {
        let factor = Cholesky::new(&[[2.0, 0.0, 2.0], [0.0, 0.0, 0.0], [2.0, 0.0, 2.0]]);
        let [first, zero, last] = factor.solve([2.0, 5.0, 2.0]);
        assert!((first - 1.0).abs() < 1e-15 && zero == 0.0 && last == 0.0);
        assert_eq!(Cholesky::new(&[[0.0]]).solve([1.0]), [0.0]);
    }
}
