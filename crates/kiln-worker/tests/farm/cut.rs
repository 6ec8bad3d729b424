//! Connections that break, workers that vanish, coordinators that are started again.

use crate::{
    fake::Control,
    setup::{TestFarm, reference, stage},
};
use hyper_util::rt::TokioIo;
use kiln_core::TaskKind;
use kiln_proto::{
    client::{Bearer, Farm},
    v1,
};
use kiln_worker::LocalArtefacts;
use std::{
    io,
    sync::{Arc, Mutex, atomic::Ordering},
    time::Duration,
};
use tokio::{io::copy_bidirectional, task::AbortHandle};
use tonic::transport::{Endpoint, Uri};

#[tokio::test(flavor = "multi_thread")]
async fn another_worker_finishes_what_a_lost_one_began() {
    let farm = TestFarm::start().await;
    farm.control.gate(3);
    let lost = farm.worker("lost");
    let bake = farm.submit("r", "3 6 salt").await;
    farm.control.until("a trace task", |c| c.waiting.load(Ordering::SeqCst) > 0).await;
    lost.lose();
    let artefacts = Arc::new(LocalArtefacts(Arc::clone(&farm.store)));
    let _other = farm.worker_with("other", farm.client(), artefacts, Arc::new(Control::default()));
    let bake = farm.end(&bake.bake_id).await;
    assert_eq!(farm.file(&bake).await, reference("3 6 salt").await);
    farm.control.until("the end of the lost worker's tasks", |c| c.cancelled.load(Ordering::SeqCst) > 0).await;
}

/// A way to the coordinator whose connections can be cut; tells how many there have been.
struct Cable {
    farm: Farm,
    laid: Arc<Mutex<Vec<AbortHandle>>>,
}

impl Cable {
    fn lay(farm: &TestFarm) -> Self {
        let laid: Arc<Mutex<Vec<AbortHandle>>> = Arc::default();
        let (connector, list) = (farm.connector.clone(), Arc::clone(&laid));
        let connect = tower::service_fn(move |_: Uri| {
            let (connector, list) = (connector.clone(), Arc::clone(&list));
            async move {
                let (near, mut middle) = tokio::io::duplex(1 << 16);
                let mut far = connector.connect().await?;
                let cable = tokio::spawn(async move { copy_bidirectional(&mut middle, &mut far).await });
                list.lock().unwrap().push(cable.abort_handle());
                Ok::<_, io::Error>(TokioIo::new(near))
            }
        });
        let channel = Endpoint::from_static("http://cut.kiln").connect_with_connector_lazy(connect);
        Self { farm: Farm::over(channel, Bearer::default()), laid }
    }

    fn cut(&self) {
        self.laid.lock().unwrap().iter().for_each(AbortHandle::abort);
    }

    fn connections(&self) -> usize {
        self.laid.lock().unwrap().len()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_goes_on_when_its_connection_is_back() {
    let farm = TestFarm::start().await;
    farm.control.gate(2);
    let cable = Cable::lay(&farm);
    let artefacts = Arc::new(LocalArtefacts(Arc::clone(&farm.store)));
    let _worker = farm.worker_over("cut", cable.farm.clone(), artefacts);
    let bake = farm.submit("r", "2 6 salt").await;
    farm.control.until("a trace task", |c| c.waiting.load(Ordering::SeqCst) > 0).await;
    cable.cut();
    farm.control.until("the worker's return", |_| cable.connections() == 2).await;
    farm.control.open();
    let bake = farm.end(&bake.bake_id).await;
    assert_eq!(farm.file(&bake).await, reference("2 6 salt").await);
    assert_eq!(farm.control.runs(TaskKind::Trace), 12, "leases are kept over a broken connection");
}

#[tokio::test(flavor = "multi_thread")]
async fn results_that_were_ready_while_the_connection_was_broken_count() {
    let farm = TestFarm::start().await;
    farm.control.gate(0);
    let cable = Cable::lay(&farm);
    let artefacts = Arc::new(LocalArtefacts(Arc::clone(&farm.store)));
    let _worker = farm.worker_over("cut", cable.farm.clone(), artefacts);
    let bake = farm.submit("r", "1 2 salt").await;
    farm.control.until("a trace task", |c| c.waiting.load(Ordering::SeqCst) > 0).await;
    cable.cut();
    farm.control.open();
    let bake = farm.end(&bake.bake_id).await;
    assert_eq!(bake.state(), v1::BakeState::Succeeded);
    assert_eq!(farm.control.runs(TaskKind::Trace), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_goes_on_where_the_last_one_ended() {
    let farm = TestFarm::start().await;
    farm.control.gate(8);
    let worker = farm.worker("a");
    let bake = farm.submit("r", "3 6 salt").await;
    let paused = farm.submit("p", "1 1 pepper").await;
    farm.client().pause(&paused.bake_id).await.unwrap();
    farm.control.until("a trace task", |c| c.waiting.load(Ordering::SeqCst) > 0).await;
    let done = loop {
        let (_, done, _) = stage(&farm.client().bake(&bake.bake_id).await.unwrap(), TaskKind::Trace);
        if done >= 4 {
            break done;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    };
    worker.lose();
    farm.control.open();
    let farm = farm.restart().await;
    let (before, imports) = (farm.control.runs(TaskKind::Trace) as u64, farm.control.runs(TaskKind::Import));
    let worker = farm.worker("b");
    let bake = farm.end(&bake.bake_id).await;
    let (total, all, hits) = stage(&bake, TaskKind::Trace);
    assert_eq!((total, all), (18, 18));
    assert!(hits >= done, "{hits} of {done} finished tasks were found");
    assert_eq!(farm.control.runs(TaskKind::Trace) as u64 - before, 18 - hits, "and not run again");
    assert_eq!(farm.control.runs(TaskKind::Import), imports);
    assert_eq!(farm.file(&bake).await, reference("3 6 salt").await);
    let paused = farm.client().bake(&paused.bake_id).await.unwrap();
    assert!(paused.paused && !paused.has_ended());
    farm.client().resume(&paused.bake_id).await.unwrap();
    assert_eq!(farm.end(&paused.bake_id).await.state(), v1::BakeState::Succeeded);
    // What has ended is remembered with its result.
    worker.lose();
    let farm = farm.restart().await;
    let known = farm.client().bake(&bake.bake_id).await.unwrap();
    assert_eq!((known.state(), known.result.unwrap().file), (v1::BakeState::Succeeded, bake.result.unwrap().file));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_outlives_its_coordinator() {
    let farm = TestFarm::start().await;
    let cable = Cable::lay(&farm);
    // The connector of the first coordinator leads nowhere once it is gone: the worker waits.
    let artefacts = Arc::new(LocalArtefacts(Arc::clone(&farm.store)));
    let worker = farm.worker_over("a", cable.farm.clone(), artefacts);
    assert_eq!(farm.bake("1 1 salt").await.state(), v1::BakeState::Succeeded);
    farm.stop().await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!worker.ran.is_finished());
    assert!(worker.leave().await.is_ok());
}
