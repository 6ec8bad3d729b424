//! Which slopes of a model are free: all six, one for each axis, or none.

use super::{
    bound::Norm,
    cholesky::Cholesky,
    moments::SIDES,
    ridge::{Square, inverse},
};
use kiln_core::REGION_PARAMETERS;

#[derive(Clone, Copy, Debug)]
pub(crate) enum Design {
    /// None.
    Constant,
    /// One for each axis, the same on both sides.
    Gradient,
    /// All six.
    Sides,
}

impl Design {
    /// The inverse by which slopes are found ([`inverse`]), as one of six columns.
    pub(crate) fn inverse(self, covariance: &Square<SIDES>) -> Square<SIDES> {
        match self {
            Self::Constant => [[0.0; SIDES]; SIDES],
            Self::Gradient => grouped::<SIDES, 3>(covariance, |i| i / 2, inverse),
            Self::Sides => inverse(covariance),
        }
    }

    /// The norm of all parameters in which the free ones alone can change.
    pub(crate) fn norm(self, matrix: Square<REGION_PARAMETERS>) -> Norm {
        let inverse = match self {
            Self::Constant => constant(matrix[0][0]),
            Self::Gradient => {
                grouped::<REGION_PARAMETERS, 4>(&matrix, |i| i.div_ceil(2), |matrix| Cholesky::new(matrix).invert())
            }
            Self::Sides => Cholesky::new(&matrix).invert(),
        };
        Norm { matrix, inverse }
    }
}

fn constant(norm: f64) -> Square<REGION_PARAMETERS> {
    let mut inverse = [[0.0; REGION_PARAMETERS]; REGION_PARAMETERS];
    inverse[0][0] = 1.0 / norm;
    inverse
}

/// An inverse for unknowns each of which is several columns.
fn grouped<const N: usize, const M: usize>(
    matrix: &Square<N>,
    group: fn(usize) -> usize,
    inverse: impl FnOnce(&Square<M>) -> Square<M>,
) -> Square<N> {
    let mut sums = [[0.0; M]; M];
    for (i, row) in matrix.iter().enumerate() {
        row.iter().enumerate().for_each(|(j, entry)| sums[group(i)][group(j)] += entry);
    }
    let found = inverse(&sums);
    std::array::from_fn(|i| std::array::from_fn(|j| found[group(i)][group(j)]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows and columns 2a + 1 and 2a + 2 are an axis' after the constant.
    #[test]
    fn a_gradient_is_the_same_on_both_sides() {
        let norm = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 + i as f64 } else { 0.1 }));
        let inverse = Design::Gradient.norm(norm).inverse;
        for row in inverse {
            assert!(row[1] == row[2] && row[3] == row[4] && row[5] == row[6] && row[1] != row[3], "{row:?}");
        }
        let none = Design::Constant.norm(norm).inverse;
        assert_eq!((none[0][0], none[1]), (1.0, [0.0; 7]));
    }

    #[test]
    fn a_gradient_of_one_axis_is_its_regression() {
        let mut covariance = [[0.0; 6]; 6];
        let entries = [(0, 0, 0.1), (1, 1, 0.2), (0, 1, 0.05), (1, 0, 0.05)];
        entries.into_iter().for_each(|(i, j, value)| covariance[i][j] = value);
        let inverse = Design::Gradient.inverse(&covariance);
        let expected = 1.0 / 0.4;
        assert!((inverse[0][1] - expected).abs() < 1e-9 && inverse[0][0] == inverse[1][1] && inverse[2][2] == 0.0);
    }
}
