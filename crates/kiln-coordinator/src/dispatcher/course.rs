//! The course of jobs: what the store answers, what the job makes of it, and how it ends.

use super::{
    Dispatcher,
    bakes::{tell_state, view},
    unix_ms,
};
use crate::{
    job::{Answer, Ended, Job, Node, Outcome, Phase, Step, Success, failure_key},
    keeper::Op,
    lanes, store_status,
};
use kiln_core::{Baked, Digest, JobId, Lane, TaskGraph, TaskKey, TaskKind, codec};
use kiln_proto::v1;
use kiln_schedule::Event;
use kiln_store::{JobOutcome, JournalEvent, StoreError};
use prost::Message;
use std::{collections::BTreeSet, sync::Arc};

/// Results whose files are kept when the store is brought down to its size.
const PINNED_RESULTS: usize = 100;

/// Time before an end is tried again that the store could not take.
const END_RETRY_MS: u64 = 2000;

impl Dispatcher {
    /// Starts the jobs that wait for a lane and now have one.
    pub(super) fn start_waiting(&mut self) {
        let offers = self.registry.offers();
        let waiting = self.jobs.values().filter(|job| is_waiting(job) && !job.paused);
        let starts: Vec<(JobId, Lane)> =
            waiting.filter_map(|job| Some((job.order.id, lanes::choose(job.order.backend, &offers)?))).collect();
        for (id, lane) in starts {
            self.journal(JournalEvent::LaneChosen { job: id, lane: lane.clone() }, super::Ack::Nobody);
            self.start_job(id, lane);
        }
    }

