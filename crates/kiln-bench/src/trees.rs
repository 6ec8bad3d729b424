//! `kiln bench trees`: how well four numbers and a model's own AO stand for trees in several surroundings, against what is
//! traced on each of them (Sloan et al. 2013, Figure 2, as a table).

use crate::{BenchError, Provenance, baked, scratch::Scratch};
use kiln_scene::{BakedPart, BakedScene, LevelFiles, example::planted};
use serde::Deserialize;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Options of `kiln bench trees`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln bench trees kit/tree_oak.glb kit/tree_fir.glb")]
pub struct Args {
    /// Models of trees, each a file of its own
    #[arg(value_name = "MODEL", required = true)]
    models: Vec<PathBuf>,
    /// Keep the level that the trees are planted in
    #[arg(long, value_name = "LEVEL.glb")]
    level_out: Option<PathBuf>,
}

#[derive(Deserialize)]
struct Foliage {
    models: Vec<Model>,
}

#[derive(Deserialize)]
struct Model {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    node: String,
    errors: Vec<Errors>,
}

#[derive(Clone, Copy, Default, Deserialize)]
struct Errors {
    global_only: f64,
    local_global: f64,
    alternated: f64,
}

/// Runs the measurement and prints its table.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &Args) -> Result<(), BenchError> {
    let scratch = Scratch::new("trees")?;
    let level = args.level_out.clone().unwrap_or_else(|| scratch.path().join("planted.glb"));
    let bad = |path: &Path, reason: String| BenchError::File { path: path.to_path_buf(), reason };
    let mut files = Vec::new();
    for path in &args.models {
        let read = LevelFiles::read(path, None).map_err(|error| bad(path, error.to_string()))?;
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        files.push((stem, read));
    }
    let models: Vec<_> = files.iter().map(|(name, read)| (name.as_str(), read.name.as_str(), &read.files)).collect();
    let glb = planted(&models).map_err(|source| BenchError::Import { path: args.models[0].clone(), source })?;
    std::fs::write(&level, glb).map_err(|error| bad(&level, error.to_string()))?;

    let traced = baked::bake(&level, &["--trees", "traced", "--half-distance", "2,300"], scratch.path())?;
    let volume = baked::bake(&level, &["--trees", "volume", "--half-distance", "2,300"], scratch.path())?;
    let foliage: Foliage = serde_json::from_value(traced.report["foliage"].clone())
        .map_err(|error| BenchError::Failed { step: "report", reason: error.to_string() })?;
    let apart = differences(&traced.scene, &volume.scene);

    println!("{}; trees against direct trace, RMSE at 2 m and 300 m\n", Provenance::now().sentence());
    println!("| tree | global only | local × global | alternated | volume's fit from the traced one's |");
    println!("|---|---|---|---|---|");
    let mut sums = [[0.0; 4]; 2];
    let mut count = 0.0;
    for node in foliage.models.iter().flat_map(|model| &model.nodes) {
        let apart = apart.get(&node.node).copied().unwrap_or_default();
        let of = |part: fn(&Errors) -> f64| {
            let all: Vec<String> = node.errors.iter().map(|errors| format!("{:.3}", part(errors))).collect();
            all.join(" / ")
        };
        let (global, local, both) = (of(|e| e.global_only), of(|e| e.local_global), of(|e| e.alternated));
        println!("| {} | {global} | {local} | {both} | {:.3} / {:.3} |", node.node, apart[0], apart[1]);
        for ((sums, errors), apart) in sums.iter_mut().zip(&node.errors).zip(apart) {
            let all = [errors.global_only, errors.local_global, errors.alternated, apart];
            sums.iter_mut().zip(all).for_each(|(sum, error)| *sum += error * error);
        }
        count += 1.0;
    }
    let mean = |column: usize| {
        let all: Vec<String> = sums.iter().map(|sums| format!("{:.3}", (sums[column] / count).sqrt())).collect();
        all.join(" / ")
    };
    println!("| all | {} | {} | {} | {} |", mean(0), mean(1), mean(2), mean(3));
    Ok(())
}

/// Root mean square over the area of the difference of what is shown of each node, for each of two half-distances.
fn differences(a: &BakedScene, b: &BakedScene) -> BTreeMap<String, [f64; 2]> {
    let mut sums: BTreeMap<String, ([f64; 2], f64)> = BTreeMap::new();
    for (a, b) in a.parts.iter().zip(&b.parts).filter(|(a, b)| a.channels == 2 && b.channels == 2) {
        let (sum, area) = sums.entry(a.node.clone()).or_default();
        for face in &a.faces {
            let weight = baked::double_area_m2(a, face);
            *area += weight;
            for (channel, sum) in sum.iter_mut().enumerate() {
                let mean = |part: &BakedPart| {
                    face.iter().map(|vertex| f64::from(part.ao[*vertex as usize * 2 + channel])).sum::<f64>() / 3.0
                };
                *sum += weight * (mean(a) - mean(b)).powi(2);
            }
        }
    }
    sums.into_iter()
        .map(|(node, (sum, area))| (node, sum.map(|sum| (sum / area.max(f64::MIN_POSITIVE)).sqrt())))
        .collect()
}
