//! `kiln bench regions`: how well models of visibility regions stand for what moving objects see, by rule, at points and normals
//! that no model was fitted to; how far neighbours' models are apart on their boundaries; and what all of it costs.

mod cost;
mod held_out;
mod jumps;

use crate::{BenchError, Provenance, imported::import_as};
use held_out::{HeldOut, Rmse};
use jumps::Jumps;
use kiln_bake::{RegionGather, gather_regions};
use kiln_core::{Digest, FoliageMode, Kernel, Level, RegionModels, RegionSamples, SkipRule};
use kiln_solve::{
    model_regions,
    region::{CenterRule, RegionFit, fit_region, region_points},
};
use kiln_trace::Tracer;
use kiln_worker::tasks::{Backend, LoadedLevel};
use rayon::prelude::*;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

/// Options of `kiln bench regions`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln regions house.glb -o house.kiln.toml; kiln bench regions house.glb
  kiln bench regions cave.glb hall.glb --held-out 16")]
pub struct Args {
    /// Levels whose sidecars, beside them, have regions
    #[arg(value_name = "LEVEL", required = true)]
    levels: Vec<PathBuf>,
    /// Points and normals in each region at which models are compared with what is traced
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1024))]
    held_out: u32,
    /// Rays of each of them
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(64..=1_048_576))]
    rays: u32,
    /// Rays of each point in place of the bake's number, which depends on how many points a region has
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=32_768))]
    point_rays: Option<u32>,
    /// Draw neighbours together by this weight in place of the sidecar's (β)
    #[arg(long, value_name = "BETA")]
    smoothing: Option<f64>,
}

/// Rules, in the order of the columns.
const RULES: [(CenterRule, &str); 6] = [
    (CenterRule::Mean, "mean only"),
    (CenterRule::Gradient, "one gradient"),
    (CenterRule::Points, "7, points' mean"),
    (CenterRule::Box, "7, box's middle"),
    (CenterRule::Best, "7, the better"),
    (CenterRule::Refined, "7, refined"),
];

/// What was found on one level.
struct Found {
    name: String,
    half_distances: String,
    models: RegionModels,
    trace_secs: f64,
    model_secs: f64,
    held_out: usize,
    /// By rule, then with small ones absorbed, and after smoothing, then what the harmonics at the very point leave.
    rmse: Vec<Rmse>,
    jumps: Jumps,
}

/// Runs the measurement and prints its tables.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &Args) -> Result<(), BenchError> {
    println!("{}; models of visibility regions\n", Provenance::now().sentence());
    let found = args.levels.iter().map(|path| measure(path, args)).collect::<Result<Vec<Found>, _>>()?;
    println!(
        "| level | half-distances | regions (absorbed) | valid points (dropped) | trace, s | models, s | 332,741 points, s |"
    );
    println!("|---|---|---|---|---|---|---|");
    for level in &found {
        let s = &level.models.summary;
        let per_point = level.trace_secs / (s.points.max(1) as f64);
        println!(
            "| {} | {} | {} ({}) | {} ({}) | {:.2} | {:.3} | {:.1} |",
            level.name,
            level.half_distances,
            s.regions,
            s.absorbed,
            s.points,
            s.dropped,
            level.trace_secs,
            level.model_secs,
            332_741.0 * per_point
        );
    }
    println!(
        "\nThe paper's 332,741 points took 9.2 s on a K20: a landmark. RMSE of AO at held-out points and normals:\n"
    );
    let names: Vec<&str> = RULES
        .iter()
        .map(|(_, name)| *name)
        .chain(["small ones absorbed", "smoothed", "harmonics at the point"])
        .collect();
    println!("| level | held out | {} |", names.join(" | "));
    println!("|---{}|", "|---".repeat(names.len() + 1));
    for level in &found {
        let all: Vec<String> = level.rmse.iter().map(Rmse::text).collect();
        println!("| {} | {} | {} |", level.name, level.held_out, all.join(" | "));
    }
    println!(
        "\nJumps of AO where regions meet, root mean square by area over six normals; and the greatest change in one frame\n"
    );
    println!(
        "| level | boundaries | as fitted | smoothed | smoothed and blended over time, in a frame | shrunk | refined | sweeps | energy |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for level in &found {
        let s = &level.models.summary;
        // Without smoothing it is 0, and stays so.
        let energy = s.energy.first().zip(s.energy.last()).filter(|(first, _)| **first > 0.0);
        let energy = energy.map_or(1.0, |(first, last)| last / first);
        println!(
            "| {} | {} | {} | {} | {} | {} | {} | {} | {:.3} of before |",
            level.name,
            level.jumps.boundaries,
            level.jumps.fitted.text(),
            level.jumps.smoothed.text(),
            level.jumps.blended.text(),
            s.shrunk,
            s.refined,
            s.sweeps,
            energy
        );
    }
    print!("{}", cost::table()?);
    Ok(())
}

