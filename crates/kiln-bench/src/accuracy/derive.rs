//! What the tables come to: error at equal rays, time at equal error, and how well bakes know their own error.

use super::{
    curve::{Crossing, best_within, cost_at, geometric_mean},
    measure::SceneResult,
    summary::RowSummary,
    variant::Family,
};
use serde::Serialize;

/// The row that adaptive sampling is measured by: 256 rays per sample, 4 samples per face.
pub(super) const YARDSTICK: &str = "4 × 256";

/// The rows of Kiln's qualities.
const QUALITIES: [&str; 3] = ["low", "medium", "high"];

/// Surface errors at equal rays.
#[derive(Clone, Debug, Serialize)]
pub(super) struct EqualRays {
    /// The rays.
    pub(super) rays: f64,
    /// Surface RMSE of least squares with the default α: of a quality its own, of fixed counts the least within these rays.
    pub(super) least_squares: f64,
    /// The same of area averages.
    pub(super) average: Option<f64>,
    /// The same of AO at the vertices.
    pub(super) vertices: Option<f64>,
}

impl EqualRays {
    /// Least squares beside what the others reach within as many rays, by any of their counts; nothing if they have none.
    fn new(rays: f64, least_squares: f64, average: &[(f64, f64)], vertices: &[(f64, f64)]) -> Option<Self> {
        let (average, vertices) = (best_within(average, rays), best_within(vertices, rays));
        (average.is_some() || vertices.is_some()).then_some(Self { rays, least_squares, average, vertices })
    }

    /// Whether least squares is below both.
    pub(super) fn is_lowest(&self) -> bool {
        [self.average, self.vertices].into_iter().flatten().all(|other| self.least_squares < other)
    }
}

/// Time to reach the estimation error of a yardstick.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct EqualError {
    /// The yardstick's estimation RMSE.
    pub(super) rmse: f64,
    /// Its processor seconds, tracing and solving.
    pub(super) yardstick_cpu_secs: f64,
    /// Where the curve of Kiln's targets reaches it; nothing if it ends above.
    pub(super) kiln: Option<Crossing>,
}

impl EqualError {
    /// Kiln's time as a fraction of the yardstick's.
    pub(super) fn ratio(&self) -> Option<f64> {
        self.kiln.map(|crossing| crossing.cost / self.yardstick_cpu_secs)
    }
}

/// A bake's own estimate beside its true error.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Calibration {
    /// The row.
    pub(super) label: String,
    /// RMSE that the bake reports.
    pub(super) estimated: f64,
    /// True RMSE: against the reference, without the part that is the reference's own error (in quadrature).
    pub(super) actual: f64,
}

impl Calibration {
    /// Estimated over true.
    pub(super) fn ratio(&self) -> f64 {
        self.estimated / self.actual
    }
}

/// What one half-distance of one scene comes to.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ChannelResult {
    /// At the ray counts of all fixed rows.
    pub(super) equal_rays: Vec<EqualRays>,
    /// Kiln's qualities, at the rays that they take here.
    pub(super) at_qualities: Vec<EqualRays>,
    /// Against fixed counts.
    pub(super) against_fixed: Option<EqualError>,
    /// Against random directions.
    pub(super) against_random: Option<EqualError>,
    /// For each row of Kiln.
    pub(super) calibration: Vec<Calibration>,
}

/// Over all scenes.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Overall {
    /// Scenes where least squares has the lowest surface RMSE at the rays of every quality, at every half-distance.
    pub(super) lowest_at_qualities: usize,
    /// Scenes where that could be told.
    pub(super) compared_at_qualities: usize,
    /// Ray counts of fixed rows, over scenes and half-distances, at which least squares is lowest, and all.
    pub(super) lowest_and_all_counts: [usize; 2],
    /// Geometric mean over scenes and half-distances of Kiln's time to reach the error of fixed counts, as a fraction.
    pub(super) time_ratio_to_fixed: Option<f64>,
    /// Half-distances of scenes that this mean is over, and those where Kiln's curve ends above the yardstick.
    pub(super) fixed_reached_and_missed: [usize; 2],
    /// The same against random directions.
    pub(super) time_ratio_to_random: Option<f64>,
    /// As for fixed counts.
    pub(super) random_reached_and_missed: [usize; 2],
    /// Calibrations within ±25 %, and all.
    pub(super) calibrated_and_all: [usize; 2],
}

/// Everything that follows from a scene's rows, for each half-distance.
pub(super) fn channels(result: &SceneResult, rows: &[RowSummary]) -> Vec<ChannelResult> {
    (0..result.half_distances_m.len()).map(|channel| of_channel(result, rows, channel)).collect()
}

