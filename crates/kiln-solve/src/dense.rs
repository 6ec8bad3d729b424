//! Dense Cholesky for the smallest components, of which a level has tens of thousands.

use crate::{
    columns::{ForColumns, for_columns},
    system::ComponentSystem,
};

/// A pivot was not positive: the matrix is not positive definite in f64.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("pivot {unknown} of a dense Cholesky factorisation is not positive; try a stronger anchor")]
pub struct NotPositive {
    /// The unknown, in the order of the system.
    pub unknown: usize,
}

/// Solves by `A = L Lᵀ` in `n² / 2` values; meant for some tens of unknowns.
pub fn solve(system: &ComponentSystem<'_>) -> Result<Vec<f64>, NotPositive> {
    solve_with_room(system, &mut Vec::new())
}

/// [`solve`] with room for the factor that can be used again.
pub(crate) fn solve_with_room(system: &ComponentSystem<'_>, room: &mut Vec<f64>) -> Result<Vec<f64>, NotPositive> {
    let factor = Factor::new(system, room)?;
    let mut x = system.rhs.to_vec();
    for_columns(system.columns, Substitution { factor, x: &mut x }).unwrap_or(());
    Ok(x)
}

/// L by columns, each from its diagonal.
struct Factor<'a> {
    columns: &'a [f64],
    n: usize,
}

impl<'a> Factor<'a> {
    /// Right-looking: every column, when done, is taken from those after it.
    fn new(system: &ComponentSystem<'_>, room: &'a mut Vec<f64>) -> Result<Self, NotPositive> {
        let n = system.len();
        fill(room, system);
        let mut rest = &mut room[..];
        for j in 0..n {
            let (column, after) = rest.split_at_mut(n - j);
            let pivot = column[0];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return Err(NotPositive { unknown: j });
            }
            let scale = 1.0 / pivot.sqrt();
            column.iter_mut().for_each(|l| *l *= scale);
            let mut trailing = &mut *after;
            for k in 1..column.len() {
                let (other, beyond) = trailing.split_at_mut(column.len() - k);
                let factor = column[k];
                if factor != 0.0 {
                    other.iter_mut().zip(&column[k..]).for_each(|(a, l)| *a -= factor * l);
                }
                trailing = beyond;
            }
            rest = after;
        }
        Ok(Self { columns: room, n })
    }
}

/// The lower triangle by columns.
fn fill(room: &mut Vec<f64>, system: &ComponentSystem<'_>) {
    let n = system.len();
    room.clear();
    room.resize(n * (n + 1) / 2, 0.0);
    let mut start = 0;
    for j in 0..n {
        let (rows, values) = system.matrix.column(j);
        rows.iter().zip(values).for_each(|(&i, value)| room[start + i as usize - j] = *value);
        start += n - j;
    }
}

/// `L y = b`, then `Lᵀ x = y`, in place.
struct Substitution<'a> {
    factor: Factor<'a>,
    x: &'a mut [f64],
}

impl ForColumns for Substitution<'_> {
    type Output = ();

    fn run<const K: usize>(self) {
        let (x, n) = (self.x.as_chunks_mut::<K>().0, self.factor.n);
        let mut start = 0;
        for j in 0..n {
            let column = &self.factor.columns[start..start + n - j];
            let inverse = 1.0 / column[0];
            let value = x[j].map(|v| v * inverse);
            x[j] = value;
            for (x, l) in x[j + 1..].iter_mut().zip(&column[1..]) {
                (0..K).for_each(|c| x[c] -= l * value[c]);
            }
            start += n - j;
        }
        for j in (0..n).rev() {
            start -= n - j;
            let column = &self.factor.columns[start..start + n - j];
            let mut sum = x[j];
            for (x, l) in x[j + 1..].iter().zip(&column[1..]) {
                (0..K).for_each(|c| sum[c] -= l * x[c]);
            }
            x[j] = sum.map(|v| v / column[0]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::LowerCsc;
    use std::borrow::Cow;

    fn system(value: Vec<f64>, rhs: Vec<f64>) -> ComponentSystem<'static> {
        let matrix = LowerCsc { column_start: vec![0, 2, 3], row: vec![0, 1, 1], value };
        ComponentSystem {
            matrix: Cow::Owned(matrix),
            anchor: Cow::Owned(vec![0.0; 2]),
            rhs: Cow::Owned(rhs),
            columns: 1,
            hole_ring: Cow::Owned(vec![0; 2]),
        }
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
