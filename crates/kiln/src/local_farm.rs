//! A farm in this process: coordinator and worker over a connection in memory.

use crate::{args::Common, commands::choose_backends, data_folder::data_folder, failure::Failure};
use anyhow::Context;
use kiln_coordinator::{Config, Coordinator, Unfinished, in_memory};
use kiln_proto::client::{Bearer, Farm};
use kiln_store::{OpenOptions, Store};
use kiln_worker::{LocalArtefacts, Role, WorkerConfig, tasks::BakeExecutor};
use std::{path::Path, sync::Arc};
use tokio::{sync::watch, task::JoinHandle};

/// Results are kept up to this size; then the least recently used go.
pub(crate) const STORE_MAX_BYTES: u64 = 20 << 30;

/// Bakes of this process, told apart from a farm's in the same folder.
pub(crate) const TENANT: &str = "kiln bake";

/// Coordinator and worker of this process.
pub(crate) struct LocalFarm {
    pub(crate) farm: Farm,
    /// What traces, for people.
    pub(crate) backend: String,
    /// What the worker runs tasks with.
    pub(crate) executor: Arc<BakeExecutor>,
    stop: watch::Sender<bool>,
    /// Ends by itself only where it cannot go on.
    pub(crate) worker: JoinHandle<Result<(), kiln_worker::WorkerError>>,
    coordinator: JoinHandle<Result<(), kiln_coordinator::ServeError>>,
}

impl LocalFarm {
    /// Opens the data folder (waiting for another process that uses it) and starts both.
    pub(crate) async fn start(common: &Common, say: impl Fn(&str)) -> Result<Self, Failure> {
        let backends = choose_backends(common)?;
        let describe = backends.describe();
        let folder = data_folder(common, "bake")?;
        let store = Arc::new(open_store(&folder, &say)?);
        let config =
            Config { unfinished: Unfinished::Leave, store_max_bytes: Some(STORE_MAX_BYTES), ..Config::default() };
        let coordinator = Coordinator::start(Arc::clone(&store), config).await.map_err(anyhow::Error::from)?;
        let (incoming, connector) = in_memory();
        let (stop, stopped) = watch::channel(false);
        let coordinator = tokio::spawn(coordinator.serve(incoming, stopping(stopped.clone())));
        let bearer = Bearer::default();
        let config = WorkerConfig {
            worker_id: format!("in-process-{}", std::process::id()),
            name: "this process".to_owned(),
            roles: vec![Role::Trace, Role::Reduce],
            adapter: describe.clone(),
            threads: backends.threads(common.thread_count()),
            memory_bytes: super::commands::worker::memory_bytes(),
        };
        let executor = Arc::new(BakeExecutor::new(backends));
        let worker = tokio::spawn(kiln_worker::run(
            Farm::over(connector.channel(), bearer.clone()),
            Arc::<BakeExecutor>::clone(&executor),
            Arc::new(LocalArtefacts(store)),
            config,
            stopping(stopped),
        ));
        let farm = Farm::over(connector.channel(), bearer);
        Ok(Self { farm, backend: describe, executor, stop, worker, coordinator })
    }

    /// Stops the worker, then the coordinator. What was acknowledged is durable.
    pub(crate) async fn stop(self) -> Result<(), Failure> {
        // Both are told at once: nobody needs what the worker still does.
        let _ = self.stop.send(true);
        self.worker.abort();
        self.executor.finish();
        let served = self.coordinator.await.context("the coordinator's thread ended")?;
        Ok(served.context("the coordinator could not go on")?)
    }
}

async fn stopping(mut stopped: watch::Receiver<bool>) {
    // An error means that the sender is gone, which says the same.
    let _ = stopped.wait_for(|&stop| stop).await;
}

/// Opens a store, saying once that it waits if another process holds it.
pub(crate) fn open_store(folder: &Path, say: impl Fn(&str)) -> Result<Store, Failure> {
    let wait = |locked: &kiln_store::StoreError| say(&format!("{locked}; waiting for it to finish"));
    Ok(Store::open_waiting(folder, OpenOptions::default(), wait).map_err(anyhow::Error::from)?)
}
