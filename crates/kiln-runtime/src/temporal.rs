//! Blending with what was there a frame ago, so that crossing from one region to another is not seen as a jump.

/// Half-time that Kiln suggests, seconds: after a tenth of a second half of a jump is left.
pub const HALF_TIME_SECS: f32 = 0.1;

/// Exponential decay towards the present: `lerp(previous, now, 1 − 2^(−dt / t_half))`.
///
/// Steps compose: blending over `a` seconds and then over `b` is blending over `a + b`, so that the result does not
/// depend on the frame rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemporalBlend {
    /// Seconds after which half of a difference is left. 0, negative or NaN: nothing is, from the first frame on.
    pub half_time_secs: f32,
}

impl Default for TemporalBlend {
    fn default() -> Self {
        Self { half_time_secs: HALF_TIME_SECS }
    }
}

impl TemporalBlend {
    /// Weight of the present after `dt_secs`, 0 to 1. A time that is negative or NaN counts as none, so that a clock that
    /// is set back changes nothing; an endless one gives 1.
    pub fn weight(self, dt_secs: f32) -> f32 {
        let is_instant = self.half_time_secs.is_nan() || self.half_time_secs <= 0.0;
        if is_instant {
            return 1.0;
        }
        if dt_secs.is_nan() || dt_secs <= 0.0 {
            return 0.0;
        }
        if dt_secs.is_infinite() {
            return 1.0;
        }
        // expm1, since 1 − 2^x loses what a short frame adds.
        -libm::expm1f(-core::f32::consts::LN_2 * (dt_secs / self.half_time_secs))
    }

    /// What is shown now: `previous` drawn towards `now`. What is not finite gives way to what is.
    pub fn blend<const N: usize>(self, previous: [f32; N], now: [f32; N], dt_secs: f32) -> [f32; N] {
        let weight = self.weight(dt_secs);
        core::array::from_fn(|i| lerp(previous[i], now[i], weight))
    }
}

fn lerp(previous: f32, now: f32, weight: f32) -> f32 {
    match (previous.is_finite(), now.is_finite()) {
        (true, true) if weight < 1.0 => previous + (now - previous) * weight,
        (true, false) => previous,
        _ => now,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn each_half_time_halves_the_difference() {
        let blend = TemporalBlend { half_time_secs: 0.25 };
        let mut value = [1.0];
        for halvings in 1..10 {
            value = blend.blend(value, [0.0], 0.25);
            assert!((value[0] - 0.5f32.powi(halvings)).abs() < 1e-6, "{halvings}: {value:?}");
        }
    }

    #[test]
    fn odd_times_are_harmless() {
        let blend = TemporalBlend::default();
        assert_eq!([0.0, -0.0, -1.0, f32::NAN, f32::NEG_INFINITY].map(|dt| blend.weight(dt)), [0.0; 5]);
        assert_eq!([1e9, f32::MAX, f32::INFINITY].map(|dt| blend.weight(dt)), [1.0; 3]);
        assert!(blend.weight(1e-6) > 0.0);
        for half_time_secs in [0.0, -1.0, f32::NAN] {
            assert_eq!(TemporalBlend { half_time_secs }.weight(0.01), 1.0);
        }
        assert_eq!(TemporalBlend { half_time_secs: f32::INFINITY }.weight(1.0), 0.0);
        assert_eq!(blend.blend([f32::NAN, f32::INFINITY], [0.25, 0.5], 0.0), [0.25, 0.5]);
        assert_eq!(blend.blend([0.25, 0.5], [f32::NAN, f32::INFINITY], f32::INFINITY), [0.25, 0.5]);
    }

    proptest! {
        #[test]
        fn steps_compose(a in 0.0..0.5f32, b in 0.0..0.5f32, half_time_secs in 0.02..1.0f32, previous in 0.0..1.0f32, now in 0.0..1.0f32) {
            let blend = TemporalBlend { half_time_secs };
            let twice = blend.blend(blend.blend([previous], [now], a), [now], b);
            let once = blend.blend([previous], [now], a + b);
            prop_assert!((twice[0] - once[0]).abs() < 1e-6, "{twice:?} {once:?}");
        }

        #[test]
        fn results_lie_between(previous in 0.0..1.0f32, now in 0.0..1.0f32, dt in any::<f32>()) {
            let [value] = TemporalBlend::default().blend([previous], [now], dt);
            prop_assert!(value >= previous.min(now) - 1e-7 && value <= previous.max(now) + 1e-7);
        }
    }
}
