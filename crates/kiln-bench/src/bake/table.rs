//! The results as Markdown, for the terminal and for documents.

use super::{
    LevelReport,
    kiln::{Bake, Place, Variant},
    reference::Reference,
    stages::{Kind, Row, millions, rows},
    targets,
};
use crate::spread::Spread;
use std::fmt::{Result, Write};

/// All that was found on a level.
pub(super) fn level(report: &LevelReport) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = write_level(&mut out, report);
    out
}

fn write_level(out: &mut String, report: &LevelReport) -> Result {
    writeln!(out, "\n### {}\n", report.name)?;
    let main = report.main();
    if let Some(bake) = main.first() {
        stages(out, &main)?;
        writeln!(out, "\nIn {}, median of {}:\n", bake.variant.name(), main.len())?;
        for line in targets::lines(&main) {
            writeln!(out, "- {line}")?;
        }
    }
    if report.variants().len() > 1 {
        variants(out, report)?;
    }
    report.reference.as_ref().map_or(Ok(()), |found| reference(out, found, &main))
}

/// The stage table; each figure is the median over the bakes.
fn stages(out: &mut String, bakes: &[&Bake]) -> Result {
    out.push_str("| stage | wall s | CPU s | share of CPU | Sloan et al. 2013, K20, s |\n|---|---|---|---|---|\n");
    let all: Vec<Vec<Row>> = bakes.iter().map(|bake| rows(&bake.report)).collect();
    let median = |index: usize, of: fn(&Row) -> Option<f64>| {
        Spread::of(all.iter().filter_map(|rows| of(rows.get(index)?))).map(|spread| spread.median)
    };
    let Some(first) = all.first() else { return Ok(()) };
    let total = first.iter().position(|row| row.kind == Kind::Total).and_then(|index| median(index, |r| r.cpu_secs));
    for (index, row) in first.iter().enumerate() {
        let (wall, cpu) = (median(index, |row| row.wall_secs), median(index, |row| row.cpu_secs));
        let share = cpu.zip(total.filter(|total| *total > 0.0)).map(|(cpu, total)| 100.0 * cpu / total);
        let text = |value: Option<f64>, digits: usize| value.map_or(String::new(), |value| format!("{value:.digits$}"));
        let percent = if share.is_some() { " %" } else { "" };
        let (wall, cpu, share) = (text(wall, 2), text(cpu, 2), text(share, 1));
        writeln!(out, "| {} | {wall} | {cpu} | {share}{percent} | {} |", row.what, row.paper)?;
    }
    out.push_str(
        "\nWall seconds where a stage is alone. The paper's level has 1.5 M V, 1.8 M F: a landmark, not a ratio.\n",
    );
    Ok(())
}

fn variants(out: &mut String, report: &LevelReport) -> Result {
    out.push_str("\n| bake | wall s | peak MiB | wall / one thread count below | wall / one process | same bytes |\n");
    out.push_str("|---|---|---|---|---|---|\n");
    let variants = report.variants();
    let base = report.bakes.first().map_or("", |bake| bake.output.as_str());
    for (index, variant) in variants.iter().enumerate() {
        let bakes = report.of(*variant);
        let wall = Spread::of(bakes.iter().map(|bake| bake.wall_secs));
        let peak = Spread::of(bakes.iter().filter_map(|bake| bake.peak_bytes).map(|bytes| bytes as f64 / 1_048_576.0));
        let is_here = |other: &&Variant| other.place == Place::Process;
        let below = variants[..index].iter().rfind(is_here).filter(|_| variant.place == Place::Process);
        let same = variants.iter().filter(is_here).find(|other| other.threads == variant.threads);
        let same = same.filter(|_| variant.place == Place::Farm);
        let is_same = bakes.iter().all(|bake| bake.output == base);
        writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} |",
            variant.name(),
            text(wall, 2),
            text(peak, 0),
            text(below.and_then(|below| ratio(report, *below, *variant)), 3),
            text(same.and_then(|same| ratio(report, *variant, *same)), 3),
            if is_same { "yes" } else { "NO" },
        )?;
    }
    out.push_str("\nRatios are pair by pair: of fewer threads to more, of coordinator and worker to one process.\n");
    Ok(())
}

/// Wall time of a variant over that of another, in each repetition.
pub(super) fn ratio(report: &LevelReport, above: Variant, below: Variant) -> Option<Spread> {
    let pairs = report.of(above).into_iter().zip(report.of(below));
    Spread::of(pairs.map(|(above, below)| above.wall_secs / below.wall_secs))
}

fn text(spread: Option<Spread>, digits: usize) -> String {
    spread.map_or(String::new(), |spread| spread.text(digits))
}

fn reference(out: &mut String, found: &Reference, main: &[&Bake]) -> Result {
    let Reference { glob, faces, level_faces, visible_area_m2, wall_secs, .. } = found;
    let whole = main.first().map_or(0.0, |bake| bake.report.visible_area_m2());
    let percent = |part: f64, whole: f64| if whole > 0.0 { 100.0 * part / whole } else { 0.0 };
    writeln!(
        out,
        "\nAgainst `--quality reference` on `{glob}`: {} faces, {:.2} % of the level's; {:.2} % of its area that can be \
         seen; both bakes took {wall_secs:.0} s.\n",
        millions(*faces),
        percent(*faces as f64, *level_faces as f64),
        percent(*visible_area_m2, whole),
    )?;
    out.push_str("| half-distance | RMSE | estimated there | estimated over the level |\n|---|---|---|---|\n");
    for (index, rmse) in found.rmse.iter().enumerate() {
        let at = |list: &[f64]| list.get(index).map_or(String::new(), |value| format!("{value:.4}"));
        let level = main.first().map_or(String::new(), |bake| at(&bake.report.error_estimate.rmse));
        writeln!(out, "| {} | {rmse:.4} | {} | {level} |", index + 1, at(&found.estimated_rmse))?;
    }
    Ok(())
}
