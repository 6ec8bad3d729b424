//! One module for each command.

pub(crate) mod bake;
pub(crate) mod bench;
pub(crate) mod cancel;
pub(crate) mod check;
pub(crate) mod compare;
pub(crate) mod example;
pub(crate) mod fetch;
pub(crate) mod ls;
pub(crate) mod probe;
pub(crate) mod regions;
pub(crate) mod serve;
pub(crate) mod submit;
pub(crate) mod view;
pub(crate) mod watch;
pub(crate) mod worker;

use crate::{
    args::{BackendChoice, Common, FarmAddress},
    failure::{Failure, UNREACHABLE},
    progress::client_failure,
    source::Source,
};
use anyhow::Context;
use kiln_core::{BakeSettings, Digest, codec};
use kiln_gpu::{AdapterChoice, GpuDevice};
use kiln_proto::client::Farm;
use kiln_scene::MeshBlob;
use kiln_worker::tasks::{Backend, Backends, LoadedLevel};
use std::{collections::BTreeMap, sync::Arc};

/// Imports a level and loads all of it, to be traced in this process.
pub(crate) fn load(source: &Source, settings: &BakeSettings) -> Result<LoadedLevel, Failure> {
    let import = kiln_scene::import(source.name(), source, source.sidecar(), settings).map_err(Failure::refused)?;
    let decode = |blob: &MeshBlob| Ok((blob.digest, Arc::new(codec::decode("a mesh", &blob.bytes)?)));
    let by_digest: BTreeMap<Digest, _> =
        import.meshes.iter().map(decode).collect::<Result<_, codec::DecodeError>>().map_err(anyhow::Error::from)?;
    let meshes = import.level.meshes.iter().filter_map(|mesh| by_digest.get(&mesh.digest).cloned()).collect();
    Ok(LoadedLevel::new(Digest::default(), import.level, meshes).map_err(anyhow::Error::from)?)
}

/// Makes the process's thread pool as wide as asked.
pub(crate) fn use_threads(common: &Common) -> Result<(), Failure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(common.thread_count());
    Ok(pool.build_global().context("the thread pool cannot be started")?)
}

/// The runtime for what waits; what computes has its own threads.
pub(crate) fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    Ok(runtime.context("the runtime cannot be started")?)
}

/// What bakes trace on.
pub(crate) fn choose_backends(common: &Common) -> Result<Backends, Failure> {
    match common.backend {
        BackendChoice::Mixed => Ok(Backends::mixed(open_device(&AdapterChoice::from_env(), common)?)),
        _ => choose_backend(common).map(Backends::from),
    }
}

/// A graphics card if there is one and it is wanted, else the CPU; the CPU too where both are.
pub(crate) fn choose_backend(common: &Common) -> Result<Backend, Failure> {
    match common.backend {
        BackendChoice::Cpu | BackendChoice::Mixed => on_processor(common),
        BackendChoice::Auto => Ok(open_device(&AdapterChoice::Real, common)?.map_or(Backend::Cpu, Backend::Gpu)),
        BackendChoice::Gpu => {
            open_device(&AdapterChoice::from_env(), common)?.map(Backend::Gpu).ok_or_else(no_graphics_card)
        }
    }
}

/// The CPU, which has no ray queries.
pub(crate) fn on_processor(common: &Common) -> Result<Backend, Failure> {
    if common.ray_queries {
        let message =
            "--ray-queries is for graphics cards, but rays would be traced on the CPU; use it with --backend gpu";
        return Err(Failure::new(crate::failure::USAGE, message));
    }
    Ok(Backend::Cpu)
}

/// A graphics card if there is one. There must be, where ray queries are asked for.
fn open_device(choice: &AdapterChoice, common: &Common) -> Result<Option<Arc<GpuDevice>>, Failure> {
    let device = GpuDevice::open_with(choice, common.device_options()).map_err(anyhow::Error::from)?;
    if device.is_none() && common.ray_queries {
        return Err(no_graphics_card());
    }
    Ok(device)
}

fn no_graphics_card() -> Failure {
    let advice = "install a Vulkan driver for it, set KILN_GPU=software for a software driver, or use --backend cpu";
    Failure::new(crate::failure::FAILED, format!("no graphics card can be used; {advice}"))
}

/// Connects to the farm now, so that one that cannot be reached is known at once.
pub(crate) async fn farm(address: &FarmAddress) -> Result<Farm, Failure> {
    let bearer = worker::bearer(address)?;
    let connect = Farm::connect(&address.coordinator, bearer);
    let patience = std::time::Duration::from_secs(15);
    match tokio::time::timeout(patience, connect).await {
        Ok(farm) => farm.map_err(client_failure),
        Err(_) => Err(Failure::new(UNREACHABLE, format!("{} does not answer", address.coordinator))),
    }
}

/// Completes when the process is asked to stop.
pub(crate) async fn stop_signal() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    // Without a handler for Ctrl-C the system ends the process by itself.
    if tokio::signal::ctrl_c().await.is_err() {
        std::future::pending::<()>().await;
    }
}
