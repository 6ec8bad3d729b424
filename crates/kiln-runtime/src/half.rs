//! Half floats (IEEE 754 binary16), by their bits.

/// The largest finite one.
pub const LARGEST: f32 = 65504.0;

/// 2¹¹², by which a half's bits, moved to where a float's are, fall short of its value.
const REBIAS: f32 = f32::from_bits((112 + 127) << 23);

/// The nearest half; of two that are equally near the even one. From 65,520 on it is infinite.
pub fn from_f32(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16) as u16 & 0x8000;
    let magnitude = bits & 0x7fff_ffff;
    if magnitude > 0x7f80_0000 {
        return sign | 0x7e00;
    }
    if magnitude >= 65520f32.to_bits() {
        return sign | 0x7c00;
    }
    // Below 2⁻¹⁴ halves are 2⁻²⁴ apart, and so are floats from ½ to 1: the sum does the rounding.
    if magnitude < 0x3880_0000 {
        return sign | ((f32::from_bits(magnitude) + 0.5).to_bits() - 0.5f32.to_bits()) as u16;
    }
    let is_odd = magnitude >> 13 & 1;
    sign | ((magnitude + 0xfff + is_odd - (112 << 23)) >> 13) as u16
}

/// The value of a half, exactly.
pub fn to_f32(half: u16) -> f32 {
    if half & 0x7c00 == 0x7c00 {
        let bits = 0x7f80_0000 | u32::from(half & 0x3ff) << 13 | u32::from(half & 0x8000) << 16;
        return f32::from_bits(bits);
    }
    finite_to_f32([u32::from(half), 0, 0, 0])[0]
}

/// Values of halves that are known to be finite; four at once, as processors like them. Where denormals count as zero, as
/// many engines set their threads to, halves below 2⁻¹⁴ are zero here.
#[inline]
pub(crate) fn finite_to_f32(halves: [u32; 4]) -> [f32; 4] {
    let magnitudes = halves.map(|half| f32::from_bits((half & 0x7fff) << 13) * REBIAS);
    core::array::from_fn(|i| f32::from_bits(magnitudes[i].to_bits() | (halves[i] & 0x8000) << 16))
}

/// Whether it is neither infinite nor NaN.
pub const fn is_finite(half: u16) -> bool {
    half & 0x7c00 != 0x7c00
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition, in numbers that hold all of it.
    fn by_definition(half: u16) -> f64 {
        let (exponent, fraction) = (i32::from(half >> 10 & 31), f64::from(half & 0x3ff) / 1024.0);
        let magnitude = match exponent {
            0 => fraction * 2f64.powi(-14),
            _ => (1.0 + fraction) * 2f64.powi(exponent - 15),
        };
        if half & 0x8000 == 0 { magnitude } else { -magnitude }
    }

    #[test]
    fn all_halves_have_their_values_and_come_back() {
        for half in 0..=u16::MAX {
            let value = to_f32(half);
            if half & 0x7c00 != 0x7c00 {
                assert_eq!(f64::from(value), by_definition(half), "{half:#06x}");
                assert_eq!(value.is_sign_negative(), half & 0x8000 != 0);
                assert_eq!(from_f32(value), half, "{half:#06x}");
            } else if half & 0x3ff == 0 {
                assert!(value.is_infinite() && from_f32(value) == half);
            } else {
                assert!(value.is_nan() && to_f32(from_f32(value)).is_nan());
            }
        }
    }

    #[test]
    fn between_two_halves_the_nearer_wins_and_in_the_middle_the_even() {
        for low in 0..0x7bff {
            let (a, b) = (to_f32(low), to_f32(low + 1));
            let middle = (a + b) / 2.0;
            let even = low + (low & 1);
            for (value, expected) in [(middle.next_down(), low), (middle, even), (middle.next_up(), low + 1)] {
                assert_eq!(from_f32(value), expected, "{value:e}");
                assert_eq!(from_f32(-value), expected | 0x8000, "{value:e}");
            }
        }
    }

    #[test]
    fn what_is_too_large_is_infinite() {
        assert_eq!(from_f32(65520f32.next_down()), 0x7bff);
        assert_eq!((from_f32(65520.0), from_f32(-1e30), from_f32(f32::INFINITY)), (0x7c00, 0xfc00, 0x7c00));
        assert_eq!((from_f32(1e-30), from_f32(-0.0)), (0, 0x8000));
    }
}
