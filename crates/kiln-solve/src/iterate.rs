//! The recurrence of conjugate gradients in f32, all right-hand sides in one pass over the matrix.
//!
//! Hestenes and Stiefel 1952. Every right-hand side has steps of its own; what they share is the reading of the
//! matrix, which is what costs. Rows are cut into chunks of a fixed size and sums of chunks are added in order, in
//! f64, so the number of threads changes no bit.

use crate::{scaled::ScaledRows, schwarz::HoleBlocks};
use rayon::prelude::*;

/// Rows that one thread works on at a time, and whose sums are added in order.
pub(crate) const CHUNK: usize = 4096;
/// Rows whose sum is kept in f32 before it is added in f64.
const RUN: usize = 32;

/// The vectors of the recurrence, scaled as the matrix is: answer, residual, direction and its product.
pub(crate) struct Iterate<'a, const K: usize> {
    matrix: &'a ScaledRows,
    holes: Option<&'a HoleBlocks>,
    /// `1 / √A_ii`, which makes residuals `r_i / A_ii`.
    scale: Vec<f32>,
    pub(crate) x: Vec<[f32; K]>,
    r: Vec<[f32; K]>,
    /// The preconditioned residual; empty without holes, where it is the residual.
    z: Vec<[f32; K]>,
    p: Vec<[f32; K]>,
    q: Vec<[f32; K]>,
    sums: Sums<K>,
}

/// `rᵀ z` and `max |r_i| / A_ii` of each right-hand side.
#[derive(Clone, Copy)]
struct Sums<const K: usize> {
    rz: [f64; K],
    worst: [f32; K],
}

impl<const K: usize> Sums<K> {
    const ZERO: Self = Self { rz: [0.0; K], worst: [0.0; K] };

    fn merge(mut self, other: &Self) -> Self {
        for c in 0..K {
            self.rz[c] += other.rz[c];
            self.worst[c] = greater(self.worst[c], other.worst[c]);
        }
        self
    }
}

/// The greater of two, or not a number where one is none.
fn greater(a: f32, b: f32) -> f32 {
    if b > a || b.is_nan() { b } else { a }
}

impl<'a, const K: usize> Iterate<'a, K> {
    /// Room for the recurrence of a matrix.
    #[expect(clippy::cast_possible_truncation, reason = "the recurrence is in f32")]
    pub(crate) fn new(matrix: &'a ScaledRows, holes: Option<&'a HoleBlocks>) -> Self {
        let n = matrix.len();
        let scale = matrix.scale.iter().map(|s| *s as f32).collect();
        let zero = || vec![[0.0; K]; n];
        let z = if holes.is_some() { zero() } else { Vec::new() };
        Self { matrix, holes, scale, x: zero(), r: zero(), z, p: zero(), q: zero(), sums: Sums::ZERO }
    }

    /// Starts from 0 for the given residuals, not scaled.
    #[expect(clippy::cast_possible_truncation, reason = "the recurrence is in f32")]
    pub(crate) fn start(&mut self, rhs: &[[f64; K]]) {
        for ((r, b), scale) in self.r.iter_mut().zip(rhs).zip(&self.matrix.scale) {
            *r = b.map(|b| (b * scale) as f32);
        }
        self.x.fill([0.0; K]);
        self.p.fill([0.0; K]);
        self.sums = self.advance([0.0; K]);
        self.precondition();
        self.turn([0.0; K]);
    }

    /// Greatest `|r_i| / A_ii` by the recurrence.
    pub(crate) fn residual(&self) -> f32 {
        self.sums.worst.iter().fold(0.0, |a, b| greater(a, *b))
    }

    pub(crate) fn step(&mut self) {
        let pq = self.multiply();
        // A right-hand side that is solved exactly, or whose direction has lost all meaning, stands still.
        let rz = self.sums.rz;
        let length = std::array::from_fn(|c| if pq[c] > 0.0 { (rz[c] / pq[c]) as f32 } else { 0.0 });
        self.sums = self.advance(length);
        self.precondition();
        let now = self.sums.rz;
        self.turn(std::array::from_fn(|c| if rz[c] > 0.0 { (now[c] / rz[c]) as f32 } else { 0.0 }));
    }

