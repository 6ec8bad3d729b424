//! Running the tasks of a lease, side by side on the worker's threads.

use crate::{
    ArtefactError, Artefacts, CancelFlag, Executor, TaskError,
    account::{Part, Sheet},
    threads::{TaskSize, TaskThreads},
};
use bytes::Bytes;
use kiln_core::{Digest, TaskKey, TaskSpec, Work, WorkSpec};
use kiln_proto::{limits, v1};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, mpsc},
    time::Instant,
};

/// A leased task, checked.
#[derive(Clone)]
pub(crate) struct LeasedTask {
    pub(crate) id: u64,
    pub(crate) key: TaskKey,
    pub(crate) spec: TaskSpec,
    /// The trace lane of its bake.
    pub(crate) lane: Arc<str>,
    pub(crate) cancel: CancelFlag,
}

/// What a lease is run with.
#[derive(Clone)]
pub(crate) struct Bench {
    pub(crate) threads: TaskThreads,
    pub(crate) executor: Arc<dyn Executor>,
    pub(crate) artefacts: Arc<dyn Artefacts>,
}

/// Is told of each finished task and of rays.
pub(crate) type Progress = Arc<dyn Fn(u32, u64) + Send + Sync>;

/// What came of a lease's tasks.
#[derive(Debug, Default)]
pub(crate) struct LeaseOutcome {
    pub(crate) results: Vec<v1::TaskResult>,
    pub(crate) failures: Vec<Failure>,
    pub(crate) seconds: f64,
    /// The device was lost, and with it tasks that have neither result nor failure.
    pub(crate) lost: Option<String>,
}

/// A task that failed.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) id: u64,
    pub(crate) key: TaskKey,
    pub(crate) kind: v1::TaskFailureKind,
    pub(crate) message: String,
    pub(crate) missing: Option<Digest>,
}

struct Done {
    id: u64,
    key: TaskKey,
    result: Bytes,
    attachments: Vec<Bytes>,
    rays: u64,
    sheet: Sheet,
    began: Instant,
    ended: Instant,
}

impl Bench {
    /// Runs the tasks and stores what they give, all together. Blocks.
    pub(crate) fn run(&self, tasks: &[LeasedTask], progress: &Progress) -> LeaseOutcome {
        let mut failures = Vec::new();
        let mut done = Vec::new();
        let mut lost = None;
        for (task, outcome) in tasks.iter().zip(self.run_all(tasks, progress)) {
            match outcome {
                Ok(result) => done.push(result),
                Err(TaskError::DeviceLost { reason }) => lost = Some(reason),
                Err(error) => failures.extend(failure(task, &error)),
            }
        }
        let began = done.iter().map(|task| task.began).min();
        let ended = done.iter().map(|task| task.ended).max();
        let seconds = began.zip(ended).map_or(0.0, |(began, ended)| (ended - began).as_secs_f64());
        let blobs: Vec<Bytes> = done.iter().flat_map(blobs).collect();
        let stored = if blobs.is_empty() { Ok(Vec::new()) } else { self.artefacts.store(blobs) };
        let results = match stored {
            Ok(_) => done.iter().map(result).collect(),
            Err(error) => {
                failures.extend(done.iter().map(|task| not_stored(task, &error)));
                Vec::new()
            }
        };
        LeaseOutcome { results, failures, seconds, lost }
    }

    /// Outcomes in the order of the tasks.
    fn run_all(&self, tasks: &[LeasedTask], progress: &Progress) -> Vec<Result<Done, TaskError>> {
        let (send, outcomes) = mpsc::channel();
        for (i, task) in tasks.iter().cloned().enumerate() {
            let (send, progress) = (send.clone(), Arc::clone(progress));
            let (executor, artefacts) = (Arc::clone(&self.executor), Arc::clone(&self.artefacts));
            self.threads.run(size(&task.spec), move || {
                let outcome = run_task(&task, &*executor, &*artefacts, &|rays| progress(0, rays));
                progress(1, 0);
                // The receiver waits until every sender is gone.
                let _ = send.send((i, outcome));
            });
        }
        drop(send);
        let lost = || Err(TaskError::Failed { reason: "the worker's threads have ended".to_owned() });
        let mut ran: Vec<Result<Done, TaskError>> = tasks.iter().map(|_| lost()).collect();
        outcomes.iter().for_each(|(i, outcome): (usize, _)| ran[i] = outcome);
        ran
    }
}

