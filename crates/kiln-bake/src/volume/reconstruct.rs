//! AO from a volume: the sky that a point sees, convolved with the clamped cosine about a normal.
//!
//! Source: Ramamoorthi and Hanrahan 2001, equation 8: the clamped cosine weights the bands by π, 2π/3 and π/4; AO divides
//! by π. The third band is 0 and what is beyond the quadratic ones is at most a few hundredths.

use super::Volume;
use glam::{DVec3, Vec3};
use kiln_core::MAX_CHANNELS;
use kiln_trace::{HARMONICS, quadratic_harmonics};

/// Weights of the constant, linear and quadratic functions: what is seen, times these, is AO as a function of the normal.
pub(crate) const COSINE_BANDS: [f64; HARMONICS] = [1.0, 2.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 0.25, 0.25, 0.25, 0.25, 0.25];

impl Volume {
    /// What a point sees, for each channel, interpolated between voxels; 0 for channels that there are not. `None` for a point
    /// that does not have all eight voxels around it, which points of the layout's boxes have. Metres relative to the
    /// level's origin.
    pub fn sky_at(&self, point: DVec3) -> Option<[[f64; HARMONICS]; MAX_CHANNELS]> {
        let mut sky = [[0.0; HARMONICS]; MAX_CHANNELS];
        for (voxel, weight) in self.layout().lattice().stencil(point)?.corners() {
            for (sums, values) in sky.iter_mut().zip(self.voxel(voxel)?.chunks_exact(HARMONICS)) {
                for (sum, value) in sums.iter_mut().zip(values) {
                    *sum += weight * f64::from(*value);
                }
            }
        }
        Some(sky)
    }

    /// AO of a point and a normal, for each channel; 0 for channels that there are not. `None` as in [`Volume::sky_at`].
    pub fn ao_at(&self, point: DVec3, normal: DVec3) -> Option<[f64; MAX_CHANNELS]> {
        self.sky_at(point).map(|sky| sky.map(|coefficients| cosine_ao(&coefficients, normal)))
    }
}

/// AO in [0, 1] about a normal, which need not be of unit length, from the coefficients of what is seen. Without a normal (zero,
/// or not finite) it is the mean over the sphere.
pub fn cosine_ao(coefficients: &[f64; HARMONICS], normal: DVec3) -> f64 {
    let normal = normal.try_normalize().map(DVec3::as_vec3);
    let basis = quadratic_harmonics(normal.unwrap_or(Vec3::Y));
    let count = if normal.is_some() { HARMONICS } else { 1 };
    let terms = COSINE_BANDS.iter().zip(basis).zip(coefficients).take(count);
    terms.map(|((band, y), c)| band * f64::from(y) * c).sum::<f64>().clamp(0.0, 1.0)
}
