//! The error of an instance's values, estimated from half the difference of its two halves.
//!
//! The halves have independent positions and directions, and their difference went through the same solve as
//! the values; the mean of two independent equal halves has the error of half their difference. Only what can be seen
//! counts: every face by the part of its area that is not buried in other geometry.

use crate::surface::Surface;
use kiln_core::{ErrorEstimate, ErrorHistogram};

/// Where and how far the two halves differ.
#[derive(Clone, Copy, Debug)]
pub struct Differences<'a> {
    /// The surface.
    pub surface: &'a Surface,
    /// The part of each face's area that can be seen.
    pub visible: &'a [f64],
    /// The area that speaks for each unknown.
    pub weight: &'a [f64],
    /// The values, `unknowns × channels`.
    pub values: &'a [f64],
    /// Half the difference of the halves' values, `unknowns × channels`.
    pub half_difference: &'a [f64],
    /// Number of channels.
    pub channels: usize,
    /// Square metres of one unit of the frame squared.
    pub unit_m2: f64,
}

impl Differences<'_> {
    /// The estimate for each channel.
    pub fn estimates(&self) -> Vec<ErrorEstimate> {
        (0..self.channels).map(|channel| self.estimate(channel)).collect()
    }

    /// Area that can be seen, square metres.
    pub fn visible_area_m2(&self) -> f64 {
        self.visible_faces().map(|(_, area)| area).sum()
    }

    /// The corners of each face and the part of its area that can be seen, square metres.
    fn visible_faces(&self) -> impl Iterator<Item = ([u32; 3], f64)> {
        let areas = self.surface.areas.iter().zip(self.visible).map(|(area, visible)| area * visible * self.unit_m2);
        self.surface.corners.iter().copied().zip(areas).filter(|(_, area)| *area > 0.0)
    }

    /// Half the difference of what the two halves would have written, which is clamped to [0, 1].
    fn at(&self, unknown: u32, channel: usize) -> f64 {
        let i = unknown as usize * self.channels + channel;
        let (value, half) = (self.values[i], self.half_difference[i]);
        0.5 * ((value + half).clamp(0.0, 1.0) - (value - half).clamp(0.0, 1.0))
    }

    fn estimate(&self, channel: usize) -> ErrorEstimate {
        // The mean over a face of the square of a linear function: (Σ d_i² + (Σ d_i)²) / 12.
        let squares = self.visible_faces().map(|(corners, area)| {
            let [a, b, c] = corners.map(|unknown| self.at(unknown, channel));
            area / 12.0 * (a * a + b * b + c * c + (a + b + c).powi(2))
        });
        let total = squares.sum::<f64>();
        let area = self.visible_area_m2();
        let mut histogram = ErrorHistogram::default();
        let mut max = 0.0f64;
        for (unknown, weight) in (0u32..).zip(self.weight).filter(|(_, weight)| **weight > 0.0) {
            let error = self.at(unknown, channel).abs();
            histogram.add(error, weight * self.unit_m2);
            max = max.max(error);
        }
        let rmse = if area > 0.0 { (total / area).sqrt() } else { 0.0 };
        ErrorEstimate { rmse, p99: histogram.quantile(0.99).min(max), max, histogram }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn surface() -> Surface {
        let points = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        Surface { points, corners: vec![[0, 1, 2], [1, 3, 2]], areas: vec![0.5; 2], mesh_face: vec![0, 1] }
    }

    fn estimate(visible: &[f64], weight: &[f64], half_difference: &[f64]) -> ErrorEstimate {
        let (surface, values) = (surface(), [0.5; 4]);
        let (channels, unit_m2) = (1, 1.0);
        Differences { surface: &surface, visible, weight, values: &values, half_difference, channels, unit_m2 }
            .estimates()[0]
            .clone()
    }

    #[test]
    fn a_constant_difference_is_all_three() {
        let e = estimate(&[1.0; 2], &[0.25; 4], &[-0.3; 4]);
        assert!((e.rmse - 0.3).abs() < 1e-15 && (e.p99 - 0.3).abs() < 1e-15 && e.max == e.p99, "{e:?}");
    }

    #[test]
    fn a_linear_difference_by_its_integral() {
        // ∫ x² over the unit square is 1/3; the values are .5, so ±.5 is what they can differ.
        let e = estimate(&[1.0; 2], &[0.25; 4], &[0.0, 0.5, 0.0, 0.5]);
        assert!((e.rmse - 0.5 * (1.0f64 / 3.0).sqrt()).abs() < 1e-15, "{e:?}");
    }

    #[test]
    fn only_what_is_seen_counts() {
        let e = estimate(&[1.0, 0.0], &[1.0, 1.0, 1.0, 0.0], &[0.1, 0.1, 0.1, 0.4]);
        assert!((e.rmse - 0.1).abs() < 1e-15 && (e.max - 0.1).abs() < 1e-15, "{e:?}");
        assert_eq!(estimate(&[0.0; 2], &[0.0; 4], &[0.4; 4]), ErrorEstimate::default());
        let half = estimate(&[1.0, 0.5], &[1.0; 4], &[0.2, 0.0, 0.0, 0.0]);
        // (1/2 · (2 · 0.2²) / 12) over an area of 3/4.
        assert!((half.rmse - (0.5 * 0.08 / 12.0 / 0.75f64).sqrt()).abs() < 1e-15, "{half:?}");
    }

    #[test]
    fn what_is_clamped_does_not_differ() {
        let e = estimate(&[1.0; 2], &[0.25; 4], &[3.0; 4]);
        assert!((e.rmse - 0.5).abs() < 1e-15 && e.max == 0.5, "{e:?}");
    }

    #[test]
    fn the_quantile_goes_by_weight() {
        let e = estimate(&[1.0; 2], &[90.0, 9.5, 0.4, 0.1], &[0.1, 0.2, 0.3, 0.4]);
        // To within a bin: an eighth of an octave.
        assert!(e.p99 >= 0.2 && e.p99 < 0.2 * 1.1 && e.max == 0.4, "{e:?}");
    }
}
