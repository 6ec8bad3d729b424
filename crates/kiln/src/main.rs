//! The `kiln` command: parses, runs one command, and turns its outcome into an exit code.

mod args;
mod commands;
mod data_folder;
mod difference;
mod failure;
mod flight;
mod gates;
mod half_distances;
mod local_farm;
mod one_mesh;
mod outcome;
mod picture;
mod progress;
mod report;
mod source;
mod visibility;

use args::{Cli, Command};
use clap::Parser;
use failure::Failure;
use std::process::ExitCode;

/// What a process ends with whose reader has gone, by the custom of shells: it may not have done all that it was asked.
const READER_GONE: i32 = 141;

/// Ends the process when who reads its output has gone, as `head` does; Rust's own `println!` would panic.
fn end_with_the_reader() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let text = panic.payload().downcast_ref::<String>().map_or("", String::as_str);
        if text.starts_with("failed printing to stdout") && text.contains("Broken pipe") {
            std::process::exit(READER_GONE);
        }
        usual(panic);
    }));
}

fn main() -> ExitCode {
    end_with_the_reader();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let _ = error.print();
            return if error.use_stderr() { failure::USAGE.into() } else { ExitCode::SUCCESS };
        }
    };
    // A service tells what happens to it; a command's own messages are enough.
    let is_service = matches!(cli.command, Command::Serve(_) | Command::Worker(_));
    start_logs(cli.common.verbose.saturating_add(u8::from(is_service) * 2));
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            failure.print();
            failure.code.into()
        }
    }
}

fn run(cli: Cli) -> Result<(), Failure> {
    let common = cli.common;
    match cli.command {
        Command::Bake(args) => commands::bake::run(&args, &common),
        Command::Check(args) => commands::check::run(&args, &common),
        Command::Compare(args) => commands::compare::run(&args, &common),
        Command::Probe(args) => commands::probe::run(&args, &common),
        Command::Regions(args) => commands::regions::run(&args, &common),
        Command::View(args) => commands::view::run(&args, &common),
        Command::Example(args) => commands::example::run(&args, &common),
        Command::Serve(args) => commands::serve::run(&args, &common),
        Command::Worker(args) => commands::worker::run(&args, &common),
        Command::Submit(args) => commands::submit::run(&args, &common),
        Command::Watch(args) => commands::watch::run(&args, &common),
        Command::Fetch(args) => commands::fetch::run(&args, &common),
        Command::Cancel(args) => commands::cancel::run(&args, &common),
        Command::Ls(args) => commands::ls::run(&args, &common),
        Command::Bench(args) => commands::bench::run(&args, &common),
    }
}

/// Logs go to stderr: errors at first, then warnings, and so on; RUST_LOG overrides.
fn start_logs(verbosity: u8) {
    let level = ["error", "warn", "info", "debug", "trace"][usize::from(verbosity.min(4))];
    let own = ["kiln", "kiln_coordinator", "kiln_worker", "kiln_store"].map(|name| format!(",{name}={level}"));
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| format!("error{}", own.concat()).into());
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false).init();
}
