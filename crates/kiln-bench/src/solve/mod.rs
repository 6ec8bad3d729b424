//! `kiln bench solve`: Kiln's linear solver beside direct solvers on the same matrices, and its stress suite.

mod compare;
mod gather;
mod level_file;
mod outcome;
mod run_one;
mod scenes;
mod signal;
pub mod stress;
mod system_file;
mod table;

use crate::{BenchError, Provenance, scratch::Scratch};
use compare::{CaseResult, Contest, Peer};
use kiln_core::{DEFAULT_REGULARIZATION, SolveSettings};
use kiln_solve::{ComponentSystem, components::Components, system::MAX_COLUMNS};
use outcome::Program;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Options of `kiln bench solve`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln bench solve --peer ./solve-peer --level level.glb --json-out out.json
  kiln bench solve --stress")]
pub struct Args {
    /// The comparison program, built by the command at the head of tests/peers/solve.cpp
    #[arg(long, value_name = "PROGRAM")]
    peer: Option<PathBuf>,
    /// Also the matrices of this level, with a made-up signal on its surfaces
    #[arg(long, value_name = "SCENE")]
    level: Vec<PathBuf>,
    /// Weights of the regulariser
    #[arg(long, value_name = "A1,A2…", value_delimiter = ',', default_values_t = [DEFAULT_REGULARIZATION, 1.0])]
    alpha: Vec<f64>,
    /// Right-hand sides: two for each half-distance
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = column_count)]
    columns: usize,
    /// Rounds, in each of which the solvers take turns
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Components of the level made by code; 0: no such level
    #[arg(long, value_name = "N", default_value_t = 57_000)]
    components: u32,
    /// Vertices along a side of the terrain; 0: no terrain
    #[arg(long, value_name = "N", default_value_t = 1200)]
    side: u32,
    /// Share of the terrain's side that a square hole without samples takes, 0 to 1
    #[arg(long, value_name = "F", default_value_t = 0.0)]
    hole: f64,
    /// Also the simplicial solvers on the terrain, which take minutes
    #[arg(long)]
    slow: bool,
    /// The stress suite at its whole size instead, each case against the clean mesh's answer
    #[arg(long)]
    stress: bool,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE.json")]
    json_out: Option<PathBuf>,
    /// Solves a system file and writes the answer: what the command runs in a process of its own
    #[arg(long, hide = true, num_args = 2, value_names = ["SYSTEM", "ANSWER"])]
    run_one: Option<Vec<PathBuf>>,
}

fn column_count(text: &str) -> Result<usize, String> {
    let count = text.parse().ok().filter(|count| (1..=MAX_COLUMNS).contains(count));
    count.ok_or_else(|| format!("not a number from 1 to {MAX_COLUMNS}"))
}

/// What is written as JSON.
#[derive(Serialize)]
struct Report {
    provenance: Provenance,
    cases: Vec<CaseResult>,
}

/// Measures, and prints the table.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub fn run(args: &Args) -> Result<(), BenchError> {
    if let Some([system, answer]) = args.run_one.as_deref() {
        println!("{}", json_text(&run_one::run(system, answer)?)?);
        return Ok(());
    }
    if args.stress {
        return stress::run(stress::Size::Whole, &mut |line| println!("{line}"));
    }
    let provenance = Provenance::now();
    println!("{}\n", provenance.sentence());
    let cases = args.measure()?;
    print!("{}", table::render(&cases));
    if args.peer.is_none() {
        println!("\n{}", table::HOW_TO_GET_PEERS);
    }
    let Some(path) = &args.json_out else { return Ok(()) };
    let text = json_text(&Report { provenance, cases })?;
    std::fs::write(path, text).map_err(|error| BenchError::File {
        path: path.clone(),
        reason: format!("{error}; check the folder and its free space"),
    })
}

fn json_text(value: &impl Serialize) -> Result<String, BenchError> {
    serde_json::to_string(value).map_err(|error| BenchError::Failed { step: "JSON", reason: error.to_string() })
}

impl Args {
    #[expect(clippy::print_stderr, reason = "what it is doing, beside the command's output")]
    fn measure(&self) -> Result<Vec<CaseResult>, BenchError> {
        let scratch = Scratch::new("solve")?;
        let mut cases = Vec::new();
        for &alpha in &self.alpha {
            let settings = SolveSettings { regularization: alpha, ..SolveSettings::default() };
            for matrix in self.matrices() {
                eprintln!("{}, α = {alpha}", matrix.name());
                let system = matrix.system(&settings, self.columns)?;
                let solvers =
                    self.contest(&matrix, scratch.path())?.hold(&system, &mut |what| eprintln!("  {what}"))?;
                cases.push(case(&matrix, alpha, &system, solvers));
            }
        }
        Ok(cases)
    }

    fn matrices(&self) -> Vec<Matrix<'_>> {
        let level = (self.components > 0).then_some(Matrix::Level { components: self.components });
        let terrain = (self.side > 0).then_some(Matrix::Terrain { side: self.side, hole: self.hole });
        level.into_iter().chain(self.level.iter().map(|path| Matrix::File { path })).chain(terrain).collect()
    }

    fn contest(&self, matrix: &Matrix<'_>, folder: &Path) -> Result<Contest, BenchError> {
        let rounds = self.rounds as usize;
        // On large components the simplicial solvers take very long: once, on the terrain only if asked for.
        let simplicial = match matrix {
            Matrix::File { .. } => rounds,
            Matrix::Level { .. } => 1,
            Matrix::Terrain { .. } => usize::from(self.slow),
        };
        let all = [("cholmod", rounds), ("cholmod-simplicial", simplicial), ("eigen", simplicial.min(1))];
        let peer = |executable: &PathBuf| {
            let chosen = all.into_iter().filter(|(_, rounds)| *rounds > 0);
            chosen.map(|(solver, rounds)| Peer { program: Program::peer(executable, solver), rounds }).collect()
        };
        let peers = self.peer.as_ref().map_or_else(Vec::new, peer);
        Ok(Contest { kiln: Program::kiln()?, peers, rounds, folder: folder.to_path_buf() })
    }
}

/// A matrix to solve.
enum Matrix<'a> {
    Level { components: u32 },
    File { path: &'a Path },
    Terrain { side: u32, hole: f64 },
}

impl Matrix<'_> {
    fn name(&self) -> String {
        match self {
            Self::Level { components } => format!("level of {components} components"),
            Self::File { path } => path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
            Self::Terrain { side, hole: 0.0 } => format!("terrain of {side}²"),
            Self::Terrain { side, hole } => format!("terrain of {side}², hole of {hole} of its side"),
        }
    }

    fn system(&self, settings: &SolveSettings, columns: usize) -> Result<ComponentSystem<'static>, BenchError> {
        match self {
            Self::Level { components } => Ok(scenes::level(*components, settings, columns)),
            Self::File { path } => level_file::system(path, settings, columns),
            Self::Terrain { side, hole } => Ok(scenes::terrain(*side, *hole, settings, columns)),
        }
    }
}

fn case(
    matrix: &Matrix<'_>,
    alpha: f64,
    system: &ComponentSystem<'_>,
    solvers: Vec<compare::SolverResult>,
) -> CaseResult {
    let components = Components::of_matrix(&system.matrix);
    let size = |component| components.unknowns(component).len();
    CaseResult {
        name: matrix.name(),
        alpha,
        unknowns: system.len(),
        entries: system.matrix.entry_count(),
        columns: system.columns,
        components: components.count(),
        largest: (0..components.count()).map(size).max().unwrap_or(0),
        solvers,
    }
}