fn measure(path: &Path, args: &Args) -> Result<Found, BenchError> {
    let name = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let imported = import_as(path, FoliageMode::default())?;
    let failed = |reason: String| BenchError::Failed { step: "models of regions", reason: format!("{name}: {reason}") };
    let mut level = imported.level;
    if level.regions.regions.is_empty() {
        let advice = "make them: kiln regions LEVEL.glb -o LEVEL.kiln.toml";
        return Err(failed(format!("its sidecar has no visibility regions; {advice}")));
    }
    level.regions.settings.smoothing = args.smoothing.unwrap_or(level.regions.settings.smoothing);
    if let Some(rays) = args.point_rays {
        level.regions.settings.rays_per_point = rays.next_power_of_two();
        level.sampling.no_skip.insert(SkipRule::Adaptive);
    }
    let loaded =
        LoadedLevel::new(Digest::default(), level, imported.meshes).map_err(|error| failed(error.to_string()))?;
    let (_, tracer) = loaded.tracer(&Backend::Cpu).map_err(|error| failed(error.to_string()))?;
    let (level, tracer): (&Level, &dyn Tracer) = (&loaded.level, &**tracer);
    let began = Instant::now();
    let samples = gather(level, tracer).map_err(|error| failed(error.to_string()))?;
    let trace_secs = began.elapsed().as_secs_f64();
    let began = Instant::now();
    let models = model_regions(&level.regions, &samples).map_err(|error| failed(error.to_string()))?;
    let model_secs = began.elapsed().as_secs_f64();
    let points = region_points(&level.regions.regions, &samples).map_err(|error| failed(error.to_string()))?;
    let held_out = HeldOut::trace(level, tracer, &samples, args).map_err(|error| failed(error.to_string()))?;
    let fits: Vec<Vec<RegionFit>> =
        RULES.iter().map(|(rule, _)| points.par_iter().map(|points| fit_region(points, *rule)).collect()).collect();
    let mut rmse: Vec<Rmse> =
        fits.iter().map(|fits| held_out.rmse(|region, point| fits[region].at(point).collect())).collect();
    let mut unsmoothed = level.regions.clone();
    unsmoothed.settings.smoothing = 0.0;
    let absorbed = model_regions(&unsmoothed, &samples).map_err(|error| failed(error.to_string()))?;
    rmse.push(held_out.rmse(|region, point| absorbed.models[absorbed.model_of[region] as usize].at(point).collect()));
    let smoothed = |region: usize, point| models.models[models.model_of[region] as usize].at(point).collect();
    rmse.push(held_out.rmse(smoothed));
    rmse.push(held_out.rmse_of_harmonics());
    let refined = &fits[RULES.len() - 1];
    let jumps = Jumps::measure(level, |region, point| refined[region].at(point).collect(), smoothed);
    Ok(Found {
        half_distances: half_distances(&level.sampling.kernel),
        name,
        trace_secs,
        model_secs,
        held_out: held_out.len(),
        rmse,
        jumps,
        models,
    })
}

/// All regions, side by side; what comes of it does not depend on that.
fn gather(level: &Level, tracer: &dyn Tracer) -> Result<RegionSamples, kiln_trace::TraceError> {
    let settings = RegionGather::of(level);
    let regions = level.regions.regions.par_iter();
    let runs = regions.map(|region| gather_regions(tracer, std::slice::from_ref(region), &settings));
    Ok(RegionSamples::joined(level.sampling.kernel.channel_count(), runs.collect::<Result<Vec<_>, _>>()?))
}

fn half_distances(kernel: &Kernel) -> String {
    match kernel {
        Kernel::Obscurance { half_distances_m } => {
            let all: Vec<String> = half_distances_m.iter().map(|distance| format!("{distance:.3} m")).collect();
            all.join(", ")
        }
        Kernel::Occlusion { ray_distance_m } => format!("occlusion to {ray_distance_m} m"),
    }
}
