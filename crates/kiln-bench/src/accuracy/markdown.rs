//! The dated document: what was found, and every row.

use super::{
    derive::{EqualError, YARDSTICK},
    report::{Report, SceneReport},
    summary::{ErrorSummary, RowSummary},
    variant::Family,
};
use std::{
    fmt::{Result, Write},
    path::Path,
};

/// The document of a measurement; the plot is taken to lie beside it.
pub(super) fn document(report: &Report, plot: Option<&Path>) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = head(&mut out, report);
    if let Some(name) = plot.and_then(Path::file_name) {
        let _ = writeln!(out, "![Error against time]({})\n", name.to_string_lossy());
    }
    let _ = conclusions(&mut out, report);
    for scene in &report.scenes {
        let _ = scene_table(&mut out, scene);
    }
    out
}

fn head(out: &mut String, report: &Report) -> Result {
    let provenance = &report.provenance;
    writeln!(out, "# Error against time and rays, {}\n", provenance.date)?;
    writeln!(out, "Made by `{}` in {:.0} minutes.", provenance.command, report.total_wall_secs / 60.0)?;
    writeln!(out, "Machine and code: {}. {} seeds.\n", provenance.sentence(), report.seeds)?;
    writeln!(
        out,
        "*Estimation error* is the distance from the converged solution on the same unknowns with the same α, over the \
         area that has valid samples. *Surface error* is the distance of the interpolated result from the signal at \
         independent points; it has a floor that the mesh sets (the converged reference's own surface error). RMSE over \
         seeds is in quadrature, with the least and greatest of a seed; times are medians of processor seconds. Where a \
         level has more faces than were baked, whole pieces of it were, spread evenly, and all of it occludes: times are \
         those of the part.\n"
    )
}

fn conclusions(out: &mut String, report: &Report) -> Result {
    let overall = &report.overall;
    let ratio = |ratio: Option<f64>| ratio.map_or("not reached".to_owned(), |ratio| format!("{ratio:.3}"));
    let counts = |[reached, missed]: [usize; 2]| format!("{reached} of {} half-distances", reached + missed);
    writeln!(out, "## What it comes to\n")?;
    writeln!(
        out,
        "- Least squares as Kiln bakes has a lower surface RMSE than area averages and AO at the vertices have within as \
         many rays, at all three qualities and every half-distance, on {} of {} scenes. With fixed counts for all, over \
         every number of rays that was tried, fewer and more than a bake takes, it is lowest at {} of {}.",
        overall.lowest_at_qualities,
        overall.compared_at_qualities,
        overall.lowest_and_all_counts[0],
        overall.lowest_and_all_counts[1]
    )?;
    writeln!(
        out,
        "- Kiln's time to the estimation RMSE of fixed counts ({YARDSTICK}), as a fraction of theirs, geometric mean: \
         {} ({}).",
        ratio(overall.time_ratio_to_fixed),
        counts(overall.fixed_reached_and_missed)
    )?;
    writeln!(
        out,
        "- The same against random directions ({YARDSTICK}): {} ({}).",
        ratio(overall.time_ratio_to_random),
        counts(overall.random_reached_and_missed)
    )?;
    let [calibrated, all] = overall.calibrated_and_all;
    writeln!(out, "- The error that a bake reports is within ±25 % of the true one in {calibrated} of {all} cases.\n")?;
    time_table(out, report)?;
    calibration_table(out, report)
}

fn time_table(out: &mut String, report: &Report) -> Result {
    writeln!(
        out,
        "| scene, half-distance | RMSE of fixed {YARDSTICK} | its s | Kiln's s | ratio | RMSE of random {YARDSTICK} | its s | Kiln's s | ratio |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|---|")?;
    for scene in &report.scenes {
        for (channel, distance) in scene.channels.iter().zip(&scene.result.half_distances_m) {
            let cells = |equal: &Option<EqualError>| equal.as_ref().map_or(" | | | ".to_owned(), equal_cells);
            let (fixed, random) = (cells(&channel.against_fixed), cells(&channel.against_random));
            writeln!(out, "| {}, {distance} m | {fixed} | {random} |", scene.result.scene)?;
        }
    }
    writeln!(out)
}

