//! `kiln bench bake`: whole bakes, each in a process of its own: where their time goes, beside the table of Sloan et al. 2013;
//! threads, a farm on this machine, error against a reference, and cost against size.

mod farm;
mod kiln;
mod plot;
mod reference;
mod report;
mod rocks;
mod scaling;
mod stages;
mod table;
mod targets;
#[cfg(test)]
mod tests;

use crate::{BenchError, Provenance, scratch::Scratch};
use kiln::{Bake, Kiln, Place, Variant};
use kiln_worker::tasks::Backend;
use reference::Reference;
use serde::Serialize;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Options of `kiln bench bake`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln bench bake level.glb
  kiln bench bake level.glb --thread-counts 1,2 --farm --reps 5 --markdown-out bake.md
  kiln bench bake level.glb --reference 'rock_*'
  kiln bench bake small.glb large.glb --instances 1,10,100,1000 --svg-out bake.svg")]
pub struct Args {
    /// Levels, .glb or .gltf
    #[arg(value_name = "LEVEL", required_unless_present = "instances")]
    levels: Vec<PathBuf>,
    /// Scenes made by code, too: so many instances of a rock, on uneven ground
    #[arg(long, value_name = "N1,N2…", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    instances: Vec<u32>,
    /// Quality of the bakes
    #[arg(long, value_enum, default_value_t)]
    quality: Quality,
    /// What the numbers of trees are fitted to
    #[arg(long, value_enum, default_value_t)]
    trees: Trees,
    /// Numbers of threads to bake with [default: --threads]
    #[arg(long, value_name = "N1,N2…", value_delimiter = ',', value_parser = clap::value_parser!(u16).range(1..=1024))]
    thread_counts: Vec<u16>,
    /// Repetitions, in each of which the variants take turns
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    reps: u32,
    /// By a coordinator and a worker in processes of their own, too, with the greatest number of threads
    #[arg(long)]
    farm: bool,
    /// Error against `--quality reference` of what matches, as `kiln bake --only` does
    #[arg(long, value_name = "GLOB")]
    reference: Option<String>,
    /// Write the tables as a document
    #[arg(long, value_name = "FILE.md")]
    markdown_out: Option<PathBuf>,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE.json")]
    json_out: Option<PathBuf>,
    /// Write the plot of cost against size; needs two scenes
    #[arg(long, value_name = "FILE.svg")]
    svg_out: Option<PathBuf>,
}

/// A quality of `kiln bake`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Quality {
    Low,
    #[default]
    Medium,
    High,
    Reference,
}

impl Quality {
    fn name(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Medium => "medium",
            Self::High => "high",
            Self::Reference => "reference",
        }
    }
}

/// What a bake fits the numbers of trees to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Trees {
    #[default]
    Traced,
    Volume,
}

impl Trees {
    fn name(self) -> &'static str {
        match self {
            Self::Traced => "traced",
            Self::Volume => "volume",
        }
    }
}

/// How all bakes are made.
#[derive(Clone, Copy, Debug, Serialize)]
struct How {
    quality: Quality,
    trees: Trees,
}

impl How {
    fn options(self) -> [&'static str; 4] {
        ["--quality", self.quality.name(), "--trees", self.trees.name()]
    }
}

/// What was found on one level.
#[derive(Debug, Serialize)]
struct LevelReport {
    name: String,
    /// How many of its instances were asked for, of a scene made by code.
    made_of: Option<u32>,
    /// All bakes, in the order in which they were made.
    bakes: Vec<Bake>,
    reference: Option<Reference>,
}

/// What is written as JSON.
#[derive(Serialize)]
struct Report {
    provenance: Provenance,
    #[serde(flatten)]
    how: How,
    levels: Vec<LevelReport>,
}

