//! Holes for conjugate gradients: the unknowns that no sample reaches, and some around them, solved directly.
//!
//! Inside a hole only the regulariser holds the values, whose condition grows with the fourth power of the hole's
//! width in edges. So every residual gets, on top of Jacobi's share, the solution of its part around the holes by a
//! sparse factorisation (one subdomain of an additive Schwarz method, Dryja and Widlund 1987): what is left to
//! iterate over is the sampled surface and the overlap, whatever the size of holes.

use crate::{matrix::LowerCsc, scaled::ScaledRows, sparse, sparse::SparseError, system::ComponentSystem};
use rayon::prelude::*;

/// How far, in elements of the matrix, the factorised part reaches beyond the holes.
const OVERLAP: usize = 2;

/// The factorised surroundings of a component's holes.
pub(crate) struct HoleBlocks {
    unknowns: Vec<u32>,
    factor: sparse::Factor,
}

impl HoleBlocks {
    /// Factorises the surroundings of holes that are deeper than `limit` edges, if there are any.
    pub(crate) fn new(
        system: &ComponentSystem<'_>,
        rows: &ScaledRows,
        limit: u32,
        bytes: u64,
    ) -> Result<Option<Self>, SparseError> {
        if system.hole_depth() <= limit {
            return Ok(None);
        }
        let unknowns = surroundings(system, rows, limit);
        let matrix = submatrix(&system.matrix, &unknowns, &rows.scale);
        let factor = sparse::Factor::new(&matrix, bytes)?;
        Ok(Some(Self { unknowns, factor }))
    }

    /// `z = r`, plus the block's solution on its unknowns; all scaled.
    #[expect(clippy::cast_possible_truncation, reason = "the recurrence is in f32")]
    pub(crate) fn apply<const K: usize>(&self, r: &[[f32; K]], z: &mut [[f32; K]]) {
        z.copy_from_slice(r);
        let n = self.unknowns.len();
        let mut by_column = vec![0.0; n * K];
        for (i, unknown) in self.unknowns.iter().enumerate() {
            (0..K).for_each(|c| by_column[c * n + i] = f64::from(r[*unknown as usize][c]));
        }
        by_column.par_chunks_mut(n).for_each(|column| self.factor.solve_in_place(column, 1));
        for (i, unknown) in self.unknowns.iter().enumerate() {
            (0..K).for_each(|c| z[*unknown as usize][c] += by_column[c * n + i] as f32);
        }
    }
}

/// The unknowns of deep holes and what is near them, rising.
fn surroundings(system: &ComponentSystem<'_>, rows: &ScaledRows, limit: u32) -> Vec<u32> {
    let mut inside = vec![false; system.len()];
    let mut all: Vec<u32> = (0..system.len() as u32).filter(|i| system.hole_ring[*i as usize] > limit).collect();
    all.iter().for_each(|i| inside[*i as usize] = true);
    // A shallow rim of the hole is still hole: elements of the matrix reach two edges far.
    let mut last = all.clone();
    for _ in 0..OVERLAP + limit as usize {
        let mut next = Vec::new();
        for j in last.iter().flat_map(|i| rows.columns(*i as usize)) {
            if !inside[j as usize] {
                inside[j as usize] = true;
                next.push(j);
            }
        }
        all.extend(&next);
        last = next;
    }
    all.sort_unstable();
    all
}

/// The scaled rows and columns of some unknowns, which rise.
fn submatrix(matrix: &LowerCsc, unknowns: &[u32], scale: &[f64]) -> LowerCsc {
    let mut local = vec![u32::MAX; matrix.len()];
    unknowns.iter().zip(0..).for_each(|(unknown, place)| local[*unknown as usize] = place);
    let mut part = LowerCsc { column_start: vec![0], row: Vec::new(), value: Vec::new() };
    for &unknown in unknowns {
        let (rows, values) = matrix.column(unknown as usize);
        for (&row, &value) in rows.iter().zip(values).filter(|(row, _)| local[**row as usize] != u32::MAX) {
            part.row.push(local[row as usize]);
            part.value.push(value * scale[row as usize] * scale[unknown as usize]);
        }
        part.column_start.push(part.row.len() as u32);
    }
    part
}
