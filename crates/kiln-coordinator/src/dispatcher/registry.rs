//! The workers that are known: who they are, how they are reached, what they hold.

use super::Outbox;
use crate::{keeper::Arrival, lanes::Offer};
use kiln_core::{Digest, JobId, TaskKind};
use kiln_proto::{FieldError, PROTOCOL, PROTOCOL_MIN, digest, limits, required, status, v1};
use kiln_schedule::{Capabilities, HeldLease, LeaseId, Roles, TaskId, WorkerId};
use std::collections::{BTreeMap, BTreeSet};
use tokio::sync::mpsc::error::TrySendError;
use tonic::{Code, Status};

/// A worker's hello, checked.
#[derive(Clone, Debug)]
pub(crate) struct Hello {
    pub(crate) worker_id: String,
    pub(crate) name: String,
    version: String,
    adapter: String,
    trace_lanes: Vec<String>,
    solve_lane: String,
    pub(crate) capabilities: Capabilities,
    pub(crate) held: Vec<HeldLease>,
}

impl Hello {
    /// Checks a hello: its fields, the protocol, and the revisions of the worker's code.
    pub(crate) fn new(hello: v1::Hello) -> Result<Self, Status> {
        if hello.protocol_min > PROTOCOL || hello.protocol_max < PROTOCOL_MIN {
            let message = format!(
                "the worker speaks protocol {} to {} and this coordinator {PROTOCOL_MIN} to {PROTOCOL}; run the same version of kiln on both",
                hello.protocol_min, hello.protocol_max
            );
            return Err(status::error(Code::FailedPrecondition, "PROTOCOL", message));
        }
        for kind in TaskKind::ALL {
            let wire = v1::TaskKind::from(kind) as i32;
            let rev = hello.kernel_revs.iter().find(|rev| rev.kind == wire).map_or(0, |rev| rev.rev);
            if rev != kind.kernel_rev() {
                let message = format!(
                    "the worker's {} code is of revision {rev} and this coordinator's of {}; run the same version of kiln on both",
                    kind.name(),
                    kind.kernel_rev()
                );
                return Err(status::error(Code::FailedPrecondition, "KERNEL_REVISION", message));
            }
        }
        Ok(Self::checked(hello)?)
    }

    fn checked(hello: v1::Hello) -> Result<Self, FieldError> {
        let texts = [("worker_id", &hello.worker_id), ("name", &hello.name), ("version", &hello.version)];
        let lanes = hello.trace_lanes.iter().chain([&hello.solve_lane, &hello.adapter]);
        for (field, text) in texts.into_iter().chain(lanes.map(|lane| ("lanes", lane))) {
            if text.len() > limits::NAME_BYTES || text.chars().any(char::is_control) {
                let problem = format!("must have at most {} bytes and no control characters", limits::NAME_BYTES);
                return Err(FieldError::new(field, problem));
            }
        }
        if hello.worker_id.is_empty() {
            return Err(FieldError::new("worker_id", "is empty"));
        }
        if hello.trace_lanes.len() > 64 || hello.held_leases.len() > 1024 {
            return Err(FieldError::new("hello", "has more than 64 lanes or 1024 leases"));
        }
        let has = |role| hello.roles.contains(&(role as i32));
        let roles = Roles { trace: has(v1::WorkerRole::Trace), reduce: has(v1::WorkerRole::Reduce) };
        if roles == Roles::default() {
            return Err(FieldError::new("roles", "is empty; a worker traces, reduces, or both"));
        }
        let held = hello.held_leases.iter().map(|held| HeldLease { lease: LeaseId(held.lease_id), epoch: held.epoch });
        let capabilities = Capabilities {
            roles,
            trace_lanes: hello.trace_lanes.iter().cloned().collect(),
            solve_lanes: BTreeSet::from([hello.solve_lane.clone()]),
            memory_bytes: hello.memory_bytes,
            cores: hello.cores,
            concurrent_leases: hello.concurrent_leases.clamp(1, 16),
        };
        Ok(Self {
            held: held.collect(),
            capabilities,
            worker_id: hello.worker_id,
            name: hello.name,
            version: hello.version,
            adapter: hello.adapter,
            trace_lanes: if roles.trace { hello.trace_lanes } else { Vec::new() },
            solve_lane: hello.solve_lane,
        })
    }
}