fn result(task: &Done) -> v1::TaskResult {
    let part = |part| {
        let entry = task.sheet.entry(part);
        Some(v1::PartTime { seconds: entry.seconds(), cpu_seconds: entry.cpu_seconds() })
    };
    v1::TaskResult {
        task_id: task.id,
        key: task.key.0.0.to_vec(),
        artefact: Digest::of(&task.result).0.to_vec(),
        seconds: (task.ended - task.began).as_secs_f64(),
        cpu_seconds: task.sheet.cpu_seconds(),
        rays: task.rays,
        loading: part(Part::Loading),
        building: part(Part::Building),
        tracing: part(Part::Tracing),
    }
}

/// Pieces of an instance whose solve has no work for several threads: some thousand unknowns.
const PIECES_OF_SMALL_SOLVE: usize = 4;

fn size(spec: &TaskSpec) -> TaskSize {
    match spec {
        TaskSpec::Work(WorkSpec {
            work:
                Work::Trace(_) | Work::Volume(_) | Work::Points(_) | Work::Regions(_) | Work::Read(_) | Work::Resample(_),
            ..
        }) => TaskSize::Small,
        TaskSpec::Work(WorkSpec { work: Work::Solve(_), inputs, .. }) if inputs.len() <= PIECES_OF_SMALL_SOLVE => {
            TaskSize::Small
        }
        TaskSpec::Work(WorkSpec { work: Work::Solve(_) | Work::Fit(_) | Work::Model(_), .. }) => TaskSize::Large,
        TaskSpec::Import { .. } | TaskSpec::Plan(_) | TaskSpec::Export(_) => TaskSize::Large,
    }
}

fn run_task(
    task: &LeasedTask,
    executor: &dyn Executor,
    artefacts: &dyn Artefacts,
    progress: &dyn Fn(u64),
) -> Result<Done, TaskError> {
    if task.cancel.is_cancelled() {
        return Err(TaskError::Cancelled);
    }
    let (began, sheet) = (Instant::now(), Sheet::default());
    // A bug in a task must not take the worker and its other leases down.
    let run = || executor.run(&task.spec, &task.lane, artefacts, &task.cancel, progress);
    let output = catch_unwind(AssertUnwindSafe(|| sheet.charge(run)));
    let output = output.map_err(|panic| TaskError::Failed { reason: describe_panic(&*panic) })??;
    Ok(Done {
        id: task.id,
        key: task.key,
        result: output.result.into(),
        attachments: output.attachments.into_iter().map(Bytes::from).collect(),
        rays: output.rays,
        sheet,
        began,
        ended: Instant::now(),
    })
}

fn describe_panic(panic: &(dyn std::any::Any + Send)) -> String {
    let words = panic.downcast_ref::<&str>().copied().or(panic.downcast_ref::<String>().map(String::as_str));
    format!("the task panicked: {}; this is a bug in Kiln, please report it", words.unwrap_or("no message"))
}

fn blobs(task: &Done) -> impl Iterator<Item = Bytes> {
    std::iter::once(&task.result).chain(&task.attachments).cloned()
}

fn not_stored(task: &Done, error: &ArtefactError) -> Failure {
    Failure {
        id: task.id,
        key: task.key,
        kind: v1::TaskFailureKind::Artefact,
        message: format!("the result could not be stored: {error}"),
        missing: None,
    }
}

/// What is said of a task that did not give a result; nothing of one that was cancelled or is handed back.
fn failure(task: &LeasedTask, error: &TaskError) -> Option<Failure> {
    let (kind, missing) = match error {
        TaskError::Cancelled | TaskError::DeviceLost { .. } => return None,
        TaskError::Refused { .. } => (v1::TaskFailureKind::Refused, None),
        TaskError::Failed { .. } => (v1::TaskFailureKind::Failed, None),
        TaskError::Artefact(ArtefactError::Missing { digest }) => (v1::TaskFailureKind::Artefact, Some(*digest)),
        TaskError::Artefact(_) => (v1::TaskFailureKind::Artefact, None),
    };
    let message = limits::cut(&error.to_string(), limits::FAILURE_TEXT_BYTES).to_owned();
    Some(Failure { id: task.id, key: task.key, kind, message, missing })
}
