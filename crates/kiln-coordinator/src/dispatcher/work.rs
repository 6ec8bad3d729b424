//! Tasks on their way: queued, leased, brought back.

use super::{Dispatcher, Landed, registry::Leased};
use crate::{
    flights::Entry,
    job::{Effort, Node, Parts, Step},
    keeper::{Arrival, Delivery, Op, Verdict},
};
use kiln_core::{Digest, JobId, TaskKey};
use kiln_proto::{FieldError, digest, limits, required, v1};
use kiln_schedule::{CompletedTask, Event, LeaseId, ReadyTask, ReturnReason, RevokeReason, TaskId, WorkerId};
use kiln_store::StoreError;
use prost::Message;
use std::{collections::BTreeMap, sync::Arc};

impl Dispatcher {
    /// Queues tasks whose results the store does not have. Those that are in the air already are waited for.
    pub(super) fn queue(&mut self, nodes: Vec<(JobId, Node)>) {
        let mut ready: BTreeMap<JobId, Vec<ReadyTask>> = BTreeMap::new();
        for (id, node) in nodes {
            let Some(task) = self.jobs.get(&id).and_then(|job| job.task(node)) else { continue };
            let jobs = &self.jobs;
            let entry = Entry { job: id, node, key: task.key };
            let Some(number) = self.flights.add(entry, |job| Self::is_paused(jobs, job)) else { continue };
            ready.entry(id).or_default().push(ReadyTask {
                task: number,
                kind: node.kind(),
                cost: task.cost,
                needs: task.needs,
                locality: task.locality,
            });
        }
        for (job, tasks) in ready {
            self.feed(Event::TasksReady { job, tasks });
        }
    }

    /// Queues tasks that waited for one that will not come, those of paused jobs last: they must not go first.
    pub(super) fn queue_again(&mut self, mut nodes: Vec<(JobId, Node)>) {
        nodes.sort_by_key(|&(job, _)| Self::is_paused(&self.jobs, job));
        self.queue(nodes);
    }

    /// Sends tasks to a worker, in messages that fit.
    pub(super) fn lease(&mut self, worker: WorkerId, lease: LeaseId, epoch: u32, job: JobId, tasks: &[TaskId]) {
        let now_ms = self.now_ms();
        let Some(owner) = self.jobs.get_mut(&job) else { return };
        let entries = tasks.iter().filter_map(|&id| Some((id, *self.flights.get(id)?)));
        let mut messages: Vec<v1::Lease> = Vec::new();
        let mut bytes = usize::MAX;
        let mut kind = None;
        for (id, entry) in entries {
            let Some(task) = owner.task(entry.node) else { continue };
            kind = Some(entry.node.kind());
            owner.progress.began(entry.node.kind(), now_ms);
            let leased = v1::LeasedTask { task_id: id.0, key: entry.key.0.0.to_vec(), spec: Some((&task.spec).into()) };
            let size = leased.encoded_len();
            if bytes.saturating_add(size) > limits::LEASE_BYTES {
                bytes = 0;
                messages.push(v1::Lease {
                    lease: Some(v1::LeaseRef { lease_id: lease.0, epoch }),
                    bake_id: job.to_string(),
                    lane: owner.lane.as_ref().map(Into::into),
                    tasks: Vec::new(),
                });
            }
            bytes += size;
            if let Some(message) = messages.last_mut() {
                message.tasks.push(leased);
            }
        }
        if let Some(kind) = kind {
            let open = tasks.iter().copied().collect();
            self.registry.leased(worker, lease, Leased { epoch, job, kind, open });
        }
        for message in messages {
            self.registry.tell(worker, v1::session_response::Message::Lease(message));
        }
    }

