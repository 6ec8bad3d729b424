//! An artist's curve over AO: what `--remap` of a bake applies to colours.

use crate::bytes::f32_at;

/// A curve over AO.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Remap<'a> {
    /// AO as it is.
    #[default]
    None,
    /// `ao^gamma`.
    Gamma(f32),
    /// Piecewise linear through points.
    Curve(Curve<'a>),
}

impl Remap<'_> {
    /// What AO becomes, 0 to 1. NaN counts as 0.
    pub fn apply(&self, ao: f32) -> f32 {
        match self {
            Self::None => unit(ao),
            Self::Gamma(gamma) => remap_gamma(ao, *gamma),
            Self::Curve(curve) => curve.apply(ao),
        }
    }
}

/// Points of a curve in a pack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve<'a> {
    bytes: &'a [u8],
    stride: usize,
    count: usize,
}

impl<'a> Curve<'a> {
    pub(crate) const fn new(bytes: &'a [u8], stride: usize, count: usize) -> Self {
        Self { bytes, stride, count }
    }

    /// How many points.
    pub const fn len(&self) -> usize {
        self.count
    }

    /// Whether there is none.
    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// A point: (input, output). Inputs rise.
    pub fn point(&self, index: usize) -> Option<[f32; 2]> {
        let at = (index < self.count).then_some(index * self.stride)?;
        Some([f32_at(self.bytes, at), f32_at(self.bytes, at + 4)])
    }

    fn apply(&self, ao: f32) -> f32 {
        piecewise(unit(ao), self.count, |index| self.point(index).unwrap_or_default())
    }
}

/// `ao^gamma`, 0 to 1.
pub fn remap_gamma(ao: f32, gamma: f32) -> f32 {
    unit(libm::powf(unit(ao), gamma))
}

/// AO on the piecewise linear curve through (input, output) points with rising inputs, 0 to 1; beyond its ends their
/// outputs hold. Without points AO stays as it is.
pub fn remap_curve(ao: f32, points: &[[f32; 2]]) -> f32 {
    piecewise(unit(ao), points.len(), |index| points[index])
}

fn piecewise(value: f32, count: usize, point: impl Fn(usize) -> [f32; 2]) -> f32 {
    let (mut low, mut high) = (0, count);
    while low < high {
        let middle = low.midpoint(high);
        if point(middle)[0] <= value {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    if count == 0 {
        return value;
    }
    if low == 0 || low == count {
        return unit(point(low.min(count - 1))[1]);
    }
    let ([x0, y0], [x1, y1]) = (point(low - 1), point(low));
    unit(y0 + (y1 - y0) * ((value - x0) / (x1 - x0)))
}

/// From 0 to 1; NaN is 0.
#[inline]
pub(crate) fn unit(value: f32) -> f32 {
    if value > 0.0 { value.min(1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_curve_goes_through_its_points_and_holds_beyond_them() {
        let points = [[0.2, 0.1], [0.6, 1.0], [0.8, 0.4]];
        for (ao, expected) in [(0.0, 0.1), (0.2, 0.1), (0.4, 0.55), (0.6, 1.0), (0.7, 0.7), (0.8, 0.4), (1.0, 0.4)] {
            assert!((remap_curve(ao, &points) - expected).abs() < 1e-6, "{ao}");
        }
        assert_eq!((remap_curve(0.3, &[]), remap_curve(0.3, &[[0.5, 2.0]])), (0.3, 1.0));
    }

    #[test]
    fn powers() {
        assert_eq!((remap_gamma(0.5, 2.0), remap_gamma(0.25, 0.5), remap_gamma(0.0, 0.5)), (0.25, 0.5, 0.0));
        assert_eq!(
            (Remap::Gamma(2.0).apply(7.0), Remap::None.apply(f32::NAN), Remap::None.apply(0.3)),
            (1.0, 0.0, 0.3)
        );
    }

    proptest! {
        #[test]
        fn the_identity_as_a_power_and_as_a_curve(ao in 0.0..=1.0f32) {
            prop_assert!((remap_gamma(ao, 1.0) - ao).abs() < 1e-6);
            prop_assert!((remap_curve(ao, &[[0.0, 0.0], [0.3, 0.3], [1.0, 1.0]]) - ao).abs() < 1e-6);
        }

        #[test]
        fn a_rising_curve_keeps_order(a in 0.0..=1.0f32, b in 0.0..=1.0f32, gamma in 0.1..5.0f32) {
            let (low, high) = (a.min(b), a.max(b));
            prop_assert!(remap_gamma(low, gamma) <= remap_gamma(high, gamma));
            let points = [[0.1, 0.0], [0.5, 0.7], [0.9, 1.0]];
            prop_assert!(remap_curve(low, &points) <= remap_curve(high, &points) + 1e-6);
        }
    }
}
