//! The miniature farm: coordinator, network and workers around a scheduler.

use super::{
    Random, check, check_no_idle_hands,
    hands::{SimWorker, Temper},
};
use crate::{
    Action, Config, Event, Ignored, JobSpec, LeaseId, ReadyTask, Requirements, Scheduler, TaskId, TenantLimits,
    WorkerId,
};
use kiln_core::{Digest, JobId, TaskKind};
use std::collections::{BTreeMap, BTreeSet};

/// Faults happen until then; afterwards a good worker joins, and all must come to an end.
pub(super) const CHAOS_MS: u64 = 60_000;
const END_MS: u64 = 900_000;

pub(crate) fn config() -> Config {
    Config {
        heartbeat_timeout_ms: 5_000,
        max_lease_ms: 60_000,
        no_fit_timeout_ms: Some(20_000),
        tenants: BTreeMap::from([("small".to_owned(), TenantLimits { weight: 0.5, max_leases: 3 })]),
        ..Config::default()
    }
}

/// What happened over all, to be added up.
#[derive(Clone, Debug, Default)]
pub(crate) struct Summary {
    pub(crate) succeeded: usize,
    pub(crate) failed: usize,
    pub(crate) cancelled: usize,
    pub(crate) duplicates: usize,
    pub(crate) unknown: usize,
    pub(crate) speculative: usize,
    pub(crate) set_aside: usize,
    pub(crate) expired: usize,
    pub(crate) drained: usize,
    pub(crate) returned: usize,
    pub(crate) late_accepted: usize,
}

impl Summary {
    pub(crate) fn add(&mut self, other: &Self) {
        self.succeeded += other.succeeded;
        self.failed += other.failed;
        self.cancelled += other.cancelled;
        self.duplicates += other.duplicates;
        self.unknown += other.unknown;
        self.speculative += other.speculative;
        self.set_aside += other.set_aside;
        self.expired += other.expired;
        self.drained += other.drained;
        self.returned += other.returned;
        self.late_accepted += other.late_accepted;
    }
}

#[derive(Debug)]
struct SimJob {
    stage: usize,
    stages: Vec<Vec<ReadyTask>>,
    open: BTreeSet<TaskId>,
}

/// What is under way in the simulated world.
#[derive(Clone, Debug)]
pub(super) enum Coming {
    /// A message to the coordinator; from a worker it may be lost.
    Message(Option<WorkerId>, Event),
    Granted {
        worker: WorkerId,
        lease: LeaseId,
        epoch: u32,
        tasks: Vec<TaskId>,
    },
    Revoked {
        worker: WorkerId,
        lease: LeaseId,
        tasks: Vec<TaskId>,
        ended: bool,
    },
    /// A worker is done with a task of a lease.
    Ran {
        worker: WorkerId,
        lease: LeaseId,
        task: TaskId,
        millis: u64,
    },
    Join(WorkerId),
    Beat(WorkerId),
    Tick,
    Chaos,
    GoodWorker,
}

pub(crate) struct Farm {
    pub(super) random: Random,
    scheduler: Scheduler,
    coming: BTreeMap<(u64, u64), Coming>,
    sequence: u64,
    pub(super) now_ms: u64,
    pub(super) workers: BTreeMap<WorkerId, SimWorker>,
    jobs: BTreeMap<JobId, SimJob>,
    pub(super) poison: BTreeSet<TaskId>,
    accepted: BTreeSet<TaskId>,
    leased_at: BTreeMap<LeaseId, WorkerId>,
    pub(super) summary: Summary,
    tell: bool,
    history: Option<Vec<(u64, Event, Vec<Action>)>>,
}

impl Farm {
    pub(crate) fn new(seed: u64, tell: bool) -> Self {
        let mut farm = Self {
            random: Random::new(seed),
            scheduler: Scheduler::new(config()),
            coming: BTreeMap::new(),
            sequence: 0,
            now_ms: 0,
            workers: BTreeMap::new(),
            jobs: BTreeMap::new(),
            poison: BTreeSet::new(),
            accepted: BTreeSet::new(),
            leased_at: BTreeMap::new(),
            summary: Summary::default(),
            tell,
            history: None,
        };
        for _ in 0..farm.random.range(1, 8) {
            let at = farm.random.range(0, 20_000);
            farm.new_worker(at, None);
        }
        for job in 0..farm.random.range(1, 5) {
            farm.new_job(JobId(job));
        }
        farm.at(0, Coming::Tick);
        farm.at(500, Coming::Chaos);
        farm.at(CHAOS_MS + 1, Coming::GoodWorker);
        farm
    }

    pub(crate) fn keep_history(&mut self) {
        self.history = Some(Vec::new());
    }

    pub(super) fn at(&mut self, at_ms: u64, what: Coming) {
        self.sequence += 1;
        self.coming.insert((at_ms, self.sequence), what);
    }

