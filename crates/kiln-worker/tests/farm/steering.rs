//! What clients do to bakes: cancel, pause, repeat, ask why.

use crate::{
    fake::Control,
    setup::{TestFarm, config, stage, submission},
};
use kiln_coordinator::{Config, Unfinished};
use kiln_core::TaskKind;
use kiln_proto::{status, v1};
use std::sync::atomic::Ordering;

fn waits(control: &Control) -> bool {
    control.waiting.load(Ordering::SeqCst) > 0
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_bake_stops_and_keeps_what_it_has() {
    let farm = TestFarm::start().await;
    farm.control.gate(0);
    let worker = farm.worker("a");
    let bake = farm.submit("r", "2 4 salt").await;
    farm.control.until("a trace task", waits).await;
    let cancelled = farm.client().cancel(&bake.bake_id).await.unwrap();
    assert_eq!(cancelled.state(), v1::BakeState::Cancelled);
    assert!(cancelled.ended_unix_ms >= cancelled.submitted_unix_ms);
    farm.control.until("the end of its tasks", |c| c.cancelled.load(Ordering::SeqCst) > 0).await;
    assert_eq!(farm.client().cancel(&bake.bake_id).await.unwrap().state(), v1::BakeState::Cancelled, "again");
    farm.control.open();
    let again = farm.bake("2 4 salt").await;
    assert_eq!(again.state(), v1::BakeState::Succeeded);
    assert_eq!(stage(&again, TaskKind::Import), (1, 1, 1), "what was finished is not run again");
    worker.lose();
    let farm = farm.restart().await;
    assert_eq!(farm.client().bake(&bake.bake_id).await.unwrap().state(), v1::BakeState::Cancelled);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_id_names_one_bake() {
    let farm = TestFarm::start().await;
    let client = farm.client();
    let (submission, files) = submission("r", "1 1 salt");
    let (first, repeated) = client.submit_with_files(&submission, &files).await.unwrap();
    assert!(!repeated);
    let (second, repeated) = client.submit(&submission).await.unwrap();
    assert!(repeated);
    assert_eq!(first.bake_id, second.bake_id);
    let mut other = submission.clone();
    other.priority = 7;
    let error = client.submit(&other).await.unwrap_err();
    assert_eq!(error.reason().as_deref(), Some(status::REQUEST_ID_REUSED));
    // Also when the coordinator was started again, and for calls at the same time.
    drop(client);
    let farm = farm.restart().await;
    let (third, repeated) = farm.client().submit(&submission).await.unwrap();
    assert!(repeated && third.bake_id == first.bake_id);
    let mut fresh = submission.clone();
    fresh.request_id = "s".into();
    let (a, b) = (farm.client(), farm.client());
    let (a, b) = tokio::join!(a.submit(&fresh), b.submit(&fresh));
    let ((a, a_repeated), (b, b_repeated)) = (a.unwrap(), b.unwrap());
    assert_eq!(a.bake_id, b.bake_id);
    assert!(a_repeated != b_repeated, "one of the two was first");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_source_must_have_been_uploaded() {
    let farm = TestFarm::start().await;
    let (submission, _) = submission("r", "1 1 salt");
    let error = farm.client().submit(&submission).await.unwrap_err();
    assert_eq!(error.reason().as_deref(), Some(status::SOURCE_MISSING));
    assert!(error.to_string().contains("level.txt"), "{error}");
    let error = farm.client().bake("77").await.unwrap_err();
    assert_eq!(error.reason().as_deref(), Some(status::BAKE_NOT_FOUND));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_paused_bake_waits_and_holds_nobody_back() {
    let farm = TestFarm::start().await;
    farm.control.gate(0);
    let _worker = farm.worker("a");
    let paused = farm.submit("one", "4 4 salt").await;
    farm.control.until("a trace task", waits).await;
    let view = farm.client().pause(&paused.bake_id).await.unwrap();
    assert!(view.paused);
    let reasons = farm.client().explain(&paused.bake_id).await.unwrap();
    assert!(reasons.iter().any(|reason| reason.contains("paused")), "{reasons:?}");
    farm.control.open();
    // Another bake that needs the same pieces does not wait for the paused one.
    let other = farm.bake("5 4 salt").await;
    assert_eq!(other.state(), v1::BakeState::Succeeded);
    // It gets what the other has made, and goes no further by itself.
    let waits = farm.client().bake(&paused.bake_id).await.unwrap();
    assert_eq!((waits.state(), stage(&waits, TaskKind::Export).1), (v1::BakeState::Exporting, 0));
    farm.client().resume(&paused.bake_id).await.unwrap();
    assert_eq!(farm.end(&paused.bake_id).await.state(), v1::BakeState::Succeeded);
    assert_eq!(farm.control.runs(TaskKind::Trace), 20);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bake_that_nobody_can_run_says_so_and_fails() {
    let farm = TestFarm::start().await;
    let (mut submission, files) = submission("r", "1 1 salt");
    submission.backend = v1::Backend::Gpu;
    let bake = farm.client().submit_with_files(&submission, &files).await.unwrap().0;
    let reasons = farm.client().explain(&bake.bake_id).await.unwrap();
    assert!(reasons[0].contains("no worker is connected"), "{reasons:?}");
    let _worker = farm.worker("a");
    let bake = farm.end(&bake.bake_id).await;
    let failure = bake.failure.unwrap();
    assert_eq!(failure.kind(), v1::FailureKind::NoWorker);
    assert!(failure.message.contains("none of the 1 connected workers has a GPU"), "{failure:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_for_one_bake_leaves_others_alone() {
    let farm = TestFarm::start().await;
    let left = farm.submit("r", "1 1 salt").await;
    let farm = farm.restart_with(Config { unfinished: Unfinished::Leave, ..config() }).await;
    let _worker = farm.worker("a");
    assert_eq!(farm.bake("1 1 pepper").await.state(), v1::BakeState::Succeeded);
    assert_eq!(farm.client().bake(&left.bake_id).await.unwrap().state(), v1::BakeState::Submitted);
    assert_eq!(farm.control.runs(TaskKind::Import), 1);
    // Until it is asked for again.
    let again = farm.submit("r", "1 1 salt").await;
    assert_eq!(again.bake_id, left.bake_id);
    assert_eq!(farm.end(&left.bake_id).await.state(), v1::BakeState::Succeeded);
}
