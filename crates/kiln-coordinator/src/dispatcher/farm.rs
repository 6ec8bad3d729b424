//! What workers say, and what becomes of them.

use super::{
    Dispatcher, Outbox, Respond,
    bakes::page_size_of,
    registry::{Failure, Hello},
};
use crate::keeper::Op;
use kiln_proto::{FieldError, PROTOCOL, limits, required, v1};
use kiln_schedule::{Event, HeldLease, LeaseId, ReturnReason, SetAsideReason, WorkerId};
use tonic::Status;
use v1::{session_request::Message as Request, session_response::Message as Response};

impl Dispatcher {
    /// A worker connects, for the first time or again.
    pub(super) fn join(&mut self, hello: Box<Hello>, outbox: Outbox, respond: Respond<(WorkerId, u64)>) {
        let now_ms = self.now_ms();
        let (capabilities, held) = (hello.capabilities.clone(), hello.held.clone());
        let (worker_id, name) = (hello.worker_id.clone(), hello.name.clone());
        let (worker, session) = match self.registry.join(*hello, outbox, now_ms) {
            Ok(joined) => joined,
            Err(error) => {
                let _ = respond.send(Err(error));
                return;
            }
        };
        tracing::info!(worker = name, number = worker.0, "a worker joined");
        let _ = respond.send(Ok((worker, session)));
        let welcome = v1::Welcome {
            worker_id,
            heartbeat_interval_ms: self.config.heartbeat_interval.as_millis() as u32,
            protocol: PROTOCOL,
        };
        self.registry.tell(worker, Response::Welcome(welcome));
        self.feed(Event::WorkerJoined { worker, capabilities, held });
        self.start_waiting();
    }

    /// A worker says something. What makes no sense is noted and passed over: its lease will run out.
    pub(super) fn said(&mut self, worker: WorkerId, session: u64, request: v1::SessionRequest) {
        if !self.registry.hears(worker, session, self.now_ms()) {
            return;
        }
        let outcome = match request.message {
            Some(Request::Heartbeat(_)) => {
                self.feed(Event::Heartbeat(worker));
                self.registry.tell(worker, Response::Alive(v1::Alive {}));
                Ok(())
            }
            Some(Request::Progress(progress)) => held(progress.lease).map(|held| {
                self.lease_progress(worker, held.lease, held.epoch, progress.rays);
            }),
            Some(Request::Results(results)) => self.results(worker, &results),
            Some(Request::Failed(failed)) => Failure::try_from(failed).map(|failure| self.failure(worker, failure)),
            Some(Request::Returned(returned)) => self.returned(worker, &returned),
            Some(Request::Draining(draining)) => {
                self.registry.set_state(worker, v1::WorkerState::Draining);
                let deadline_ms = self.now_ms().saturating_add(draining.deadline_ms);
                self.feed(Event::WorkerDraining { worker, deadline_ms });
                Ok(())
            }
            Some(Request::Hello(_)) | None => Err(FieldError::new("message", "is missing, unknown, or a second hello")),
        };
        if let Err(error) = outcome {
            tracing::warn!(worker = self.registry.name(worker), %error, "a worker's message makes no sense");
        }
    }

    fn failure(&mut self, worker: WorkerId, failure: Failure) {
        let HeldLease { lease, epoch } = failure.lease;
        if let Some(task) = self.flights.find(failure.task, failure.key) {
            if let (Some(digest), Some(entry)) = (failure.missing, self.flights.get(task)) {
                self.keeper.send(Op::Recheck { job: entry.job, digest });
            }
            self.task_failed(worker, lease, epoch, task, failure.reason, failure.permanent);
        }
    }

    fn returned(&mut self, worker: WorkerId, returned: &v1::LeaseReturned) -> Result<(), FieldError> {
        let HeldLease { lease, epoch } = held(returned.lease)?;
        let reason = match returned.reason() {
            v1::ReturnReason::Busy | v1::ReturnReason::Unspecified => ReturnReason::Busy,
            v1::ReturnReason::Draining => ReturnReason::Draining,
        };
        let over = self.registry.take_lease(worker, lease, epoch);
        self.lease_over(lease, over);
        self.feed(Event::LeaseReturned { worker, lease, epoch, reason });
        Ok(())
    }

    /// A worker's stream ended: it may come back.
    pub(super) fn left(&mut self, worker: WorkerId, session: u64) {
        if !self.registry.hears(worker, session, self.now_ms()) {
            return;
        }
        tracing::info!(worker = self.registry.name(worker), "a worker's connection ended");
        self.registry.disconnect(worker);
        self.feed(Event::WorkerDisconnected(worker));
    }

    /// The scheduler trusts a worker no more.
    pub(super) fn set_aside(&mut self, worker: WorkerId, why: &SetAsideReason) {
        tracing::warn!(worker = self.registry.name(worker), %why, "a worker is set aside");
        self.registry.tell(worker, Response::SetAside(v1::SetAside { reason: why.to_string() }));
        self.registry.set_state(worker, v1::WorkerState::SetAside);
    }

    /// The scheduler has given a worker up, or it has drained: its stream ends.
    pub(super) fn dismiss(&mut self, worker: WorkerId, why: &str) {
        tracing::info!(worker = self.registry.name(worker), why, "a worker is gone");
        for (lease, leased) in self.registry.remove(worker) {
            self.lease_over(lease, Some(leased));
        }
        self.feed(Event::WorkerLost(worker));
    }

    pub(super) fn list_workers(&self, page_size: u32, token: &str) -> Result<v1::ListWorkersResponse, Status> {
        let size = page_size_of(page_size)?;
        if token.len() > limits::NAME_BYTES {
            return Err(FieldError::new("page_token", "is not one that ListWorkers gave").into());
        }
        let workers = self.registry.shown(self.now_ms());
        let mut workers = workers.into_iter().skip_while(|worker| worker.worker_id.as_str() <= token).peekable();
        let page: Vec<v1::Worker> = workers.by_ref().take(size).collect();
        let last = page.last().map(|worker| worker.worker_id.clone()).unwrap_or_default();
        let next_page_token = workers.peek().map(|_| last).unwrap_or_default();
        Ok(v1::ListWorkersResponse { workers: page, next_page_token })
    }
}

fn held(lease: Option<v1::LeaseRef>) -> Result<HeldLease, FieldError> {
    let held = required("lease", lease)?;
    Ok(HeldLease { lease: LeaseId(held.lease_id), epoch: held.epoch })
}
