//! The worker's side of its session with the coordinator.
//!
//! One loop owns all state and reacts to what comes: messages, finished leases, the heartbeat's tick, the request to
//! stop. When the connection breaks, leases go on running; the next connection names them, and results that were not
//! settled are sent again.

use crate::{
    Artefacts, CancelFlag, Executor,
    lease::{Bench, LeaseOutcome, LeasedTask, Progress},
    threads::TaskThreads,
};
use kiln_core::{TaskKey, TaskKind};
use kiln_proto::{client::Farm, digest, v1};
use std::{
    collections::{BTreeMap, BTreeSet},
    future::Future,
    pin::{Pin, pin},
    sync::Arc,
    time::{Duration, Instant},
};
use tokio::{
    sync::mpsc,
    time::{MissedTickBehavior, interval, sleep, timeout},
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status, Streaming};
use v1::{session_request::Message as Say, session_response::Message as Hear};

/// Waits between attempts to connect: doubled from the first to the last.
const FIRST_WAIT: Duration = Duration::from_millis(100);
const LAST_WAIT: Duration = Duration::from_secs(10);

/// Messages that may wait to be sent.
const OUTGOING: usize = 256;

/// Heartbeats without an answer after which the connection counts as broken.
const SILENT_HEARTBEATS: u32 = 4;

/// Time to finish leases when asked to stop.
const DRAIN: Duration = Duration::from_secs(20);

/// What a worker may be asked to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Trace tasks.
    Trace,
    /// Every other kind.
    Reduce,
}

/// Who a worker is.
#[derive(Clone, Debug)]
pub struct WorkerConfig {
    /// The same on every reconnect, and no other worker's; 1 to 64 characters.
    pub worker_id: String,
    /// For people.
    pub name: String,
    /// What it may be asked to do.
    pub roles: Vec<Role>,
    /// What traces, for people.
    pub adapter: String,
    /// Threads that tasks run on.
    pub threads: usize,
    /// Memory one task may use, bytes.
    pub memory_bytes: u64,
}

/// Why a worker stopped.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator does not want it.
    #[error("the coordinator refuses this worker: {}", .0.message())]
    Refused(Status),
    /// Its threads could not be started.
    #[error("the worker's threads cannot be started: {0}")]
    Threads(#[from] std::io::Error),
    /// What it traces on is gone. Its leases were handed back.
    #[error("{reason}; the worker has left the farm: see to the driver, then start it again")]
    DeviceLost {
        /// Which device, and what its driver said.
        reason: String,
    },
}

/// Leases taken at once: while one runs out of tasks, the next keeps the threads busy.
const CONCURRENT_LEASES: u32 = 2;

/// Works for a coordinator until `shutdown` completes; then finishes what it has, within a time, and leaves.
pub async fn run(
    farm: Farm,
    executor: Arc<dyn Executor>,
    artefacts: Arc<dyn Artefacts>,
    config: WorkerConfig,
    shutdown: impl Future<Output = ()> + Send,
) -> Result<(), WorkerError> {
    let (finished, mut finishes) = mpsc::channel(64);
    let mut worker = Worker {
        bench: Bench { threads: TaskThreads::start(config.threads)?, executor, artefacts },
        config,
        started: Instant::now(),
        leases: BTreeMap::new(),
        next_part: 0,
        unsettled: BTreeMap::new(),
        next_sequence: 1,
        finished,
        draining_until: None,
        lost: None,
    };
    let mut shutdown = pin!(shutdown);
    let mut wait = FIRST_WAIT;
    loop {
        let began = Instant::now();
        match worker.connection(&farm, &mut finishes, shutdown.as_mut()).await {
            Ok(()) => return worker.left(),
            Err(status) if is_final(&status) => return Err(WorkerError::Refused(status)),
            Err(status) => tracing::warn!(reason = status.message(), "the coordinator is gone; connecting again"),
        }
        if worker.draining_until.is_some() {
            return worker.left();
        }
        wait = if began.elapsed() > LAST_WAIT { FIRST_WAIT } else { (wait * 2).min(LAST_WAIT) };
        tokio::select! {
            () = sleep(wait) => {}
            () = &mut shutdown => return Ok(()),
        }
    }
}