/// A lease in a worker's hands.
#[derive(Debug)]
pub(super) struct Leased {
    pub(super) epoch: u32,
    pub(super) job: JobId,
    pub(super) kind: TaskKind,
    /// Tasks that are neither done nor failed.
    pub(super) open: BTreeSet<TaskId>,
}

/// A worker.
#[derive(Debug)]
struct Worker {
    hello: Hello,
    state: v1::WorkerState,
    /// Number of its session, and where its messages go; none while it is not connected.
    session: Option<(u64, Outbox)>,
    heard_ms: u64,
    leases: BTreeMap<LeaseId, Leased>,
    tasks_done: u64,
    tasks_failed: u64,
    rays: u64,
}

/// All workers.
#[derive(Debug, Default)]
pub(super) struct Registry {
    workers: BTreeMap<WorkerId, Worker>,
    numbers: BTreeMap<String, WorkerId>,
    next_worker: u64,
    next_session: u64,
    /// Workers that were cut off and have yet to be given up.
    cut_off: Vec<WorkerId>,
}

impl Registry {
    /// A worker connects: its number, that of its session, and whether it was connected before.
    pub(super) fn join(&mut self, hello: Hello, outbox: Outbox, now_ms: u64) -> Result<(WorkerId, u64), Status> {
        let number = *self.numbers.entry(hello.worker_id.clone()).or_insert_with(|| {
            self.next_worker += 1;
            WorkerId(self.next_worker)
        });
        self.next_session += 1;
        let session = Some((self.next_session, outbox));
        match self.workers.get_mut(&number) {
            Some(worker) if worker.state == v1::WorkerState::SetAside => {
                let message = format!(
                    "{} is set aside: its tasks failed where others' did not; look at its logs",
                    worker.hello.name
                );
                return Err(status::error(Code::FailedPrecondition, "SET_ASIDE", message));
            }
            Some(worker) => {
                worker.hello = hello;
                worker.session = session;
                worker.state = v1::WorkerState::Active;
                worker.heard_ms = now_ms;
            }
            None => {
                let worker = Worker {
                    hello,
                    state: v1::WorkerState::Active,
                    session,
                    heard_ms: now_ms,
                    leases: BTreeMap::new(),
                    tasks_done: 0,
                    tasks_failed: 0,
                    rays: 0,
                };
                self.workers.insert(number, worker);
            }
        }
        Ok((number, self.next_session))
    }

    /// Whether a message comes from the worker's present session; notes that it lives.
    pub(super) fn hears(&mut self, number: WorkerId, session: u64, now_ms: u64) -> bool {
        match self.workers.get_mut(&number) {
            Some(worker) if worker.session.as_ref().is_some_and(|(known, _)| *known == session) => {
                worker.heard_ms = now_ms;
                true
            }
            _ => false,
        }
    }

    /// The worker's stream is gone.
    pub(super) fn disconnect(&mut self, number: WorkerId) {
        if let Some(worker) = self.workers.get_mut(&number) {
            worker.session = None;
            if worker.state == v1::WorkerState::Active {
                worker.state = v1::WorkerState::Disconnected;
            }
        }
    }

    /// The worker is gone for good; gives its leases back.
    pub(super) fn remove(&mut self, number: WorkerId) -> BTreeMap<LeaseId, Leased> {
        let Some(worker) = self.workers.get_mut(&number) else { return BTreeMap::new() };
        let leases = std::mem::take(&mut worker.leases);
        if worker.state == v1::WorkerState::SetAside {
            // Remembered, so that it does not come back under the same id.
            worker.session = None;
        } else if let Some(worker) = self.workers.remove(&number) {
            self.numbers.remove(&worker.hello.worker_id);
        }
        leases
    }

    pub(super) fn set_state(&mut self, number: WorkerId, state: v1::WorkerState) {
        if let Some(worker) = self.workers.get_mut(&number) {
            worker.state = state;
        }
    }

