//! Eigenvalues and eigenvectors of symmetric 3×3 matrices by cyclic rotations (Jacobi 1846), without allocation.

/// Far more than the six or seven sweeps that quadratic convergence needs.
const SWEEPS: usize = 16;

/// The eigenvalues of a symmetric matrix, in no order, and the unit eigenvector of each.
pub(crate) fn symmetric_eigen(mut a: [[f64; 3]; 3]) -> [(f64, [f64; 3]); 3] {
    // Rows of `vectors` are eigenvectors.
    let mut vectors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..SWEEPS {
        if a[0][1] == 0.0 && a[0][2] == 0.0 && a[1][2] == 0.0 {
            break;
        }
        [(0, 1), (0, 2), (1, 2)].into_iter().for_each(|(p, q)| rotate(&mut a, &mut vectors, p, q));
    }
    std::array::from_fn(|i| (a[i][i], vectors[i]))
}

/// The rotation in the plane of two axes that makes their off-diagonal element 0.
fn rotate(a: &mut [[f64; 3]; 3], vectors: &mut [[f64; 3]; 3], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let tangent = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
    let sine = tangent * cosine;
    let turn = |x: f64, y: f64| [cosine * x - sine * y, sine * x + cosine * y];
    for row in a.iter_mut() {
        [row[p], row[q]] = turn(row[p], row[q]);
    }
    for k in 0..3 {
        [a[p][k], a[q][k]] = turn(a[p][k], a[q][k]);
        [vectors[p][k], vectors[q][k]] = turn(vectors[p][k], vectors[q][k]);
    }
    // What rounding left there would only be turned about.
    (a[p][q], a[q][p]) = (0.0, 0.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_parts_make_the_matrix_and_are_orthonormal(
            entries in prop::array::uniform6(-1.0..1.0f64), exponents in prop::array::uniform3(-9..1i32),
        ) {
            let [xx, yy, zz, xy, xz, yz] = entries;
            let scale = exponents.map(|e| 10f64.powi(e));
            let mut a = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
            (0..9).for_each(|i| a[i / 3][i % 3] *= scale[i / 3] * scale[i % 3]);
            let parts = symmetric_eigen(a);
            for i in 0..3 {
                for j in 0..3 {
                    let again: f64 = parts.iter().map(|(value, v)| value * v[i] * v[j]).sum();
                    prop_assert!((again - a[i][j]).abs() <= 1e-14, "{a:?} {parts:?}");
                    let dot: f64 = (0..3).map(|k| parts[i].1[k] * parts[j].1[k]).sum();
                    prop_assert!((dot - f64::from(u8::from(i == j))).abs() <= 1e-14, "{parts:?}");
                }
            }
        }
    }
}
