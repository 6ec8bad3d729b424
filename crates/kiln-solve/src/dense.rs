//! Dense Cholesky for the smallest components, of which a level has tens of thousands.

use crate::system::ComponentSystem;

/// A pivot was not positive: the matrix is not positive definite in f64.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("pivot {unknown} of a dense Cholesky factorisation is not positive; try a stronger anchor")]
pub struct NotPositive {
    /// The unknown, in the order of the system.
    pub unknown: usize,
}

/// Solves by `A = L Lᵀ` in `n² / 2` values; meant for some 64 unknowns.
pub fn solve(system: &ComponentSystem) -> Result<Vec<f64>, NotPositive> {
    let factor = Factor::new(system)?;
    let mut x = system.rhs.clone();
    factor.solve_in_place(&mut x, system.columns);
    Ok(x)
}

/// L by rows, each up to its diagonal.
struct Factor {
    rows: Vec<f64>,
    n: usize,
}

fn row_start(i: usize) -> usize {
    i * (i + 1) / 2
}

impl Factor {
    fn new(system: &ComponentSystem) -> Result<Self, NotPositive> {
        let n = system.len();
        let mut rows = vec![0.0; row_start(n)];
        for j in 0..n {
            let (row_indices, values) = system.matrix.column(j);
            row_indices.iter().zip(values).for_each(|(&i, value)| rows[row_start(i as usize) + j] = *value);
        }
        for i in 0..n {
            let (above, row) = rows.split_at_mut(row_start(i));
            let row = &mut row[..=i];
            for j in 0..i {
                let other = &above[row_start(j)..=row_start(j) + j];
                row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
            }
            let pivot = row[i] - dot(&row[..i], &row[..i]);
            if !(pivot > 0.0 && pivot.is_finite()) {
                return Err(NotPositive { unknown: i });
            }
            row[i] = pivot.sqrt();
        }
        Ok(Self { rows, n })
    }

    fn solve_in_place(&self, x: &mut [f64], columns: usize) {
        for c in 0..columns {
            for i in 0..self.n {
                let row = &self.rows[row_start(i)..=row_start(i) + i];
                let known: f64 = (0..i).map(|j| row[j] * x[j * columns + c]).sum();
                x[i * columns + c] = (x[i * columns + c] - known) / row[i];
            }
            for i in (0..self.n).rev() {
                let row = &self.rows[row_start(i)..=row_start(i) + i];
                x[i * columns + c] /= row[i];
                let value = x[i * columns + c];
                (0..i).for_each(|j| x[j * columns + c] -= row[j] * value);
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::LowerCsc;

    fn system(value: Vec<f64>, rhs: Vec<f64>) -> ComponentSystem {
        let matrix = LowerCsc { column_start: vec![0, 2, 3], row: vec![0, 1, 1], value };
        ComponentSystem { matrix, anchor: vec![0.0; 2], rhs, columns: 1, hole_depth: 0 }
    }

    #[test]
    fn two_by_two_by_hand() {
        // [4 2; 2 3] x = [10; 9] has x = [1.5; 2].
        let x = solve(&system(vec![4.0, 2.0, 3.0], vec![10.0, 9.0])).unwrap();
        assert!((x[0] - 1.5).abs() < 1e-15 && (x[1] - 2.0).abs() < 1e-15, "{x:?}");
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        for value in [vec![1.0, 2.0, 1.0], vec![1.0, 1.0, 1.0], vec![1.0, f64::NAN, 1.0]] {
            assert_eq!(solve(&system(value, vec![0.0; 2])), Err(NotPositive { unknown: 1 }));
        }
    }
}
