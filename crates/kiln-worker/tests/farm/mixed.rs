//! Lanes: bakes that stay in one and bakes that do not, and devices that are lost.

use crate::{
    fake::{Control, Fault},
    setup::{TestFarm, stage},
};
use kiln_core::{MIXED_LANE, TaskKind};
use kiln_proto::v1;
use kiln_worker::WorkerError;
use std::sync::{Arc, atomic::Ordering};

const CARD: &str = "gpu:x:1";

fn control(fault: Option<Fault>) -> Arc<Control> {
    let control = Control::default();
    *control.fault.lock().unwrap() = fault.map(|fault| (TaskKind::Trace, fault));
    Arc::new(control)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mixed_bake_is_traced_in_every_lane_under_keys_of_its_own() {
    let farm = TestFarm::start().await;
    let (processor, card) = (control(None), control(None));
    for control in [&processor, &card] {
        control.gate(0);
    }
    let _a = farm.worker_of("cpu", "a", &processor);
    let _b = farm.worker_of(CARD, "b", &card);
    let bake = farm.submit_mixed("m", "4 8 salt").await;
    for control in [&processor, &card] {
        control.until("a trace task", |c| c.waiting.load(Ordering::SeqCst) > 0).await;
        control.open();
    }
    let mixed = farm.end(&bake.bake_id).await;
    farm.file(&mixed).await;
    assert_eq!(mixed.lane, Some(v1::Lane { trace: MIXED_LANE.into(), solve: "any".into() }));
    assert_eq!(processor.runs(TaskKind::Trace) + card.runs(TaskKind::Trace), 32);
    // A bake in one lane takes none of its results.
    let alone = farm.bake("4 8 salt").await;
    assert_eq!(alone.lane.as_ref().unwrap().trace, CARD);
    assert_ne!(farm.file(&alone).await, farm.file(&mixed).await, "the fake's results follow from the bake's lane");
    assert_eq!(stage(&alone, TaskKind::Trace), (32, 32, 0));
    // Another mixed one takes them all.
    let again = farm.submit_mixed("again", "4 8 salt").await;
    assert_eq!(stage(&farm.end(&again.bake_id).await, TaskKind::Trace), (32, 32, 32));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_work_of_a_lost_device_goes_on_in_another_lane() {
    let farm = TestFarm::start().await;
    let processor = control(None);
    let card = farm.worker_of(CARD, "card", &control(Some(Fault::LosesDevice)));
    let bake = farm.submit_mixed("m", "2 3 salt").await;
    let lost = card.ran.await.unwrap();
    assert!(matches!(&lost, Err(WorkerError::DeviceLost { reason }) if reason == "the card fell out"), "{lost:?}");
    let _processor = farm.worker_of("cpu", "processor", &processor);
    let bake = farm.end(&bake.bake_id).await;
    farm.file(&bake).await;
    assert_eq!(processor.runs(TaskKind::Trace), 6);
    let trace = bake.stages.iter().find(|stage| stage.kind() == v1::TaskKind::Trace).unwrap();
    assert_eq!(trace.retries, 0, "a lost device is no failure of its tasks");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bake_in_one_lane_waits_for_another_device_of_its_kind() {
    let farm = TestFarm::start().await;
    let (processor, other) = (control(None), control(None));
    let card = farm.worker_of(CARD, "card", &control(Some(Fault::LosesDevice)));
    let bake = farm.submit("m", "2 3 salt").await;
    assert!(matches!(card.ran.await.unwrap(), Err(WorkerError::DeviceLost { .. })));
    let _processor = farm.worker_of("cpu", "processor", &processor);
    let _other = farm.worker_of(CARD, "other", &other);
    let bake = farm.end(&bake.bake_id).await;
    farm.file(&bake).await;
    assert_eq!(bake.lane.unwrap().trace, CARD);
    assert_eq!((processor.runs(TaskKind::Trace), other.runs(TaskKind::Trace)), (0, 6));
}