    pub(super) fn revoke(
        &mut self,
        worker: WorkerId,
        lease: LeaseId,
        epoch: u32,
        tasks: &[TaskId],
        ended: bool,
        why: RevokeReason,
    ) {
        let over = match ended {
            true => self.registry.take_lease(worker, lease, epoch),
            false => self.registry.settle(worker, lease, epoch, tasks.iter().copied()),
        };
        self.lease_over(lease, over);
        let revoke = v1::Revoke {
            lease: Some(v1::LeaseRef { lease_id: lease.0, epoch }),
            task_ids: if ended { Vec::new() } else { tasks.iter().map(|task| task.0).collect() },
            reason: reason(why).to_owned(),
        };
        self.registry.tell(worker, v1::session_response::Message::Revoke(revoke));
    }

    /// A lease is over: its rays under way are counted no more.
    pub(super) fn lease_over(&mut self, lease: LeaseId, leased: Option<Leased>) {
        if let Some(leased) = leased
            && let Some(job) = self.jobs.get_mut(&leased.job)
        {
            job.progress.under_way(leased.kind, lease.0, 0);
        }
    }

    pub(super) fn lease_progress(&mut self, worker: WorkerId, lease: LeaseId, epoch: u32, rays: u64) {
        self.feed(Event::LeaseProgress { worker, lease, epoch });
        if let Some(leased) = self.registry.lease_of(worker, lease, epoch)
            && let Some(job) = self.jobs.get_mut(&leased.job)
        {
            job.progress.under_way(leased.kind, lease.0, rays);
        }
    }

    /// A worker brings results: the store looks at them first.
    pub(super) fn results(&mut self, worker: WorkerId, results: &v1::LeaseResults) -> Result<(), FieldError> {
        let held = required("lease", results.lease)?;
        let mut arrivals = Vec::with_capacity(results.entries.len());
        for (i, entry) in results.entries.iter().enumerate() {
            let within = |error: FieldError| error.within(&format!("entries[{i}]"));
            let key = TaskKey(digest("key", &entry.key).map_err(within)?);
            let artefact = digest("artefact", &entry.artefact).map_err(within)?;
            let effort = effort(entry);
            // A result that nobody waits for any more is not even looked at.
            let Some(task) = self.flights.find(TaskId(entry.task_id), key) else { continue };
            let Some(flying) = self.flights.get(task) else { continue };
            let Some(expected) = self.jobs.get(&flying.job).and_then(|job| job.task(flying.node)) else { continue };
            arrivals.push(Arrival { key, artefact, effort, expect: expected.expect, task });
        }
        let delivery = Delivery {
            worker,
            lease: LeaseId(held.lease_id),
            epoch: held.epoch,
            sequence: results.sequence,
            lease_seconds: finite(results.lease_seconds),
            arrivals,
        };
        self.keeper.send(Op::Deliver(delivery));
        Ok(())
    }

    /// The store has looked at results, and kept the good ones.
    pub(super) fn delivered(&mut self, delivery: &Delivery, outcome: Result<Vec<Verdict>, Arc<StoreError>>) {
        let Delivery { worker, lease, epoch, .. } = *delivery;
        match outcome {
            Ok(verdicts) => self.judged(delivery, &verdicts),
            Err(error) => {
                self.note_fatal(&error);
                tracing::warn!(%error, "results could not be kept; their tasks go back");
                self.feed(Event::LeaseReturned { worker, lease, epoch, reason: ReturnReason::Busy });
            }
        }
        let settled = v1::Settled { sequence: delivery.sequence };
        self.registry.tell(worker, v1::session_response::Message::Settled(settled));
    }