    /// Sends a message, if the worker is connected. One that does not read what it is sent is cut off.
    pub(super) fn tell(&mut self, number: WorkerId, message: v1::session_response::Message) {
        let Some(worker) = self.workers.get_mut(&number) else { return };
        let Some((_, outbox)) = &worker.session else { return };
        let sent = outbox.try_send(Ok(v1::SessionResponse { message: Some(message) }));
        // One whose connection has ended is told of by its session.
        if let Err(TrySendError::Full(_)) = sent {
            tracing::warn!(worker = worker.hello.name, "the worker does not read what it is sent and is cut off");
            self.disconnect(number);
            self.cut_off.push(number);
        }
    }

    /// The workers that were cut off since the last call.
    pub(super) fn take_cut_off(&mut self) -> Vec<WorkerId> {
        std::mem::take(&mut self.cut_off)
    }

    /// The worker's name for people.
    pub(super) fn name(&self, number: WorkerId) -> String {
        self.workers.get(&number).map_or_else(|| format!("worker {}", number.0), |worker| worker.hello.name.clone())
    }

    pub(super) fn leased(&mut self, number: WorkerId, lease: LeaseId, leased: Leased) {
        if let Some(worker) = self.workers.get_mut(&number) {
            worker.leases.insert(lease, leased);
        }
    }

    /// A lease as the worker holds it.
    pub(super) fn lease_of(&self, number: WorkerId, lease: LeaseId, epoch: u32) -> Option<&Leased> {
        self.workers.get(&number)?.leases.get(&lease).filter(|leased| leased.epoch == epoch)
    }

    /// Tasks of a lease are done or failed; gives the lease when it was its last.
    pub(super) fn settle(
        &mut self,
        number: WorkerId,
        lease: LeaseId,
        epoch: u32,
        tasks: impl IntoIterator<Item = TaskId>,
    ) -> Option<Leased> {
        let leases = &mut self.workers.get_mut(&number)?.leases;
        let leased = leases.get_mut(&lease).filter(|leased| leased.epoch == epoch)?;
        for task in tasks {
            leased.open.remove(&task);
        }
        if leased.open.is_empty() { leases.remove(&lease) } else { None }
    }

    /// A lease is taken from the worker.
    pub(super) fn take_lease(&mut self, number: WorkerId, lease: LeaseId, epoch: u32) -> Option<Leased> {
        let leases = &mut self.workers.get_mut(&number)?.leases;
        leases.get(&lease).filter(|leased| leased.epoch == epoch)?;
        leases.remove(&lease)
    }

    pub(super) fn worked(&mut self, number: WorkerId, arrivals: &[Arrival]) {
        if let Some(worker) = self.workers.get_mut(&number) {
            worker.tasks_done += arrivals.len() as u64;
            worker.rays += arrivals.iter().map(|arrival| arrival.effort.rays).sum::<u64>();
        }
    }

    pub(super) fn failed(&mut self, number: WorkerId) {
        if let Some(worker) = self.workers.get_mut(&number) {
            worker.tasks_failed += 1;
        }
    }

    /// What the connected workers offer, in the order in which they came.
    pub(super) fn offers(&self) -> Vec<Offer<'_>> {
        let active = self.workers.values().filter(|worker| worker.state == v1::WorkerState::Active);
        active
            .map(|worker| Offer {
                trace: &worker.hello.trace_lanes,
                solve: worker.hello.capabilities.roles.reduce.then_some(worker.hello.solve_lane.as_str()),
            })
            .collect()
    }

    /// Connected workers, their cores, and leases in workers' hands.
    pub(super) fn connected(&self) -> (u64, u64, u64) {
        let connected = self.workers.values().filter(|worker| worker.session.is_some());
        let cores = connected.clone().map(|worker| u64::from(worker.hello.capabilities.cores)).sum();
        let leases = self.workers.values().map(|worker| worker.leases.len() as u64).sum();
        (connected.count() as u64, cores, leases)
    }

    /// All workers as shown, in the order of their ids.
    pub(super) fn shown(&self, now_ms: u64) -> Vec<v1::Worker> {
        self.numbers.values().filter_map(|number| Some(self.workers.get(number)?.shown(now_ms))).collect()
    }
}