fn equal_cells(equal: &EqualError) -> String {
    let bound = if equal.kiln.is_some_and(|crossing| crossing.is_bound) { "≤ " } else { "" };
    let kiln = equal.kiln.map_or("not reached".to_owned(), |crossing| format!("{bound}{:.2}", crossing.cost));
    let ratio = equal.ratio().map_or(String::new(), |ratio| format!("{bound}{ratio:.3}"));
    format!("{:.5} | {:.2} | {kiln} | {ratio}", equal.rmse, equal.yardstick_cpu_secs)
}

fn calibration_table(out: &mut String, report: &Report) -> Result {
    writeln!(out, "Estimated and true RMSE (the reference's own error taken out in quadrature):\n")?;
    writeln!(out, "| scene, half-distance | bake | estimated | true | ratio |\n|---|---|---|---|---|")?;
    for scene in &report.scenes {
        for (channel, distance) in scene.channels.iter().zip(&scene.result.half_distances_m) {
            for one in &channel.calibration {
                let (estimated, actual) = (one.estimated, one.actual);
                let (label, ratio) = (&one.label, one.ratio());
                writeln!(
                    out,
                    "| {}, {distance} m | {label} | {estimated:.5} | {actual:.5} | {ratio:.2} |",
                    scene.result.scene
                )?;
            }
        }
    }
    writeln!(out)
}

fn scene_table(out: &mut String, scene: &SceneReport) -> Result {
    let result = &scene.result;
    let list = |values: Vec<f64>| values.iter().map(|v| format!("{v:.4}")).collect::<Vec<_>>().join(" / ");
    writeln!(out, "## {}\n", result.scene)?;
    writeln!(
        out,
        "{} of {} faces baked, {} points, mean AO {}. Reference: {:.0} M rays, own estimate of its error {}, surface \
         error {}.{}\n",
        result.baked_faces,
        result.faces,
        result.points,
        list(result.mean_ao.clone()),
        result.reference_rays as f64 / 1e6,
        list(result.reference_rmse.clone()),
        list(result.reference_surface.iter().map(|error| error.rmse).collect()),
        left_out(&result.left_out)
    )?;
    write!(out, "| | samples × rays | trace s | solve s | M rays | k samples |")?;
    for distance in &result.half_distances_m {
        write!(out, " {distance} m: estimation RMSE | p99 | max | surface RMSE | p99 | bias |")?;
    }
    writeln!(out, "\n|---|---|---|---|---|---|{}", "---|".repeat(6 * result.half_distances_m.len()))?;
    scene.summary.iter().try_for_each(|row| table_row(out, row))?;
    writeln!(out)
}

fn left_out(names: &[String]) -> String {
    if names.is_empty() {
        String::new()
    } else {
        format!(" Left out, since they take too many rays: {}.", names.join(", "))
    }
}

fn table_row(out: &mut String, row: &RowSummary) -> Result {
    let family = if row.family == Family::Fixed { "Kiln, fixed counts" } else { row.family.title() };
    write!(
        out,
        "| {family} | {} | {:.2} | {:.3} | {:.2} | {:.1} |",
        row.label,
        row.trace_cpu_secs.median,
        row.solve_cpu_secs.median,
        row.rays / 1e6,
        row.samples / 1e3
    )?;
    for (estimation, surface) in row.estimation.iter().zip(&row.surface) {
        let rmse = |error: &ErrorSummary| format!("{:.5} ({:.5}–{:.5})", error.rmse, error.rmse_min, error.rmse_max);
        let (p99, max) = (estimation.p99, estimation.max);
        write!(out, " {} | {p99:.4} | {max:.3} | {} |", rmse(estimation), rmse(surface))?;
        write!(out, " {:.4} | {:+.4} |", surface.p99, surface.bias)?;
    }
    writeln!(out)
}