/// Measures, and prints the tables.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub fn run(args: &Args, backend: &Backend) -> Result<(), BenchError> {
    let provenance = Provenance::now();
    let scratch = Scratch::new("bake")?;
    let kiln = Kiln::this(scratch.path(), backend)?;
    let mut levels = Vec::new();
    let (quality, trees) = (args.quality.name(), args.trees.name());
    let head = format!("{}; quality {quality}, trees {trees}", provenance.sentence());
    println!("{head}");
    for (path, made_of) in args.scenes(scratch.path())? {
        let level = args.measure(&path, made_of, &kiln)?;
        print!("{}", table::level(&level));
        levels.push(level);
    }
    print!("{}", scaling::table(&levels));
    if let Some(path) = &args.svg_out {
        write(path, plot::draw(&levels, &head).as_bytes())?;
    }
    if let Some(path) = &args.markdown_out {
        let title = format!("## {}\n\n{head}. Made by `{}`.\n", provenance.date, provenance.command);
        let tables: Vec<String> = levels.iter().map(table::level).collect();
        write(path, (title + &tables.concat() + &scaling::table(&levels)).as_bytes())?;
    }
    let Some(path) = &args.json_out else { return Ok(()) };
    let report = Report { provenance, how: args.how(), levels };
    let text = serde_json::to_string(&report)
        .map_err(|error| BenchError::Failed { step: "JSON", reason: error.to_string() })?;
    write(path, text.as_bytes())
}

impl Args {
    /// Scenes made by code, the smallest first, then the levels.
    fn scenes(&self, folder: &Path) -> Result<Vec<(PathBuf, Option<u32>)>, BenchError> {
        let mut scenes = Vec::new();
        for &count in &self.instances {
            let path = folder.join(format!("rocks_{count}.glb"));
            write(&path, &rocks::level(count)?)?;
            scenes.push((path, Some(count)));
        }
        scenes.extend(self.levels.iter().map(|path| (path.clone(), None)));
        Ok(scenes)
    }

    fn how(&self) -> How {
        How { quality: self.quality, trees: self.trees }
    }

    /// The variants of a repetition, in their order; the last in this process's manner is the one that tables are of.
    fn variants(&self) -> Vec<Variant> {
        let mut threads: Vec<usize> = self.thread_counts.iter().map(|count| usize::from(*count)).collect();
        threads.sort_unstable();
        threads.dedup();
        if threads.is_empty() {
            threads.push(rayon::current_num_threads());
        }
        let most = threads.last().copied().unwrap_or(1);
        let here = threads.into_iter().map(|threads| Variant { place: Place::Process, threads });
        let farm = self.farm.then_some(Variant { place: Place::Farm, threads: most });
        here.chain(farm).collect()
    }

    #[expect(clippy::print_stderr, reason = "what it is doing, beside the command's output")]
    fn measure(&self, path: &Path, made_of: Option<u32>, kiln: &Kiln) -> Result<LevelReport, BenchError> {
        let name = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let mut bakes = Vec::new();
        for rep in 0..self.reps {
            for variant in self.variants() {
                eprintln!("{name}: {} of {}, {}", rep + 1, self.reps, variant.name());
                bakes.push(kiln.bake(path, self.how(), variant)?);
            }
        }
        let reference = match &self.reference {
            Some(glob) => {
                eprintln!("{name}: reference of {glob}");
                Some(Reference::measure(path, glob, self.how(), kiln)?)
            }
            None => None,
        };
        Ok(LevelReport { name, made_of, bakes, reference })
    }
}

impl LevelReport {
    /// Bakes of a variant, one for each repetition.
    fn of(&self, variant: Variant) -> Vec<&Bake> {
        self.bakes.iter().filter(|bake| bake.variant == variant).collect()
    }

    /// The variants, in their order.
    fn variants(&self) -> Vec<Variant> {
        let mut variants: Vec<Variant> = Vec::new();
        for bake in &self.bakes {
            if !variants.contains(&bake.variant) {
                variants.push(bake.variant);
            }
        }
        variants
    }

    /// Bakes in one process with the greatest number of threads: what tables are of.
    fn main(&self) -> Vec<&Bake> {
        let here = self.variants().into_iter().filter(|variant| variant.place == Place::Process);
        here.max_by_key(|variant| variant.threads).map_or_else(Vec::new, |variant| self.of(variant))
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), BenchError> {
    let bad = |error| BenchError::File {
        path: path.to_path_buf(),
        reason: format!("{error}; check the folder and its free space"),
    };
    fs::write(path, bytes).map_err(bad)
}
