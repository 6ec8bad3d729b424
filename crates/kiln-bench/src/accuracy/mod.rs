//! `kiln bench accuracy`: error against time and rays of several ways to bake.

mod bake;
mod curve;
mod derive;
mod errors;
mod markdown;
mod measure;
mod plain;
mod points;
mod points_file;
mod random;
mod random_rays;
mod report;
mod scene;
mod settings;
mod summary;
pub(crate) mod svg;
mod table;
#[cfg(test)]
mod tests;
mod truth;
mod variant;

use crate::clock::Stopwatch;
use crate::{BenchError, Provenance};
use measure::Plan;
use report::{Report, SceneReport};
use scene::BenchScene;
use std::{path::PathBuf, str::FromStr};
use variant::Family;

/// Options of `kiln bench accuracy`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln bench accuracy duck.glb --quick
  kiln bench accuracy duck.glb:0.1,15 collision_world.glb:2,300 --seeds 5 --json-out accuracy.json --svg-out accuracy.svg")]
pub struct Args {
    /// Levels, each with half-distances of its own if wanted: SCENE.glb[:D1,D2…]
    #[arg(required = true, value_name = "SCENE[:D1,D2]")]
    scenes: Vec<SceneArg>,
    /// Half-distances in metres of levels without their own, or `auto`
    #[arg(long, value_name = "D1,D2…", default_value = "auto")]
    half_distance: HalfDistances,
    /// What to measure: kiln, fixed, random, vertices, average, alpha0, alpha1 [default: all]
    #[arg(long, value_name = "V1,V2…", value_delimiter = ',')]
    variants: Vec<Family>,
    /// How often each variant is run, each time with another seed
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// One seed
    #[arg(long, conflicts_with = "seeds")]
    quick: bool,
    /// Points at which results are compared with the true signal
    #[arg(long, value_name = "N", default_value_t = 3000)]
    points: u32,
    /// Rays at each of these points
    #[arg(long, value_name = "N", default_value_t = 2048, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    truth_rays: u32,
    /// Bake about this many faces of a level, in whole pieces spread evenly; all of it occludes. 0: all faces
    #[arg(long, value_name = "N", default_value_t = 16_384)]
    faces: u64,
    /// Leave out variants that would take more rays than this in one run
    #[arg(long, value_name = "N", default_value_t = 50_000_000)]
    max_rays: u64,
    /// Rays per face of the reference that estimation errors are measured against
    #[arg(long, value_name = "N", default_value_t = 16_384, value_parser = clap::value_parser!(u32).range(128..=1 << 24))]
    reference_rays_per_face: u32,
    /// Write the points of the scene and the signal there, for `kiln probe --points` and other tools; needs one scene
    #[arg(long, value_name = "FILE.json")]
    points_out: Option<PathBuf>,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE.json")]
    json_out: Option<PathBuf>,
    /// Write the plot
    #[arg(long, value_name = "FILE.svg")]
    svg_out: Option<PathBuf>,
    /// Write the document
    #[arg(long, value_name = "FILE.md")]
    markdown_out: Option<PathBuf>,
}

/// A level and its half-distances.
#[derive(Clone, Debug, PartialEq)]
struct SceneArg {
    path: PathBuf,
    half_distances: Option<HalfDistances>,
}

/// `auto`, or a list.
#[derive(Clone, Debug, PartialEq)]
struct HalfDistances(Option<Vec<f64>>);

impl FromStr for HalfDistances {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self(None));
        }
        let one = |part: &str| match part.trim().parse::<f64>() {
            Ok(d) if d.is_finite() && d > 0.0 => Ok(d),
            _ => Err(format!("{part:?} is no positive length in metres")),
        };
        text.split(',').map(one).collect::<Result<_, _>>().map(|all| Self(Some(all)))
    }
}

impl FromStr for SceneArg {
    type Err = String;

    /// A colon may also be part of the path: what follows it must then not look like half-distances.
    fn from_str(text: &str) -> Result<Self, String> {
        let split = text.rsplit_once(':').and_then(|(path, tail)| Some((path, tail.parse().ok()?)));
        Ok(match split {
            Some((path, half_distances)) => Self { path: path.into(), half_distances: Some(half_distances) },
            None => Self { path: text.into(), half_distances: None },
        })
    }
}

/// Measures all scenes and reports.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub fn run(args: &Args) -> Result<(), BenchError> {
    if args.points_out.is_some() && args.scenes.len() > 1 {
        return Err(BenchError::Usage("--points-out needs one scene; run it once for each".to_owned()));
    }
    let (watch, provenance, plan) = (Stopwatch::start(), Provenance::now(), args.plan());
    let mut scenes = Vec::new();
    for wanted in &args.scenes {
        let scene = args.measure(wanted, &plan)?;
        print!("{}", table::scene(&scene));
        scenes.push(scene);
    }
    let report = Report::new(provenance, plan.seeds, watch.read().wall_secs, scenes);
    print!("{}", table::overall(&report.overall));
    args.write(&report)
}

impl Args {
    #[expect(clippy::print_stderr, reason = "what it is doing, beside the command's output")]
    fn measure(&self, wanted: &SceneArg, plan: &Plan) -> Result<SceneReport, BenchError> {
        let half_distances = wanted.half_distances.as_ref().unwrap_or(&self.half_distance);
        let most_faces = (self.faces > 0).then_some(self.faces);
        let scene = BenchScene::load(&wanted.path, half_distances.0.as_deref(), most_faces)?;
        eprintln!("{}: points", scene.name);
        let points = measure::true_points(&scene, plan)?;
        if let Some(path) = &self.points_out {
            report::write(path, &points_file::json(&scene, &points, self.truth_rays).to_string())?;
        }
        let result = measure::measure(&scene, plan, points, &mut |what| eprintln!("{}: {what}", scene.name))?;
        Ok(SceneReport::new(result))
    }

    fn write(&self, report: &Report) -> Result<(), BenchError> {
        if let Some(path) = &self.json_out {
            report::write(path, &report::json_text(report)?)?;
        }
        if let Some(path) = &self.svg_out {
            report::write(path, &svg::draw(&report.scenes, &report.provenance.sentence()))?;
        }
        if let Some(path) = &self.markdown_out {
            report::write(path, &markdown::document(report, self.svg_out.as_deref()))?;
        }
        Ok(())
    }

    fn plan(&self) -> Plan {
        let all = self.variants.is_empty();
        Plan {
            families: Family::ALL.into_iter().filter(|family| all || self.variants.contains(family)).collect(),
            seeds: if self.quick { 1 } else { self.seeds },
            points: self.points as usize,
            truth_rays: self.truth_rays,
            reference_rays_per_face: self.reference_rays_per_face,
            most_rays: self.max_rays,
        }
    }
}
