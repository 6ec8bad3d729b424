//! The results as Markdown, for the terminal and for documents.

use super::{
    SceneReport,
    agree::{Agreement, Disagreement},
    contest::{Row, Standings},
    lap::Lap,
};
use crate::spread::Spread;
use std::fmt::{Result, Write};

const BUILD_HEAD: &str = "
| build | threads | wall s | CPU s | tree MB | bytes per triangle | peak MB |
|---|---|---|---|---|---|---|
";
const RATE_HEAD: &str = "
| tracer | threads | mode | hits | mean t | Mrays per CPU s | Mrays per wall s | Kiln / it, CPU | Kiln / it, wall |
|---|---|---|---|---|---|---|---|---|
";
const AGREE_HEAD: &str = "
| Kiln against | rays | hits, its hits | hit differs | distance differs | distance off f64, its | same distance, other triangle | other side | relative difference of t, mean, greatest within | differs on | Kiln wrong in f64 |
|---|---|---|---|---|---|---|---|---|---|---|
";

/// All that was found on a scene.
pub(super) fn scene(report: &SceneReport) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = head(&mut out, report);
    let _ = builds(&mut out, report);
    out.push_str(RATE_HEAD);
    for row in &report.standings.rows {
        let _ = rate(&mut out, &report.standings, row);
    }
    if !report.predicted.is_empty() {
        out.push_str("\nAgainst the model of docs/gpu.md, with typical figures of this kind of device:\n\n");
        report.predicted.iter().for_each(|predicted| out.push_str(&(predicted.line() + "\n")));
    }
    if let Some(both) = &report.ray_queries {
        out.push_str(&both.text());
    }
    let _ = agreements(&mut out, &report.standings.agreements);
    out
}

fn head(out: &mut String, report: &SceneReport) -> Result {
    let SceneReport { name, points, rays_per_point, diagonal_m, .. } = report;
    writeln!(out, "\n### {name}\n")?;
    if let Some(build) = report.builds.first() {
        let (triangles, instances, meshes) = (build.triangles, build.instances, build.meshes);
        write!(out, "{triangles} triangles in {instances} instances of {meshes} meshes; ")?;
    }
    writeln!(out, "{points} points of {rays_per_point} rays, diagonal {diagonal_m} m.")
}

fn builds(out: &mut String, report: &SceneReport) -> Result {
    out.push_str(BUILD_HEAD);
    for build in &report.builds {
        writeln!(
            out,
            "| Kiln | {} | {:.3} | {:.3} | {:.1} | {:.1} | {} |",
            build.threads,
            build.wall_secs,
            build.cpu_secs,
            mega(build.bvh_bytes),
            build.bytes_per_triangle(),
            if build.peak_bytes > 0 { format!("{:.1}", mega(build.peak_bytes)) } else { String::new() }
        )?;
    }
    for of in &report.standings.peer_builds {
        let least = of.builds.iter().map(|build| build.build_seconds).fold(f64::INFINITY, f64::min);
        let first = of.builds.first();
        let bytes = |bytes: Option<u64>| bytes.map_or(String::new(), |bytes| format!("{:.1}", mega(bytes)));
        let memory = first.and_then(|build| build.memory_bytes);
        let per_triangle = first.zip(memory).map(|(build, bytes)| bytes as f64 / build.triangles.max(1) as f64);
        writeln!(
            out,
            "| {} | {} | {least:.3} | | {} | {} | {} |",
            of.tracer,
            of.threads,
            bytes(memory),
            per_triangle.map_or(String::new(), |bytes| format!("{bytes:.1}")),
            bytes(first.and_then(|build| build.peak_bytes)),
        )?;
    }
    Ok(())
}

fn mega(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

fn rate(out: &mut String, standings: &Standings, row: &Row) -> Result {
    let text = |value: Option<f64>, digits: usize| value.map_or(String::new(), |value| format!("{value:.digits$}"));
    let spread =
        |rate: fn(&Lap) -> f64| Spread::of(row.laps.iter().map(rate)).map_or_else(String::new, |spread| spread.text(2));
    let first = row.laps.first();
    let ratios = standings.ratios(row);
    let ratio = |ratio: Option<Spread>| ratio.map_or_else(String::new, |ratio| ratio.text(2));
    let is_closest = row.mode.starts_with("closest");
    writeln!(
        out,
        "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
        row.tracer,
        row.threads,
        row.mode,
        text(first.and_then(|lap| lap.hit_fraction), 6),
        text(first.and_then(|lap| lap.mean_t).filter(|_| is_closest), 5),
        spread(|lap| lap.mrays_per_cpu_second),
        spread(|lap| lap.mrays_per_wall_second),
        ratio(ratios.map(|ratios| ratios.cpu)),
        ratio(ratios.map(|ratios| ratios.wall)),
    )
}

fn agreements(out: &mut String, agreements: &[Agreement]) -> Result {
    if agreements.is_empty() {
        return Ok(());
    }
    out.push_str(AGREE_HEAD);
    for found in agreements {
        let share = found.differing() as f64 / found.rays.max(1) as f64;
        writeln!(
            out,
            "| {} | {} | {}, {} | {} | {} | {}, {} | {} | {} | {:.1e}, {:.1e} | {share:.1e} of the rays | {}: {} |",
            found.against,
            found.rays,
            found.kiln_hits,
            found.peer_hits,
            found.hit_differs,
            found.distance_differs,
            found.kiln_off_f64,
            found.peer_off_f64,
            found.ties,
            found.side_differs,
            found.mean_within,
            found.greatest_within,
            found.kiln_wrong,
            if found.holds() { "agrees" } else { "DISAGREES" }
        )?;
    }
    let worst = || agreements.iter().flat_map(|found| found.worst.iter().map(|worst| (&found.against, worst)));
    if worst().next().is_some() {
        out.push_str("\nRays that differ the most:\n\n");
    }
    worst().try_for_each(|(against, worst)| disagreement(out, against, worst))
}

fn disagreement(out: &mut String, against: &str, worst: &Disagreement) -> Result {
    let Disagreement { ray, origin, direction, kiln, peer, f64_t, .. } = worst;
    let hit = |hit: &super::files::FileHit| {
        let side = if hit.is_back { ", back" } else { "" };
        if hit.is_hit() { format!("{} (triangle {}{side})", hit.t, hit.triangle) } else { "a miss".to_owned() }
    };
    writeln!(
        out,
        "- ray {ray} from {origin:?} to {direction:?}: Kiln {}, {against} {}; in f64 {f64_t:.9}",
        hit(kiln),
        hit(peer)
    )
}