    /// `q = A p`; returns `pᵀ q`.
    fn multiply(&mut self) -> [f64; K] {
        let (p, matrix) = (&self.p, self.matrix);
        let chunk_sum = |(chunk, q): (usize, &mut [[f32; K]])| {
            let mut sum = [0.0; K];
            for (run, q) in q.chunks_mut(RUN).enumerate() {
                let mut part = [0.0f32; K];
                for (offset, q) in q.iter_mut().enumerate() {
                    let i = chunk * CHUNK + run * RUN + offset;
                    *q = matrix.product(i, p);
                    for c in 0..K {
                        part[c] += p[i][c] * q[c];
                    }
                }
                (0..K).for_each(|c| sum[c] += f64::from(part[c]));
            }
            sum
        };
        if self.q.len() <= CHUNK {
            return chunk_sum((0, &mut self.q));
        }
        let sums: Vec<[f64; K]> = self.q.par_chunks_mut(CHUNK).enumerate().map(chunk_sum).collect();
        sums.iter().fold([0.0; K], |total, sum| std::array::from_fn(|c| total[c] + sum[c]))
    }

    /// `x += length p`, `r −= length q`; returns the sums of the new residual.
    fn advance(&mut self, length: [f32; K]) -> Sums<K> {
        let (p, q, scale) = (&self.p, &self.q, &self.scale);
        let chunk_sum = |chunk: usize, x: &mut [[f32; K]], r: &mut [[f32; K]]| {
            let range = chunk * CHUNK..chunk * CHUNK + x.len();
            let step = Step { length, p: &p[range.clone()], q: &q[range.clone()], scale: &scale[range] };
            step.take(x, r)
        };
        if self.x.len() <= CHUNK {
            return chunk_sum(0, &mut self.x, &mut self.r);
        }
        let chunks = self.x.par_chunks_mut(CHUNK).zip(self.r.par_chunks_mut(CHUNK)).enumerate();
        let sums: Vec<Sums<K>> = chunks.map(|(chunk, (x, r))| chunk_sum(chunk, x, r)).collect();
        sums.iter().fold(Sums::ZERO, Sums::merge)
    }

    /// `z` from `r`, where there are holes.
    fn precondition(&mut self) {
        let Some(holes) = self.holes else { return };
        holes.apply(&self.r, &mut self.z);
        let sums = |(r, z): (&[[f32; K]], &[[f32; K]])| {
            let mut sum = [0.0; K];
            r.iter().zip(z).for_each(|(r, z)| (0..K).for_each(|c| sum[c] += f64::from(r[c]) * f64::from(z[c])));
            sum
        };
        let sums: Vec<[f64; K]> = self.r.par_chunks(CHUNK).zip(self.z.par_chunks(CHUNK)).map(sums).collect();
        self.sums.rz = sums.iter().fold([0.0; K], |total, sum| std::array::from_fn(|c| total[c] + sum[c]));
    }

    /// `p = z + turn p`.
    fn turn(&mut self, turn: [f32; K]) {
        let z = if self.holes.is_some() { &self.z } else { &self.r };
        let chunk = |(p, z): (&mut [[f32; K]], &[[f32; K]])| {
            for (p, z) in p.iter_mut().zip(z) {
                for c in 0..K {
                    p[c] = z[c] + turn[c] * p[c];
                }
            }
        };
        if self.p.len() <= CHUNK {
            chunk((&mut self.p, z));
        } else {
            self.p.par_chunks_mut(CHUNK).zip(z.par_chunks(CHUNK)).for_each(chunk);
        }
    }
}

/// One chunk's step along its direction.
struct Step<'a, const K: usize> {
    length: [f32; K],
    p: &'a [[f32; K]],
    q: &'a [[f32; K]],
    scale: &'a [f32],
}

impl<const K: usize> Step<'_, K> {
    fn take(&self, x: &mut [[f32; K]], r: &mut [[f32; K]]) -> Sums<K> {
        let Self { length, p, q, scale } = self;
        let mut sums = Sums::ZERO;
        for start in (0..x.len()).step_by(RUN) {
            let mut part = [0.0f32; K];
            for i in start..(start + RUN).min(x.len()) {
                for c in 0..K {
                    x[i][c] += length[c] * p[i][c];
                    let new = r[i][c] - length[c] * q[i][c];
                    r[i][c] = new;
                    part[c] += new * new;
                    sums.worst[c] = greater(sums.worst[c], (new * scale[i]).abs());
                }
            }
            (0..K).for_each(|c| sums.rz[c] += f64::from(part[c]));
        }
        sums
    }
}
