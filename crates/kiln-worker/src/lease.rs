//! Running the tasks of a lease, side by side on the worker's threads.

use crate::{Artefacts, CancelFlag, Executor, TaskError, cpu_time};
use bytes::Bytes;
use kiln_core::{Digest, TaskKey, TaskSpec};
use kiln_proto::{limits, v1};
use rayon::prelude::*;
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    time::Instant,
};

/// A leased task, checked.
pub(crate) struct LeasedTask {
    pub(crate) id: u64,
    pub(crate) key: TaskKey,
    pub(crate) spec: TaskSpec,
    pub(crate) cancel: CancelFlag,
}

/// What came of a lease's tasks.
#[derive(Debug, Default)]
pub(crate) struct LeaseOutcome {
    pub(crate) results: Vec<v1::TaskResult>,
    pub(crate) failures: Vec<Failure>,
    pub(crate) seconds: f64,
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
    seconds: f64,
    cpu_seconds: f64,
    rays: u64,
}

/// Runs the tasks and stores what they give, all together. Must be called inside the worker's thread pool.
/// `progress` is told of each finished task and of rays.
pub(crate) fn run(
    tasks: &[LeasedTask],
    executor: &dyn Executor,
    artefacts: &dyn Artefacts,
    progress: &(dyn Fn(u32, u64) + Sync),
) -> LeaseOutcome {
    let start = Instant::now();
    let ran: Vec<Result<Done, Option<Failure>>> = tasks
        .par_iter()
        .with_max_len(1)
        .map(|task| {
            let outcome = run_task(task, executor, artefacts, &|rays| progress(0, rays));
            progress(1, 0);
            outcome.map_err(|error| failure(task, &error))
        })
        .collect();
    let (mut done, mut failures) = (Vec::new(), Vec::new());
    for outcome in ran {
        match outcome {
            Ok(task) => done.push(task),
            Err(failure) => failures.extend(failure),
        }
    }
    let stored = artefacts.store(done.iter().flat_map(blobs).collect());
    let results = match stored {
        Ok(_) => done.iter().map(result).collect(),
        Err(error) => {
            let error = TaskError::Artefact(error);
            failures.extend(done.iter().map(|task| Failure {
                id: task.id,
                key: task.key,
                kind: v1::TaskFailureKind::Artefact,
                message: format!("the result could not be stored: {error}"),
                missing: None,
            }));
            Vec::new()
        }
    };
    LeaseOutcome { results, failures, seconds: start.elapsed().as_secs_f64() }
}

fn run_task(
    task: &LeasedTask,
    executor: &dyn Executor,
    artefacts: &dyn Artefacts,
    progress: &dyn Fn(u64),
) -> Result<Done, TaskError> {
    let start = Instant::now();
    // A bug in a task must not take the worker and its other leases down.
    let run = || catch_unwind(AssertUnwindSafe(|| executor.run(&task.spec, artefacts, &task.cancel, progress)));
    let (output, cpu_seconds) = cpu_time::measure(run);
    let output = output.map_err(|panic| TaskError::Failed { reason: describe_panic(&*panic) })??;
    Ok(Done {
        id: task.id,
        key: task.key,
        result: output.result.into(),
        attachments: output.attachments.into_iter().map(Bytes::from).collect(),
        seconds: start.elapsed().as_secs_f64(),
        cpu_seconds,
        rays: output.rays,
    })
}

fn describe_panic(panic: &(dyn std::any::Any + Send)) -> String {
    let words = panic.downcast_ref::<&str>().copied().or(panic.downcast_ref::<String>().map(String::as_str));
    format!("the task panicked: {}; this is a bug in Kiln, please report it", words.unwrap_or("no message"))
}

fn blobs(task: &Done) -> impl Iterator<Item = Bytes> {
    std::iter::once(&task.result).chain(&task.attachments).cloned()
}

fn result(task: &Done) -> v1::TaskResult {
    v1::TaskResult {
        task_id: task.id,
        key: task.key.0.0.to_vec(),
        artefact: Digest::of(&task.result).0.to_vec(),
        seconds: task.seconds,
        cpu_seconds: task.cpu_seconds,
        rays: task.rays,
    }
}

/// What is said of a task that did not give a result; nothing of one that was cancelled.
fn failure(task: &LeasedTask, error: &TaskError) -> Option<Failure> {
    let kind = match error {
        TaskError::Cancelled => return None,
        TaskError::Refused { .. } => v1::TaskFailureKind::Refused,
        TaskError::Failed { .. } => v1::TaskFailureKind::Failed,
        TaskError::Artefact(_) => v1::TaskFailureKind::Artefact,
    };
    let missing = match error {
        TaskError::Artefact(crate::ArtefactError::Missing { digest }) => Some(*digest),
        _ => None,
    };
    let message = limits::cut(&error.to_string(), limits::FAILURE_TEXT_BYTES).to_owned();
    Some(Failure { id: task.id, key: task.key, kind, message, missing })
}
