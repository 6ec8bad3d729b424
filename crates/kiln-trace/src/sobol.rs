//! Owen-scrambled Sobol points in two dimensions, in integers.
//!
//! Sources: Sobol' 1967 (the sequence), Owen 1995 (nested uniform scrambling), Burley 2020, "Practical hash-based
//! Owen scrambling" (the scramble as a hash of reversed bits), with the multipliers that Vegdahl 2021 published for
//! it. `kiln-gpu` has the same functions in WGSL (`sampling.wgsl`): keep them in sync.

/// The seeds of one scrambled sequence, one for each dimension.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SobolScramble(pub [u32; 2]);

/// Nested uniform scramble of a 32-bit fixed-point number in [0, 1).
#[inline(always)]
pub fn owen_scramble(x: u32, seed: u32) -> u32 {
    laine_karras(x.reverse_bits(), seed).reverse_bits()
}

/// A permutation in which every output bit depends only on input bits at or below it.
#[inline(always)]
fn laine_karras(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// The reversed bits of the second dimension of the Sobol sequence (those of the first are the index itself). Its
/// generator matrix is Pascal's triangle modulo 2, which takes the polynomial p(X) over GF(2), its coefficients the bits
/// of the index, to p(X + 1): five halvings.
#[inline(always)]
fn sobol_second_reversed(index: u32) -> u32 {
    let mut x = index;
    x ^= x >> 16;
    x ^= (x & 0xff00_ff00) >> 8;
    x ^= (x & 0xf0f0_f0f0) >> 4;
    x ^= (x & 0xcccc_cccc) >> 2;
    x ^ ((x & 0xaaaa_aaaa) >> 1)
}

/// The coordinates of a point of the sequence before it is scrambled, 32-bit fixed-point numbers in [0, 1): linear in
/// the bits of the index over GF(2).
#[inline(always)]
pub fn sobol_digits(index: u32) -> [u32; 2] {
    [index, sobol_second_reversed(index)].map(u32::reverse_bits)
}

/// Point `index` of the scrambled sequence, each coordinate a multiple of 2⁻²⁴ in [0, 1). Any run of 2ᵏ points that
/// starts at a multiple of 2ᵏ is a (0, k, 2)-net.
#[expect(clippy::cast_precision_loss, reason = "24 bits fit")]
#[inline(always)]
pub fn sobol_point(index: u32, scramble: SobolScramble) -> [f32; 2] {
    let [x, y] = sobol_digits(index);
    [owen_scramble(x, scramble.0[0]), owen_scramble(y, scramble.0[1])]
        .map(|bits| (bits >> 8) as f32 * (1.0 / 16_777_216.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The defining property of a (0, k, 2)-net: every elementary interval of area 2⁻ᵏ has one point.
        #[test]
        fn aligned_runs_are_nets(seed: [u32; 2], block in 0u32..1000, k in 1u32..9) {
            let n = 1u32 << k;
            for split in 0..=k {
                let mut seen = vec![false; n as usize];
                for i in 0..n {
                    let [x, y] = sobol_point(block * n + i, SobolScramble(seed));
                    prop_assert!((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y));
                    let column = (x * (1u32 << split) as f32) as u32;
                    let row = (y * (1u32 << (k - split)) as f32) as u32;
                    let cell = (column << (k - split) | row) as usize;
                    prop_assert!(!seen[cell], "cell {cell} twice at split {split}");
                    seen[cell] = true;
                }
            }
        }

        #[test]
        fn the_scramble_is_nested(x: u32, seed: u32, bit in 0u32..32) {
            // Numbers that share their high bits still share them after the scramble.
            let other = x ^ (1 << bit);
            let differing = owen_scramble(x, seed) ^ owen_scramble(other, seed);
            prop_assert_eq!(differing.leading_zeros(), 31 - bit);
        }
    }

    #[test]
    fn the_second_dimension_is_that_of_the_direction_numbers() {
        for index in (0..5000).chain([1 << 31, u32::MAX, 0x1234_5678]) {
            // Sobol' 1967: v₁ = 1/2, each further direction number is the last one ⊕ itself halved.
            let (mut expected, mut direction) = (0u32, 1u32 << 31);
            for bit in 0..32 {
                expected ^= if index >> bit & 1 == 1 { direction } else { 0 };
                direction ^= direction >> 1;
            }
            assert_eq!(sobol_second_reversed(index).reverse_bits(), expected);
        }
    }

    #[test]
    fn scrambles_are_uniform() {
        // Mean of the first point over many scrambles: 1/2 with a standard error of .289 / 64.
        let mean = (0..4096u32)
            .map(|i| f64::from(sobol_point(0, SobolScramble([i.wrapping_mul(0x9e37_79b9), i ^ 0x5bd1_e995]))[0]))
            .sum::<f64>()
            / 4096.0;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
    }
}
