//! The farm end to end, in memory: a coordinator, real worker sessions, and an executor that only pretends to bake.

#![expect(clippy::unwrap_used, reason = "a test ends at the first surprise")]

mod cut;
mod fake;
mod faults;
mod mixed;
mod setup;
mod steering;

use fake::Control;
use kiln_core::TaskKind;
use kiln_proto::{client::BakeUpdate, v1};
use kiln_worker::RemoteArtefacts;
use setup::{TestFarm, config, reference, stage, submission};
use std::sync::Arc;

#[tokio::test(flavor = "multi_thread")]
async fn a_bake_goes_from_source_to_file_and_is_known_from_then_on() {
    let farm = TestFarm::start().await;
    let worker = farm.worker("a");
    let first = farm.bake("3 4 salt").await;
    let file = farm.file(&first).await;
    assert_eq!(file.len(), 6 + 3 * (4 + 4 * 6));
    assert_eq!(stage(&first, TaskKind::Import), (1, 1, 0));
    assert_eq!(stage(&first, TaskKind::Trace), (12, 12, 0));
    assert_eq!(stage(&first, TaskKind::Solve), (3, 3, 0));
    assert_eq!(stage(&first, TaskKind::Export), (1, 1, 0));
    assert_eq!(first.stages[2].rays_traced, 12 * 64);
    assert_eq!((first.stages[2].rays_done, first.stages[2].rays_total), (1200, 1200));
    assert_eq!(first.lane, Some(v1::Lane { trace: "cpu".into(), solve: "any".into() }));
    assert_eq!(first.warnings.len(), 1);

    let second = farm.bake("3 4 salt").await;
    assert_ne!(second.bake_id, first.bake_id);
    assert!(second.result.as_ref().unwrap().answered_from_store);
    assert_eq!(stage(&second, TaskKind::Trace), (12, 12, 12));
    assert_eq!(farm.file(&second).await, file);
    assert_eq!(farm.control.runs(TaskKind::Import), 1);

    // Another level with the same salt shares the keys of its pieces, and of its solves.
    let third = farm.bake("4 4 salt").await;
    assert_eq!(stage(&third, TaskKind::Trace), (16, 16, 12));
    assert_eq!(stage(&third, TaskKind::Solve), (4, 4, 3));
    assert!(worker.leave().await.is_ok());
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bakes_at_the_same_time_share_what_is_under_way() {
    let farm = TestFarm::start().await;
    farm.control.gate(0);
    let _worker = farm.worker("a");
    let one = farm.submit("one", "2 3 salt").await;
    farm.control.until("a trace task", |c| c.waiting.load(std::sync::atomic::Ordering::SeqCst) > 0).await;
    let two = farm.submit("two", "3 3 salt").await;
    farm.control.open();
    let (one, two) = (farm.end(&one.bake_id).await, farm.end(&two.bake_id).await);
    assert_eq!((one.state(), two.state()), (v1::BakeState::Succeeded, v1::BakeState::Succeeded));
    assert_eq!(farm.control.runs(TaskKind::Trace), 9, "equal keys run once");
    assert_eq!(stage(&two, TaskKind::Trace), (9, 9, 6));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_the_same_within_a_bake_runs_once() {
    let farm = TestFarm::start().await;
    let _worker = farm.worker("a");
    let bake = farm.bake("5 3 salt twins").await;
    assert_eq!((stage(&bake, TaskKind::Trace), farm.control.runs(TaskKind::Trace)), ((15, 15, 12), 3));
    assert_eq!((stage(&bake, TaskKind::Solve), farm.control.runs(TaskKind::Solve)), ((5, 5, 4), 1));
    let file = farm.file(&bake).await;
    let solutions: Vec<&[u8]> = file[6..].chunks(4 + 4 * 6).map(|instance| &instance[4..]).collect();
    assert_eq!(solutions, [solutions[0]; 5], "and each instance is given the result");
}

#[tokio::test(flavor = "multi_thread")]
async fn workers_may_have_no_store_but_the_farms() {
    let farm = TestFarm::start().await;
    let cache = tempfile::tempdir().unwrap();
    let cache = Arc::new(kiln_store::Store::open(cache.path(), Default::default()).unwrap());
    let runtime = tokio::runtime::Handle::current();
    let remote = RemoteArtefacts::new(farm.client(), Arc::clone(&cache), 1 << 30, runtime);
    let _worker = farm.worker_over("far", farm.client(), Arc::new(remote));
    let bake = farm.bake("2 5 salt").await;
    assert_eq!(farm.file(&bake).await, reference("2 5 salt").await);
    assert!(cache.usage().unwrap().artefacts >= 2, "the level and its mesh were kept");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_leaves_hands_its_work_on() {
    let farm = TestFarm::start().await;
    farm.control.gate(2);
    let leaving = farm.worker("leaving");
    let bake = farm.submit("r", "2 8 salt").await;
    farm.control.until("a trace task", |c| c.waiting.load(std::sync::atomic::Ordering::SeqCst) > 0).await;
    let stays = Arc::new(Control::default());
    let artefacts = Arc::new(kiln_worker::LocalArtefacts(Arc::clone(&farm.store)));
    let _stays = farm.worker_with("stays", farm.client(), artefacts, Arc::clone(&stays));
    let left = tokio::spawn(leaving.leave());
    tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    farm.control.open();
    assert!(left.await.unwrap().is_ok());
    let bake = farm.end(&bake.bake_id).await;
    assert_eq!(farm.file(&bake).await, reference("2 8 salt").await);
    let traced = farm.control.runs(TaskKind::Trace) + stays.runs(TaskKind::Trace);
    assert_eq!(traced, 16, "what the leaving worker had begun it finished");
    assert!(stays.runs(TaskKind::Trace) > 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watcher_sees_everything_in_order() {
    let farm = TestFarm::start().await;
    farm.control.gate(2);
    let bake = farm.submit("r", "2 3 salt").await;
    assert_eq!(bake.state(), v1::BakeState::Submitted);
    let mut watch = farm.client().watch(&bake.bake_id);
    let Some(BakeUpdate::Snapshot(first)) = watch.next().await.unwrap() else { panic!("a snapshot comes first") };
    assert_eq!(first.state(), v1::BakeState::Submitted);
    let _worker = farm.worker("a");
    farm.control.until("a trace task", |c| c.waiting.load(std::sync::atomic::Ordering::SeqCst) > 0).await;
    // Long enough for what is done so far to be told.
    tokio::time::sleep(2 * config().progress_interval).await;
    farm.control.open();
    let (mut states, mut progress, mut warnings) = (vec![], 0, 0);
    while let Some(update) = watch.next().await.unwrap() {
        match update {
            BakeUpdate::Snapshot(bake) => states.push(bake.state()),
            BakeUpdate::Progress(_) => progress += 1,
            BakeUpdate::Warning(warning) => warnings += usize::from(warning.code == "fake"),
            BakeUpdate::AttemptFailed(failed) => panic!("{failed:?}"),
        }
    }
    states.dedup();
    use v1::BakeState::{Baking, Exporting, Importing, Planning, Succeeded};
    assert_eq!(states, [Importing, Planning, Baking, Exporting, Succeeded]);
    assert!(progress > 0);
    assert_eq!(warnings, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn events_go_on_after_the_one_that_was_seen() {
    let farm = TestFarm::start().await;
    let _worker = farm.worker("a");
    let bake = farm.submit("r", "1 1 salt").await;
    farm.end(&bake.bake_id).await;
    let mut bakes = farm.client().bakes();
    let all = |after_event| v1::WatchBakeRequest { bake_id: bake.bake_id.clone(), after_event };
    // The bake has ended: a watcher is told its end, whatever it has seen.
    let mut stream = bakes.watch_bake(all(0)).await.unwrap().into_inner();
    let end = stream.message().await.unwrap().unwrap();
    assert!(matches!(end.event, Some(v1::watch_bake_response::Event::Snapshot(bake)) if bake.has_ended()));
    assert!(stream.message().await.unwrap().is_none());
    // Another is under way: its events can be asked for from any number on.
    farm.control.gate(0);
    let other = farm.submit("r2", "1 1 pepper").await;
    farm.control.until("a trace task", |c| c.waiting.load(std::sync::atomic::Ordering::SeqCst) > 0).await;
    let now = farm.client().bake(&other.bake_id).await.unwrap();
    let after_event = now.last_event - 2;
    let request = v1::WatchBakeRequest { bake_id: other.bake_id.clone(), after_event };
    let mut stream = bakes.watch_bake(request).await.unwrap().into_inner();
    let numbers = [stream.message().await.unwrap().unwrap().number, stream.message().await.unwrap().unwrap().number];
    assert_eq!(numbers, [after_event + 1, after_event + 2]);
    farm.control.open();
    farm.end(&other.bake_id).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_farm_can_be_looked_at() {
    let farm = TestFarm::start().await;
    let _worker = farm.worker("a");
    farm.bake("2 2 salt").await;
    let client = farm.client();
    let workers = client.list_workers().await.unwrap();
    assert_eq!(workers.len(), 1);
    assert_eq!((workers[0].worker_id.as_str(), workers[0].tasks_done), ("a", 9));
    let stats = client.stats().await.unwrap();
    assert_eq!((stats.workers, stats.cores, stats.bakes_active, stats.bakes_ended), (1, 2, 0, 1));
    assert_eq!(stats.kinds.iter().map(|kind| kind.run).sum::<u64>(), 9);
    let mut watch = client.state().watch_farm(v1::WatchFarmRequest {}).await.unwrap().into_inner();
    let seen = watch.message().await.unwrap().unwrap();
    assert_eq!(seen.workers.len(), 1);
    let (bakes, next) = client.list(1, "", false).await.unwrap();
    assert_eq!((bakes.len(), next), (1, None));
    let (submission, files) = submission("x", "1 1 other");
    client.submit_with_files(&submission, &files).await.unwrap();
    let (bakes, next) = client.list(1, "", false).await.unwrap();
    assert_eq!(bakes[0].bake_id, "2");
    let (bakes, next) = client.list(1, &next.unwrap(), false).await.unwrap();
    assert_eq!((bakes[0].bake_id.as_str(), next), ("1", None));
}