/// Whether connecting again would give the same answer.
fn is_final(status: &Status) -> bool {
    let codes = [Code::InvalidArgument, Code::FailedPrecondition, Code::PermissionDenied, Code::Unauthenticated];
    codes.contains(&status.code())
}

struct Worker {
    config: WorkerConfig,
    bench: Bench,
    started: Instant,
    /// Parts of leases that run: a long lease comes in several messages.
    leases: BTreeMap<u64, LeasePart>,
    next_part: u64,
    /// Results that the coordinator has not settled.
    unsettled: BTreeMap<u64, v1::LeaseResults>,
    next_sequence: u64,
    finished: mpsc::Sender<Finish>,
    draining_until: Option<Instant>,
    /// Why it leaves, if its device was lost.
    lost: Option<String>,
}

struct LeasePart {
    lease: v1::LeaseRef,
    tasks: Vec<(u64, CancelFlag)>,
}

enum Finish {
    Progress(v1::LeaseProgress),
    Done { part: u64, outcome: LeaseOutcome },
}

impl Worker {
    /// One connection, from hello to its end. `Ok` once drained.
    async fn connection(
        &mut self,
        farm: &Farm,
        finishes: &mut mpsc::Receiver<Finish>,
        mut shutdown: Pin<&mut (impl Future<Output = ()> + Send)>,
    ) -> Result<(), Status> {
        let (say, outgoing) = mpsc::channel(OUTGOING);
        let outgoing_is_full = |_| Status::unavailable("the session is over");
        say.send(request(Say::Hello(self.hello()))).await.map_err(outgoing_is_full)?;
        let mut stream = farm.workers().session(ReceiverStream::new(outgoing)).await?.into_inner();
        let Hear::Welcome(welcome) = receive(&mut stream).await? else {
            return Err(Status::failed_precondition("the coordinator's first message is no welcome"));
        };
        tracing::info!(worker = self.config.worker_id, "connected");
        let mut to_say: Vec<Say> = self.unsettled.values().cloned().map(Say::Results).collect();
        if let Some(until) = self.draining_until {
            let left = until.saturating_duration_since(Instant::now());
            to_say.push(Say::Draining(v1::Draining { deadline_ms: left.as_millis() as u64 }));
        }
        let period = Duration::from_millis(u64::from(welcome.heartbeat_interval_ms.clamp(50, 60_000)));
        let mut heartbeat = interval(period);
        heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut heard = Instant::now();
        loop {
            for message in to_say.drain(..) {
                say.send(request(message)).await.map_err(outgoing_is_full)?;
            }
            if self.is_drained() {
                return Ok(());
            }
            tokio::select! {
                message = receive(&mut stream) => {
                    heard = Instant::now();
                    self.hear(message?, &mut to_say);
                }
                () = &mut shutdown, if self.draining_until.is_none() => self.drain(&mut to_say),
                Some(finish) = finishes.recv() => self.finish(finish, &mut to_say),
                _ = heartbeat.tick() => {
                    if heard.elapsed() > period * SILENT_HEARTBEATS {
                        return Err(Status::unavailable("the coordinator does not answer heartbeats"));
                    }
                    let uptime_ms = self.started.elapsed().as_millis() as u64;
                    to_say.push(Say::Heartbeat(v1::Heartbeat { uptime_ms }));
                }
            }
        }
    }

    /// What is said once it has left.
    fn left(&mut self) -> Result<(), WorkerError> {
        self.lost.take().map_or(Ok(()), |reason| Err(WorkerError::DeviceLost { reason }))
    }

    fn drain(&mut self, to_say: &mut Vec<Say>) {
        self.draining_until = Some(Instant::now() + DRAIN);
        to_say.push(Say::Draining(v1::Draining { deadline_ms: DRAIN.as_millis() as u64 }));
    }

    /// Whether it was told to leave and has nothing left to do, or no time. One that hands leases back waits until the
    /// coordinator, which then knows, ends the session.
    fn is_drained(&self) -> bool {
        let is_idle = self.leases.is_empty() && self.unsettled.is_empty() && self.lost.is_none();
        self.draining_until.is_some_and(|until| is_idle || Instant::now() >= until)
    }

