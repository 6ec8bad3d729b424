//! Why a job is not running.

use crate::{
    Requirements, Scheduler,
    job::Class,
    worker::{Worker, lacking},
};
use kiln_core::{JobId, TaskKind};
use std::{collections::BTreeSet, fmt};

/// Why a job is not running, or that it is.
#[derive(Clone, Debug, PartialEq)]
pub enum Explanation {
    /// No such job, or it is over.
    Unknown,
    /// Paused by request.
    Paused {
        /// Leases that still run.
        leases: usize,
    },
    /// Tasks are out.
    Running {
        /// Leases.
        leases: usize,
        /// Tasks in them.
        tasks: usize,
        /// Tasks that wait.
        waiting: usize,
    },
    /// Nothing is ready: the coordinator is at work on it, or it is done.
    NothingReady,
    /// No worker is connected.
    NoWorkers,
    /// Workers are connected, and none could ever run a waiting task.
    NoWorkerFits {
        /// The kind of task.
        kind: TaskKind,
        /// What it asks for.
        needs: Requirements,
        /// What each group of like workers lacks.
        lacking: Vec<String>,
    },
    /// The workers that fit are set aside, drain, or wait after failures.
    WorkersUnavailable {
        /// How many would fit.
        workers: usize,
    },
    /// The job's limit of leases is reached.
    JobLimit {
        /// The limit.
        max_leases: usize,
    },
    /// The tenant's limit of leases is reached.
    TenantLimit {
        /// The tenant.
        tenant: String,
        /// The limit.
        max_leases: usize,
    },
    /// Tasks wait before they are tried again.
    Delayed {
        /// When the first is tried.
        until_ms: u64,
    },
    /// Every worker that fits is busy with work that goes first.
    Waiting {
        /// Jobs with waiting tasks that go first.
        jobs_ahead: usize,
        /// Workers that fit.
        workers: usize,
    },
}

impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => write!(f, "there is no such job, or it is over"),
            Self::Paused { leases: 0 } => write!(f, "it is paused"),
            Self::Paused { leases } => write!(f, "it is paused; {leases} leases still run"),
            Self::Running { leases, tasks, waiting } => {
                write!(f, "it is running: {tasks} tasks in {leases} leases, {waiting} tasks wait")
            }
            Self::NothingReady => write!(f, "no task is ready to be run"),
            Self::NoWorkers => write!(f, "no worker is connected; start one with kiln worker"),
            Self::NoWorkerFits { kind, needs, lacking } => {
                write!(f, "no worker can run its {} tasks", kind.name())?;
                if let Some(lane) = &needs.lane {
                    write!(f, " in the lane {lane}")?;
                }
                write!(f, ": {}", lacking.join("; "))
            }
            Self::WorkersUnavailable { workers } => write!(
                f,
                "{workers} workers could run it, but they are disconnected, draining, set aside, or rest after failures"
            ),
            Self::JobLimit { max_leases } => write!(f, "it has as many leases as it may: {max_leases}"),
            Self::TenantLimit { tenant, max_leases } => {
                write!(f, "the tenant {tenant} has as many leases as it may: {max_leases}")
            }
            Self::Delayed { until_ms: _ } => write!(f, "its tasks wait a little before they are tried again"),
            Self::Waiting { jobs_ahead, workers } => {
                write!(f, "the {workers} workers that fit are busy; {jobs_ahead} other jobs go first")
            }
        }
    }
}

impl Scheduler {
    /// Why a job is not running, or that it is.
    pub fn explain(&self, job: JobId) -> Explanation {
        let Some(job) = self.jobs.get(&job) else { return Explanation::Unknown };
        let leases = job.leases.len();
        if job.paused {
            return Explanation::Paused { leases };
        }
        if leases > 0 {
            let held = job.leases.iter().filter_map(|lease| self.leases.get(lease));
            return Explanation::Running { leases, tasks: held.map(|l| l.tasks.len()).sum(), waiting: job.waiting };
        }
        let waiting: Vec<_> = job.classes.iter().filter(|class| class.waiting() > 0).collect();
        if waiting.is_empty() {
            let delayed = self.delayed.iter().find(|(_, task)| job.tasks.contains(task));
            return delayed.map_or(Explanation::NothingReady, |&(until_ms, _)| Explanation::Delayed { until_ms });
        }
        if self.workers.all.is_empty() {
            return Explanation::NoWorkers;
        }
        let unfit = waiting.iter().find(|class| self.workers.fitting(&class.key).next().is_none());
        if let Some(class) = unfit {
            return self.no_fit(class);
        }
        let limits = self.limits(job);
        if job.spec.max_leases.is_some_and(|max| leases >= max) {
            return Explanation::JobLimit { max_leases: job.spec.max_leases.unwrap_or(0) };
        }
        if self.tenant_leases(job) >= limits.max_leases {
            return Explanation::TenantLimit { tenant: job.spec.tenant.clone(), max_leases: limits.max_leases };
        }
        let fitting = || waiting.iter().flat_map(|class| self.workers.fitting(&class.key));
        let count = |keep: &dyn Fn(&Worker) -> bool| {
            let workers = fitting().filter(|(_, worker)| keep(worker)).map(|(id, _)| id);
            workers.collect::<BTreeSet<_>>().len()
        };
        let workers = count(&|worker| worker.is_available() && worker.rests_until_ms <= self.now_ms);
        if workers == 0 {
            return Explanation::WorkersUnavailable { workers: count(&|_| true) };
        }
        Explanation::Waiting { jobs_ahead: self.jobs_ahead(job), workers }
    }

    /// What each group of workers lacks for a class.
    pub(crate) fn no_fit(&self, class: &Class) -> Explanation {
        let lacks = self.workers.groups.values().map(|group| {
            let lack = lacking(&group.capabilities, class.key.kind, &class.key.needs);
            let lack = lack.unwrap_or_else(|| "fits, but is set aside or drains".to_owned());
            match group.members.len() {
                1 => format!("1 worker {lack}"),
                workers => format!("of {workers} workers each {lack}"),
            }
        });
        let lacking = lacks.collect();
        Explanation::NoWorkerFits { kind: class.key.kind, needs: class.key.needs.clone(), lacking }
    }
}
