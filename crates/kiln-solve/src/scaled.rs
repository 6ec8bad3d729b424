//! The matrix that conjugate gradients read: whole rows in f32, scaled to a diagonal of 1.
//!
//! With `S = diag(1 / √A_ii)` the scaled matrix `S A S` has elements within [−1, 1], whatever the sizes of
//! triangles, so f32 has the range for it, and Jacobi's preconditioner is the identity. What is lost by f32 is
//! made good by residuals in f64 (see [`crate::pcg`]).

use crate::matrix::LowerCsc;

/// A diagonal element is not a positive number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BadDiagonal {
    pub(crate) unknown: usize,
}

/// One element outside the diagonal.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    column: u32,
    value: f32,
}

/// `S A S` by rows, but for its diagonal of ones.
pub(crate) struct ScaledRows {
    start: Vec<usize>,
    entry: Vec<Entry>,
    /// `1 / √A_ii`.
    pub(crate) scale: Vec<f64>,
}

impl ScaledRows {
    #[expect(clippy::cast_possible_truncation, reason = "f32 is what these rows are for")]
    pub(crate) fn new(lower: &LowerCsc) -> Result<Self, BadDiagonal> {
        let n = lower.len();
        let scale = scales(lower)?;
        let mut start = vec![0usize; n + 1];
        for j in 0..n {
            let below = &lower.column(j).0[1..];
            start[j + 1] += below.len();
            below.iter().for_each(|i| start[*i as usize + 1] += 1);
        }
        for i in 0..n {
            start[i + 1] += start[i];
        }
        let mut next = start[..n].to_vec();
        let mut entry = vec![Entry::default(); start[n]];
        // Columns in order fill row j below its diagonal before its own column fills the rest: rows are sorted.
        for j in 0..n {
            let (rows, values) = lower.column(j);
            for (at, (&i, &v)) in (next[j]..).zip(rows[1..].iter().zip(&values[1..])) {
                let value = (v * scale[j] * scale[i as usize]) as f32;
                entry[at] = Entry { column: i, value };
                let slot = &mut next[i as usize];
                entry[*slot] = Entry { column: j as u32, value };
                *slot += 1;
            }
        }
        Ok(Self { start, entry, scale })
    }

    pub(crate) fn len(&self) -> usize {
        self.scale.len()
    }

    /// The columns of a row's elements outside the diagonal, rising.
    pub(crate) fn columns(&self, i: usize) -> impl Iterator<Item = u32> {
        self.entry[self.start[i]..self.start[i + 1]].iter().map(|entry| entry.column)
    }

    /// One element of the product with `x` in each column, summed in the order of the row.
    #[inline]
    pub(crate) fn product<const K: usize>(&self, i: usize, x: &[[f32; K]]) -> [f32; K] {
        let mut sum = x[i];
        for entry in &self.entry[self.start[i]..self.start[i + 1]] {
            let x = &x[entry.column as usize];
            for c in 0..K {
                sum[c] += entry.value * x[c];
            }
        }
        sum
    }
}

fn scales(lower: &LowerCsc) -> Result<Vec<f64>, BadDiagonal> {
    let scale = |unknown| {
        let diagonal = lower.diagonal(unknown);
        let good = diagonal > 0.0 && diagonal.is_finite();
        if good { Ok(1.0 / diagonal.sqrt()) } else { Err(BadDiagonal { unknown }) }
    };
    (0..lower.len()).map(scale).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_the_scaled_matrix() {
        // [4 2 0; 2 9 -3; 0 -3 16]: scales 1/2, 1/3, 1/4.
        let value = vec![4.0, 2.0, 9.0, -3.0, 16.0];
        let lower = LowerCsc { column_start: vec![0, 2, 4, 5], row: vec![0, 1, 1, 2, 2], value };
        let rows = ScaledRows::new(&lower).unwrap_or_else(|bad| panic!("{bad:?}"));
        assert_eq!(rows.scale, [0.5, 1.0 / 3.0, 0.25]);
        assert_eq!(rows.columns(1).collect::<Vec<_>>(), [0, 2]);
        let x = [[1.0, 0.0], [0.0, 1.0], [2.0, 0.0]];
        let third = 1.0f32 / 3.0;
        assert_eq!(rows.product(0, &x), [1.0, third]);
        assert_eq!(rows.product(1, &x), [third - 0.5, 1.0]);
        assert_eq!(rows.product(2, &x), [2.0, -0.25]);
    }

    #[test]
    fn what_is_not_positive_is_named() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let lower = LowerCsc { column_start: vec![0, 1, 2], row: vec![0, 1], value: vec![1.0, bad] };
            assert_eq!(ScaledRows::new(&lower).err(), Some(BadDiagonal { unknown: 1 }));
        }
    }
}