impl Worker {
    fn shown(&self, now_ms: u64) -> v1::Worker {
        v1::Worker {
            worker_id: self.hello.worker_id.clone(),
            name: self.hello.name.clone(),
            version: self.hello.version.clone(),
            state: self.state.into(),
            trace_lanes: self.hello.trace_lanes.clone(),
            solve_lane: self.hello.solve_lane.clone(),
            adapter: self.hello.adapter.clone(),
            cores: self.hello.capabilities.cores,
            memory_bytes: self.hello.capabilities.memory_bytes,
            leases: self.leases.len() as u32,
            tasks_done: self.tasks_done,
            tasks_failed: self.tasks_failed,
            rays: self.rays,
            silent_ms: now_ms.saturating_sub(self.heard_ms),
        }
    }
}

/// The parts of a failure that a worker reports, checked.
#[derive(Debug)]
pub(super) struct Failure {
    pub(super) lease: HeldLease,
    pub(super) task: TaskId,
    pub(super) key: kiln_core::TaskKey,
    pub(super) reason: String,
    pub(super) permanent: bool,
    /// An artefact that the task needs and the worker could not get.
    pub(super) missing: Option<Digest>,
}

impl TryFrom<v1::TaskFailed> for Failure {
    type Error = FieldError;

    fn try_from(failed: v1::TaskFailed) -> Result<Self, FieldError> {
        let held = required("lease", failed.lease)?;
        let permanent = failed.kind() == v1::TaskFailureKind::Refused;
        let missing = (!failed.missing.is_empty()).then(|| digest("missing", &failed.missing)).transpose()?;
        Ok(Self {
            lease: HeldLease { lease: LeaseId(held.lease_id), epoch: held.epoch },
            task: TaskId(failed.task_id),
            key: kiln_core::TaskKey(digest("key", &failed.key)?),
            reason: limits::cut(&failed.message, limits::FAILURE_TEXT_BYTES).to_owned(),
            permanent,
            missing,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hello() -> v1::Hello {
        v1::Hello {
            worker_id: "w".into(),
            protocol_min: PROTOCOL_MIN,
            protocol_max: PROTOCOL,
            roles: vec![v1::WorkerRole::Trace.into(), v1::WorkerRole::Reduce.into()],
            trace_lanes: vec!["cpu".into()],
            solve_lane: "any".into(),
            kernel_revs: TaskKind::ALL
                .map(|kind| v1::KernelRev { kind: v1::TaskKind::from(kind).into(), rev: kind.kernel_rev() })
                .to_vec(),
            ..Default::default()
        }
    }

    #[test]
    fn workers_of_other_versions_are_refused() {
        let reason = |change: fn(&mut v1::Hello)| {
            let mut hello = hello();
            change(&mut hello);
            status::reason(&Hello::new(hello).unwrap_err()).unwrap()
        };
        assert!(Hello::new(hello()).is_ok());
        assert_eq!(reason(|h| h.protocol_min = PROTOCOL + 1), "PROTOCOL");
        assert_eq!(reason(|h| h.kernel_revs[2].rev += 1), "KERNEL_REVISION");
        assert_eq!(reason(|h| h.kernel_revs.clear()), "KERNEL_REVISION");
        assert_eq!(reason(|h| h.roles.clear()), status::INVALID_FIELD);
        assert_eq!(reason(|h| h.worker_id.clear()), status::INVALID_FIELD);
    }

    #[test]
    fn a_newer_session_takes_the_place_of_the_older() {
        let mut registry = Registry::default();
        let outbox = || tokio::sync::mpsc::channel(1).0;
        let (worker, first) = registry.join(Hello::new(hello()).unwrap(), outbox(), 0).unwrap();
        let (same, second) = registry.join(Hello::new(hello()).unwrap(), outbox(), 1).unwrap();
        assert_eq!(worker, same);
        assert!(!registry.hears(worker, first, 2));
        assert!(registry.hears(worker, second, 2));
        registry.set_state(worker, v1::WorkerState::SetAside);
        registry.remove(worker);
        assert!(registry.join(Hello::new(hello()).unwrap(), outbox(), 3).is_err());
    }
}
