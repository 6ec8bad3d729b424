//! `kiln bench foliage`: what trees and shrubs do to what stands under them, by each mode, against a reference bake of their real
//! geometry; and what each costs.

use crate::{
    BenchError, Provenance,
    baked::{self, double_area_m2},
    imported::import_as,
    scratch::Scratch,
};
use kiln_core::{Class, FoliageMode};
use kiln_scene::BakedScene;
use kiln_trace::Scene;
use kiln_worker::tasks::{Backend, LoadedLevel};
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

/// Options of `kiln bench foliage`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln bench foliage level.glb --only 'terrain*'")]
pub struct Args {
    /// The level; a sidecar beside it says what is foliage
    #[arg(value_name = "LEVEL")]
    level: PathBuf,
    /// What is baked and compared
    #[arg(long, value_name = "GLOB", default_value = "terrain*")]
    only: String,
}

/// Ways to bake.
const MODES: [&str; 3] = ["expected", "attenuate", "geometry"];

/// Runs the measurement and prints its tables.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &Args) -> Result<(), BenchError> {
    println!("{}; foliage over {:?}\n", Provenance::now().sentence(), args.only);
    memory(&args.level)?;
    let scratch = Scratch::new("foliage")?;
    let bake = |options: &[&str]| {
        let folder = scratch.path().join("one");
        std::fs::create_dir_all(&folder)
            .map_err(|error| BenchError::File { path: folder.clone(), reason: error.to_string() })?;
        let began = Instant::now();
        let all = [&["--only", args.only.as_str(), "--half-distance", "2,300"], options].concat();
        let baked = baked::bake(&args.level, &all, &folder)?;
        let seconds = began.elapsed().as_secs_f64();
        // Nothing is known to the next.
        let _ = std::fs::remove_dir_all(&folder);
        Ok::<_, BenchError>((baked, seconds))
    };
    let gold = bake(&["--quality", "reference", "--foliage", "geometry"])?.0;
    println!("| foliage | RMSE 2 m | RMSE 300 m | mean error | bake, s | CPU s | Mrays |");
    println!("|---|---|---|---|---|---|---|");
    for mode in MODES {
        let (baked, seconds) = bake(&["--foliage", mode])?;
        let (rmse, mean) = errors(&baked.scene, &gold.scene);
        let number = |path: &str| baked.report.pointer(path).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN);
        println!(
            "| {} | {:.4} | {:.4} | {:+.4}, {:+.4} | {seconds:.1} | {:.1} | {:.1} |",
            mode,
            rmse[0],
            rmse[1],
            mean[0],
            mean[1],
            number("/cpu_seconds"),
            number("/rays/traced") / 1e6
        );
    }
    Ok(())
}

/// What trees of nodes and triangles come to: of what is opaque in all modes, and of foliage in each.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn memory(path: &Path) -> Result<(), BenchError> {
    let built = |mode: FoliageMode| -> Result<(usize, usize, f64, u64), BenchError> {
        let imported = import_as(path, mode)?;
        let level = imported.level;
        let per_class = |class: Class| level.counts.classes.get(&class).copied().unwrap_or(0);
        let faces = per_class(Class::Tree) + per_class(Class::Shrub);
        let failed = |reason: String| BenchError::Failed { step: "load", reason };
        let loaded = LoadedLevel::new(kiln_core::Digest::default(), level, imported.meshes)
            .map_err(|error| failed(error.to_string()))?;
        let began = Instant::now();
        let scene: &Scene = &loaded.tracer(&Backend::Cpu).map_err(|error| failed(error.to_string()))?.0;
        let seconds = began.elapsed().as_secs_f64();
        Ok((scene.memory_bytes(), scene.foliage().map_or(0, kiln_trace::Foliage::memory_bytes), seconds, faces))
    };
    let (soft, foliage, soft_secs, _) = built(FoliageMode::Expected)?;
    let (solid, _, solid_secs, faces) = built(FoliageMode::Geometry)?;
    let instanced = solid - (soft - foliage).min(solid);
    let mib = |bytes: f64| bytes / f64::from(1 << 20);
    println!("Memory of trees of boxes for foliage, and the time to build all trees of the level:\n");
    println!("| foliage as | MiB | of fog and crossings | level built in, s |");
    println!("|---|---|---|---|");
    println!("| fog boxes, tree models with crossings | {:.2} | 1 | {soft_secs:.2} |", mib(foliage as f64));
    let ratio = |bytes: f64| bytes / foliage.max(1) as f64;
    println!(
        "| instances of real geometry | {:.2} | {:.1} | {solid_secs:.2} |",
        mib(instanced as f64),
        ratio(instanced as f64)
    );
    // Each copy in the one tree, as without instancing, at the bytes that a face of a mesh takes.
    let copies = faces as f64 * BYTES_PER_FACE;
    println!("| copies of real geometry, {faces} faces | {:.2} | {:.1} | |\n", mib(copies), ratio(copies));
    Ok(())
}

/// Bytes of nodes and triangles for each face of a flattened level of 1.8 million faces (docs/benchmarks/rays.md).
const BYTES_PER_FACE: f64 = 46.9;

/// RMSE and mean of the difference over the area of what both have values for.
fn errors(baked: &BakedScene, gold: &BakedScene) -> ([f64; 2], [f64; 2]) {
    let (mut squares, mut sums, mut area) = ([0.0; 2], [0.0; 2], 0.0);
    for (a, b) in baked.parts.iter().zip(&gold.parts).filter(|(a, b)| a.channels == 2 && b.channels == 2) {
        for face in &a.faces {
            let weight = double_area_m2(a, face) / 3.0;
            for vertex in face {
                area += weight;
                for channel in 0..2 {
                    let at = *vertex as usize * 2 + channel;
                    let difference = f64::from(a.ao[at]) - f64::from(b.ao[at]);
                    squares[channel] += weight * difference * difference;
                    sums[channel] += weight * difference;
                }
            }
        }
    }
    (squares.map(|sum| (sum / area).sqrt()), sums.map(|sum| sum / area))
}