    fn hello(&self) -> v1::Hello {
        let lanes = self.bench.executor.lanes();
        let role = |role: &Role| match role {
            Role::Trace => v1::WorkerRole::Trace.into(),
            Role::Reduce => v1::WorkerRole::Reduce.into(),
        };
        // Results that may not have arrived are as good as work under way: nobody else need begin it anew.
        let unsettled = self.unsettled.values().filter_map(|results| results.lease);
        let held = self.leases.values().map(|part| part.lease).chain(unsettled);
        let held: BTreeSet<(u64, u32)> = held.map(|lease| (lease.lease_id, lease.epoch)).collect();
        let held = held.into_iter().map(|(lease_id, epoch)| v1::LeaseRef { lease_id, epoch }).collect();
        let rev = |kind: &TaskKind| v1::KernelRev { kind: v1::TaskKind::from(*kind).into(), rev: kind.kernel_rev() };
        v1::Hello {
            worker_id: self.config.worker_id.clone(),
            name: self.config.name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            protocol_min: kiln_proto::PROTOCOL_MIN,
            protocol_max: kiln_proto::PROTOCOL,
            roles: self.config.roles.iter().map(role).collect(),
            trace_lanes: lanes.trace,
            solve_lane: lanes.solve,
            adapter: self.config.adapter.clone(),
            cores: self.config.threads as u32,
            memory_bytes: self.config.memory_bytes,
            concurrent_leases: CONCURRENT_LEASES,
            held_leases: held,
            kernel_revs: TaskKind::ALL.iter().map(rev).collect(),
        }
    }

    fn hear(&mut self, message: Hear, to_say: &mut Vec<Say>) {
        match message {
            Hear::Lease(lease) if self.draining_until.is_some() => to_say.push(Say::Returned(v1::LeaseReturned {
                lease: lease.lease,
                reason: v1::ReturnReason::Draining.into(),
            })),
            Hear::Lease(lease) => self.start(lease, to_say),
            Hear::Revoke(revoke) => {
                if let Some(lease) = &revoke.lease {
                    self.revoke(lease, &revoke.task_ids);
                }
            }
            Hear::Drain(drain) => {
                let until = Instant::now() + Duration::from_millis(drain.deadline_ms);
                self.draining_until = Some(self.draining_until.map_or(until, |earlier| earlier.min(until)));
            }
            Hear::SetAside(aside) => tracing::warn!(reason = aside.reason, "the coordinator gives this worker no work"),
            Hear::Settled(settled) => drop(self.unsettled.remove(&settled.sequence)),
            Hear::Welcome(_) | Hear::Alive(_) => {}
        }
    }

    fn start(&mut self, message: v1::Lease, to_say: &mut Vec<Say>) {
        let Some(lease) = message.lease else { return };
        let mut tasks = Vec::with_capacity(message.tasks.len());
        let lane: Arc<str> = message.lane.map_or_else(String::new, |lane| lane.trace).into();
        for task in message.tasks {
            let (id, key_bytes) = (task.task_id, task.key.clone());
            match leased_task(task, &lane) {
                Ok(task) => tasks.push(task),
                Err(error) => to_say.push(Say::Failed(v1::TaskFailed {
                    lease: Some(lease),
                    task_id: id,
                    key: key_bytes,
                    kind: v1::TaskFailureKind::Failed.into(),
                    message: format!("the task makes no sense to this worker: {error}"),
                    missing: Vec::new(),
                })),
            }
        }
        let part = self.next_part;
        self.next_part += 1;
        let flags = tasks.iter().map(|task| (task.id, task.cancel.clone())).collect();
        self.leases.insert(part, LeasePart { lease, tasks: flags });
        let (bench, finished) = (self.bench.clone(), self.finished.clone());
        tokio::task::spawn_blocking(move || {
            let sender = ProgressSender::new(lease, finished.clone());
            let progress: Progress = Arc::new(move |tasks, rays| sender.add(tasks, rays));
            let outcome = bench.run(&tasks, &progress);
            // The loop is gone only when the worker is.
            let _ = finished.blocking_send(Finish::Done { part, outcome });
        });
    }

    fn revoke(&mut self, lease: &v1::LeaseRef, tasks: &[u64]) {
        for part in self.leases.values().filter(|part| part.lease.lease_id == lease.lease_id) {
            let is_named = |id: &u64| tasks.is_empty() || tasks.contains(id);
            part.tasks.iter().filter(|(id, _)| is_named(id)).for_each(|(_, flag)| flag.cancel());
        }
    }

