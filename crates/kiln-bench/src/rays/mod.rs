//! `kiln bench rays`: rays per second, time and memory of building, and agreement with another tracer ray by ray.

mod agree;
mod both_ways;
mod build;
pub(crate) mod case;
mod contest;
mod files;
mod lap;
mod peer;
mod predicted;
pub(crate) mod scaling;
mod surface;
mod table;
#[cfg(test)]
mod tests;

use crate::{BenchError, Provenance, scratch::Scratch};
use both_ways::BothWays;
use build::{Build, BuildPlace};
use case::{Case, Input, RayCounts};
use contest::{Plan, Standings};
use files::Paths;
use kiln_worker::tasks::Backend;
use peer::Peer;
use predicted::{Predicted, Traced};
use rayon::ThreadPool;
use serde::Serialize;
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// Options of `kiln bench rays`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln bench rays level.glb
  kiln bench rays level.glb --flatten --peer ./embree-peer --markdown-out rays.md
  kiln bench rays cave collision_world --peer ./embree-peer      reads cave.pos, cave.idx, cave.rays, and so on
  KILN_GPU=software kiln bench rays --backend gpu --ray-queries level.glb
                                          traces the same rays by the card's ray queries and without, and compares
  kiln bench rays --scaling level.glb --svg-out scaling.svg --json-out scaling.json")]
pub struct Args {
    /// Levels, .glb or .gltf, whose rays are made here; or PREFIX for PREFIX.pos, PREFIX.idx and PREFIX.rays (formats:
    /// docs/benchmarks/rays.md)
    #[arg(value_name = "LEVEL|PREFIX")]
    scenes: Vec<Input>,
    /// A comparison program, built by the command at the head of tests/peers/embree.cpp
    #[arg(long, value_name = "PROGRAM")]
    peer: Option<PathBuf>,
    /// Numbers of threads to measure with [default: 1, and --threads]
    #[arg(long, value_name = "N1,N2…", value_delimiter = ',', value_parser = clap::value_parser!(u16).range(1..=1024))]
    thread_counts: Vec<u16>,
    /// Repetitions, in each of which the tracers take turns
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    reps: u32,
    /// Measure rates with every so manieth run of 1,024 points only
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    stride: u32,
    /// Points on the surfaces of a level
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..=1 << 24))]
    points: u32,
    /// Rays at each of these points
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1 << 15))]
    rays_per_point: u32,
    /// Rays at each point when the tracer makes and sums them itself, powers of two
    #[arg(long, value_name = "K1,K2…", value_delimiter = ',', default_values_t = [16, 64], value_parser = gather_count)]
    gather: Vec<u32>,
    /// All instances of a level as one mesh
    #[arg(long)]
    flatten: bool,
    /// Write the closest hit of each ray; needs one scene
    #[arg(long, value_name = "HITS")]
    out: Option<PathBuf>,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE.json")]
    json_out: Option<PathBuf>,
    /// Write the tables as a document
    #[arg(long, value_name = "FILE.md")]
    markdown_out: Option<PathBuf>,
    /// Instead: cost against the number of triangles and of instances, of scenes made by code and of the given ones
    #[arg(long, conflicts_with_all = ["peer", "out", "flatten", "markdown_out"])]
    scaling: bool,
    /// With --scaling: write the plot
    #[arg(long, value_name = "FILE.svg", requires = "scaling")]
    svg_out: Option<PathBuf>,
    /// With --scaling: leave out scenes made by code with more triangles, or more instances, than this
    #[arg(long, value_name = "N", requires = "scaling", default_value_t = u64::MAX, hide_default_value = true)]
    most: u64,
    /// Builds one scene and prints what it took: what the command runs in a process of its own
    #[arg(long, hide = true)]
    build_only: bool,
}

fn gather_count(text: &str) -> Result<u32, String> {
    let count = text.parse().ok().filter(|count: &u32| count.is_power_of_two() && *count <= 1 << 15);
    count.ok_or_else(|| "not a power of two up to 32768".to_owned())
}

/// What was found on one scene.
#[derive(Debug, Serialize)]
struct SceneReport {
    name: String,
    points: usize,
    rays_per_point: usize,
    diagonal_m: f32,
    /// For each number of threads.
    builds: Vec<Build>,
    #[serde(flatten)]
    standings: Standings,
    /// On a graphics device: the model's rates beside the measured.
    predicted: Vec<Predicted>,
    /// On a graphics device that traces by ray queries: the software traversal beside them.
    ray_queries: Option<BothWays>,
}

/// What is written as JSON.
#[derive(Serialize)]
struct Report {
    provenance: Provenance,
    /// Where Kiln's rays were traced.
    backend: String,
    scenes: Vec<SceneReport>,
}

