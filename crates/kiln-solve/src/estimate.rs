//! The error of an instance's values, estimated from half the difference of its two halves.
//!
//! The halves have independent positions and directions, and their difference went through the same solve as
//! the values; the mean of two independent equal halves has the error of half their difference. A face of which
//! only one half has valid samples adds nothing to the difference, so its error is understated.

use crate::surface::Surface;
use kiln_core::ErrorEstimate;

/// Where and how far the two halves differ.
#[derive(Clone, Copy, Debug)]
pub struct Differences<'a> {
    /// The surface.
    pub surface: &'a Surface,
    /// Whether each face has valid samples; only these count.
    pub sampled: &'a [bool],
    /// The area that speaks for each unknown.
    pub weight: &'a [f64],
    /// Half the difference of the halves' values, `unknowns × channels`.
    pub half_difference: &'a [f64],
    /// Number of channels.
    pub channels: usize,
}

impl Differences<'_> {
    /// The estimate for each channel.
    pub fn estimates(&self) -> Vec<ErrorEstimate> {
        (0..self.channels).map(|channel| self.estimate(channel)).collect()
    }

    /// Area with valid samples, square units of the frame.
    pub fn sampled_area(&self) -> f64 {
        self.sampled_faces().map(|(_, area)| area).sum()
    }

    fn sampled_faces(&self) -> impl Iterator<Item = ([u32; 3], f64)> {
        let faces = self.surface.corners.iter().copied().zip(self.surface.areas.iter().copied());
        faces.zip(self.sampled).filter_map(|(face, sampled)| sampled.then_some(face))
    }

    fn estimate(&self, channel: usize) -> ErrorEstimate {
        let at = |unknown: u32| self.half_difference[unknown as usize * self.channels + channel];
        // The mean over a face of the square of a linear function: (Σ d_i² + (Σ d_i)²) / 12.
        let squares = self.sampled_faces().map(|(corners, area)| {
            let [a, b, c] = corners.map(at);
            area / 12.0 * (a * a + b * b + c * c + (a + b + c).powi(2))
        });
        let total = squares.sum::<f64>();
        let area = self.sampled_area();
        let mut errors: Vec<(f64, f64)> = (0u32..)
            .zip(self.weight)
            .filter(|(_, weight)| **weight > 0.0)
            .map(|(unknown, weight)| (at(unknown).abs(), *weight))
            .collect();
        errors.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        ErrorEstimate {
            rmse: if area > 0.0 { (total / area).sqrt() } else { 0.0 },
            p99: quantile(&errors, 0.99),
            max: errors.last().map_or(0.0, |last| last.0),
        }
    }
}

/// The least value with at least the given fraction of the weight at or below it, of pairs sorted by value.
fn quantile(sorted: &[(f64, f64)], fraction: f64) -> f64 {
    let wanted = fraction * sorted.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut below = 0.0;
    let reached = sorted.iter().find(|(_, weight)| {
        below += weight;
        below >= wanted
    });
    reached.or(sorted.last()).map_or(0.0, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn surface() -> Surface {
        let points = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        Surface { points, corners: vec![[0, 1, 2], [1, 3, 2]], areas: vec![0.5; 2], mesh_face: vec![0, 1] }
    }

    fn estimate(sampled: &[bool], weight: &[f64], half_difference: &[f64]) -> ErrorEstimate {
        let surface = surface();
        Differences { surface: &surface, sampled, weight, half_difference, channels: 1 }.estimates()[0]
    }

    #[test]
    fn a_constant_difference_is_all_three() {
        let e = estimate(&[true; 2], &[0.25; 4], &[-0.3; 4]);
        assert!((e.rmse - 0.3).abs() < 1e-15 && e.p99 == 0.3 && e.max == 0.3, "{e:?}");
    }

    #[test]
    fn a_linear_difference_by_its_integral() {
        // ∫ x² over the unit square is 1/3.
        let e = estimate(&[true; 2], &[0.25; 4], &[0.0, 1.0, 0.0, 1.0]);
        assert!((e.rmse - (1.0f64 / 3.0).sqrt()).abs() < 1e-15, "{e:?}");
    }

    #[test]
    fn only_sampled_faces_and_weighted_unknowns_count() {
        let e = estimate(&[true, false], &[1.0, 1.0, 1.0, 0.0], &[0.1, 0.1, 0.1, 9.0]);
        assert!((e.rmse - 0.1).abs() < 1e-15 && e.max == 0.1, "{e:?}");
        assert_eq!(estimate(&[false; 2], &[0.0; 4], &[1.0; 4]), ErrorEstimate::default());
    }

    #[test]
    fn the_quantile_goes_by_weight() {
        let e = estimate(&[true; 2], &[90.0, 9.5, 0.4, 0.1], &[0.1, 0.2, 0.3, 0.4]);
        assert_eq!((e.p99, e.max), (0.2, 0.4));
    }
}
