//! How the rays of a group of samples are dealt to cones of 32; the host side of `sampling.wgsl`.
//!
//! The N = 2ᵏ directions of a sample are a (0, k, 2)-net: of any split of the unit square into 2ᶜ columns × 2ʳ rows
//! with c + r ≤ k, every cell has exactly N / 2ᶜ⁺ʳ of its points, whatever the scramble. The cosine map is continuous
//! and preserves area, so a cell is a compact cone of directions. A cone of 32 lanes takes the same cell from
//! 2ᵍ neighbouring samples: 4 rays each from 8 samples where there are enough of both. Narrow cones are worth more
//! than a common origin, since neighbours in the order of faces are near each other and see the same geometry.
//!
//! # Which indices fall in a cell
//!
//! Nothing is sorted: the generator is inverted. Write an index's low k bits as
//! `column bits | solved bits | ray bits`, the lowest first.
//!
//! - The first coordinate is the reversed index under a permutation in which output bits depend on input bits at or
//!   below them. Its leading c bits, the column, so fix the index's lowest c bits: found one by one.
//! - The second coordinate is, before its scramble and in reversed bits, the polynomial `p(1 + X)` over GF(2), where the
//!   index's bits are the coefficients of `p`. The row, unscrambled like the column, gives it modulo Xʳ. Any choice of the
//!   ray bits leaves `(1 + X)ᶜ m(1 + X) ≡ known (mod Xʳ)`; with `(1 + X)⁸ ≡ 1` for r ≤ 8, a product by `(1 + X)⁸⁻ᶜ` and
//!   another shift of the polynomial give `m`, the solved bits.
//!
//! So each (cell, ray) is one index, and all cells together are all N of them, in about 10 (c + r) + 30 operations.

use bytemuck::{Pod, Zeroable};

/// Lanes that trace one cone.
pub(crate) const CONE_LANES: u32 = 32;

/// Rays that a sample has in a cone where enough samples share it.
const RAYS_PER_CELL: u32 = 4;

/// Keep in sync with `Cones` in `sampling.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(crate) struct Cones {
    column_bits: u32,
    row_bits: u32,
    ray_bits: u32,
    padding: u32,
}

const _: () = assert!(size_of::<Cones>() == 16);

impl Cones {
    /// For a number of rays that is a power of two, and any number of samples.
    pub(crate) fn new(rays_per_sample: u32, sample_count: usize) -> Self {
        let neighbours = u32::try_from(sample_count.max(1)).unwrap_or(CONE_LANES).clamp(1, CONE_LANES);
        // At least two cells where there are two rays, since a workgroup traces two cones at once.
        let most = (rays_per_sample / 2).max(1);
        let rays_per_cell = (CONE_LANES / neighbours.next_power_of_two()).max(RAYS_PER_CELL).min(most);
        let cell_bits = (rays_per_sample / rays_per_cell).ilog2();
        Self {
            column_bits: cell_bits.div_ceil(2),
            row_bits: cell_bits / 2,
            ray_bits: rays_per_cell.ilog2(),
            padding: 0,
        }
    }

    /// Cells of the unit square.
    pub(crate) fn cell_count(&self) -> u32 {
        1 << (self.column_bits + self.row_bits)
    }

    /// Samples that share a cone.
    pub(crate) fn samples_per_cone(&self) -> u32 {
        CONE_LANES >> self.ray_bits
    }

    /// Rays of one sample in one cell.
    pub(crate) fn rays_per_cell(&self) -> u32 {
        1 << self.ray_bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_trace::MAX_RAYS_PER_SAMPLE;

    #[test]
    fn every_ray_has_a_lane() {
        for k in 0..=MAX_RAYS_PER_SAMPLE.ilog2() {
            for samples in [0, 1, 2, 3, 7, 8, 9, 1000, usize::MAX] {
                let cones = Cones::new(1 << k, samples);
                assert_eq!(cones.cell_count() * cones.rays_per_cell(), 1 << k);
                assert_eq!(cones.samples_per_cone() * cones.rays_per_cell(), CONE_LANES);
                // The inversion's limits.
                assert!(cones.column_bits <= 8 && cones.row_bits <= 8);
                assert!(k == 0 || cones.cell_count() >= 2);
            }
        }
        let cones = Cones::new(32, 1000);
        assert_eq!((cones.samples_per_cone(), cones.rays_per_cell(), cones.cell_count()), (8, 4, 8));
        let cones = Cones::new(256, 1);
        assert_eq!((cones.samples_per_cone(), cones.rays_per_cell(), cones.cell_count()), (1, 32, 8));
    }
}
