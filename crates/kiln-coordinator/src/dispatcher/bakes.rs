//! What clients ask about bakes.

use super::{Ack, Ask, Dispatcher, Known, Respond, Watching, unix_ms};
use crate::{
    events::EventLog,
    job::{Job, Order, Outcome, Phase},
    lanes, store_status,
};
use kiln_core::{Digest, JobId, SkipRule};
use kiln_proto::{FieldError, Submission, limits, status, v1};
use kiln_schedule::Event;
use kiln_store::{JournalEvent, StoreError, SubmittedJob};
use std::sync::Arc;
use tonic::{Code, Status};

/// Most bytes of a failure's message in a list.
const BRIEF_BYTES: usize = 1024;

impl Dispatcher {
    pub(super) fn asked(&mut self, ask: Ask) {
        // A caller that has gone away does not want its answer: sending fails, and that is all right.
        match ask {
            Ask::Submit { submission, payload, source, respond } => self.submit(*submission, payload, source, respond),
            Ask::Get { bake, respond } => {
                let _ = respond.send(self.find(&bake).map(view));
            }
            Ask::List { page_size, page_token, active_only, respond } => {
                let _ = respond.send(self.list(page_size, &page_token, active_only));
            }
            Ask::Watch { bake, respond } => {
                let watching = self.find(&bake).map(|job| Watching {
                    events: Arc::clone(&job.events),
                    ended: matches!(job.phase, Phase::Ended(_)),
                });
                let _ = respond.send(watching);
            }
            Ask::Cancel { bake, respond } => self.cancel(&bake, respond),
            Ask::Pause { bake, paused, respond } => self.pause(&bake, paused, respond),
            Ask::Explain { bake, respond } => {
                let _ = respond.send(self.explain(&bake));
            }
            Ask::Workers { page_size, page_token, respond } => {
                let _ = respond.send(self.list_workers(page_size, &page_token));
            }
            Ask::Stats { respond } => {
                let _ = respond.send(Ok(self.stats()));
            }
        }
    }

    fn find(&self, bake: &str) -> Result<&Job, Status> {
        let job = bake.parse().ok().and_then(|id| self.jobs.get(&JobId(id)));
        job.ok_or_else(|| {
            let message =
                format!("there is no bake {:?}; `kiln ls` lists those that are remembered", limits::cut(bake, 64));
            status::error(Code::NotFound, status::BAKE_NOT_FOUND, message)
        })
    }

    fn submit(&mut self, submission: Submission, payload: Digest, source: Digest, respond: Respond<(v1::Bake, bool)>) {
        if let Some(known) = self.requests.get(&submission.request_id) {
            self.submit_again(known.payload == payload, known.job, &submission.request_id, respond);
            return;
        }
        let id = JobId(self.next_job);
        self.next_job += 1;
        self.requests.insert(submission.request_id.clone(), Known { payload, job: id });
        let no_skip = &submission.source.settings.no_skip;
        let skips_unchanged = !no_skip.contains(&SkipRule::Unchanged);
        let order = Order {
            id,
            request_id: submission.request_id,
            payload,
            source,
            backend: submission.backend,
            priority: submission.priority,
            name: submission.name,
            tenant: submission.tenant,
            submitted_unix_ms: unix_ms(),
            skips_unchanged,
        };
        let event = JournalEvent::JobSubmitted(SubmittedJob {
            job: id,
            request_id: order.request_id.clone(),
            payload,
            source,
            name: order.name.clone(),
            tenant: order.tenant.clone(),
            priority: order.priority,
            submitted_unix_ms: order.submitted_unix_ms,
            lane: None,
        });
        let job = Job::new(order, EventLog::new(self.first_event, self.config.events_kept));
        self.journal(event, Ack::Submitted { job: Box::new(job), respond: vec![(respond, false)] });
    }

    /// A request id came before: with the same payload it is answered like the first.
    fn submit_again(&mut self, same: bool, id: JobId, request_id: &str, respond: Respond<(v1::Bake, bool)>) {
        if !same {
            let message = format!(
                "the request id {request_id:?} was used for another bake ({id}); choose a new id for each bake that is wanted"
            );
            let _ = respond.send(Err(status::error(Code::AlreadyExists, status::REQUEST_ID_REUSED, message)));
            return;
        }
        if let Some(job) = self.jobs.get_mut(&id) {
            let _ = respond.send(Ok((view(job), true)));
            // One that an earlier coordinator left is wanted now.
            if std::mem::take(&mut job.dormant) {
                self.wake(id);
            }
            return;
        }
        // Not durable yet: the answer comes with that of the first.
        let pending = self.acks.values_mut().find_map(|ack| match ack {
            Ack::Submitted { job, respond } if job.order.id == id => Some(respond),
            _ => None,
        });
        if let Some(pending) = pending {
            pending.push((respond, true));
        }
    }

    /// The journal has events, or could not take them.
    pub(super) fn journaled(&mut self, ack: u64, outcome: Result<(), Arc<StoreError>>) {
        if let Err(error) = &outcome {
            self.note_fatal(error);
        }
        let Some(ack) = self.acks.remove(&ack) else { return };
        match (ack, outcome) {
            (Ack::Submitted { job, respond }, Ok(())) => self.submitted(*job, respond),
            (Ack::Submitted { job, respond }, Err(error)) => {
                self.requests.remove(&job.order.request_id);
                for (respond, _) in respond {
                    let _ = respond.send(Err(store_status(&error)));
                }
            }
            (Ack::Paused { job, paused, respond }, Ok(())) => self.paused(job, paused, respond),
            (Ack::Paused { respond, .. }, Err(error)) => {
                let _ = respond.send(Err(store_status(&error)));
            }
            (Ack::Nobody, Ok(())) => {}
            (Ack::Nobody, Err(error)) => tracing::warn!(%error, "the journal missed an event that it can do without"),
        }
    }

