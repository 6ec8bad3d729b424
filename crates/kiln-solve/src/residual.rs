//! What the values leave of the signal: where a mesh is too coarse for its shadows.
//!
//! A face's samples stray from the linear function that its corners' values make, for two reasons: the signal is not
//! linear there, and each sample has the noise of its few directions. Moments alone cannot tell the two apart, so the
//! second is taken from what is known of it. A sample is the mean of R rays whose values, in [0, 1], have a variance of at
//! most p(1 − p) about their mean p. R scrambled Sobol points estimate the mean of a function with edges with a variance
//! that falls as R^(−3/2) (He, Wang 2015, SIAM J. Numer. Anal. 53(1), for two dimensions), which is right for one ray too:
//! `σ² = E[p(1 − p)] / R^(3/2)`, and with E[p(1 − p)] = E[f − f²] + σ² for the samples f,
//! `σ² = E[f − f²] / (R^(3/2) − 1)`. What is left is the variance that more rays would not remove.
//!
//! With few samples on a face the values follow some of their noise, so what is left is somewhat too small, never too great.

use crate::surface::Surface;
use kiln_core::{CoarseFace, CoarseFaces, FaceMoments, HalfMoments};

/// Faces listed for an instance.
const LISTED: usize = 8;

/// What is left on each face of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Residuals<'a> {
    /// The surface.
    pub surface: &'a Surface,
    /// The part of each face's area that can be seen.
    pub visible: &'a [f64],
    /// `faces × channels` variances about the values, by [`face_variances`].
    pub variances: &'a [f64],
    /// Number of channels.
    pub channels: usize,
}

/// Variance of each face's samples about the values, `unknowns × channels`, that are written for them (which are clamped
/// to [0, 1]), less that of a sample's directions: `faces × channels`. Moments have an entry for each face of the mesh.
pub fn face_variances(surface: &Surface, moments: &FaceMoments, values: &[f64], rays_per_sample: u32) -> Vec<f64> {
    let channels = moments.channel_count();
    let mut variances = Vec::with_capacity(surface.corners.len() * channels);
    for (corners, face) in surface.corners.iter().zip(&surface.mesh_face) {
        let halves = moments.face(*face as usize);
        variances.extend((0..channels).map(|channel| {
            let at_corners = corners.map(|u| values[u as usize * channels + channel].clamp(0.0, 1.0));
            variance(&halves, channel, at_corners, rays_per_sample)
        }));
    }
    variances
}

impl Residuals<'_> {
    /// The faces whose deviation is [`CoarseFaces::LEAST_DEVIATION`] or more in some channel. `unit_m2`: square metres of one unit of the frame
    /// squared.
    pub fn coarse_faces(&self, unit_m2: f64) -> CoarseFaces {
        let mut found = CoarseFaces::default();
        for (face, variances) in self.variances.chunks_exact(self.channels).enumerate() {
            let deviation = variances.iter().copied().fold(0.0, f64::max).sqrt();
            if deviation < CoarseFaces::LEAST_DEVIATION {
                continue;
            }
            found.count += 1;
            found.visible_area_m2 += self.visible_area(face) * unit_m2;
            found.worst.push(CoarseFace { face: self.surface.mesh_face[face], deviation });
        }
        // Stable: of equals, the first face.
        found.worst.sort_by(|a, b| b.deviation.total_cmp(&a.deviation));
        found.worst.truncate(LISTED);
        found
    }

    /// Deviation around each unknown, `unknowns × channels`, in [0, 1]: root of the mean variance of its faces by their
    /// visible area; 0 where nothing can be seen.
    pub fn at_unknowns(&self) -> Vec<f64> {
        let channels = self.channels;
        let mut sums = vec![0.0; self.surface.unknown_count() * channels];
        let mut areas = vec![0.0; self.surface.unknown_count()];
        for (face, corners) in self.surface.corners.iter().enumerate() {
            let area = self.visible_area(face);
            for unknown in corners.map(|u| u as usize) {
                areas[unknown] += area;
                for channel in 0..channels {
                    sums[unknown * channels + channel] += area * self.variances[face * channels + channel];
                }
            }
        }
        for (sums, area) in sums.chunks_exact_mut(channels).zip(areas) {
            sums.iter_mut().for_each(|sum| *sum = if area > 0.0 { (*sum / area).sqrt().min(1.0) } else { 0.0 });
        }
        sums
    }

    fn visible_area(&self, face: usize) -> f64 {
        self.surface.areas[face] * self.visible[face]
    }
}

