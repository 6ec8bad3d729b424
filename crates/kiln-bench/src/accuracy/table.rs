//! The tables on the terminal.

use super::{
    derive::{EqualRays, Overall, YARDSTICK},
    report::SceneReport,
    summary::RowSummary,
};
use std::fmt::{Result, Write};

/// The table of a scene.
pub(super) fn scene(scene: &SceneReport) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = header(&mut out, scene);
    for row in &scene.summary {
        let _ = line(&mut out, row);
    }
    let _ = verdicts(&mut out, scene);
    out
}

fn header(out: &mut String, scene: &SceneReport) -> Result {
    let result = &scene.result;
    let list = |values: Vec<f64>| values.iter().map(|v| format!("{v:.4}")).collect::<Vec<_>>().join(" / ");
    let distances: Vec<String> = result.half_distances_m.iter().map(|d| format!("{d} m")).collect();
    let (baked, faces, points) = (result.baked_faces, result.faces, result.points);
    writeln!(out, "\n{}, half-distances {}", result.scene, distances.join(" / "))?;
    writeln!(out, "{baked} of {faces} faces baked, {points} points, mean AO {}", list(result.mean_ao.clone()))?;
    writeln!(
        out,
        "reference: {:.1} M rays, own estimate {}, surface error {}",
        result.reference_rays as f64 / 1e6,
        list(result.reference_rmse.clone()),
        list(result.reference_surface.iter().map(|error| error.rmse).collect())
    )?;
    if !result.left_out.is_empty() {
        writeln!(out, "left out (too many rays): {}", result.left_out.join(", "))?;
    }
    write!(out, "{:25} {:>8} {:>8} {:>9} {:>8}", "", "trace s", "solve s", "rays", "samples")?;
    for distance in distances {
        write!(out, " | {distance:>7} est.    p99    max    own | surf.    p99    bias")?;
    }
    writeln!(out)
}

fn line(out: &mut String, row: &RowSummary) -> Result {
    write!(
        out,
        "{:8} {:16} {:8.2} {:8.3} {:8.2}M {:7.0}k",
        row.family.name(),
        row.label,
        row.trace_cpu_secs.median,
        row.solve_cpu_secs.median,
        row.rays / 1e6,
        row.samples / 1e3
    )?;
    for (channel, (estimation, surface)) in row.estimation.iter().zip(&row.surface).enumerate() {
        let own = row.reported_rmse.get(channel).map_or("-".to_owned(), |own| format!("{own:.4}"));
        write!(out, " | {:12.5} {:6.4} {:6.3} {own:>6}", estimation.rmse, estimation.p99, estimation.max)?;
        write!(out, " | {:.4} {:6.4} {:+7.4}", surface.rmse, surface.p99, surface.bias)?;
    }
    writeln!(out)
}

fn verdicts(out: &mut String, scene: &SceneReport) -> Result {
    for (channel, distance) in scene.channels.iter().zip(&scene.result.half_distances_m) {
        if !channel.equal_rays.is_empty() {
            let lowest = channel.equal_rays.iter().filter(|equal| EqualRays::is_lowest(equal)).count();
            let all = channel.equal_rays.len();
            let qualities = channel.at_qualities.iter().filter(|equal| EqualRays::is_lowest(equal)).count();
            writeln!(
                out,
                "{distance} m: least squares lowest on the surface at the rays of {qualities} of {} qualities, and at \
                 {lowest} of {all} ray counts",
                channel.at_qualities.len()
            )?;
        }
        for (name, equal) in [("fixed", &channel.against_fixed), ("random", &channel.against_random)] {
            let Some(equal) = equal else { continue };
            let (rmse, secs) = (equal.rmse, equal.yardstick_cpu_secs);
            let ratio = equal.ratio().map_or("not reached".to_owned(), |ratio| format!("in {ratio:.3} of its time"));
            writeln!(out, "{distance} m: error of {name} {YARDSTICK} (RMSE {rmse:.5}, {secs:.2} s) {ratio}")?;
        }
    }
    Ok(())
}

/// What all scenes come to.
pub(super) fn overall(overall: &Overall) -> String {
    let ratio = |ratio: Option<f64>| ratio.map_or("-".to_owned(), |ratio| format!("{ratio:.3}"));
    let [fixed, fixed_missed] = overall.fixed_reached_and_missed;
    let [random, random_missed] = overall.random_reached_and_missed;
    let [lowest, counts] = overall.lowest_and_all_counts;
    let [calibrated, calibrations] = overall.calibrated_and_all;
    format!(
        "\nleast squares lowest at the rays of all three qualities on {} of {} scenes, and at {lowest} of \
         {counts} ray counts\ntime to the error of fixed 4 × 256: {} of its \
         ({fixed} half-distances, {fixed_missed} not reached)\ntime to the error of random 4 × 256: {} of its \
         ({random} half-distances, {random_missed} not reached)\nown estimates within ±25 %: {calibrated} of \
         {calibrations}\n",
        overall.lowest_at_qualities,
        overall.compared_at_qualities,
        ratio(overall.time_ratio_to_fixed),
        ratio(overall.time_ratio_to_random),
    )
}
