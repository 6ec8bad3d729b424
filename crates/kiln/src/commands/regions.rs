//! `kiln regions`: visibility regions for a level that has none.

use crate::{
    args::{Common, RegionsArgs},
    failure::Failure,
    outcome::write_whole,
    source::Source,
};
use glam::DVec3;
use kiln_bake::regions::{MadeRegions, SolidObject, make_regions};
use kiln_core::{BakeSettings, Instance, RegionSettings, Regions};
use kiln_scene::region_tables;
use kiln_worker::tasks::{Backend, LoadedLevel};
use serde_json::json;
use std::time::Instant;

/// A region of less than so many cells is nothing to speak of, where cells are so small that the usual bound in cubic metres is
/// more.
const SMALL_REGION_CELLS: f64 = 64.0;

pub(crate) fn run(args: &RegionsArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let start = Instant::now();
    let source = Source::read(&args.level, args.sidecar.as_deref())?;
    let level = super::load(&source, &BakeSettings::default())?;
    refuse_regions(&source, &level)?;
    let origin = level.level.origin_m;
    let mut settings = args.settings();
    settings.seeds = args.seed_point.iter().map(|seed| DVec3::from(*seed) - origin).collect();

    let (_, tracer) = level.tracer(&Backend::Cpu).map_err(anyhow::Error::from)?;
    let name = args.level.display();
    let refused = |error| Failure::refused(format!("{name}: {error}"));
    let made = make_regions(&solid_objects(&level), &**tracer, &settings).map_err(refused)?;
    let text = continued(&source, &made, origin);
    write_whole(&args.output, text.as_bytes())?;
    print(args, &made, start.elapsed().as_secs_f64(), common);
    Ok(())
}

/// A level has its regions from one source.
fn refuse_regions(source: &Source, level: &LoadedLevel) -> Result<(), Failure> {
    let count = level.level.regions.regions.len();
    match source.sidecar() {
        Some(sidecar) if count > 0 => Err(Failure::refused(format!(
            "{}: the level has {count} regions already; remove its [[region]] and [[edge]] tables first",
            sidecar.name
        ))),
        _ => Ok(()),
    }
}

/// What is drawn at first; lower levels of detail stand in its place.
fn solid_objects(level: &LoadedLevel) -> Vec<SolidObject<'_>> {
    let object = |instance: &Instance| SolidObject {
        mesh: &level.meshes[instance.mesh as usize],
        world_from_object: instance.world_from_object,
    };
    level.level.instances.iter().filter(|instance| !instance.is_lod()).map(object).collect()
}

/// The level's sidecar as it is, and the regions.
fn continued(source: &Source, made: &MadeRegions, origin: DVec3) -> String {
    let mut text = source.sidecar().map_or(String::new(), |sidecar| sidecar.text.to_owned());
    if !text.is_empty() && !text.ends_with('\n') {
        text.push('\n');
    }
    let cell_m = made.summary.cell_m;
    let mut settings = RegionSettings::default();
    let is_about_models =
        |line: &str| line.trim_start().trim_start_matches('[').trim_start().starts_with("region_models");
    if !text.lines().any(is_about_models) {
        settings.min_volume_m3 = small_volume(cell_m).min(settings.min_volume_m3);
    }
    let regions = Regions { regions: made.regions.clone(), edges: made.edges.clone(), settings };
    let digits = (-cell_m.log10()).ceil().max(0.0) as usize;
    text + &region_tables(&regions, origin, digits + 4)
}

/// Volume of a region that is nothing to speak of, two digits of it.
fn small_volume(cell_m: f64) -> f64 {
    let volume = SMALL_REGION_CELLS * cell_m.powi(3);
    format!("{volume:.1e}").parse().unwrap_or(volume)
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print(args: &RegionsArgs, made: &MadeRegions, secs: f64, common: &Common) {
    let summary = &made.summary;
    let cells: usize = summary.size.iter().product();
    let cell_volume = summary.cell_m.powi(3);
    let (free_m3, box_m3) = (summary.free_cells as f64 * cell_volume, summary.box_cells as f64 * cell_volume);
    let [x, y, z] = summary.size;
    if common.json {
        let report = json!({
            "path": args.output, "cell_m": summary.cell_m, "size": summary.size, "cells": cells,
            "free_cells": summary.free_cells, "spaces": summary.spaces, "small_spaces": summary.small,
            "shells": summary.shells,
            "back_facing_spaces": summary.back_facing[0], "back_facing_parts": summary.back_facing[1],
            "regions": made.regions.len(), "unfinished": summary.unfinished, "edges": made.edges.len(),
            "free_volume_m3": free_m3, "box_volume_m3": box_m3, "seconds": secs,
        });
        println!("{report}");
        return;
    }
    println!("{cells} cells of {:.4} m ({x} × {y} × {z}), {} of them free", summary.cell_m, summary.free_cells);
    println!(
        "{} connected spaces; left out: {} small ones, {} outside of others' shells, {} that see the backs of faces, and {} parts \
         likewise",
        summary.spaces, summary.small, summary.shells, summary.back_facing[0], summary.back_facing[1]
    );
    println!(
        "{} regions with {} edges, {box_m3:.3} m³, of which {free_m3:.3} m³ are free",
        made.regions.len(),
        made.edges.len()
    );
    if summary.unfinished > 0 {
        println!("{} regions are larger or less even than they should be, for --max-regions", summary.unfinished);
    }
    println!("wrote {} in {secs:.1} s", args.output.display());
}
