//! The inverse of a covariance matrix for slopes, with a ridge whose bias is taken out again where the data say enough.
//!
//! A ridge λ leaves `σ / (σ + λ)` of a direction of variance σ: with λ = 10⁻³ slopes of a full grid lose 2 %. Solving
//! again for what is left, m times in all, leaves `1 − (λ / (σ + λ))^m` (iterated Tikhonov regularisation, King and
//! Chillingworth 1979): with m = 8 the bias on a full grid is 10⁻¹³ of a slope, a direction of variance 10⁻² has none
//! above 5·10⁻⁹, and one of 10⁻⁶ keeps less than a hundredth. m doubles with each step `F ← F (2 − C F)`, since `1 − C
//! F` is squared.

use super::cholesky::Cholesky;

/// λ, of variances in a box scaled to [−1, 1]³.
pub(crate) const RIDGE: f64 = 1e-3;

/// A column of less variance is frozen: its slope is 0.
const LEAST_VARIANCE: f64 = 1e-6;

/// m = 2³.
const DOUBLINGS: usize = 3;

/// A square matrix.
pub(crate) type Square<const N: usize> = [[f64; N]; N];

/// Which columns have too little variance for a slope.
pub(crate) fn frozen<const N: usize>(covariance: &Square<N>) -> [bool; N] {
    std::array::from_fn(|i| covariance[i][i] < LEAST_VARIANCE)
}

/// F, for slopes `F b`. Rows and columns of frozen columns are 0.
pub(crate) fn inverse<const N: usize>(covariance: &Square<N>) -> Square<N> {
    let frozen = frozen(covariance);
    let kept = |i: usize, j: usize| if frozen[i] || frozen[j] { 0.0 } else { covariance[i][j] };
    let own = |i: usize, j: usize| if i == j && !frozen[i] { RIDGE } else { 0.0 };
    let with_ridge = std::array::from_fn(|i| std::array::from_fn(|j| kept(i, j) + own(i, j)));
    let start = Cholesky::new(&with_ridge).invert();
    (0..DOUBLINGS).fold(start, |inverse, _| doubled(covariance, &inverse))
}

/// `F (2 − C F)`. Of what slopes `F b` take of a sum of squares, `b·(2F − F C F) b`, it is the matrix, too.
pub(crate) fn doubled<const N: usize>(covariance: &Square<N>, inverse: &Square<N>) -> Square<N> {
    let product = times(covariance, inverse);
    let rest = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 2.0 } else { 0.0 } - product[i][j]));
    times(inverse, &rest)
}

fn times<const N: usize>(a: &Square<N>, b: &Square<N>) -> Square<N> {
    let mut product = [[0.0; N]; N];
    for i in 0..N {
        for k in 0..N {
            let factor = a[i][k];
            (0..N).for_each(|j| product[i][j] += factor * b[k][j]);
        }
    }
    product
}

/// `M v`.
pub(crate) fn apply<const N: usize>(matrix: &Square<N>, v: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| dot(&matrix[i], v))
}

pub(crate) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    (0..N).map(|i| a[i] * b[i]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is left of a direction by its variance.
    fn kept(variance: f64) -> f64 {
        variance * inverse(&[[variance]])[0][0]
    }

    #[test]
    fn bias_is_taken_out_where_there_is_variance() {
        assert!((kept(0.04) - 1.0).abs() < 1e-12 && (kept(0.01) - 1.0).abs() < 5e-9);
        assert!((kept(1e-3) - (1.0 - 0.5f64.powi(8))).abs() < 1e-9);
        assert!(kept(1e-5) < 0.08 && kept(2e-6) < 0.02 && kept(9e-7) == 0.0 && kept(0.0) == 0.0);
    }

    #[test]
    fn collinear_columns_share_a_slope() {
        let f = inverse(&[[0.1, 0.1, 0.0], [0.1, 0.1, 0.0], [0.0, 0.0, 0.0]]);
        let slopes = apply(&f, &[0.1, 0.1, 0.3]);
        assert!((slopes[0] - 0.5).abs() < 1e-9 && (slopes[1] - 0.5).abs() < 1e-9 && slopes[2] == 0.0, "{slopes:?}");
    }

    #[test]
    fn the_next_doubling_is_the_gain() {
        let c = [[0.1, 0.02], [0.02, 0.006]];
        let (f, b) = (inverse(&c), [0.3, -0.1]);
        let x = apply(&f, &b);
        let gain = 2.0 * dot(&x, &b) - dot(&x, &apply(&c, &x));
        assert!((gain - dot(&b, &apply(&doubled(&c, &f), &b))).abs() < 1e-12);
    }
}
