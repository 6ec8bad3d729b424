//! What the journal remembers of jobs.

use super::{Dispatcher, Known};
use crate::{
    error::StartError,
    events::EventLog,
    job::{Ended, Job, Order, Outcome, Phase, Success, failure_key, shown},
    keeper,
};
use kiln_core::{Baked, JobId, Lane};
use kiln_proto::v1;
use kiln_schedule::Event;
use kiln_store::{JobOutcome, JournalEvent, Store, StoreError, SubmittedJob};
use prost::Message;
use std::collections::BTreeMap;

/// A job as replayed.
#[derive(Debug)]
struct Remembered {
    order: Order,
    lane: Option<Lane>,
    paused: bool,
    ended: Option<Ended>,
}

/// What was replayed.
#[derive(Debug)]
pub(super) struct Replayed {
    jobs: Vec<Remembered>,
    pub(super) next_job: u64,
}

/// Replays the journal. Events of jobs that it does not know are passed over: damage may have taken the beginning.
pub(super) fn replay(store: &Store) -> Result<Replayed, StartError> {
    let mut jobs: BTreeMap<JobId, Remembered> = BTreeMap::new();
    let mut next_job = 1;
    for event in store.journal_replay()? {
        next_job = next_job.max(event.job().0 + 1);
        if let JournalEvent::JobSubmitted(submitted) = event {
            jobs.insert(submitted.job, remember(store, submitted)?);
        } else if let JournalEvent::JobForgotten(job) = event {
            jobs.remove(&job);
        } else if let Some(job) = jobs.get_mut(&event.job()) {
            apply(store, job, event)?;
        }
    }
    Ok(Replayed { jobs: jobs.into_values().collect(), next_job })
}

fn remember(store: &Store, submitted: SubmittedJob) -> Result<Remembered, StoreError> {
    let request = store.get(&submitted.payload)?;
    let request = request.and_then(|bytes| v1::SubmitBakeRequest::decode(bytes.as_slice()).ok());
    let backend = request.as_ref().map_or(v1::Backend::Auto, v1::SubmitBakeRequest::backend);
    let settings = request.and_then(|request| request.source?.settings);
    let unchanged = i32::from(v1::SkipRule::Unchanged);
    let order = Order {
        id: submitted.job,
        request_id: submitted.request_id,
        payload: submitted.payload,
        source: submitted.source,
        backend,
        priority: submitted.priority,
        name: submitted.name,
        tenant: submitted.tenant,
        submitted_unix_ms: submitted.submitted_unix_ms,
        skips_unchanged: settings.is_none_or(|settings| !settings.no_skip.contains(&unchanged)),
    };
    Ok(Remembered { order, lane: submitted.lane, paused: false, ended: None })
}

fn apply(store: &Store, job: &mut Remembered, event: JournalEvent) -> Result<(), StoreError> {
    match event {
        JournalEvent::LaneChosen { lane, .. } => job.lane = Some(lane),
        JournalEvent::JobPaused(_) => job.paused = true,
        JournalEvent::JobResumed(_) => job.paused = false,
        JournalEvent::JobFinished { outcome, finished_unix_ms, .. } => {
            let outcome = match outcome {
                JobOutcome::Cancelled => Some(Outcome::Cancelled),
                JobOutcome::Failed { reason } => Some(Outcome::Failed(failure(store, job, reason)?)),
                // A result that the store has lost is made again.
                JobOutcome::Succeeded { baked: digest } => keeper::read::<Baked>(store, "a bake's summary", &digest)?
                    .map(|baked| Outcome::Succeeded(Box::new(Success { digest, baked, from_store: false }))),
            };
            job.ended = outcome.map(|outcome| Ended { outcome, at_unix_ms: finished_unix_ms });
        }
        JournalEvent::JobSubmitted(_) | JournalEvent::JobForgotten(_) => {}
    }
    Ok(())
}

/// The details of a failure, if they are still there, else its reason alone.
fn failure(store: &Store, job: &Remembered, reason: String) -> Result<v1::BakeFailure, StoreError> {
    let digest = store.result(failure_key(job.order.id, job.order.payload))?;
    let bytes = digest.map(|digest| store.get(&digest)).transpose()?.flatten();
    let detailed = bytes.and_then(|bytes| v1::BakeFailure::decode(bytes.as_slice()).ok());
    Ok(detailed.unwrap_or_else(|| v1::BakeFailure {
        kind: v1::FailureKind::TaskFailed.into(),
        message: reason,
        ..Default::default()
    }))
}

impl Dispatcher {
    /// Takes over what was replayed; unfinished jobs go on where the store's results end.
    pub(super) fn adopt(&mut self, replayed: Replayed) {
        for remembered in replayed.jobs {
            let id = remembered.order.id;
            let mut job = Job::new(remembered.order, EventLog::new(self.first_event, self.config.events_kept));
            job.paused = remembered.paused;
            let known = Known { payload: job.order.payload, job: id };
            self.requests.insert(job.order.request_id.clone(), known);
            if let Some(ended) = remembered.ended {
                job.lane = remembered.lane;
                if let Outcome::Succeeded(success) = &ended.outcome {
                    job.warnings = shown(&success.baked.summary.warnings);
                }
                job.phase = Phase::Ended(ended);
                self.jobs.insert(id, job);
                continue;
            }
            job.dormant = !self.resumes();
            job.lane = remembered.lane;
            self.jobs.insert(id, job);
            if self.resumes() {
                self.wake(id);
            }
        }
    }

    /// A job of an earlier coordinator goes on.
    pub(super) fn wake(&mut self, id: JobId) {
        self.enroll(id);
        match self.jobs.get(&id).and_then(|job| job.lane.clone()) {
            Some(lane) => self.start_job(id, lane),
            None => self.start_waiting(),
        }
    }

    /// Tells the scheduler of a job.
    pub(super) fn enroll(&mut self, id: JobId) {
        let Some(job) = self.jobs.get(&id) else { return };
        let paused = job.paused;
        let spec = kiln_schedule::JobSpec {
            job: id,
            tenant: job.order.tenant.clone(),
            priority: job.order.priority,
            max_leases: None,
        };
        self.feed(Event::JobAdded(spec));
        if paused {
            self.feed(Event::JobPaused(id));
        }
    }
}
