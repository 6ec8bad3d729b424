//! The value of a ray: `1 − 2^(−t/d)`, rounded to 2⁻¹⁶ so that sums are order-free integers.
//!
//! `2^x` is our own polynomial, the same on every backend; `kiln-gpu` has it in WGSL (`kernel.wgsl`): keep in sync.

pub use kiln_core::REACH_EPSILON;
use kiln_core::{Kernel, MAX_CHANNELS, Sampling};

/// The fixed-point value of an open ray.
pub const ONE: u32 = 1 << 16;

/// The most rays of one sample: its sums then fit in 32 bits.
pub const MAX_RAYS_PER_SAMPLE: u32 = 1 << 15;

/// A kernel in the form that tracers evaluate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KernelRates {
    /// `1/d` for each channel, per metre; 0 for channels that are not used.
    pub per_half_distance: [f32; MAX_CHANNELS],
    /// Channels used, 1 to [`MAX_CHANNELS`].
    pub channels: usize,
    /// Plain occlusion: every hit up to `t_max` counts as 0.
    pub is_occlusion: bool,
    /// Rays are cut here, metres: beyond it a hit counts as a miss.
    pub t_max: f32,
}

impl KernelRates {
    /// From a kernel with at least one and at most [`MAX_CHANNELS`] channels.
    #[expect(clippy::cast_possible_truncation, reason = "the ray path is f32")]
    pub fn new(kernel: &Kernel) -> Self {
        let reach = kernel.reach_m(REACH_EPSILON).min(f64::from(f32::MAX)) as f32;
        let mut rates = Self { per_half_distance: [0.0; 4], channels: 1, is_occlusion: true, t_max: reach };
        if let Kernel::Obscurance { half_distances_m } = kernel {
            rates.is_occlusion = false;
            rates.channels = half_distances_m.len().min(MAX_CHANNELS);
            for (rate, d) in rates.per_half_distance.iter_mut().zip(half_distances_m) {
                *rate = (1.0 / d) as f32;
            }
        }
        rates
    }

    /// The kernel of a bake, whose rays may be without end.
    #[expect(clippy::cast_possible_truncation, reason = "the ray path is f32")]
    pub fn of(sampling: &Sampling) -> Self {
        Self { t_max: sampling.reach_m().min(f64::from(f32::MAX)) as f32, ..Self::new(&sampling.kernel) }
    }

    /// Fixed-point value of a hit at distance `t` in a channel.
    #[inline(always)]
    pub fn hit_value(&self, channel: usize, t: f32) -> u32 {
        if self.is_occlusion { 0 } else { fixed_obscurance(t * self.per_half_distance[channel]) }
    }
}

/// `round(65536 (1 − 2^−x))` for x ≥ 0; absolute error before rounding below 3e-7.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the value is in [0, 65536]")]
#[inline(always)]
fn fixed_obscurance(x: f32) -> u32 {
    if x >= 24.0 {
        return ONE;
    }
    ((1.0 - small_exp2_minus(x)) * 65536.0 + 0.5) as u32
}

/// `2^−x` for 0 ≤ x ≤ 126; relative error below 3e-7.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the exponent is in [1, 127]")]
#[inline(always)]
fn small_exp2_minus(x: f32) -> f32 {
    let whole = (x + 0.5).floor();
    // 2^−x = 2^−whole · 2^f, |f| ≤ 1/2: Taylor in f ln 2 to degree 6.
    let y = (whole - x) * std::f32::consts::LN_2;
    let p = 1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * (1.0 / 720.0))))));
    let scale = f32::from_bits((127 - whole as u32) << 23);
    p * scale
}

/// `2^−x` for x ≥ 0; relative error below 3e-7, and 0 where it is below 2⁻⁶⁴.
#[inline(always)]
pub(crate) fn exp2_minus(x: f32) -> f32 {
    if x < 64.0 { small_exp2_minus(x) } else { 0.0 }
}

/// `1 − 2^−x` for x ≥ 0; relative error below 1e-6, also where x is small.
#[inline(always)]
pub(crate) fn one_minus_exp2_minus(x: f32) -> f32 {
    if x >= 0.25 {
        return 1.0 - exp2_minus(x);
    }
    let y = x * std::f32::consts::LN_2;
    y * (1.0 - y * (0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y * (1.0 / 120.0)))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_match_the_definition() {
        for i in 0..=300_000 {
            let x = i as f32 * 1e-4;
            let expected = 65536.0 * (1.0 - (-f64::from(x)).exp2());
            assert!((f64::from(fixed_obscurance(x)) - expected).abs() < 0.53, "{x}");
        }
        assert_eq!(fixed_obscurance(0.0), 0);
        assert_eq!(fixed_obscurance(f32::INFINITY), ONE);
    }

    #[test]
    fn powers_match_the_definition() {
        for i in 0..=640_000 {
            let x = i as f32 * 1e-4;
            let expected = (-f64::from(x)).exp2();
            let error =
                |found: f32, expected: f64| (f64::from(found) - expected).abs() / expected.max(f64::MIN_POSITIVE);
            assert!(x >= 64.0 || error(exp2_minus(x), expected) < 4e-7, "{x}");
            assert!(error(one_minus_exp2_minus(x), -(-f64::from(x) * std::f64::consts::LN_2).exp_m1()) < 1e-6, "{x}");
        }
        assert_eq!([exp2_minus(0.0), exp2_minus(f32::INFINITY), one_minus_exp2_minus(f32::INFINITY)], [1.0, 0.0, 1.0]);
    }

    #[test]
    fn reach_is_where_the_kernel_is_within_epsilon() {
        let rates = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] });
        assert!((rates.t_max - 3000.0).abs() < 1e-3);
        assert_eq!(rates.hit_value(1, 300.0), ONE / 2);
        let rates = KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY });
        assert_eq!((rates.t_max, rates.hit_value(0, 5.0)), (f32::MAX, 0));
    }
}
