//! The command line.

mod bake;
mod farm;
mod regions;
mod tools;

pub(crate) use bake::BakeArgs;
pub(crate) use farm::{
    CancelArgs, FarmAddress, FetchArgs, LsArgs, RoleChoice, ServeArgs, SubmitArgs, WatchArgs, WorkerArgs,
};
pub(crate) use regions::RegionsArgs;
pub(crate) use tools::{BenchArgs, CheckArgs, CompareArgs, ExampleArgs, OverlayChoice, ProbeArgs, ViewArgs};

use clap::{Args, Parser, Subcommand, ValueEnum};
use kiln_gpu::DeviceOptions;
use std::path::PathBuf;

/// Bakes ambient obscurance for game levels.
///
/// Exit codes: 0 good, 1 bake failed, 2 usage, 3 input refused, 4 quality gate missed, 5 farm unreachable,
/// 130 interrupted.
#[derive(Debug, Parser)]
#[command(name = "kiln", version, propagate_version = true, max_term_width = 110)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) common: Common,
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Options of every command.
#[derive(Args, Clone, Debug)]
pub(crate) struct Common {
    /// Print results as JSON, for machines
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Plain lines in place of progress bars (also where the output is no terminal)
    #[arg(long, global = true)]
    pub(crate) no_progress: bool,
    /// More log lines; repeat for more still
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub(crate) verbose: u8,
    /// Threads to work on [default: one for each core]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,
    /// Where rays are traced: `auto` takes a graphics card if there is one, else the CPU
    #[arg(long, global = true, value_enum, default_value_t)]
    pub(crate) backend: BackendChoice,
    /// Let the graphics card's own ray queries (experimental) find what rays meet; results stay the same
    #[arg(long, global = true)]
    pub(crate) ray_queries: bool,
    /// Folder for results that later runs reuse [default: a folder of this user]
    #[arg(long, global = true, value_name = "FOLDER", env = "KILN_DATA_DIR")]
    pub(crate) data_dir: Option<PathBuf>,
}

impl Common {
    /// What a graphics card is opened with.
    pub(crate) fn device_options(&self) -> DeviceOptions {
        DeviceOptions { ray_queries: self.ray_queries, ..DeviceOptions::default() }
    }

    /// Threads to work on.
    pub(crate) fn thread_count(&self) -> usize {
        let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        self.threads.map_or_else(cores, usize::from)
    }
}

/// Where rays are traced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum BackendChoice {
    /// A graphics card if there is one, else the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A graphics card; a software driver too if KILN_GPU=software is set.
    Gpu,
    /// The CPU and a graphics card, if there is one, side by side; of a farm, whatever its workers have. The result is within
    /// the error bound, but not the same bit for bit from run to run.
    Mixed,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Bake(BakeArgs),
    Check(CheckArgs),
    Compare(CompareArgs),
    Probe(ProbeArgs),
    Regions(RegionsArgs),
    View(ViewArgs),
    Example(ExampleArgs),
    Serve(ServeArgs),
    Worker(WorkerArgs),
    Submit(SubmitArgs),
    Watch(WatchArgs),
    Fetch(FetchArgs),
    Cancel(CancelArgs),
    Ls(LsArgs),
    Bench(BenchArgs),
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    /// The shortest command lines of a command and of those under it, each with what it demands.
    fn shortest(command: &clap::Command, before: &[String]) -> Vec<Vec<String>> {
        let mut line = before.to_vec();
        line.push(command.get_name().to_owned());
        let under: Vec<_> = command.get_subcommands().collect();
        if !under.is_empty() {
            return under.into_iter().flat_map(|command| shortest(command, &line)).collect();
        }
        for argument in command.get_arguments().filter(|argument| argument.is_required_set()) {
            line.extend(argument.get_long().map(|long| format!("--{long}")));
            line.push("1".to_owned());
        }
        // These demand more than they say.
        let more = match line.join(" ").as_str() {
            "kiln example" => Some("--list"),
            "kiln bench bake" => Some("level.glb"),
            _ => None,
        };
        line.extend(more.map(str::to_owned));
        vec![line]
    }

    /// A name that a command and all commands have in common, but not its type, is found only where it is read.
    #[test]
    fn every_command_parses() {
        let lines = shortest(&Cli::command(), &[]);
        assert!(lines.len() >= 15, "{lines:?}");
        for line in lines {
            let parsed = Cli::try_parse_from(&line);
            assert!(parsed.is_ok(), "{line:?}: {}", parsed.err().map(|error| error.to_string()).unwrap_or_default());
        }
    }
}
