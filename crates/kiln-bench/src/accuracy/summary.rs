//! What the runs of one way to bake come to: errors in quadrature over the seeds, medians of times.

use super::{
    errors::ErrorStats,
    measure::{Row, Run, SceneResult},
    variant::Family,
};
use serde::Serialize;

/// An error over all seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct ErrorSummary {
    /// RMSE over all seeds: the root of the mean of the squares.
    pub(super) rmse: f64,
    /// The least RMSE of a seed.
    pub(super) rmse_min: f64,
    /// The greatest RMSE of a seed.
    pub(super) rmse_max: f64,
    /// Mean 99th percentile of the absolute error.
    pub p99: f64,
    /// Greatest absolute error of any seed.
    pub(super) max: f64,
    /// Mean error.
    pub(super) bias: f64,
}

/// A duration over all seeds, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct TimeSummary {
    /// The median.
    pub(super) median: f64,
    /// The least.
    pub(super) min: f64,
    /// The greatest.
    pub(super) max: f64,
}

/// One way to bake, over all seeds.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RowSummary {
    /// Its family.
    pub(super) family: Family,
    /// Its numbers.
    pub(super) label: String,
    /// Processor seconds of tracing.
    pub(super) trace_cpu_secs: TimeSummary,
    /// Processor seconds of solving.
    pub(super) solve_cpu_secs: TimeSummary,
    /// Processor seconds of both.
    pub(super) cpu_secs: TimeSummary,
    /// Wall seconds of both.
    pub(super) wall_secs: TimeSummary,
    /// Mean rays of a run.
    pub(super) rays: f64,
    /// Mean samples of a run.
    pub(super) samples: f64,
    /// Estimation error of each channel.
    pub(super) estimation: Vec<ErrorSummary>,
    /// Surface error of each channel.
    pub(super) surface: Vec<ErrorSummary>,
    /// RMSE that the bakes report of themselves, in quadrature, of each channel.
    pub(super) reported_rmse: Vec<f64>,
}

/// Summaries of all rows of a scene.
pub(super) fn summarize(result: &SceneResult) -> Vec<RowSummary> {
    let channels = result.half_distances_m.len();
    result.rows.iter().map(|row| summary(row, channels)).collect()
}

fn summary(row: &Row, channels: usize) -> RowSummary {
    let runs = &row.runs;
    let time = |of: &dyn Fn(&Run) -> f64| times(runs.iter().map(of).collect());
    let mean = |of: &dyn Fn(&Run) -> f64| runs.iter().map(of).sum::<f64>() / runs.len().max(1) as f64;
    let errors = |of: &dyn Fn(&Run) -> &Vec<ErrorStats>| {
        (0..channels).map(|c| error(&runs.iter().map(|run| of(run)[c]).collect::<Vec<_>>())).collect()
    };
    let reported = |c: usize| {
        let squares: Vec<f64> = runs.iter().filter_map(|run| run.reported_rmse.get(c)).map(|r| r * r).collect();
        (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
    };
    RowSummary {
        family: row.family,
        label: row.label.clone(),
        trace_cpu_secs: time(&|run| run.trace.cpu_secs),
        solve_cpu_secs: time(&|run| run.solve.cpu_secs),
        cpu_secs: time(&|run| (run.trace + run.solve).cpu_secs),
        wall_secs: time(&|run| (run.trace + run.solve).wall_secs),
        rays: mean(&|run| run.rays as f64),
        samples: mean(&|run| run.samples as f64),
        estimation: errors(&|run| &run.estimation),
        surface: errors(&|run| &run.surface),
        reported_rmse: (0..channels).filter_map(reported).collect(),
    }
}

fn error(stats: &[ErrorStats]) -> ErrorSummary {
    let count = stats.len().max(1) as f64;
    let mean = |of: &dyn Fn(&ErrorStats) -> f64| stats.iter().map(of).sum::<f64>() / count;
    let greatest = |of: &dyn Fn(&ErrorStats) -> f64| stats.iter().map(of).fold(0.0, f64::max);
    ErrorSummary {
        rmse: mean(&|s| s.rmse * s.rmse).sqrt(),
        rmse_min: stats.iter().map(|s| s.rmse).fold(f64::INFINITY, f64::min),
        rmse_max: greatest(&|s| s.rmse),
        p99: mean(&|s| s.p99),
        max: greatest(&|s| s.max),
        bias: mean(&|s| s.bias),
    }
}

fn times(mut seconds: Vec<f64>) -> TimeSummary {
    seconds.sort_by(f64::total_cmp);
    let at = |index: usize| seconds.get(index).copied().unwrap_or(0.0);
    let middle = seconds.len() / 2;
    let median =
        if seconds.len().is_multiple_of(2) { 0.5 * (at(middle.wrapping_sub(1)) + at(middle)) } else { at(middle) };
    TimeSummary { median, min: at(0), max: at(seconds.len().wrapping_sub(1)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_add_in_quadrature_and_times_by_the_median() {
        let stats = [0.3, 0.4].map(|rmse| ErrorStats { rmse, p99: 2.0 * rmse, max: rmse, bias: -rmse });
        let found = error(&stats);
        assert!((found.rmse - 0.125f64.sqrt()).abs() < 1e-15);
        assert_eq!((found.rmse_min, found.rmse_max, found.max), (0.3, 0.4, 0.4));
        assert!((found.bias + 0.35).abs() < 1e-15 && (found.p99 - 0.7).abs() < 1e-15);
        assert_eq!(times(vec![3.0, 1.0, 9.0]), TimeSummary { median: 3.0, min: 1.0, max: 9.0 });
        assert_eq!(times(vec![3.0, 1.0]).median, 2.0);
    }
}
