//! Tasks that fail, results that make no sense, inputs that are refused, artefacts that are lost.

use crate::{
    fake::{Control, Fault},
    setup::{TestFarm, reference, submission},
};
use kiln_core::{Digest, TaskKind, codec};
use kiln_proto::v1;
use kiln_worker::LocalArtefacts;
use std::{
    collections::BTreeSet,
    sync::{Arc, atomic::Ordering},
};

#[tokio::test(flavor = "multi_thread")]
async fn a_task_that_always_fails_fails_the_bake_with_what_was_said() {
    for (fault, says) in [(Fault::Fails, "the moon is full"), (Fault::Panics, "panicked: the moon is full")] {
        let farm = TestFarm::start().await;
        *farm.control.fault.lock().unwrap() = Some((TaskKind::Plan, fault));
        let _worker = farm.worker("a");
        let bake = farm.bake("1 1 salt").await;
        assert_eq!(bake.state(), v1::BakeState::Failed);
        let failure = bake.failure.unwrap();
        assert_eq!(failure.kind(), v1::FailureKind::TaskFailed);
        assert_eq!(failure.task(), v1::TaskKind::Plan);
        assert_eq!(failure.attempts.len(), 3, "{failure:?}");
        for attempt in &failure.attempts {
            assert_eq!(attempt.worker, "worker a");
            assert!(attempt.message.contains(says), "{attempt:?}");
        }
        let plan = bake.stages.iter().find(|stage| stage.kind() == v1::TaskKind::Plan).unwrap();
        assert_eq!(plan.retries, 2);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn results_that_make_no_sense_are_not_accepted() {
    let lie = async |kind: TaskKind| {
        let farm = TestFarm::start().await;
        *farm.control.fault.lock().unwrap() = Some((kind, Fault::Lies));
        let _worker = farm.worker("a");
        let failure = farm.bake("1 1 salt").await.failure.unwrap();
        assert_eq!(failure.task(), kind.into());
        assert!(failure.attempts[0].message.contains("is no good"), "{failure:?}");
        // An honest run afterwards is not harmed by what the liar had stored.
        *farm.control.fault.lock().unwrap() = None;
        let bake = farm.bake("1 1 salt").await;
        assert_eq!(farm.file(&bake).await, reference("1 1 salt").await);
    };
    tokio::join!(lie(TaskKind::Import), lie(TaskKind::Trace), lie(TaskKind::Solve), lie(TaskKind::Export));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_input_that_is_refused_is_not_tried_again() {
    let farm = TestFarm::start().await;
    let worker = farm.worker("a");
    let bake = farm.bake("refuse node 3 has no mesh").await;
    let failure = bake.failure.clone().unwrap();
    assert_eq!(failure.kind(), v1::FailureKind::InputRefused);
    assert_eq!(failure.message, "level.txt: node 3 has no mesh; mend the file");
    let import = bake.stages.iter().find(|stage| stage.kind() == v1::TaskKind::Import).unwrap();
    assert_eq!((import.done, import.retries), (0, 0));
    worker.lose();
    let farm = farm.restart().await;
    assert_eq!(farm.client().bake(&bake.bake_id).await.unwrap().failure, Some(failure), "and it is remembered");
}

#[tokio::test(flavor = "multi_thread")]
async fn another_worker_may_do_what_one_fails_at() {
    let farm = TestFarm::start().await;
    *farm.control.fault.lock().unwrap() = Some((TaskKind::Solve, Fault::Fails));
    let _bad = farm.worker("bad");
    let artefacts = Arc::new(LocalArtefacts(Arc::clone(&farm.store)));
    let _good = farm.worker_with("good", farm.client(), artefacts, Arc::new(Control::default()));
    let bake = farm.bake("8 1 salt").await;
    assert_eq!(farm.file(&bake).await, reference("8 1 salt").await);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_store_has_lost_is_made_again() {
    let farm = TestFarm::start().await;
    farm.control.gate(0);
    let _worker = farm.worker("a");
    let (submission, files) = submission("r", "2 2 salt");
    let bake = farm.client().submit_with_files(&submission, &files).await.unwrap().0;
    farm.control.until("a trace task", |c| c.waiting.load(Ordering::SeqCst) > 0).await;
    let mut sources: BTreeSet<Digest> = files.into_keys().collect();
    sources.insert(Digest::of(&codec::encode(&submission.source)));
    let collected = farm.store.collect_garbage(&sources, 0).unwrap();
    assert!(collected.artefacts >= 3, "level, mesh and plan: {collected:?}");
    farm.control.open();
    let bake = farm.end(&bake.bake_id).await;
    assert_eq!(farm.file(&bake).await, reference("2 2 salt").await);
    assert_eq!(farm.control.runs(TaskKind::Import), 2);
}
