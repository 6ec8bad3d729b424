//! The one owner of all state: jobs, workers, leases.
//!
//! A single loop takes messages (calls of clients, words of workers, answers of the store, the passing of time),
//! changes the state, and sends on what follows. Nothing else changes it, so there are no locks and no orders of
//! events but the one that the loop sees. The loop never waits for a disk or a peer: the store is asked through
//! [`Keeper`], and a worker that does not read what it is sent is cut off.
//!
//! What a client is told has happened is durable: its answer is sent when the journal has the event.

mod bakes;
mod course;
mod farm;
mod message;
mod registry;
mod replay;
mod stats;
mod work;

pub(crate) use message::{Ask, Handle, Message, Outbox, Watching};
pub(crate) use registry::Hello;

use crate::{
    config::{Config, Unfinished},
    error::{ServeError, StartError},
    flights::Flights,
    job::{Effort, Job, Phase},
    keeper::{Keeper, Op, Stored},
};
use kiln_core::{Digest, JobId};
use kiln_proto::v1;
use kiln_schedule::{Action, Event, Scheduler, TaskId};
use kiln_store::{JournalEvent, Store, StoreError};
use registry::Registry;
use stats::Totals;
use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};
use tokio::sync::{mpsc, oneshot, watch};

/// Messages that wait before whoever sends more has to wait too.
const INBOX: usize = 4096;

/// Time between two looks at timeouts.
const TICK_MS: u64 = 250;

/// A request id that was used, and for what.
#[derive(Debug)]
struct Known {
    payload: Digest,
    job: JobId,
}

/// What to do when the journal has events.
#[derive(Debug)]
enum Ack {
    /// A job is durable; tell all who submitted it. The flag: it was a repetition.
    Submitted { job: Box<Job>, respond: Vec<(Respond<(v1::Bake, bool)>, bool)> },
    /// A job is paused, or resumed.
    Paused { job: JobId, paused: bool, respond: Respond<v1::Bake> },
    /// Nobody waits.
    Nobody,
}

type Respond<T> = oneshot::Sender<Result<T, tonic::Status>>;

/// The result of a task that is about to be announced to the scheduler.
#[derive(Clone, Copy, Debug)]
struct Landed {
    digest: Digest,
    /// `None` for a task whose result another one brought.
    effort: Option<Effort>,
}

/// All state.
#[derive(Debug)]
pub(crate) struct Dispatcher {
    config: Config,
    began: Instant,
    keeper: Keeper,
    scheduler: Scheduler,
    jobs: BTreeMap<JobId, Job>,
    requests: BTreeMap<String, Known>,
    flights: Flights,
    landed: BTreeMap<TaskId, Landed>,
    /// Tasks that were refused for their input, with the reason.
    refused: BTreeMap<TaskId, String>,
    registry: Registry,
    acks: BTreeMap<u64, Ack>,
    next_ack: u64,
    next_job: u64,
    /// Bakes' events begin here, so that numbers of an earlier coordinator are never taken for this one's.
    first_event: u64,
    cancels: BTreeMap<JobId, Vec<Respond<v1::Bake>>>,
    totals: Totals,
    farm: watch::Sender<Arc<v1::WatchFarmResponse>>,
    last_tick_ms: u64,
    /// The store cannot go on; the loop ends.
    fatal: Option<ServeError>,
}

/// A dispatcher that runs.
#[derive(Debug)]
pub(crate) struct Running {
    pub(crate) handle: Handle,
    pub(crate) task: tokio::task::JoinHandle<Result<(), ServeError>>,
}

/// Takes the journal over, replays it, and starts the loop. Blocks.
pub(crate) fn start(
    store: &Arc<Store>,
    config: Config,
    runtime: &tokio::runtime::Handle,
) -> Result<Running, StartError> {
    let fence = store.take_fence()?;
    let replayed = replay::replay(store)?;
    let (inbox, messages) = mpsc::channel(INBOX);
    let answers = inbox.downgrade();
    let keeper = Keeper::start(Arc::clone(store), fence, move |stored| {
        if let Some(inbox) = answers.upgrade() {
            // The dispatcher ends before the thread does only when it stops: nobody needs the answer then.
            let _ = inbox.blocking_send(Message::Stored(stored));
        }
    })
    .map_err(StartError::Thread)?;
    let farm = watch::Sender::new(Arc::default());
    let handle = Handle::new(inbox, farm.subscribe());
    let mut dispatcher = Dispatcher {
        began: Instant::now(),
        keeper,
        scheduler: Scheduler::new(config.scheduler.clone()),
        jobs: BTreeMap::new(),
        requests: BTreeMap::new(),
        // Numbers of an earlier coordinator's tasks are not used again: late results of theirs carry them.
        flights: Flights::new(fence.0 << 40),
        landed: BTreeMap::new(),
        refused: BTreeMap::new(),
        registry: Registry::default(),
        acks: BTreeMap::new(),
        next_ack: 0,
        next_job: replayed.next_job,
        first_event: fence.0 << 32,
        cancels: BTreeMap::new(),
        totals: Totals::default(),
        farm,
        last_tick_ms: 0,
        fatal: None,
        config,
    };
    dispatcher.adopt(replayed);
    let task = runtime.spawn(dispatcher.run(messages));
    Ok(Running { handle, task })
}