    fn new_job(&mut self, job: JobId) {
        let random = &mut self.random;
        let mut next = job.0 * 10_000;
        let trace = random.range(1, 60) as usize;
        let solve = random.range(1, 10) as usize;
        let kinds = [(TaskKind::Import, 1), (TaskKind::Trace, trace), (TaskKind::Solve, solve), (TaskKind::Export, 1)];
        // One in four is a mixed bake, which any worker that traces may work for.
        let lane = match random.range(0, 11) {
            0 => Some("tpu"),
            1..=3 => None,
            _ => Some("cpu"),
        };
        let level = Digest::of(&[random.range(0, 2) as u8]);
        let stages = kinds.map(|(kind, count)| {
            let mut task = || {
                next += 1;
                let needs = match kind {
                    TaskKind::Trace => lane.map(str::to_owned),
                    TaskKind::Solve => Some("x86_64".to_owned()),
                    _ => None,
                };
                ReadyTask {
                    task: TaskId(next),
                    kind,
                    cost: random.range(0, 2000),
                    needs: Requirements { lane: needs, memory_bytes: 1 << random.range(20, 30) },
                    locality: level,
                }
            };
            (0..count).map(|_| task()).collect()
        });
        if random.once_in(8) {
            self.poison.insert(TaskId(job.0 * 10_000 + random.range(1, trace as u64)));
        }
        let tenant = (*random.pick(&["big", "small"])).to_owned();
        let max_leases = random.once_in(3).then(|| random.range(1, 4) as usize);
        let spec = JobSpec { job, tenant, priority: random.range(0, 3) as i32, max_leases };
        let at = random.range(0, 30_000);
        let job_state = SimJob { stage: 0, stages: stages.to_vec(), open: BTreeSet::new() };
        self.jobs.insert(job, job_state);
        self.at(at, Coming::Message(None, Event::JobAdded(spec)));
        self.announce(job, at);
        let random = &mut self.random;
        let later = at + random.range(1, 30_000);
        match random.range(0, 11) {
            0 => self.at(later, Coming::Message(None, Event::JobCancelled(job))),
            1 => {
                let resumed = later + self.random.range(1, 20_000);
                self.at(later, Coming::Message(None, Event::JobPaused(job)));
                self.at(resumed, Coming::Message(None, Event::JobResumed(job)));
            }
            _ => {}
        }
    }

    /// Announces the tasks of a job's stage.
    fn announce(&mut self, job: JobId, at_ms: u64) {
        let state = self.jobs.get_mut(&job).unwrap();
        let tasks = state.stages[state.stage].clone();
        state.open = tasks.iter().map(|task| task.task).collect();
        self.at(at_ms, Coming::Message(None, Event::TasksReady { job, tasks }));
    }

    pub(crate) fn run(mut self) -> Summary {
        self.steps();
        self.summary
    }

    pub(crate) fn run_for_history(mut self) -> Vec<(u64, Event, Vec<Action>)> {
        self.steps();
        self.history.unwrap_or_default()
    }

    fn steps(&mut self) {
        while let Some(((at, _), what)) = self.coming.pop_first() {
            self.now_ms = at;
            let over = self.jobs.is_empty() && at > CHAOS_MS;
            if over || at > END_MS {
                break;
            }
            self.step(what);
        }
        let waits: Vec<_> = self.jobs.keys().map(|job| (job, self.scheduler.explain(*job))).collect();
        assert!(waits.is_empty(), "these did not end: {waits:?}\n{:#?}", self.scheduler.stats());
    }

    fn step(&mut self, what: Coming) {
        match what {
            Coming::Message(from, event) => {
                let cut = from.is_some_and(|from| {
                    let worker = &self.workers[&from];
                    worker.cut_until > self.now_ms || !worker.connected
                });
                if !cut {
                    self.deliver(event);
                }
            }
            Coming::Granted { worker, lease, epoch, tasks } => self.granted(worker, lease, epoch, tasks),
            Coming::Revoked { worker, lease, tasks, ended } => self.revoked(worker, lease, &tasks, ended),
            Coming::Ran { worker, lease, task, millis } => self.ran(worker, lease, task, millis),
            Coming::Beat(worker) => {
                if self.workers[&worker].alive {
                    self.send(worker, &Event::Heartbeat(worker));
                    self.at(self.now_ms + 1000, Coming::Beat(worker));
                }
            }
            Coming::Join(worker) => self.join(worker),
            Coming::Tick => {
                self.deliver(Event::Tick);
                self.at(self.now_ms + 250, Coming::Tick);
            }
            Coming::Chaos => self.chaos(),
            Coming::GoodWorker => self.new_worker(self.now_ms, Some(Temper::Good)),
        }
    }

