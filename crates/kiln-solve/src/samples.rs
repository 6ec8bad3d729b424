//! One face's samples as weighted sums: what the two halves say together, and how far they are apart.

use kiln_core::{HalfMoments, MAX_CHANNELS};

/// Weighted sums over the valid samples of one face.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WeightedSums {
    /// `Σ w φ_i f` for each channel.
    pub phi_f: [[f64; 3]; MAX_CHANNELS],
    /// `Σ w φ_i φ_j`: 00, 11, 22, 01, 02, 12.
    pub phi_phi: [f64; 6],
}

/// A face with valid samples. Each half speaks for half of the face's area, each of its samples for an equal part of
/// that; what the invalid ones would speak for is hidden, and nobody speaks for it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaceSamples {
    /// The mean of the halves.
    pub mean: WeightedSums,
    /// Half the difference of the halves.
    pub half_difference: WeightedSums,
}

impl FaceSamples {
    /// Weighs the halves of a face of the given area; `None` where no sample is valid.
    #[inline]
    pub fn new(halves: &[HalfMoments; 2], channels: usize, area: f64) -> Option<Self> {
        let taking = halves.iter().filter(|half| half.taken.max(half.valid) > 0).count();
        if halves.iter().all(|half| half.valid == 0) {
            return None;
        }
        let mut samples = Self::default();
        for (half, sign) in halves.iter().zip([1.0, -1.0]).filter(|(half, _)| half.valid > 0) {
            let weight = area / (taking as f64 * f64::from(half.taken.max(half.valid)));
            samples.mean.add(half, channels, weight);
            if taking == 2 {
                samples.half_difference.add(half, channels, sign * weight);
            }
        }
        Some(samples)
    }
}

impl WeightedSums {
    fn add(&mut self, half: &HalfMoments, channels: usize, weight: f64) {
        let phi_f =
            self.phi_f.iter_mut().zip(&half.phi_f).take(channels).flat_map(|(sums, add)| sums.iter_mut().zip(add));
        phi_f.chain(self.phi_phi.iter_mut().zip(&half.phi_phi)).for_each(|(sum, add)| *sum += weight * add);
    }

    /// `Σ w φ_i`: coordinates add up to 1, so it is a row's sum.
    pub fn phi(&self) -> [f64; 3] {
        let [xx, yy, zz, xy, xz, yz] = self.phi_phi;
        [xx + xy + xz, xy + yy + yz, xz + yz + zz]
    }

    /// `Σ w φ_i (f − g_x)` of a channel, for the values x at the corners.
    pub fn misfit(&self, channel: usize, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [xx, yy, zz, xy, xz, yz] = self.phi_phi;
        let [fx, fy, fz] = self.phi_f[channel];
        [fx - (xx * x + xy * y + xz * z), fy - (xy * x + yy * y + yz * z), fz - (xz * x + yz * y + zz * z)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [[f64; 3]; 2] = [[0.2, 0.3, 0.5], [0.6, 0.3, 0.1]];

    fn half(values: &[f64]) -> HalfMoments {
        let mut half = HalfMoments::default();
        values.iter().zip(POINTS).for_each(|(f, phi)| half.add(phi, &[*f]));
        half
    }

    #[test]
    fn invalid_samples_hide_their_part_of_the_area() {
        let mut one = half(&[1.0]);
        one.add_invalid();
        let mut none = HalfMoments::default();
        none.add_invalid();
        for (halves, visible) in [([one, none], 0.75), ([half(&[1.0, 1.0]), one], 2.25), ([half(&[1.0]), none], 1.5)] {
            let samples = FaceSamples::new(&halves, 1, 3.0).unwrap();
            assert!((samples.mean.phi().iter().sum::<f64>() - visible).abs() < 1e-15);
            assert!((samples.mean.phi_f[0].iter().sum::<f64>() - visible).abs() < 1e-15);
        }
        assert_eq!(FaceSamples::new(&[none; 2], 1, 3.0), None);
        assert_eq!(FaceSamples::new(&[HalfMoments::default(); 2], 1, 3.0), None);
    }

    #[test]
    fn halves_weigh_the_same_whatever_their_counts() {
        let samples = FaceSamples::new(&[half(&[1.0, 1.0]), half(&[0.0])], 1, 2.0).unwrap();
        assert!((samples.mean.phi_f[0].iter().sum::<f64>() - 1.0).abs() < 1e-15);
        assert!((samples.half_difference.phi_f[0].iter().sum::<f64>() - 1.0).abs() < 1e-15);
        let single = FaceSamples::new(&[half(&[1.0, 0.5]), HalfMoments::default()], 1, 2.0).unwrap();
        assert_eq!(single.half_difference, WeightedSums::default());
        assert!((single.mean.phi().iter().sum::<f64>() - 2.0).abs() < 1e-15);
    }

    #[test]
    fn what_is_linear_has_no_misfit() {
        let corners = [0.1, 0.7, 0.4];
        let f = POINTS.map(|phi| phi.iter().zip(corners).map(|(p, x)| p * x).sum::<f64>());
        let samples = FaceSamples::new(&[half(&f), half(&f[..1])], 1, 2.0).unwrap();
        assert!(samples.mean.misfit(0, corners).iter().all(|m| m.abs() < 1e-15));
    }
}
