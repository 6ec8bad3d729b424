//! AO in five bits, as a G-buffer has it, with dithering so that steps of 1/31 are not seen (Sloan et al. 2013, section 3).
//!
//! The dither of a pixel is the additive recurrence of Roberts 2018 ("The unreasonable effectiveness of quasirandom
//! sequences", the R2 sequence) in 32-bit integers that wrap: near pixels get values far apart, which looks much like blue
//! noise, needs no texture, and is the same bit for bit on every processor. Each step is odd, so along a row, a column or
//! the frames of one pixel all 2³² values come up once: in the mean a pixel is what it was, which is all that a dither
//! must do. `shaders/kiln_runtime.wgsl` does the same; keep them in sync.

use crate::remap::unit;

/// Steps of AO in five bits.
pub const DITHER_LEVELS: u32 = 31;

/// 2³² / g, 2³² / g² with g the plastic number 1.3247, and 2³² / φ for frames.
const STEP_X: u32 = 0xc13f_a9a9;
const STEP_Y: u32 = 0x91e1_0da5;
const STEP_FRAME: u32 = 0x9e37_79b9;

/// Binary digits of a step that are counted.
const FRACTION_BITS: u32 = 20;

/// The dither of a pixel in a frame, a fraction of 2³². Give 0 for a pattern that stands still.
#[inline]
pub const fn dither(x: u32, y: u32, frame: u32) -> u32 {
    let along = x.wrapping_mul(STEP_X).wrapping_add(y.wrapping_mul(STEP_Y));
    along.wrapping_add(frame.wrapping_mul(STEP_FRAME))
}

/// AO in 31 steps, 0 to 31, rounded up or down by a dither of 0 to 2³² − 1: its mean over all dithers is AO, to 2⁻²⁰ of a
/// step. What is above 1 is 1; what is below 0, or NaN, is 0.
#[inline]
pub fn quantise(ao: f32, dither: u32) -> u32 {
    (fixed(ao) + (dither >> (32 - FRACTION_BITS))) >> FRACTION_BITS
}

/// AO in 31 steps, 0 to 31, the nearest.
#[inline]
pub fn quantise_nearest(ao: f32) -> u32 {
    quantise(ao, 1 << 31)
}

/// AO of 0 to 31 steps; more count as 31.
#[inline]
pub fn dequantise(steps: u32) -> f32 {
    steps.min(DITHER_LEVELS) as f32 / DITHER_LEVELS as f32
}

/// Steps times 2²⁰. Halves are added before the fraction is cut off, so that a whole number of steps stays one.
#[inline]
fn fixed(ao: f32) -> u32 {
    (unit(ao) * (DITHER_LEVELS << FRACTION_BITS) as f32 + 0.5) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_a_whole_number_of_steps_stays_it_whatever_the_dither() {
        for steps in 0..=31 {
            let ao = dequantise(steps);
            for dither in [0, 1, 1 << 31, u32::MAX - 1, u32::MAX] {
                assert_eq!(quantise(ao, dither), steps);
            }
        }
    }

    #[test]
    fn what_is_out_of_range_is_at_its_end() {
        for dither in [0, u32::MAX] {
            assert_eq!([-1.0, -0.0, f32::NAN, f32::NEG_INFINITY].map(|ao| quantise(ao, dither)), [0; 4]);
            assert_eq!([1.0, 1.5, f32::INFINITY].map(|ao| quantise(ao, dither)), [31; 3]);
        }
        assert_eq!((dequantise(32), dequantise(u32::MAX)), (1.0, 1.0));
    }

    #[test]
    fn the_nearest_step_is_at_most_half_a_step_away() {
        for i in 0..=100_000 {
            let ao = i as f32 / 100_000.0;
            assert!((dequantise(quantise_nearest(ao)) - ao).abs() <= 0.5 / 31.0 + 1e-6, "{ao}");
        }
    }

    /// All dithers that differ in what is counted.
    #[test]
    fn the_mean_over_the_dither_is_the_value() {
        for ao in [0.0, 0.013, 0.25, 1.0 / 3.0, 0.5, 0.777_7, 0.999, 1.0] {
            let sum: u64 = (0..1u32 << 20).map(|d| u64::from(quantise(ao, d << 12))).sum();
            let mean = sum as f64 / f64::from(1 << 20) / 31.0;
            assert!((mean - f64::from(ao)).abs() < 1e-7, "{ao}: {mean}");
        }
    }

    /// A row, a column, a square and a pixel over time: each is right in the mean long before all dithers came up.
    #[test]
    fn pixels_near_one_another_have_the_right_mean() {
        let mean = |ao: f32, pixels: &mut dyn Iterator<Item = (u32, u32, u32)>| {
            let (mut sum, mut count) = (0u32, 0u32);
            for (x, y, frame) in pixels {
                sum += quantise(ao, dither(x, y, frame));
                count += 1;
            }
            f64::from(sum) / f64::from(count)
        };
        for i in 0..200 {
            let ao = i as f32 / 199.0;
            let steps = f64::from(ao) * 31.0;
            let near = |mean: f64, limit: f64| assert!((mean - steps).abs() < limit, "{ao}: {mean} for {steps}");
            near(mean(ao, &mut (0..64).map(|x| (x + 1000, 77, 0))), 0.05);
            near(mean(ao, &mut (0..64).map(|y| (5, y, 3))), 0.05);
            near(mean(ao, &mut (0..64).map(|frame| (640, 480, frame))), 0.05);
            near(mean(ao, &mut (0..256).map(|i| (i % 16, i / 16, 0))), 0.03);
            near(mean(ao, &mut (0..16).map(|i| (i % 4 + 100, i / 4 + 9, 0))), 0.13);
        }
    }

    proptest! {
        #[test]
        fn it_is_one_of_the_two_steps_beside(ao in 0.0..=1.0f32, dither in any::<u32>()) {
            let steps = f64::from(quantise(ao, dither));
            prop_assert!((steps - f64::from(ao) * 31.0).abs() < 1.0 + 1e-5);
        }
    }
}
