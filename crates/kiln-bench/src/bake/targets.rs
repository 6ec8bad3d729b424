//! What a bake of a large level is meant to reach, and whether it does.

use super::{
    kiln::Bake,
    stages::{Kind, PAPER_TOTAL_SECS, rows},
};
use crate::spread::Spread;

/// Samples of the paper's level.
const SAMPLES: f64 = 6.7e6;
const MAX_HANDLING: f64 = 0.10;
const MIN_BUSY: f64 = 0.90;
const MAX_MEMORY_GIB: f64 = 2.5;
const MAX_RMSE: f64 = 0.006;

/// Figures of a bake in one process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Figures {
    pub(super) seconds: f64,
    pub(super) samples: f64,
    pub(super) rays: f64,
    /// Rays in a second of a thread's time, millions.
    pub(super) mrays_per_cpu_second: f64,
    /// All but tracing, solving, building and waiting: part of the threads' time.
    pub(super) handling: f64,
    /// All but tracing and solving, waiting with it: part of the threads' time.
    pub(super) rest: f64,
    /// Processor time by threads' time.
    pub(super) busy: f64,
    pub(super) memory_gib: Option<f64>,
    /// The greatest of the half-distances, by the bake's own estimate.
    pub(super) rmse: f64,
}

impl Figures {
    pub(super) fn of(bake: &Bake) -> Self {
        let report = &bake.report;
        let rows = rows(report);
        let cpu = |kinds: &[Kind]| -> f64 {
            rows.iter().filter(|row| kinds.contains(&row.kind)).filter_map(|row| row.cpu_secs).sum()
        };
        let threads_secs = bake.variant.threads as f64 * report.seconds.max(1e-9);
        let (tracing, all) = (cpu(&[Kind::Trace]), cpu(&[Kind::Total]));
        let (rays, all_rays) = (report.rays.traced as f64, report.part("tracing").cpu_seconds);
        Self {
            seconds: report.seconds,
            samples: report.samples.total as f64,
            rays,
            mrays_per_cpu_second: if all_rays > 0.0 { 1e-6 * rays / all_rays } else { 0.0 },
            handling: cpu(&[Kind::Plan, Kind::Load, Kind::Samples, Kind::Other]) / threads_secs,
            rest: (1.0 - (tracing + cpu(&[Kind::Solve, Kind::Foliage, Kind::Regions])) / threads_secs).max(0.0),
            busy: all / threads_secs,
            memory_gib: report.peak_memory_bytes.map(|bytes| bytes as f64 / f64::from(1 << 30)),
            rmse: report.error_estimate.rmse.iter().copied().fold(0.0, f64::max),
        }
    }
}

/// A line for each target, of the medians over repetitions.
pub(super) fn lines(bakes: &[&Bake]) -> Vec<String> {
    let all: Vec<Figures> = bakes.iter().map(|bake| Figures::of(bake)).collect();
    let median = |of: fn(&Figures) -> f64| Spread::of(all.iter().map(of)).map_or(0.0, |spread| spread.median);
    let verdict = |holds: bool| if holds { "holds" } else { "does not hold" };
    let seconds = median(|f| f.seconds);
    let (samples, handling, busy) = (median(|f| f.samples), median(|f| f.handling), median(|f| f.busy));
    let (rmse, rest) = (median(|f| f.rmse), 100.0 * median(|f| f.rest));
    let memory = Spread::of(all.iter().filter_map(|figures| figures.memory_gib));
    let memory = memory.map_or("peak memory: the system does not tell".to_owned(), |spread| {
        let gib = spread.median;
        format!("peak memory {gib:.2} GiB; at most {MAX_MEMORY_GIB} {}", verdict(gib <= MAX_MEMORY_GIB))
    });
    let foliage = bakes.first().map(|bake| &bake.report.foliage).filter(|foliage| foliage.bytes_at_vertices > 0);
    let size = foliage.map(|foliage| {
        format!(
            "a game loads {:.3} MB for foliage; values at the vertices of every instance would be {:.1} MB, {:.0} times as much",
            1e-6 * foliage.bytes as f64,
            1e-6 * foliage.bytes_at_vertices as f64,
            foliage.bytes_at_vertices as f64 / foliage.bytes.max(1) as f64
        )
    });
    let lines = vec![
        format!(
            "{:.2} M rays; {:.2} Mrays in a second of a thread's time while it traces",
            1e-6 * median(|f| f.rays),
            median(|f| f.mrays_per_cpu_second)
        ),
        format!("{seconds:.1} s; under {PAPER_TOTAL_SECS} s {}", verdict(seconds < PAPER_TOTAL_SECS)),
        format!("{:.2} M samples; at least {:.1} M {}", 1e-6 * samples, 1e-6 * SAMPLES, verdict(samples >= SAMPLES)),
        format!(
            "sampling, gathering, loading, storing, scheduling and progress: {:.1} % of the threads' time; at most {:.0} % {} \
             (with import, building, export and idling {rest:.1} %)",
            100.0 * handling,
            100.0 * MAX_HANDLING,
            verdict(handling <= MAX_HANDLING)
        ),
        format!("threads busy {:.1} %; at least {:.0} % {}", 100.0 * busy, 100.0 * MIN_BUSY, verdict(busy >= MIN_BUSY)),
        memory,
        format!("estimated RMSE {rmse:.4}; at most {MAX_RMSE} {}", verdict(rmse <= MAX_RMSE)),
    ];
    lines.into_iter().chain(size).collect()
}
