//! `kiln worker`: one worker of a farm.

use crate::{
    args::{Common, FarmAddress, RoleChoice, WorkerArgs},
    data_folder::data_folder,
    failure::Failure,
    local_farm::{STORE_MAX_BYTES, open_store},
    progress::client_failure,
};
use anyhow::Context;
use kiln_proto::client::{Bearer, Farm};
use kiln_worker::{RemoteArtefacts, Role, WorkerConfig, WorkerError, tasks::BakeExecutor};
use std::sync::Arc;

pub(crate) fn run(args: &WorkerArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    super::runtime()?.block_on(work(args, common))
}

#[expect(clippy::print_stderr, reason = "the operator is told what the worker does")]
async fn work(args: &WorkerArgs, common: &Common) -> Result<(), Failure> {
    let backends = super::choose_backends(common)?;
    let describe = backends.describe();
    // A worker keeps a folder of its own: several may run on one machine.
    let name = args.name.clone().unwrap_or_else(|| format!("{}-{}", host_name(), std::process::id()));
    let folder = data_folder(common, &format!("workers/{}", folder_name(&name)))?;
    let cache = Arc::new(open_store(&folder, |text| eprintln!("{text}"))?);
    let bearer = bearer(&args.farm)?;
    let address = &args.farm.coordinator;
    let (session, bulk) = (Farm::at(address, bearer.clone()), Farm::at(address, bearer));
    let (session, bulk) = (session.map_err(client_failure)?, bulk.map_err(client_failure)?);
    let artefacts = RemoteArtefacts::new(bulk, cache, STORE_MAX_BYTES, tokio::runtime::Handle::current());
    let config = WorkerConfig {
        worker_id: format!("{}-{}", super::submit::unique_id(), std::process::id()),
        name: name.clone(),
        roles: args.roles.iter().map(|&role| role.into()).collect(),
        adapter: describe.clone(),
        threads: backends.threads(common.thread_count()),
        memory_bytes: memory_bytes(),
    };
    eprintln!("kiln: worker {name} traces on {describe} with {} threads for {address}", config.threads);
    let executor = Arc::new(BakeExecutor::new(backends));
    let tasks = Arc::<BakeExecutor>::clone(&executor);
    let ran = kiln_worker::run(session, tasks, Arc::new(artefacts), config, super::stop_signal()).await;
    executor.finish();
    ran.map_err(|error| match error {
        WorkerError::DeviceLost { .. } => Failure::new(crate::failure::FAILED, error),
        _ => Failure::new(crate::failure::UNREACHABLE, error),
    })
}

/// The bearer of the token in the file or in KILN_TOKEN, if there is one.
pub(crate) fn bearer(address: &FarmAddress) -> Result<Bearer, Failure> {
    let token = match &address.token_file {
        Some(path) => {
            let context = || format!("the token file {} cannot be read", path.display());
            Some(std::fs::read_to_string(path).with_context(context)?)
        }
        None => std::env::var("KILN_TOKEN").ok(),
    };
    Bearer::new(token.as_deref().map(str::trim)).map_err(client_failure)
}

/// Memory that a task may use: what the machine has free, where it tells (Linux), else 4 GiB.
pub(crate) fn memory_bytes() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
    kib.map_or(4 << 30, |kib| kib * 1024)
}

fn host_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").ok().or_else(|| std::env::var("HOSTNAME").ok());
    name.map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).unwrap_or_else(|| "worker".to_owned())
}

fn folder_name(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

impl From<RoleChoice> for Role {
    fn from(choice: RoleChoice) -> Self {
        match choice {
            RoleChoice::Trace => Self::Trace,
            RoleChoice::Reduce => Self::Reduce,
        }
    }
}
