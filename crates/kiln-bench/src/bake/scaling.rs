//! Cost of a bake against the size of its level.

use super::{LevelReport, targets::Figures};
use crate::spread::Spread;
use std::fmt::Write;

/// What a bake costs, medians over repetitions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cost {
    pub(super) faces: f64,
    pub(super) instances: f64,
    pub(super) wall_secs: f64,
    /// Processor microseconds for each face.
    pub(super) micros_per_face: f64,
    /// Processor nanoseconds for each ray, of the whole bake.
    pub(super) nanos_per_ray: f64,
    /// Of the time in which it traces.
    pub(super) tracing_nanos_per_ray: f64,
}

impl Cost {
    /// Of bakes in one process with the greatest number of threads.
    pub(super) fn of(level: &LevelReport) -> Option<Self> {
        let main = level.main();
        let first = &main.first()?.report;
        let median = |values: Vec<f64>| Spread::of(values).map_or(0.0, |spread| spread.median);
        let cpu = median(main.iter().map(|bake| bake.report.cpu_seconds).collect());
        let rate = median(main.iter().map(|bake| Figures::of(bake).mrays_per_cpu_second).collect());
        let (faces, rays) = (first.level.faces as f64, first.rays.traced as f64);
        Some(Self {
            faces,
            instances: first.level.instances as f64,
            wall_secs: median(main.iter().map(|bake| bake.report.seconds).collect()),
            micros_per_face: 1e6 * cpu / faces.max(1.0),
            nanos_per_ray: 1e9 * cpu / rays.max(1.0),
            tracing_nanos_per_ray: if rate > 0.0 { 1e3 / rate } else { 0.0 },
        })
    }
}

/// A row for each level, if there are several.
pub(super) fn table(levels: &[LevelReport]) -> String {
    let costs: Vec<(&str, Cost)> =
        levels.iter().filter_map(|level| Some((level.name.as_str(), Cost::of(level)?))).collect();
    if costs.len() < 2 {
        return String::new();
    }
    let mut out = "\n### Cost against size\n\n\
| scene | faces | instances | wall s | CPU µs per face | CPU ns per ray | of it tracing |\n|---|---|---|---|---|---|---|\n"
        .to_owned();
    for (name, cost) in costs {
        let Cost { faces, instances, wall_secs, micros_per_face, nanos_per_ray, tracing_nanos_per_ray } = cost;
        // Writing to a string does not fail.
        let _ = writeln!(
            out,
            "| {name} | {faces} | {instances} | {wall_secs:.2} | {micros_per_face:.1} | {nanos_per_ray:.0} | \
             {tracing_nanos_per_ray:.0} |"
        );
    }
    out
}
