//! What foliage gets from a bake: numbers of instances, and the fits that they come from.

use crate::{FitWork, PointsWork, ResultError, TraceSummary, work::check_range, work::check_size};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What an instance has in place of values at its vertices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum InstanceNumbers {
    /// The local AO of its model is to be multiplied by `y0 + y1 u + y2 v + y3 w`, u, v and w being the place within the
    /// model's box ([`crate::MeshEntry::bounds`]), each from −1 to 1 (Sloan et al. 2013, equation 3).
    Global {
        /// y0 to y3 for each channel.
        channels: Vec<[f32; 4]>,
        /// The same for the blend of the channels.
        blend: [f32; 4],
    },
    /// AO that all of it has.
    Scalar {
        /// For each channel, 0 to 1.
        ao: Vec<f32>,
        /// Nothing with values is near: it is open.
        is_open: bool,
    },
}

impl InstanceNumbers {
    /// Checks numbers that are said to be of so many channels.
    pub(crate) fn check(&self, channels: usize) -> Result<(), ResultError> {
        match self {
            Self::Global { channels: all, blend } => {
                check_size("channels", all.len(), channels)?;
                let bad = all.iter().chain([blend]).flatten().filter(|y| !y.is_finite()).count();
                check_size("numbers that are not finite", bad, 0)
            }
            Self::Scalar { ao, .. } => {
                check_size("channels", ao.len(), channels)?;
                check_range("number", ao)
            }
        }
    }
}

/// AO at the points of some instances of a model, as it was traced there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointValues {
    /// `instances × points × channels`, each in [0, 1]; NaN where a point is invalid.
    pub values: Vec<f32>,
    /// Rays of all of them.
    pub rays: u64,
}

impl PointValues {
    pub(crate) fn check(&self, points: &PointsWork, channels: usize) -> Result<(), ResultError> {
        let count = (points.count as usize).saturating_mul(points.point_count as usize).saturating_mul(channels);
        check_size("values", self.values.len(), count)?;
        let wrong = self.values.iter().filter(|value| !value.is_nan() && !(0.0..=1.0).contains(*value)).count();
        check_size("values out of [0, 1]", wrong, 0)
    }
}

/// What the fit of a model's instances gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TreeFits {
    /// Number of channels.
    pub channels: u32,
    /// Local AO that all instances share, `vertices × channels`, in [0, 1].
    pub local: Vec<f32>,
    /// [`InstanceNumbers::Global`] of each instance that receives, in the level's order.
    pub numbers: Vec<InstanceNumbers>,
    /// Errors against what was fitted, for each channel.
    pub errors: Vec<TreeErrors>,
    /// The same for each instance, in the level's order.
    pub instance_errors: Vec<Vec<TreeErrors>>,
    /// Totals of tracing the model alone.
    pub trace: TraceSummary,
    /// The lanes that did.
    pub trace_lanes: BTreeSet<String>,
    /// Voxels of the whole volume; 0 if the fit was to what was traced at points.
    pub voxels: u64,
    /// Rays traced at points.
    pub point_rays: u64,
    /// It is a lower level of detail, read from the fits of the full one: it has no errors of its own.
    pub is_lod: bool,
}

/// Errors of a model's instances against the signal that they were fitted to, for one channel: roots of weighted means of
/// squares.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TreeErrors {
    /// The linear function alone, with L = 1.
    pub global_only: f64,
    /// It times the local AO of the model alone.
    pub local_global: f64,
    /// Both fitted in turn.
    pub alternated: f64,
    /// Weight of the samples of all instances.
    pub weight: f64,
}

impl TreeFits {
    pub(crate) fn check(&self, fit: &FitWork, channels: usize) -> Result<(), ResultError> {
        check_size("channels", self.channels as usize, channels)?;
        check_size("values", self.local.len(), (fit.vertex_count as usize).saturating_mul(channels))?;
        check_size("numbers", self.numbers.len(), fit.instance_count as usize)?;
        check_size("errors", self.errors.len(), channels)?;
        check_size("instances' errors", self.instance_errors.len(), fit.instance_count as usize)?;
        check_range("value", &self.local)?;
        self.numbers.iter().try_for_each(|numbers| numbers.check(channels))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fits() -> TreeFits {
        let numbers = InstanceNumbers::Global { channels: vec![[1.0, 0.0, 0.0, 0.0]; 2], blend: [1.0, 0.0, 0.0, 0.0] };
        let error = TreeErrors { global_only: 0.3, local_global: 0.2, alternated: 0.1, weight: 1.0 };
        TreeFits {
            channels: 2,
            local: vec![0.5; 6],
            numbers: vec![numbers; 3],
            errors: vec![error; 2],
            instance_errors: vec![vec![error; 2]; 3],
            trace: TraceSummary::default(),
            trace_lanes: BTreeSet::new(),
            voxels: 9,
            point_rays: 0,
            is_lod: false,
        }
    }

    #[test]
    fn values_at_points_are_ao_or_invalid() {
        let work = PointsWork { mesh: 0, first: 2, count: 2, point_count: 3, rays: 128 };
        let of = |value: f32, count: usize| PointValues { values: vec![value; count], rays: 1 }.check(&work, 2).is_ok();
        assert!(of(0.5, 12) && of(f32::NAN, 12));
        assert!(!of(0.5, 11) && !of(1.5, 12) && !of(f32::INFINITY, 12));
    }

    #[test]
    fn fits_that_cannot_be_are_refused() {
        let work = FitWork { mesh: 0, vertex_count: 3, instance_count: 3 };
        fits().check(&work, 2).unwrap();
        assert!(fits().check(&work, 1).is_err());
        let refused = |change: fn(&mut TreeFits)| {
            let mut wrong = fits();
            change(&mut wrong);
            wrong.check(&work, 2).unwrap_err().to_string()
        };
        assert!(refused(|fits| fits.local.truncate(5)).contains("5 values"));
        assert!(refused(|fits| fits.local[1] = 1.5).contains("value 1"));
        assert!(refused(|fits| fits.numbers.truncate(2)).contains("2 numbers"));
        assert!(refused(|fits| fits.errors.truncate(1)).contains("1 errors"));
        let infinite = InstanceNumbers::Global { channels: vec![[f32::NAN; 4]; 2], blend: [0.0; 4] };
        assert!(infinite.check(2).unwrap_err().to_string().contains("not finite"));
        let scalar = |ao| InstanceNumbers::Scalar { ao, is_open: false };
        assert!(scalar(vec![0.0, 1.0]).check(2).is_ok() && scalar(vec![0.0, 1.1]).check(2).is_err());
    }
}
