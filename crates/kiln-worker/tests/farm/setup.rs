//! A farm in one process: coordinators that can be killed, workers that can be lost, connections that can be cut.

use crate::fake::{Control, Fake};
use bytes::Bytes;
use kiln_coordinator::{Config, Coordinator, InMemoryConnector, ServeError, in_memory};
use kiln_core::{BakeSettings, Digest, SourceFile, SourceManifest, TaskKind};
use kiln_proto::{
    Submission,
    client::{Bearer, Farm},
    v1,
};
use kiln_store::{OpenOptions, Store};
use kiln_worker::{Artefacts, LocalArtefacts, Role, WorkerConfig, WorkerError};
use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};
use tempfile::TempDir;
use tokio::{sync::oneshot, task::JoinHandle};

/// A coordinator over a store in a temporary folder.
pub(crate) struct TestFarm {
    pub(crate) folder: Arc<TempDir>,
    pub(crate) store: Arc<Store>,
    pub(crate) connector: InMemoryConnector,
    pub(crate) control: Arc<Control>,
    stop: oneshot::Sender<()>,
    served: JoinHandle<Result<(), ServeError>>,
}

/// A config whose times suit tests.
pub(crate) fn config() -> Config {
    let scheduler = kiln_schedule::Config {
        reconnect_grace_ms: 300,
        return_delay_ms: 20,
        failure_delay_ms: 20,
        no_fit_timeout_ms: Some(600),
        max_lease_tasks: 4,
        ..kiln_schedule::Config::default()
    };
    Config { scheduler, heartbeat_interval: Duration::from_millis(100), ..Config::default() }
}

impl TestFarm {
    pub(crate) async fn start() -> Self {
        Self::start_in(Arc::new(TempDir::new().unwrap()), config(), Arc::default()).await
    }

    async fn start_in(folder: Arc<TempDir>, config: Config, control: Arc<Control>) -> Self {
        let options = OpenOptions { garbage_grace_secs: 0, ..OpenOptions::default() };
        let store = Arc::new(Store::open(folder.path(), options).unwrap());
        let coordinator = Coordinator::start(Arc::clone(&store), config).await.unwrap();
        let (incoming, connector) = in_memory();
        let (stop, stopped) = oneshot::channel::<()>();
        let served = tokio::spawn(coordinator.serve(incoming, async {
            let _ = stopped.await;
        }));
        Self { folder, store, connector, control, stop, served }
    }

    /// Stops the coordinator, lets go of the store, and starts another on the same folder.
    pub(crate) async fn restart(self) -> Self {
        self.restart_with(config()).await
    }