    fn submitted(&mut self, job: Job, respond: Vec<(Respond<(v1::Bake, bool)>, bool)>) {
        let id = job.order.id;
        tracing::info!(bake = %id, name = job.order.name, "a bake was submitted");
        for (respond, repeated) in respond {
            let _ = respond.send(Ok((view(&job), repeated)));
        }
        self.jobs.insert(id, job);
        self.enroll(id);
        self.start_waiting();
    }

    fn cancel(&mut self, bake: &str, respond: Respond<v1::Bake>) {
        let id = match self.find(bake) {
            Ok(job) if matches!(job.phase, Phase::Ended(_)) => {
                let _ = respond.send(Ok(view(job)));
                return;
            }
            Ok(job) => job.order.id,
            Err(error) => {
                let _ = respond.send(Err(error));
                return;
            }
        };
        self.cancels.entry(id).or_default().push(respond);
        self.end_job(id, Outcome::Cancelled);
    }

    fn pause(&mut self, bake: &str, paused: bool, respond: Respond<v1::Bake>) {
        match self.find(bake) {
            Ok(job) if job.paused == paused || job.is_over() => {
                let _ = respond.send(Ok(view(job)));
            }
            Ok(job) => {
                let id = job.order.id;
                let event = if paused { JournalEvent::JobPaused(id) } else { JournalEvent::JobResumed(id) };
                self.journal(event, Ack::Paused { job: id, paused, respond });
            }
            Err(error) => {
                let _ = respond.send(Err(error));
            }
        }
    }

    fn paused(&mut self, id: JobId, paused: bool, respond: Respond<v1::Bake>) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        job.paused = paused;
        tell_state(job);
        let _ = respond.send(Ok(view(job)));
        if job.dormant {
            return;
        }
        if paused {
            self.feed(Event::JobPaused(id));
            let jobs = &self.jobs;
            let free = self.flights.held_back(|job| Self::is_paused(jobs, job));
            self.queue_again(free);
        } else {
            self.feed(Event::JobResumed(id));
            self.start_waiting();
        }
    }

    fn list(&self, page_size: u32, token: &str, active_only: bool) -> Result<v1::ListBakesResponse, Status> {
        let size = page_size_of(page_size)?;
        let before = match token {
            "" => u64::MAX,
            token => token.parse().map_err(|_| FieldError::new("page_token", "is not one that ListBakes gave"))?,
        };
        let jobs = self.jobs.range(..JobId(before)).rev().map(|(_, job)| job);
        let mut jobs = jobs.filter(|job| !active_only || !matches!(job.phase, Phase::Ended(_))).peekable();
        let bakes: Vec<v1::Bake> = jobs.by_ref().take(size).map(|job| brief(view(job))).collect();
        let last = bakes.last().map(|bake| bake.bake_id.clone()).unwrap_or_default();
        let next_page_token = jobs.peek().map(|_| last).unwrap_or_default();
        Ok(v1::ListBakesResponse { bakes, next_page_token })
    }

    fn explain(&self, bake: &str) -> Result<v1::ExplainBakeResponse, Status> {
        let job = self.find(bake)?;
        let mut reasons = Vec::new();
        if job.dormant {
            reasons.push("it was left by an earlier coordinator and waits for `kiln serve` on this data folder".into());
        }
        if job.paused {
            reasons.push("it is paused; `kiln resume` lets it go on".into());
        }
        match &job.phase {
            Phase::Ended(ended) => reasons.push(match &ended.outcome {
                Outcome::Succeeded(_) => "it has succeeded".into(),
                Outcome::Failed(failure) => format!("it has failed: {}", failure.message),
                Outcome::Cancelled => "it was cancelled".into(),
            }),
            Phase::Ending(_) => reasons.push("its end is being written to the journal".into()),
            Phase::Waiting(_) => {
                reasons.push(format!(
                    "its lane is not decided: {}",
                    lanes::why_none(job.order.backend, &self.registry.offers())
                ));
            }
            _ => reasons.push(self.scheduler.explain(job.order.id).to_string()),
        }
        Ok(v1::ExplainBakeResponse { state: job.phase.shown().into(), reasons })
    }
}

/// A job as it is now.
pub(super) fn view(job: &Job) -> v1::Bake {
    job.view(job.events.last())
}

/// A job without the texts that can be long, for lists.
pub(super) fn brief(mut bake: v1::Bake) -> v1::Bake {
    bake.warnings.clear();
    if let Some(failure) = &mut bake.failure {
        failure.attempts.clear();
        failure.message.truncate(limits::cut(&failure.message, BRIEF_BYTES).len());
    }
    bake
}

/// Tells watchers the whole state.
pub(super) fn tell_state(job: &Job) {
    job.events.append(|number| v1::watch_bake_response::Event::Snapshot(job.view(number)));
}

/// The entries of a page.
pub(super) fn page_size_of(page_size: u32) -> Result<usize, FieldError> {
    match page_size {
        0 => Ok(100),
        size if size <= limits::PAGE => Ok(size as usize),
        size => Err(FieldError::new("page_size", format!("is {size}; it must be from 1 to {}", limits::PAGE))),
    }
}
