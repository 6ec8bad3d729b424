//! `kiln bench rays --scaling`: what building and tracing cost as scenes grow.

pub(crate) mod plot;
pub(crate) mod shapes;

use super::{
    Args,
    build::Build,
    case::{Case, RayCounts},
    files, json_text,
    lap::{Course, Lap, Mode},
    pool,
    predicted::Traced,
};
use crate::{BenchError, Provenance};
use kiln_worker::tasks::Backend;
use serde::Serialize;
use std::sync::Arc;

/// Triangles of the scenes that are one mesh.
const TRIANGLES: [u32; 6] = [10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000];
/// Instances of the others.
const INSTANCES: [u32; 6] = [1, 10, 100, 1_000, 10_000, 100_000];

/// What a scene is measured for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    /// Made by code, one mesh.
    Triangles,
    /// Made by code, instances of one mesh.
    Instances,
    /// Given on the command line.
    Level,
}

impl Kind {
    /// What a panel has on its horizontal axis.
    fn size(self, scene: &Measured) -> f64 {
        if self == Self::Instances { scene.build.instances as f64 } else { scene.build.triangles as f64 }
    }

    fn label(self) -> &'static str {
        if self == Self::Instances { "instances" } else { "triangles, those of each instance counted" }
    }
}

/// What a scene costs.
#[derive(Debug, Serialize)]
struct Measured {
    kind: Kind,
    name: String,
    build: Build,
    closest: Lap,
    any: Lap,
}

/// What is written as JSON.
#[derive(Serialize)]
struct Report {
    provenance: Provenance,
    backend: String,
    scenes: Vec<Measured>,
}

/// Measures all scenes, and prints the table. Builds use the CPU, whatever the backend.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(super) fn run(args: &Args, backend: &Backend) -> Result<(), BenchError> {
    let provenance = Provenance::now();
    println!("{}; rays on {}\n", provenance.sentence(), backend.describe());
    println!("{HEAD}");
    let mut scenes = Vec::new();
    for (kind, case) in cases(args) {
        let measured = measure(kind, &case?, args, backend)?;
        println!("{}", measured.line());
        scenes.push(measured);
    }
    if let Some(path) = &args.svg_out {
        files::write(path, plot::draw(&scenes, &provenance.sentence()).as_bytes())?;
    }
    let Some(path) = &args.json_out else { return Ok(()) };
    files::write(path, json_text(&Report { provenance, backend: backend.describe(), scenes })?.as_bytes())
}

/// The scenes, each made when its turn comes.
fn cases(args: &Args) -> impl Iterator<Item = (Kind, Result<Case, BenchError>)> {
    let RayCounts { points, per_point } = args.counts();
    // A quarter of the points: there are many scenes, and their rates need not be known to a percent.
    let counts = RayCounts { points: points.div_ceil(4), per_point };
    let most = move |size: &u32| u64::from(*size) <= args.most;
    let triangles =
        TRIANGLES.into_iter().filter(most).map(move |n| (Kind::Triangles, Ok(shapes::by_triangles(n, counts))));
    let instances =
        INSTANCES.into_iter().filter(most).map(move |n| (Kind::Instances, Ok(shapes::by_instances(n, counts))));
    let given = args.scenes.iter().map(move |input| (Kind::Level, Case::read(input, counts)));
    triangles.chain(instances).chain(given)
}

fn measure(kind: Kind, case: &Case, args: &Args, backend: &Backend) -> Result<Measured, BenchError> {
    let reps = args.reps as usize;
    let pool = pool(args.threads().last().copied().unwrap_or(1))?;
    // Memory is that of a process that did other things before, so its peak says nothing.
    let build = Build { peak_bytes: 0, ..pool.install(|| Build::of(case, reps)) };
    let traced = Traced::new(backend, &Arc::new(pool.install(|| case.build())))?;
    let course = Course::new(traced.tracer(), case, args.stride as usize, matches!(backend, Backend::Cpu));
    let best = |mode| -> Result<Lap, BenchError> {
        let mut best = course.run(mode, &pool)?;
        for _ in 1..reps.max(2) {
            best.keep_best(&course.run(mode, &pool)?);
        }
        Ok(best)
    };
    Ok(Measured { kind, name: case.name.clone(), build, closest: best(Mode::Closest)?, any: best(Mode::Any)? })
}

const HEAD: &str = "\
| scene | triangles | instances | build wall s | tree MB | bytes per triangle | closest, Mrays per CPU s | any, Mrays per CPU s | hits |
|---|---|---|---|---|---|---|---|---|";

impl Measured {
    fn line(&self) -> String {
        let Self { name, build, closest, any, .. } = self;
        format!(
            "| {name} | {} | {} | {:.4} | {:.1} | {:.1} | {:.2} | {:.2} | {:.3} |",
            build.triangles,
            build.instances,
            build.wall_secs,
            build.bvh_bytes as f64 / 1e6,
            build.bytes_per_triangle(),
            closest.mrays_per_cpu_second,
            any.mrays_per_cpu_second,
            closest.hit_fraction.unwrap_or(0.0),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn scenes_are_measured_and_drawn() {
        let line = ["rays", "--scaling", "--points", "256", "--rays-per-point", "4", "--reps", "1", "--most", "10000"];
        let args = Line::try_parse_from(line).unwrap().args;
        let chosen: Vec<Kind> = cases(&args).map(|(kind, _)| kind).collect();
        assert_eq!(chosen, [&[Kind::Triangles][..], &[Kind::Instances; 5]].concat());
        let few = |kind| cases(&args).find(|(of, _)| *of == kind).map(|(kind, case)| (kind, case.unwrap()));
        let scenes: Vec<Measured> = [Kind::Triangles, Kind::Instances]
            .map(|kind| few(kind).unwrap())
            .map(|(kind, case)| measure(kind, &case, &args, &Backend::Cpu).unwrap())
            .into();
        assert!(scenes.iter().all(|scene| scene.closest.rays == 256 && scene.build.bvh_bytes > 0));
        assert!(scenes[0].closest.hit_fraction > Some(0.05), "{:?}", scenes[0].closest);
        let svg = plot::draw(&scenes, "a < b");
        assert_eq!((svg.matches("<polyline").count(), svg.matches("<circle").count()), (8, 8));
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN") && svg.ends_with("</svg>\n"), "{svg}");
    }
}