    pub(crate) async fn restart_with(self, config: Config) -> Self {
        let Self { folder, store, control, stop, served, .. } = self;
        drop(stop);
        served.await.unwrap().unwrap();
        let mut store = Some(store);
        let start = std::time::Instant::now();
        // Connections and blocking calls that are still ending hold the store for a moment.
        while let Some(shared) = store.take() {
            if let Err(shared) = Arc::try_unwrap(shared) {
                assert!(start.elapsed() < Duration::from_secs(10), "the store is never let go of");
                store = Some(shared);
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        }
        Self::start_in(folder, config, control).await
    }

    pub(crate) async fn stop(self) {
        drop(self.stop);
        self.served.await.unwrap().unwrap();
    }

    pub(crate) fn client(&self) -> Farm {
        Farm::over(self.connector.channel(), Bearer::default())
    }

    /// A worker with the coordinator's own store.
    pub(crate) fn worker(&self, name: &str) -> TestWorker {
        self.worker_over(name, self.client(), Arc::new(LocalArtefacts(Arc::clone(&self.store))))
    }

    pub(crate) fn worker_over(&self, name: &str, farm: Farm, artefacts: Arc<dyn Artefacts>) -> TestWorker {
        self.worker_with(name, farm, artefacts, Arc::clone(&self.control))
    }

    /// A worker under a control of its own.
    pub(crate) fn worker_with(
        &self,
        name: &str,
        farm: Farm,
        artefacts: Arc<dyn Artefacts>,
        control: Arc<Control>,
    ) -> TestWorker {
        self.worker_in("cpu", name, farm, artefacts, control)
    }

    /// A worker that traces in a lane, with the coordinator's own store and a control of its own.
    pub(crate) fn worker_of(&self, lane: &str, name: &str, control: &Arc<Control>) -> TestWorker {
        let artefacts = Arc::new(LocalArtefacts(Arc::clone(&self.store)));
        self.worker_in(lane, name, self.client(), artefacts, Arc::clone(control))
    }

    fn worker_in(
        &self,
        lane: &str,
        name: &str,
        farm: Farm,
        artefacts: Arc<dyn Artefacts>,
        control: Arc<Control>,
    ) -> TestWorker {
        let executor = Arc::new(Fake { control, trace_lanes: vec![lane.to_owned()] });
        let config = WorkerConfig {
            worker_id: name.to_owned(),
            name: format!("worker {name}"),
            roles: vec![Role::Trace, Role::Reduce],
            adapter: String::new(),
            threads: 2,
            memory_bytes: 1 << 30,
        };
        let (stop, stopped) = oneshot::channel::<()>();
        let ran = tokio::spawn(kiln_worker::run(farm, executor, artefacts, config, async {
            let _ = stopped.await;
        }));
        TestWorker { stop, ran }
    }

    /// Uploads a level and submits it.
    pub(crate) async fn submit(&self, request_id: &str, level: &str) -> v1::Bake {
        let (submission, files) = submission(request_id, level);
        self.client().submit_with_files(&submission, &files).await.unwrap().0
    }

    /// Uploads a level and submits it for any lane.
    pub(crate) async fn submit_mixed(&self, request_id: &str, level: &str) -> v1::Bake {
        let (submission, files) = submission(request_id, level);
        let submission = Submission { backend: v1::Backend::Mixed, ..submission };
        self.client().submit_with_files(&submission, &files).await.unwrap().0
    }

    /// Submits a level and waits for its end.
    pub(crate) async fn bake(&self, level: &str) -> v1::Bake {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let id = format!("bake-{}", NEXT.fetch_add(1, Ordering::Relaxed));
        let bake = self.submit(&id, level).await;
        self.end(&bake.bake_id).await
    }

    pub(crate) async fn end(&self, bake_id: &str) -> v1::Bake {
        let end = self.client().watch(bake_id).end();
        tokio::time::timeout(Duration::from_secs(20), end).await.expect("the bake does not end").unwrap()
    }

    /// The baked file.
    pub(crate) async fn file(&self, bake: &v1::Bake) -> Bytes {
        assert_eq!(bake.state(), v1::BakeState::Succeeded, "{:?}", bake.failure);
        let (_, file) = bake.result.as_ref().unwrap().digests().unwrap();
        self.client().download(file).await.unwrap()
    }
}

/// A submission of a level, and its files.
pub(crate) fn submission(request_id: &str, level: &str) -> (Submission, BTreeMap<Digest, Bytes>) {
    let bytes = Bytes::from(level.to_owned());
    let digest = Digest::of(&bytes);
    let file = SourceFile { path: "level.txt".into(), digest };
    let submission = Submission {
        request_id: request_id.into(),
        source: SourceManifest { files: vec![file], sidecar: None, settings: BakeSettings::default() },
        backend: v1::Backend::Auto,
        priority: 0,
        name: "level.txt".into(),
        tenant: String::new(),
    };
    (submission, BTreeMap::from([(digest, bytes)]))
}

/// A worker that runs.
pub(crate) struct TestWorker {
    pub(crate) stop: oneshot::Sender<()>,
    pub(crate) ran: JoinHandle<Result<(), WorkerError>>,
}

impl TestWorker {
    /// The worker is gone from one moment to the next.
    pub(crate) fn lose(self) {
        self.ran.abort();
    }

    /// The worker is told to leave.
    pub(crate) async fn leave(self) -> Result<(), WorkerError> {
        drop(self.stop);
        self.ran.await.unwrap()
    }
}

/// Total, done and cache hits of a kind.
pub(crate) fn stage(bake: &v1::Bake, kind: TaskKind) -> (u64, u64, u64) {
    let stage = bake.stages.iter().find(|stage| TaskKind::try_from(stage.kind()) == Ok(kind));
    stage.map_or((0, 0, 0), |stage| (stage.total, stage.done, stage.cache_hits))
}

/// The result that every run of a level must give.
pub(crate) async fn reference(level: &str) -> Bytes {
    let farm = TestFarm::start().await;
    let _worker = farm.worker("reference");
    let bake = farm.bake(level).await;
    farm.file(&bake).await
}