/// Mean square of a face's valid samples about a linear function, less the noise of their directions.
fn variance(halves: &[HalfMoments; 2], channel: usize, [x, y, z]: [f64; 3], rays_per_sample: u32) -> f64 {
    let (mut squares, mut spread, mut count) = (0.0, 0.0, 0.0);
    for half in halves {
        let ([xx, yy, zz, xy, xz, yz], [fx, fy, fz]) = (half.phi_phi, half.phi_f[channel]);
        let quadratic = xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z);
        squares += half.f_squared[channel] + quadratic - 2.0 * (fx * x + fy * y + fz * z);
        // Coordinates add up to 1, so Σ φ_i f over the corners is Σ f.
        spread += (fx + fy + fz) - half.f_squared[channel];
        count += f64::from(half.valid);
    }
    let rays = f64::from(rays_per_sample);
    let explained = if rays_per_sample > 1 { spread.max(0.0) / (rays * rays.sqrt() - 1.0) } else { f64::INFINITY };
    if count > 0.0 { (squares - explained).max(0.0) / count } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    const POINTS: [[f64; 3]; 4] = [[0.5, 0.3, 0.2], [0.1, 0.6, 0.3], [0.2, 0.2, 0.6], [1.0 / 3.0; 3]];

    /// Rays without number: nothing is explained by their noise.
    const MANY: u32 = 1 << 30;

    fn half(values: &[f64]) -> HalfMoments {
        let mut half = HalfMoments::default();
        POINTS.iter().zip(values).for_each(|(phi, f)| half.add(*phi, &[*f]));
        half
    }

    #[test]
    fn what_is_linear_leaves_nothing_and_a_step_half_its_height() {
        let corners = [0.1, 0.7, 0.4];
        let linear = POINTS.map(|phi| phi.iter().zip(corners).map(|(p, x)| p * x).sum::<f64>());
        assert!(variance(&[half(&linear), half(&linear[..2])], 0, corners, MANY) < 1e-15);
        for height in [1.0, 0.4] {
            let (low, high) = (0.5 - height / 2.0, 0.5 + height / 2.0);
            let step = [half(&[low, high]), half(&[high, low, low, high])];
            let left = variance(&step, 0, [0.5; 3], MANY).sqrt();
            assert!((left - height / 2.0).abs() < 1e-9, "{left}");
        }
        assert_eq!(variance(&[HalfMoments::default(); 2], 0, corners, 16), 0.0);
    }

    #[test]
    fn the_noise_of_directions_is_not_the_meshs_fault() {
        // One ray is 0 or 1: nothing can be said. A step from 0 to 1 has samples without noise, whatever their rays.
        let step = [half(&[0.0, 1.0]), half(&[1.0, 0.0])];
        assert_eq!(variance(&step, 0, [0.5; 3], 1), 0.0);
        assert_eq!(variance(&step, 0, [0.5; 3], 2).sqrt(), 0.5);
        // 16 rays of p = 1/2: a variance of p(1 − p)/64 is explained, and ten times that is not.
        let noise = (0.25f64 / 64.0).sqrt();
        let around = |by: f64| [half(&[0.5 - by, 0.5 + by]), half(&[0.5 + by, 0.5 - by])];
        assert!(variance(&around(noise), 0, [0.5; 3], 16) < 1e-12);
        let left = variance(&around(10f64.sqrt() * noise), 0, [0.5; 3], 16);
        assert!((left / (noise * noise) - 9.0).abs() < 0.2, "{left}");
    }

    /// Two triangles of a unit square.
    fn square() -> Surface {
        let points = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        Surface { points, corners: vec![[0, 1, 2], [1, 3, 2]], areas: vec![0.5; 2], mesh_face: vec![7, 9] }
    }

    #[test]
    fn only_coarse_faces_count_by_what_is_seen_of_them() {
        let surface = square();
        let residuals = |variances: [f64; 4], visible: [f64; 2]| {
            Residuals { surface: &surface, visible: &visible, variances: &variances, channels: 2 }.coarse_faces(4.0)
        };
        let fine = residuals([0.0099, 0.0, 0.0, 0.0099], [1.0; 2]);
        assert_eq!(fine, CoarseFaces::default());
        let found = residuals([0.02, 0.04, 0.0, 0.09], [1.0, 0.25]);
        assert_eq!((found.count, found.visible_area_m2), (2, 2.0 + 0.5));
        let worst: Vec<_> = found.worst.iter().map(|face| (face.face, (face.deviation * 1e9).round())).collect();
        assert_eq!(worst, [(9, 3e8), (7, 2e8)]);
    }

    #[test]
    fn vertices_have_the_mean_of_what_is_seen_around_them() {
        let surface = square();
        let residuals = |visible: &[f64]| {
            Residuals { surface: &surface, visible, variances: &[0.04, 0.16], channels: 1 }.at_unknowns()
        };
        let close = |found: Vec<f64>, expected: [f64; 4]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?} {expected:?}");
        };
        close(residuals(&[1.0, 1.0]), [0.2, 0.1f64.sqrt(), 0.1f64.sqrt(), 0.4]);
        close(residuals(&[1.0, 0.0]), [0.2, 0.2, 0.2, 0.0]);
    }

    proptest! {
        #[test]
        fn what_is_left_is_between_nothing_and_all(
            values in prop::collection::vec(0.0..=1.0f64, 1..=4),
            corners in prop::array::uniform3(0.0..=1.0f64),
            bits in 0..16u32,
        ) {
            let halves = [half(&values), HalfMoments::default()];
            let (left, all) = (variance(&halves, 0, corners, 1 << bits), variance(&halves, 0, corners, MANY));
            prop_assert!((0.0..=1.0).contains(&left) && left <= all + 1e-12, "{left} {all}");
        }
    }
}
