//! Options of the farm's commands.

use super::bake::SettingsArgs;
use clap::{Args, ValueEnum};
use std::{net::SocketAddr, path::PathBuf};

/// Where the coordinator is.
#[derive(Args, Clone, Debug)]
pub(crate) struct FarmAddress {
    /// The coordinator
    #[arg(long, value_name = "URL", env = "KILN_COORDINATOR", default_value = "http://127.0.0.1:7480")]
    pub(crate) coordinator: String,
    /// File that holds the farm's token, where it demands one (else KILN_TOKEN)
    #[arg(long, value_name = "FILE")]
    pub(crate) token_file: Option<PathBuf>,
}

/// Runs the coordinator.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  kiln serve\n  kiln serve --listen 127.0.0.1:7480 --data-dir /srv/kiln")]
pub(crate) struct ServeArgs {
    /// Address to listen on; one that is not loopback needs a token
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7480")]
    pub(crate) listen: SocketAddr,
    /// File that holds the token that every caller must present (else KILN_TOKEN)
    #[arg(long, value_name = "FILE")]
    pub(crate) token_file: Option<PathBuf>,
    /// Write the address that is listened on to this file once it is (for --listen …:0)
    #[arg(long, value_name = "FILE")]
    pub(crate) address_file: Option<PathBuf>,
}

/// Runs a worker of a farm.
#[derive(Args, Debug)]
#[command(
    after_help = "Examples:\n  kiln worker\n  kiln worker --coordinator http://farm:7480 --role trace --threads 8"
)]
pub(crate) struct WorkerArgs {
    #[command(flatten)]
    pub(crate) farm: FarmAddress,
    /// What to do: trace rays, reduce (import, plan, solve, export), or both
    #[arg(long = "role", value_enum, value_delimiter = ',', default_values_t = [RoleChoice::Trace, RoleChoice::Reduce])]
    pub(crate) roles: Vec<RoleChoice>,
    /// Name to show on the farm [default: host name and process id]
    #[arg(long)]
    pub(crate) name: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum RoleChoice {
    /// Trace tasks.
    Trace,
    /// Every other kind.
    Reduce,
}

/// Submits a level to a farm and prints the bake's id.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  kiln submit level.glb\n  kiln submit level.glb --wait -o baked.glb")]
pub(crate) struct SubmitArgs {
    /// The level: .glb or .gltf
    pub(crate) level: PathBuf,
    #[command(flatten)]
    pub(crate) farm: FarmAddress,
    #[command(flatten)]
    pub(crate) settings: SettingsArgs,
    /// Bakes of greater priority come first
    #[arg(long, value_name = "N", default_value_t = 0, allow_hyphen_values = true)]
    pub(crate) priority: i32,
    /// The same id again returns the earlier answer [default: a new one]
    #[arg(long, value_name = "ID")]
    pub(crate) request_id: Option<String>,
    /// Watch the bake to its end
    #[arg(long)]
    pub(crate) wait: bool,
    /// With --wait: fetch the result to this file
    #[arg(short, long, value_name = "OUT.glb", requires = "wait")]
    pub(crate) output: Option<PathBuf>,
    /// Make a pack, which an engine loads; with --wait, fetch it to this file
    #[arg(long, value_name = "P.kiln")]
    pub(crate) pack: Option<PathBuf>,
    /// With --wait: write what was done and how well, as JSON
    #[arg(long, value_name = "R.json", requires = "wait")]
    pub(crate) report: Option<PathBuf>,
}

/// Watches a bake to its end.
#[derive(Args, Debug)]
pub(crate) struct WatchArgs {
    /// The bake's id
    pub(crate) bake: String,
    #[command(flatten)]
    pub(crate) farm: FarmAddress,
}

/// Fetches a finished bake.
#[derive(Args, Debug)]
pub(crate) struct FetchArgs {
    /// The bake's id
    pub(crate) bake: String,
    /// Where to write the baked .glb
    #[arg(short, long, value_name = "OUT.glb")]
    pub(crate) output: PathBuf,
    /// Where to write the pack, if the bake made one [default: beside the output]
    #[arg(long, value_name = "P.kiln")]
    pub(crate) pack: Option<PathBuf>,
    /// Write what was done and how well, as JSON
    #[arg(long, value_name = "R.json")]
    pub(crate) report: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) farm: FarmAddress,
}

/// Cancels a bake.
#[derive(Args, Debug)]
pub(crate) struct CancelArgs {
    /// The bake's id
    pub(crate) bake: String,
    #[command(flatten)]
    pub(crate) farm: FarmAddress,
}

/// Lists bakes, and with --workers the workers.
#[derive(Args, Debug)]
pub(crate) struct LsArgs {
    #[command(flatten)]
    pub(crate) farm: FarmAddress,
    /// List workers in place of bakes
    #[arg(long)]
    pub(crate) workers: bool,
}