impl Dispatcher {
    /// The loop.
    async fn run(mut self, mut messages: mpsc::Receiver<Message>) -> Result<(), ServeError> {
        let mut pulse = tokio::time::interval(self.config.progress_interval.max(Duration::from_millis(10)));
        pulse.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        while self.fatal.is_none() {
            tokio::select! {
                message = messages.recv() => match message {
                    Some(Message::Stop) | None => break,
                    Some(message) => self.take(message),
                },
                _ = pulse.tick() => self.pulse(),
            }
        }
        let Self { keeper, fatal, .. } = self;
        // Messages that wait are dropped with their responders: callers learn that the coordinator has stopped.
        drop(messages);
        let finished = tokio::task::spawn_blocking(move || keeper.finish()).await;
        if let Err(error) = finished {
            tracing::error!(%error, "the store's thread could not be ended");
        }
        fatal.map_or(Ok(()), Err)
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Ask(ask) => self.asked(ask),
            Message::Join { hello, outbox, respond } => self.join(hello, outbox, respond),
            Message::Said { worker, session, request } => self.said(worker, session, request),
            Message::Left { worker, session } => self.left(worker, session),
            Message::Stored(stored) => self.stored(stored),
            Message::Stop => {}
        }
    }

    /// Time passed.
    fn pulse(&mut self) {
        let now_ms = self.now_ms();
        let jobs = self.jobs.values_mut().filter(|job| !matches!(job.phase, Phase::Ended(_)));
        for job in jobs {
            for stage in job.progress.take_changed() {
                job.events.append(|_| v1::watch_bake_response::Event::Progress(stage));
            }
        }
        if self.keeper.is_dead() {
            self.fatal.get_or_insert(ServeError::Keeper);
        }
        for worker in self.registry.take_cut_off() {
            self.feed(Event::WorkerDisconnected(worker));
        }
        if now_ms.saturating_sub(self.last_tick_ms) >= TICK_MS {
            self.last_tick_ms = now_ms;
            self.feed(Event::Tick);
            self.fail_unfit(now_ms);
            self.retry_ends(now_ms);
            self.publish_farm();
        }
    }

    /// Milliseconds of the coordinator's clock: the scheduler's time.
    fn now_ms(&self) -> u64 {
        self.began.elapsed().as_millis() as u64
    }

    /// Tells the scheduler, and does what follows.
    fn feed(&mut self, event: Event) {
        for action in self.scheduler.apply(self.now_ms(), event) {
            self.act(action);
        }
    }

    /// Does what the scheduler wants.
    fn act(&mut self, action: Action) {
        match action {
            Action::Lease { worker, lease, epoch, job, tasks, .. } => self.lease(worker, lease, epoch, job, &tasks),
            Action::RevokeLease { worker, lease, epoch, tasks, ended, why } => {
                self.revoke(worker, lease, epoch, &tasks, ended, why);
            }
            Action::TaskAccepted { job, task, .. } => self.accepted(job, task),
            Action::ResultIgnored { task, why, .. } => tracing::debug!(?task, ?why, "a result does not count"),
            Action::TaskRetried { job, task, attempt } => self.retried(job, task, &attempt),
            Action::JobFailed { job, reason, task, attempts } => self.job_failed(job, reason, task, &attempts),
            Action::WorkerSetAside { worker, why } => self.set_aside(worker, &why),
            Action::WorkerExpired(worker) => self.dismiss(worker, "it was silent for too long"),
            Action::WorkerDrained(worker) => self.dismiss(worker, "it has drained"),
        }
    }

    /// Appends to the journal; `ack` follows when it is durable.
    fn journal(&mut self, event: JournalEvent, ack: Ack) {
        let number = self.next_ack;
        self.next_ack += 1;
        self.acks.insert(number, ack);
        self.keeper.send(Op::Journal { events: vec![event], ack: number });
    }

    fn stored(&mut self, stored: Stored) {
        match stored {
            Stored::Journaled { ack, outcome } => self.journaled(ack, outcome),
            Stored::Ended { job, outcome } => self.ended(job, outcome),
            Stored::Answer { job, found } => self.answered(job, found),
            Stored::LookedUp { job, found } => self.looked_up(job, found),
            Stored::Lost { job, digest } => self.restart(job, digest),
            Stored::Graph { job, graph } => self.graph_read(job, graph),
            Stored::Baked { job, digest, baked } => self.baked_read(job, digest, baked),
            Stored::Outputs { job, outcome } => self.outputs_stored(job, outcome),
            Stored::Delivered { delivery, outcome } => self.delivered(&delivery, outcome),
            Stored::Broken { job, error } => self.broken(job, &error),
        }
    }

    /// Notes an error after which nothing can be promised any more.
    fn note_fatal(&mut self, error: &Arc<StoreError>) {
        if matches!(**error, StoreError::Fenced { .. } | StoreError::JournalBroken { .. }) {
            self.fatal.get_or_insert_with(|| ServeError::Store(Arc::clone(error)));
        }
    }

    /// Whether a job takes part in anything at all.
    fn is_paused(jobs: &BTreeMap<JobId, Job>, job: JobId) -> bool {
        jobs.get(&job).is_none_or(|job| job.paused)
    }

    /// Whether bakes of an earlier coordinator go on.
    fn resumes(&self) -> bool {
        self.config.unfinished == Unfinished::Resume
    }
}

/// Milliseconds since 1970.
pub(crate) fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64)
}