    fn finish(&mut self, finish: Finish, to_say: &mut Vec<Say>) {
        match finish {
            Finish::Progress(progress) => to_say.push(Say::Progress(progress)),
            Finish::Done { part, outcome } => {
                let Some(part) = self.leases.remove(&part) else { return };
                to_say.extend(outcome.failures.into_iter().map(|failure| {
                    Say::Failed(v1::TaskFailed {
                        lease: Some(part.lease),
                        task_id: failure.id,
                        key: failure.key.0.0.to_vec(),
                        kind: failure.kind.into(),
                        message: failure.message,
                        missing: failure.missing.map_or_else(Vec::new, |digest| digest.0.to_vec()),
                    })
                }));
                if !outcome.results.is_empty() {
                    let results = v1::LeaseResults {
                        lease: Some(part.lease),
                        entries: outcome.results,
                        lease_seconds: outcome.seconds,
                        sequence: self.next_sequence,
                    };
                    self.unsettled.insert(self.next_sequence, results.clone());
                    self.next_sequence += 1;
                    to_say.push(Say::Results(results));
                }
                if let Some(reason) = outcome.lost {
                    self.lose(reason, part.lease, to_say);
                }
            }
        }
    }

    /// The device is gone: the worker leaves, so that it gets no more leases, and hands this one back.
    fn lose(&mut self, reason: String, lease: v1::LeaseRef, to_say: &mut Vec<Say>) {
        tracing::error!(reason, "the device is lost; the worker hands its leases back and leaves");
        if self.draining_until.is_none() {
            self.drain(to_say);
        }
        self.lost.get_or_insert(reason);
        let reason = v1::ReturnReason::Draining.into();
        to_say.push(Say::Returned(v1::LeaseReturned { lease: Some(lease), reason }));
    }
}

impl Drop for Worker {
    /// Nobody takes the results any more: tasks are told to stop.
    fn drop(&mut self) {
        self.leases.values().flat_map(|part| &part.tasks).for_each(|(_, flag)| flag.cancel());
    }
}

/// Sends progress of a lease, a few times a second at most.
struct ProgressSender {
    lease: v1::LeaseRef,
    sum: std::sync::Mutex<(u32, u64, Instant)>,
    finished: mpsc::Sender<Finish>,
}

impl ProgressSender {
    const INTERVAL: Duration = Duration::from_millis(250);

    fn new(lease: v1::LeaseRef, finished: mpsc::Sender<Finish>) -> Self {
        Self { lease, sum: std::sync::Mutex::new((0, 0, Instant::now())), finished }
    }

    fn add(&self, tasks: u32, rays: u64) {
        let mut sum = self.sum.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        sum.0 += tasks;
        sum.1 += rays;
        if sum.2.elapsed() >= Self::INTERVAL {
            sum.2 = Instant::now();
            let progress = v1::LeaseProgress { lease: Some(self.lease), tasks_done: sum.0, rays: sum.1 };
            // Progress that finds no room is told by the next.
            let _ = self.finished.try_send(Finish::Progress(progress));
        }
    }
}

fn leased_task(task: v1::LeasedTask, lane: &Arc<str>) -> Result<LeasedTask, kiln_proto::FieldError> {
    let key = TaskKey(digest("key", &task.key)?);
    let spec = kiln_proto::required("spec", task.spec)?.try_into()?;
    Ok(LeasedTask { id: task.task_id, key, spec, lane: Arc::clone(lane), cancel: CancelFlag::default() })
}

fn request(message: Say) -> v1::SessionRequest {
    v1::SessionRequest { message: Some(message) }
}

/// The next message; the end of the stream is an error.
async fn receive(stream: &mut Streaming<v1::SessionResponse>) -> Result<Hear, Status> {
    /// A connection that says nothing for so long is dead, whatever the heartbeat's interval.
    const PATIENCE: Duration = Duration::from_secs(300);
    loop {
        let message = timeout(PATIENCE, stream.message()).await;
        match message.map_err(|_| Status::unavailable("the coordinator is silent"))?? {
            Some(v1::SessionResponse { message: Some(message) }) => return Ok(message),
            // A message of a later protocol: not for this worker.
            Some(v1::SessionResponse { message: None }) => {}
            None => return Err(Status::unavailable("the coordinator ended the session")),
        }
    }
}