    fn judged(&mut self, delivery: &Delivery, verdicts: &[Verdict]) {
        let Delivery { worker, lease, epoch, .. } = *delivery;
        let good = || delivery.arrivals.iter().zip(verdicts).filter_map(|(a, v)| Some((a, *v.as_ref().ok()?)));
        let costs: Vec<f64> = good().map(|(arrival, _)| self.cost(arrival.task)).collect();
        let seconds_per_cost = delivery.lease_seconds / costs.iter().sum::<f64>();
        let mut completed = Vec::new();
        for ((arrival, digest), cost) in good().zip(&costs) {
            for &task in self.flights.tasks_of(arrival.key) {
                let ran = task == arrival.task;
                self.landed.insert(task, Landed { digest, effort: ran.then_some(arrival.effort) });
                completed.push(CompletedTask { task, seconds: if ran { cost * seconds_per_cost } else { 0.0 } });
            }
        }
        self.registry.worked(worker, &delivery.arrivals);
        let over = self.registry.settle(worker, lease, epoch, good().map(|(arrival, _)| arrival.task));
        self.lease_over(lease, over);
        if !completed.is_empty() {
            self.feed(Event::TasksCompleted { worker, lease, epoch, tasks: completed });
        }
        self.landed.clear();
        // Those who waited for the same keys.
        let landed: Vec<(TaskKey, Digest)> = good().map(|(arrival, digest)| (arrival.key, digest)).collect();
        for (key, digest) in landed {
            for (job, node) in self.flights.land(key) {
                let steps = self.hit(job, node, digest);
                self.walk(job, steps);
            }
        }
        for (arrival, verdict) in delivery.arrivals.iter().zip(verdicts) {
            if let Err(reason) = verdict {
                self.task_failed(worker, lease, epoch, arrival.task, reason.clone(), false);
            }
        }
    }

    /// The scheduler took the first result of a task.
    pub(super) fn accepted(&mut self, id: JobId, task: TaskId) {
        let Some(&Landed { digest, effort }) = self.landed.get(&task) else { return };
        let Some(&Entry { node, .. }) = self.flights.get(task) else { return };
        self.refused.remove(&task);
        let steps: Vec<Step> = match effort {
            None => self.hit(id, node, digest),
            Some(effort) => {
                let now_ms = self.now_ms();
                let Some(job) = self.jobs.get_mut(&id) else { return };
                let rays = job.rays(node);
                job.progress.ran(node.kind(), rays, effort, now_ms);
                self.totals.ran(node.kind(), effort);
                self.step(id, node, digest)
            }
        };
        self.walk(id, steps);
    }

    pub(super) fn task_failed(
        &mut self,
        worker: WorkerId,
        lease: LeaseId,
        epoch: u32,
        task: TaskId,
        reason: String,
        permanent: bool,
    ) {
        if let Some(entry) = self.flights.get(task) {
            self.totals.failed(entry.node.kind());
            tracing::warn!(
                worker = self.registry.name(worker),
                kind = entry.node.kind().name(),
                reason,
                "a task failed"
            );
            if permanent {
                self.refused.insert(task, reason.clone());
            }
        }
        self.registry.failed(worker);
        let over = self.registry.settle(worker, lease, epoch, [task]);
        self.lease_over(lease, over);
        self.feed(Event::TaskFailed { worker, lease, epoch, task, reason, permanent });
    }

    fn cost(&self, task: TaskId) -> f64 {
        let entry = self.flights.get(task);
        let cost = entry.and_then(|entry| self.jobs.get(&entry.job)?.cost(entry.node));
        cost.unwrap_or(1).max(1) as f64
    }
}

/// Why a lease is taken back, for people.
fn reason(why: RevokeReason) -> &'static str {
    match why {
        RevokeReason::JobEnded => "its bake has ended",
        RevokeReason::DoneElsewhere => "another worker was faster",
        RevokeReason::Unknown => "the coordinator does not know it, or gave its tasks to others",
        RevokeReason::TooLong => "it took longer than a lease may",
        RevokeReason::SetAside => "the worker is set aside",
        RevokeReason::Drained => "the worker's time to drain is over",
    }
}

fn effort(entry: &v1::TaskResult) -> Effort {
    let part = |part: &Option<v1::PartTime>| {
        let part = part.unwrap_or_default();
        v1::PartTime { seconds: finite(part.seconds), cpu_seconds: finite(part.cpu_seconds) }
    };
    Effort {
        seconds: finite(entry.seconds),
        cpu_seconds: finite(entry.cpu_seconds),
        rays: entry.rays,
        parts: Parts { loading: part(&entry.loading), building: part(&entry.building), tracing: part(&entry.tracing) },
    }
}

/// A duration that a worker reports: nonsense counts as nothing.
fn finite(seconds: f64) -> f64 {
    if seconds.is_finite() && seconds > 0.0 { seconds } else { 0.0 }
}
