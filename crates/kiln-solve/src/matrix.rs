//! Symmetric sparse matrices by their lower triangle.

use crate::columns::{ForColumns, for_columns};

/// The lower triangle of a symmetric matrix in compressed columns. Every column starts with its diagonal, rows
/// rise within a column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LowerCsc {
    /// Start of each column, and the number of entries at the end.
    pub column_start: Vec<u32>,
    /// Row of each entry.
    pub row: Vec<u32>,
    /// Value of each entry.
    pub value: Vec<f64>,
}

impl LowerCsc {
    /// A zero matrix of `n` unknowns with an entry for each diagonal element and each of the given pairs, which
    /// may come in any order and more than once.
    pub fn with_pattern<I>(n: usize, pairs: impl Fn() -> I) -> Self
    where
        I: Iterator<Item = [u32; 2]>,
    {
        let mut start = vec![0u32; n + 1];
        pairs().for_each(|[i, j]| start[i.min(j) as usize + 1] += 1);
        for column in 0..n {
            start[column + 1] += start[column];
        }
        let mut next = start[..n].to_vec();
        let mut rows = vec![0u32; start[n] as usize];
        pairs().for_each(|[i, j]| {
            let slot = &mut next[i.min(j) as usize];
            rows[*slot as usize] = i.max(j);
            *slot += 1;
        });
        Self::from_columns(n, &start, &mut rows)
    }

    fn from_columns(n: usize, start: &[u32], rows: &mut [u32]) -> Self {
        let mut matrix = Self { column_start: vec![0], row: Vec::with_capacity(rows.len() + n), value: Vec::new() };
        for column in 0..n {
            let below = &mut rows[start[column] as usize..start[column + 1] as usize];
            below.sort_unstable();
            let mut last = column as u32;
            matrix.row.push(last);
            for &row in below.iter() {
                if row != last {
                    matrix.row.push(row);
                    last = row;
                }
            }
            matrix.column_start.push(matrix.row.len() as u32);
        }
        matrix.row.shrink_to_fit();
        matrix.value = vec![0.0; matrix.row.len()];
        matrix
    }

    /// Number of rows and columns.
    pub fn len(&self) -> usize {
        self.column_start.len().saturating_sub(1)
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of entries kept: those of the lower triangle.
    pub fn entry_count(&self) -> usize {
        self.row.len()
    }

    /// The entries of a column: rows and values, the diagonal first.
    pub fn column(&self, column: usize) -> (&[u32], &[f64]) {
        let range = self.column_start[column] as usize..self.column_start[column + 1] as usize;
        (&self.row[range.clone()], &self.value[range])
    }

    /// A diagonal element.
    pub fn diagonal(&self, i: usize) -> f64 {
        self.value[self.column_start[i] as usize]
    }

    /// Adds to a diagonal element.
    pub fn add_diagonal(&mut self, i: usize, value: f64) {
        self.value[self.column_start[i] as usize] += value;
    }

    /// Adds to the element (i, j), and so to (j, i), which must be in the pattern.
    pub fn add(&mut self, i: u32, j: u32, value: f64) {
        let (column, row) = (i.min(j) as usize, i.max(j));
        let start = self.column_start[column] as usize;
        let rows = &self.row[start..self.column_start[column + 1] as usize];
        let slot = rows.binary_search(&row).expect("the pattern holds every pair that assembly adds to");
        self.value[start + slot] += value;
    }

    /// `rhs − A x` for several columns, 1 to [`crate::system::MAX_COLUMNS`], those of one unknown together.
    pub fn residual(&self, columns: usize, x: &[f64], rhs: &[f64]) -> Vec<f64> {
        let mut r = rhs.to_vec();
        self.subtract_product(columns, x, &mut r);
        r
    }

    /// `r −= A x`, as [`Self::residual`].
    pub(crate) fn subtract_product(&self, columns: usize, x: &[f64], r: &mut [f64]) {
        for_columns(columns, SubtractProduct { matrix: self, x, r }).unwrap_or(());
    }
}

struct SubtractProduct<'a> {
    matrix: &'a LowerCsc,
    x: &'a [f64],
    r: &'a mut [f64],
}

impl ForColumns for SubtractProduct<'_> {
    type Output = ();

    fn run<const K: usize>(self) {
        let (x, r) = (self.x.as_chunks::<K>().0, self.r.as_chunks_mut::<K>().0);
        for j in 0..self.matrix.len() {
            let (rows, values) = self.matrix.column(j);
            let xj = x[j];
            let mut sum: [f64; K] = std::array::from_fn(|c| values[0] * xj[c]);
            for (&i, &value) in rows[1..].iter().zip(&values[1..]) {
                let (xi, ri) = (&x[i as usize], &mut r[i as usize]);
                for c in 0..K {
                    ri[c] -= value * xj[c];
                    sum[c] += value * xi[c];
                }
            }
            (0..K).for_each(|c| r[j][c] -= sum[c]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> LowerCsc {
        let pairs = [[2, 0], [0, 2], [1, 2], [1, 1], [2, 1]];
        let mut matrix = LowerCsc::with_pattern(4, || pairs.into_iter());
        matrix.add(0, 2, 5.0);
        matrix.add(2, 1, -1.0);
        matrix.add(1, 2, -1.0);
        (0..4).for_each(|i| matrix.add_diagonal(i, f64::from(i as u32) + 1.0));
        matrix
    }

    #[test]
    fn pattern_has_each_entry_once() {
        let matrix = example();
        assert_eq!(matrix.column_start, [0, 2, 4, 5, 6]);
        assert_eq!(matrix.row, [0, 2, 1, 2, 2, 3]);
        assert_eq!(matrix.value, [1.0, 5.0, 2.0, -2.0, 3.0, 4.0]);
    }

    #[test]
    fn residual_uses_both_triangles() {
        let x = [1.0, 10.0, 2.0, 20.0, 3.0, 30.0, 4.0, 40.0];
        let r = example().residual(2, &x, &[0.0; 8]);
        assert_eq!(r, [-16.0, -160.0, 2.0, 20.0, -10.0, -100.0, -16.0, -160.0]);
    }
}