fn of_channel(result: &SceneResult, rows: &[RowSummary], channel: usize) -> ChannelResult {
    let reference = result.reference_rmse.get(channel).copied().unwrap_or(0.0);
    let surface = |family: Family| -> Vec<(f64, f64)> {
        rows.iter().filter(|row| row.family == family).map(|row| (row.rays, row.surface[channel].rmse)).collect()
    };
    let curve: Vec<(f64, f64)> = rows
        .iter()
        .filter(|row| row.family == Family::Kiln)
        .map(|row| (row.cpu_secs.median, row.estimation[channel].rmse))
        .collect();
    let against = |family: Family| {
        let row = rows.iter().find(|row| row.family == family && row.label == YARDSTICK)?;
        let rmse = row.estimation[channel].rmse;
        let kiln = cost_at(&curve, rmse);
        (!curve.is_empty()).then_some(EqualError { rmse, yardstick_cpu_secs: row.cpu_secs.median, kiln })
    };
    let calibration = |row: &RowSummary| {
        let measured = row.estimation[channel].rmse;
        let actual = (measured * measured - reference * reference).max(0.0).sqrt();
        let estimated = *row.reported_rmse.get(channel)?;
        (actual > 0.0).then(|| Calibration { label: row.label.clone(), estimated, actual })
    };
    let (average, vertices) = (surface(Family::Average), surface(Family::Vertices));
    let at = |rays: f64, least_squares: f64| EqualRays::new(rays, least_squares, &average, &vertices);
    let fixed = surface(Family::Fixed);
    let quality = |row: &&RowSummary| row.family == Family::Kiln && QUALITIES.contains(&row.label.as_str());
    ChannelResult {
        equal_rays: within_counts(&fixed).into_iter().filter_map(|(rays, rmse)| at(rays, rmse)).collect(),
        at_qualities: rows.iter().filter(quality).filter_map(|row| at(row.rays, row.surface[channel].rmse)).collect(),
        against_fixed: against(Family::Fixed),
        against_random: against(Family::Random),
        calibration: rows.iter().filter(|row| row.family == Family::Kiln).filter_map(calibration).collect(),
    }
}

/// The ray counts of rows, ascending, each with the least error within it.
fn within_counts(rows: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut counts: Vec<f64> = rows.iter().map(|row| row.0).collect();
    counts.sort_by(f64::total_cmp);
    counts.into_iter().filter_map(|rays| Some((rays, best_within(rows, rays)?))).collect()
}

/// What all scenes come to.
pub(super) fn overall(scenes: &[Vec<ChannelResult>]) -> Overall {
    let compared: Vec<bool> = scenes
        .iter()
        .filter(|channels| channels.iter().any(|channel| !channel.at_qualities.is_empty()))
        .map(|channels| channels.iter().flat_map(|channel| &channel.at_qualities).all(EqualRays::is_lowest))
        .collect();
    let all = || scenes.iter().flatten();
    let counts = || all().flat_map(|channel| &channel.equal_rays);
    let (time_ratio_to_fixed, fixed_reached_and_missed) = ratios(all().filter_map(|c| c.against_fixed));
    let (time_ratio_to_random, random_reached_and_missed) = ratios(all().filter_map(|c| c.against_random));
    let calibrations = || all().flat_map(|channel| &channel.calibration);
    let is_calibrated = |calibration: &&Calibration| (0.75..=1.25).contains(&calibration.ratio());
    Overall {
        lowest_at_qualities: compared.iter().filter(|lowest| **lowest).count(),
        compared_at_qualities: compared.len(),
        lowest_and_all_counts: [counts().filter(|equal| equal.is_lowest()).count(), counts().count()],
        time_ratio_to_fixed,
        fixed_reached_and_missed,
        time_ratio_to_random,
        random_reached_and_missed,
        calibrated_and_all: [calibrations().filter(is_calibrated).count(), calibrations().count()],
    }
}

fn ratios(all: impl Iterator<Item = EqualError>) -> (Option<f64>, [usize; 2]) {
    let ratios: Vec<Option<f64>> = all.map(|equal| equal.ratio()).collect();
    let reached: Vec<f64> = ratios.iter().copied().flatten().collect();
    (geometric_mean(&reached), [reached.len(), ratios.len() - reached.len()])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_method_may_split_its_rays_as_suits_it() {
        let fixed = [(100.0, 0.05), (400.0, 0.02), (400.0, 0.03)];
        let average = [(100.0, 0.06), (400.0, 0.055)];
        let vertices = [(90.0, 0.04), (500.0, 0.01)];
        assert_eq!(within_counts(&fixed), [(100.0, 0.05), (400.0, 0.02), (400.0, 0.02)]);
        let at = |rays, rmse| EqualRays::new(rays, rmse, &average, &vertices).unwrap();
        assert!(!at(100.0, 0.05).is_lowest(), "the vertices are better at 100 rays");
        assert!(at(400.0, 0.02).is_lowest() && at(400.0, 0.02).vertices == Some(0.04));
        assert!(EqualRays::new(50.0, 0.1, &average, &vertices).is_none(), "nothing to compare with");
    }

    #[test]
    fn a_curve_that_ends_too_early_is_counted_as_missed() {
        let reached = Some(Crossing { cost: 2.0, is_bound: false });
        let equal = |kiln| EqualError { rmse: 0.01, yardstick_cpu_secs: 8.0, kiln };
        assert_eq!(ratios([equal(reached), equal(None)].into_iter()), (Some(0.25), [1, 1]));
    }
}