/// Measures, and prints the tables. Builds are the CPU's on every backend.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub fn run(args: &Args, backend: &Backend) -> Result<(), BenchError> {
    if args.build_only {
        let [input] = args.scenes.as_slice() else {
            return Err(BenchError::Usage("--build-only needs one scene".to_owned()));
        };
        println!("{}", json_text(&Build::of(&build::load(input, args.flatten)?, args.reps as usize))?);
        return Ok(());
    }
    if args.scaling {
        return scaling::run(args, backend);
    }
    args.check()?;
    let (provenance, place) = (Provenance::now(), BuildPlace::process()?);
    println!("{}; rays on {}", provenance.sentence(), backend.describe());
    let mut scenes = Vec::new();
    for input in &args.scenes {
        let report = args.measure(input, backend, &place)?;
        print!("{}", table::scene(&report));
        scenes.push(report);
    }
    if args.peer.is_none() {
        println!("\nNo --peer: {}.", peer::HOW_TO_BUILD);
    }
    args.write(&Report { provenance, backend: backend.describe(), scenes })
}

impl Args {
    fn check(&self) -> Result<(), BenchError> {
        let problem = match self.scenes.len() {
            0 => "name a level, a .glb, or PREFIX of PREFIX.pos, PREFIX.idx and PREFIX.rays; or use --scaling",
            2.. if self.out.is_some() => "--out needs one scene; run it once for each",
            _ => return Ok(()),
        };
        Err(BenchError::Usage(problem.to_owned()))
    }

    fn threads(&self) -> Vec<usize> {
        let given = self.thread_counts.iter().map(|count| usize::from(*count));
        let all = [1, rayon::current_num_threads()];
        let mut threads: Vec<usize> = if self.thread_counts.is_empty() { all.to_vec() } else { given.collect() };
        threads.dedup();
        threads
    }

    fn plan(&self, backend: &Backend) -> Plan {
        let peer = |is_robust| self.peer.iter().map(move |program| Peer { program: program.clone(), is_robust });
        Plan {
            threads: self.threads(),
            reps: self.reps as usize,
            stride: self.stride as usize,
            gather: self.gather.clone(),
            peers: peer(false).chain(peer(true)).collect(),
            is_cpu: matches!(backend, Backend::Cpu),
        }
    }

    fn counts(&self) -> RayCounts {
        RayCounts { points: self.points as usize, per_point: self.rays_per_point as usize }
    }

    #[expect(clippy::print_stderr, reason = "what it is doing, beside the command's output")]
    fn measure(&self, input: &Input, backend: &Backend, place: &BuildPlace) -> Result<SceneReport, BenchError> {
        let case = Case::read(input, self.counts())?;
        let case = if self.flatten { case.flatten() } else { case };
        let mut progress = |what: &str| eprintln!("{}: {what}", case.name);
        progress("build");
        let build = |threads| place.measure(input, self.flatten, threads, self.reps as usize);
        let builds = self.threads().into_iter().map(build).collect::<Result<_, _>>()?;
        let scene = Arc::new(case.build());
        let traced = Traced::new(backend, &scene)?;
        let scratch = Scratch::new("rays")?;
        let paths = self.paths(input, &case, scratch.path())?;
        if let Some(path) = &self.out {
            files::write_hits(path, &contest::hits(&case, traced.tracer())?)?;
        }
        let standings = self.plan(backend).hold(&case, traced.tracer(), &paths, scratch.path(), &mut progress)?;
        let predicted = predicted::compare(&traced, &case, &standings)?;
        let ray_queries = both_ways::compare(&traced, &scene, &case, &self.plan(backend), &mut progress)?;
        Ok(SceneReport {
            points: case.rays.origins.len(),
            rays_per_point: case.rays.per_point,
            diagonal_m: case.rays.diagonal_m,
            name: case.name,
            builds,
            standings,
            predicted,
            ray_queries,
        })
    }

    /// The scene's files, which for a level are written if a peer is to read them.
    fn paths(&self, input: &Input, case: &Case, folder: &Path) -> Result<Paths, BenchError> {
        let Input::Level(_) = input else { return Ok(Paths::of(input.path())) };
        let paths = Paths::of(&folder.join("scene"));
        if self.peer.is_some() {
            paths.write(&case.flat_mesh(), &case.rays)?;
        }
        Ok(paths)
    }

    fn write(&self, report: &Report) -> Result<(), BenchError> {
        if let Some(path) = &self.json_out {
            files::write(path, json_text(report)?.as_bytes())?;
        }
        if let Some(path) = &self.markdown_out {
            let Provenance { date, command, .. } = &report.provenance;
            let head = format!(
                "## {date}\n\nMachine and code: {}. Rays on {}. Made by `{command}`.\n",
                report.provenance.sentence(),
                report.backend
            );
            let tables: Vec<String> = report.scenes.iter().map(table::scene).collect();
            files::write(path, (head + &tables.concat()).as_bytes())?;
        }
        Ok(())
    }
}

fn pool(threads: usize) -> Result<ThreadPool, BenchError> {
    let failed = |reason: String| BenchError::Failed { step: "starting threads", reason };
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|error| failed(error.to_string()))
}

fn json_text(value: &impl Serialize) -> Result<String, BenchError> {
    serde_json::to_string(value).map_err(|error| BenchError::Failed { step: "JSON", reason: error.to_string() })
}