    /// A worker's message: late, now and then doubled or lost.
    pub(super) fn send(&mut self, worker: WorkerId, event: &Event) {
        let chaos = self.now_ms < CHAOS_MS;
        if chaos && self.random.once_in(200) {
            return;
        }
        let copies = if chaos && self.random.once_in(30) { 2 } else { 1 };
        for _ in 0..copies {
            let at = self.now_ms + self.random.range(1, 40);
            self.at(at, Coming::Message(Some(worker), event.clone()));
        }
    }

    /// Gives an event to the scheduler, checks the state, and does what it says.
    pub(super) fn deliver(&mut self, event: Event) {
        if self.tell {
            println!("{:>8} {event:?}", self.now_ms);
        }
        if let Event::JobCancelled(job) = event
            && self.jobs.remove(&job).is_some()
        {
            self.summary.cancelled += 1;
        }
        let quiet = matches!(event, Event::Heartbeat(_) | Event::LeaseProgress { .. });
        let kept = self.history.is_some().then(|| event.clone());
        let late = matches!(&event, Event::TasksCompleted { worker, lease, epoch, .. }
            if self.scheduler.held(*worker, *lease, *epoch).is_none());
        let actions = self.scheduler.apply(self.now_ms, event);
        let accepted = actions.iter().filter(|action| matches!(action, Action::TaskAccepted { .. })).count();
        self.summary.late_accepted += if late { accepted } else { 0 };
        check(&self.scheduler);
        if !quiet {
            check_no_idle_hands(&self.scheduler);
        }
        if let (Some(history), Some(event)) = (&mut self.history, kept) {
            history.push((self.now_ms, event, actions.clone()));
        }
        for action in actions {
            if self.tell {
                println!("         -> {action:?}");
            }
            self.act(action);
        }
    }

    fn act(&mut self, action: Action) {
        let soon = self.now_ms + self.random.range(1, 40);
        match action {
            Action::Lease { worker, lease, epoch, job, tasks, speculative, .. } => {
                assert!(self.scheduler.workers.all.contains_key(&worker), "a lease for a worker that is not there");
                assert!(!tasks.is_empty() && epoch > 0);
                assert!(tasks.iter().all(|task| task.0 / 10_000 == job.0));
                assert!(tasks.iter().all(|task| !self.accepted.contains(task)), "a task that is done is leased");
                assert!(self.leased_at.insert(lease, worker).is_none(), "a lease's number is used twice");
                self.summary.speculative += usize::from(speculative);
                self.at(soon, Coming::Granted { worker, lease, epoch, tasks });
            }
            Action::RevokeLease { worker, lease, tasks, ended, .. } => {
                self.at(soon, Coming::Revoked { worker, lease, tasks, ended });
            }
            Action::TaskAccepted { job, task, worker } => {
                assert!(self.accepted.insert(task), "two results were accepted for {task:?}");
                assert!(self.workers.contains_key(&worker));
                self.progress(job, task);
            }
            Action::ResultIgnored { task, why, .. } => match why {
                Ignored::Duplicate => {
                    assert!(self.accepted.contains(&task));
                    self.summary.duplicates += 1;
                }
                Ignored::Unknown => self.summary.unknown += 1,
            },
            Action::TaskRetried { task, .. } => assert!(!self.accepted.contains(&task)),
            Action::JobFailed { job, reason, task, attempts } => self.job_failed(job, &reason, task, attempts.len()),
            Action::WorkerSetAside { worker, .. } => {
                let temper = self.workers[&worker].temper;
                assert!(!matches!(temper, Temper::Good | Temper::Slow), "a good worker is set aside");
                self.summary.set_aside += 1;
            }
            Action::WorkerExpired(worker) => {
                self.summary.expired += 1;
                self.workers.get_mut(&worker).unwrap().connected = false;
                self.at(soon + 1000, Coming::Join(worker));
            }
            Action::WorkerDrained(_) => self.summary.drained += 1,
        }
    }

    fn job_failed(&mut self, job: JobId, reason: &str, task: Option<TaskId>, attempts: usize) {
        assert!(self.jobs.remove(&job).is_some(), "{job} fails after its end");
        assert!(!reason.is_empty());
        let poisoned = task.is_some_and(|task| self.poison.contains(&task));
        let nobody = reason.contains("no worker can run");
        let enough = attempts >= 3 || reason.contains("handed");
        assert!(poisoned || nobody || enough, "{job} fails for no good reason: {reason} ({attempts} attempts)");
        self.summary.failed += 1;
    }

    /// A task of a job is done: its stage may be, too, and then the job.
    fn progress(&mut self, job: JobId, task: TaskId) {
        let state = self.jobs.get_mut(&job).expect("results are accepted for jobs that are not over");
        assert!(state.open.remove(&task));
        if !state.open.is_empty() {
            return;
        }
        state.stage += 1;
        if state.stage == state.stages.len() {
            self.jobs.remove(&job);
            self.summary.succeeded += 1;
            self.at(self.now_ms, Coming::Message(None, Event::JobFinished(job)));
        } else {
            self.announce(job, self.now_ms);
        }
    }
}