    pub(super) fn start_job(&mut self, id: JobId, lane: Lane) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        tracing::info!(bake = %id, trace = lane.trace, solve = lane.solve, "a bake starts");
        let step = job.start(lane);
        self.walk(id, vec![step]);
    }

    /// Fails jobs that no worker has fitted for too long. While no worker is there at all they wait.
    pub(super) fn fail_unfit(&mut self, now_ms: u64) {
        let Some(timeout_ms) = self.config.scheduler.no_fit_timeout_ms else { return };
        let anyone = !self.registry.offers().is_empty();
        let mut unfit = Vec::new();
        for job in self.jobs.values_mut().filter(|job| is_waiting(job)) {
            let (paused, id, backend) = (job.paused, job.order.id, job.order.backend);
            let Phase::Waiting(waiting) = &mut job.phase else { continue };
            if !anyone || paused {
                waiting.unfit_since_ms = None;
            } else if now_ms.saturating_sub(*waiting.unfit_since_ms.get_or_insert(now_ms)) >= timeout_ms {
                unfit.push((id, backend));
            }
        }
        for (id, backend) in unfit {
            let why = lanes::why_none(backend, &self.registry.offers());
            let message = format!("no worker can run it: {why}; connect one that can, or choose another --backend");
            self.fail(id, v1::FailureKind::NoWorker, message);
        }
    }

    /// Takes a job's next steps. Look-ups that follow from one event are asked in one go.
    pub(super) fn walk(&mut self, id: JobId, steps: Vec<Step>) {
        let mut nodes = Vec::new();
        for step in steps {
            match step {
                Step::LookUp(more) => nodes.extend(more),
                Step::LookUpAnswer(key) => self.keeper.send(Op::LookUpAnswer { job: id, key }),
                Step::ReadGraph(digest) => self.keeper.send(Op::ReadGraph { job: id, digest }),
                Step::ReadBaked(digest) => self.keeper.send(Op::ReadBaked { job: id, digest }),
                Step::StoreOutputs(list) => {
                    self.keeper.send(Op::StoreOutputs { job: id, bytes: codec::encode(&list) });
                }
            }
        }
        if nodes.is_empty() {
            return;
        }
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let mut keys: Vec<(Node, TaskKey)> = Vec::with_capacity(nodes.len());
        for node in nodes {
            let Some(task) = job.task(node) else { continue };
            // Those of the graph were counted when it was read.
            if !matches!(node, Node::Work { .. }) {
                job.progress.planned(node.kind(), 0);
                tell_state(job);
            }
            keys.push((node, task.key));
        }
        self.keeper.send(Op::LookUp { job: id, nodes: keys });
    }

    /// A task's result is there: found, or brought by a worker.
    pub(super) fn step(&mut self, id: JobId, node: Node, result: Digest) -> Vec<Step> {
        self.jobs.get_mut(&id).map(|job| job.done(node, result)).unwrap_or_default()
    }

    /// The store has lost an artefact that a task needs. What made it is pure, and is run again.
    pub(super) fn restart(&mut self, id: JobId, lost: Digest) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        if !job.restart() {
            return;
        }
        tracing::warn!(bake = %id, artefact = %lost, "an artefact is gone; what made it is run again");
        self.feed(Event::JobFinished(id));
        let orphans = self.flights.leave(id);
        self.queue_again(orphans);
        self.enroll(id);
        let steps = self.jobs.get_mut(&id).map(Job::no_answer).unwrap_or_default();
        self.walk(id, steps);
    }

    pub(super) fn answered(&mut self, id: JobId, found: Option<Box<(Answer, Baked)>>) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let Some(found) = found.filter(|_| job.order.skips_unchanged) else {
            let steps = job.no_answer();
            self.walk(id, steps);
            return;
        };
        if !matches!(job.phase, Phase::Answering) {
            return;
        }
        let (answer, baked) = *found;
        for (kind, tasks, rays) in answer.tasks {
            job.progress.answered(kind, tasks, rays);
            self.totals.hits(kind, tasks);
        }
        job.succeed(Success { digest: answer.baked, baked, from_store: true });
        self.end_decided(id);
    }

    pub(super) fn looked_up(&mut self, id: JobId, found: Vec<(Node, Option<Digest>)>) {
        let (mut steps, mut missing) = (Vec::new(), Vec::new());
        let skips = self.jobs.get(&id).is_some_and(|job| job.order.skips_unchanged);
        for (node, result) in found {
            let Some(result) = result.filter(|_| skips) else {
                missing.push((id, node));
                continue;
            };
            steps.extend(self.hit(id, node, result));
        }
        self.queue(missing);
        self.walk(id, steps);
    }

    /// A task that need not run.
    pub(super) fn hit(&mut self, id: JobId, node: Node, result: Digest) -> Vec<Step> {
        let Some(job) = self.jobs.get_mut(&id).filter(|job| !job.is_over()) else { return Vec::new() };
        let rays = job.rays(node);
        job.progress.hit(node.kind(), rays);
        self.totals.hits(node.kind(), 1);
        self.step(id, node, result)
    }

    pub(super) fn graph_read(&mut self, id: JobId, graph: Option<Box<TaskGraph>>) {
        let Some(job) = self.jobs.get_mut(&id).filter(|job| matches!(job.phase, Phase::Planning(_))) else { return };
        let Some(graph) = graph else {
            // It was there a moment ago: the file is damaged. The task is pure; it is run again.
            self.queue(vec![(id, Node::Plan)]);
            return;
        };
        let steps = match job.planned(*graph) {
            Ok(steps) => steps,
            Err(error) => return self.fail(id, v1::FailureKind::Internal, error.to_string()),
        };
        for warning in &job.warnings {
            job.events.append(|_| v1::watch_bake_response::Event::Warning(warning.clone()));
        }
        tell_state(job);
        self.walk(id, steps);
    }

    pub(super) fn outputs_stored(&mut self, id: JobId, outcome: Result<Digest, Arc<StoreError>>) {
        match outcome {
            Ok(digest) => {
                let steps = self.jobs.get_mut(&id).map(|job| job.listed(digest)).unwrap_or_default();
                self.walk(id, steps);
            }
            Err(error) => self.broken(id, &error),
        }
    }

    pub(super) fn baked_read(&mut self, id: JobId, digest: Digest, baked: Option<Box<Baked>>) {
        let Some(job) = self.jobs.get_mut(&id).filter(|job| matches!(job.phase, Phase::Exporting(_))) else { return };
        let Some(baked) = baked else {
            self.queue(vec![(id, Node::Export)]);
            return;
        };
        job.succeed(Success { digest, baked: *baked, from_store: false });
        self.end_decided(id);
    }

    /// A job's question to the store failed.
    pub(super) fn broken(&mut self, id: JobId, error: &StoreError) {
        self.fail(id, v1::FailureKind::Internal, format!("the coordinator's store failed: {error}"));
    }

    pub(super) fn fail(&mut self, id: JobId, kind: v1::FailureKind, message: String) {
        let failure = v1::BakeFailure { kind: kind.into(), message, ..Default::default() };
        self.end_job(id, Outcome::Failed(failure));
    }

    /// Decides a job's outcome, unless it is decided.
    pub(super) fn end_job(&mut self, id: JobId, outcome: Outcome) {
        if self.jobs.get_mut(&id).is_some_and(|job| job.end(outcome)) {
            self.end_decided(id);
        }
    }

    /// The outcome is decided: nothing more is run for the job, and the journal is told.
    pub(super) fn end_decided(&mut self, id: JobId) {
        let Some(job) = self.jobs.get(&id) else { return };
        let cancelled = matches!(&job.phase, Phase::Ending(ending) if matches!(ending.outcome, Outcome::Cancelled));
        self.feed(if cancelled { Event::JobCancelled(id) } else { Event::JobFinished(id) });
        let orphans = self.flights.leave(id);
        self.queue_again(orphans);
        self.write_end(id);
    }

    fn write_end(&mut self, id: JobId) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let Phase::Ending(ending) = &mut job.phase else { return };
        ending.retry_at_ms = None;
        let (outcome, record) = match &ending.outcome {
            Outcome::Succeeded(success) => {
                let key = job.lane.as_ref().map(|lane| crate::job::answer_key(job.order.source, lane));
                let record = key.filter(|_| !success.from_store);
                let answer = || codec::encode(&Answer::new(success.digest, &job.progress));
                (JobOutcome::Succeeded { baked: success.digest }, record.map(|key| (key, answer())))
            }
            Outcome::Failed(failure) => {
                let key = failure_key(id, job.order.payload);
                (JobOutcome::Failed { reason: failure.message.clone() }, Some((key, failure.encode_to_vec())))
            }
            Outcome::Cancelled => (JobOutcome::Cancelled, None),
        };
        let event = JournalEvent::JobFinished { job: id, outcome, finished_unix_ms: unix_ms() };
        self.keeper.send(Op::End { job: id, record, event: Box::new(event) });
    }

    /// The journal has the end of a job, or could not take it.
    pub(super) fn ended(&mut self, id: JobId, outcome: Result<(), Arc<StoreError>>) {
        let retry_at_ms = self.now_ms() + END_RETRY_MS;
        let Some(job) = self.jobs.get_mut(&id) else { return };
        if let Err(error) = outcome {
            tracing::warn!(bake = %id, %error, "the end of a bake could not be written; it is tried again");
            if let Phase::Ending(ending) = &mut job.phase {
                ending.retry_at_ms = Some(retry_at_ms);
            }
            for respond in self.cancels.remove(&id).unwrap_or_default() {
                let _ = respond.send(Err(store_status(&error)));
            }
            self.note_fatal(&error);
            return;
        }
        let phase = std::mem::replace(&mut job.phase, Phase::Answering);
        job.phase = match phase {
            Phase::Ending(ending) => Phase::Ended(Ended { outcome: ending.outcome, at_unix_ms: unix_ms() }),
            other => other,
        };
        tracing::info!(bake = %id, state = job.phase.shown().as_str_name(), "a bake has ended");
        tell_state(job);
        let shown = view(job);
        for respond in self.cancels.remove(&id).unwrap_or_default() {
            let _ = respond.send(Ok(shown.clone()));
        }
        self.totals.ended(shown);
        self.forget_old();
        self.collect_garbage();
    }

    pub(super) fn retry_ends(&mut self, now_ms: u64) {
        let due = |job: &&Job| matches!(&job.phase, Phase::Ending(ending) if ending.retry_at_ms.is_some_and(|at| at <= now_ms));
        let due: Vec<JobId> = self.jobs.values().filter(due).map(|job| job.order.id).collect();
        due.into_iter().for_each(|id| self.write_end(id));
    }

    /// The scheduler gives a job up.
    pub(super) fn job_failed(
        &mut self,
        id: JobId,
        reason: String,
        task: Option<kiln_schedule::TaskId>,
        attempts: &[kiln_schedule::AttemptLog],
    ) {
        let refused = task.and_then(|task| self.refused.remove(&task));
        let kind = task.and_then(|task| self.flights.get(task)).map(|entry| entry.node.kind());
        let attempts = attempts.iter().map(|attempt| v1::AttemptFailure {
            worker: self.registry.name(attempt.worker),
            message: attempt.reason.clone(),
        });
        let failure_kind = match (&refused, task) {
            (Some(_), _) => v1::FailureKind::InputRefused,
            (None, Some(_)) => v1::FailureKind::TaskFailed,
            (None, None) => v1::FailureKind::NoWorker,
        };
        let failure = v1::BakeFailure {
            kind: failure_kind.into(),
            // A refusal speaks for itself: it names the file, what is wrong with it, and what to do.
            message: refused.unwrap_or(reason),
            task: kind.map_or(v1::TaskKind::Unspecified, v1::TaskKind::from).into(),
            attempts: attempts.collect(),
        };
        self.end_job(id, Outcome::Failed(failure));
    }

    pub(super) fn retried(&mut self, id: JobId, task: kiln_schedule::TaskId, attempt: &kiln_schedule::AttemptLog) {
        let kind = self.flights.get(task).map_or(TaskKind::Import, |entry| entry.node.kind());
        let worker = self.registry.name(attempt.worker);
        let Some(job) = self.jobs.get_mut(&id) else { return };
        job.progress.retried(kind);
        let failure = v1::AttemptFailure { worker, message: attempt.reason.clone() };
        let failed = v1::AttemptFailed { kind: v1::TaskKind::from(kind).into(), failure: Some(failure) };
        job.events.append(|_| v1::watch_bake_response::Event::AttemptFailed(failed));
    }

    /// Forgets the oldest ended jobs beyond those that are kept.
    fn forget_old(&mut self) {
        let ended = self.jobs.iter().filter(|(_, job)| matches!(job.phase, Phase::Ended(_))).map(|(&id, _)| id);
        let ended: Vec<JobId> = ended.collect();
        let surplus = ended.len().saturating_sub(self.config.ended_bakes_kept);
        for &id in &ended[..surplus] {
            if let Some(job) = self.jobs.remove(&id) {
                self.requests.remove(&job.order.request_id);
                self.journal(JournalEvent::JobForgotten(id), super::Ack::Nobody);
            }
        }
    }

    /// Brings the store down to its size while nothing is under way that needs what is in it. The latest results
    /// stay, as do the requests and failures of jobs that are remembered.
    fn collect_garbage(&mut self) {
        let Some(max_bytes) = self.config.store_max_bytes else { return };
        if self.jobs.values().any(|job| !matches!(job.phase, Phase::Ended(_)) && !job.dormant) {
            return;
        }
        let mut live: BTreeSet<Digest> = self.jobs.values().map(|job| job.order.payload).collect();
        let succeeded = self.jobs.values().rev().filter_map(|job| match &job.phase {
            Phase::Ended(Ended { outcome: Outcome::Succeeded(success), .. }) => Some(success),
            _ => None,
        });
        let named =
            |success: &Success| std::iter::once(success.digest).chain(success.baked.files()).collect::<Vec<_>>();
        live.extend(succeeded.take(PINNED_RESULTS).flat_map(|success| named(success)));
        self.keeper.send(Op::Collect { live, max_bytes });
    }
}

fn is_waiting(job: &Job) -> bool {
    matches!(job.phase, Phase::Waiting(_)) && !job.dormant
}
