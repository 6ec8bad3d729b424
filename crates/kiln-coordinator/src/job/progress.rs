//! How far a job is, counted for each kind of task.

use kiln_core::TaskKind;
use kiln_proto::v1;
use std::collections::BTreeMap;

/// What a run of a task took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Effort {
    pub(crate) seconds: f64,
    pub(crate) cpu_seconds: f64,
    pub(crate) rays: u64,
    pub(crate) parts: Parts,
}

/// Time of parts of tasks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Parts {
    pub(crate) loading: v1::PartTime,
    pub(crate) building: v1::PartTime,
    pub(crate) tracing: v1::PartTime,
}

impl Parts {
    fn add(&mut self, other: &Self) {
        let add = |sum: &mut v1::PartTime, part: &v1::PartTime| {
            sum.seconds += part.seconds;
            sum.cpu_seconds += part.cpu_seconds;
        };
        add(&mut self.loading, &other.loading);
        add(&mut self.building, &other.building);
        add(&mut self.tracing, &other.tracing);
    }
}

/// Progress of one kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Stage {
    pub(crate) total: u64,
    pub(crate) done: u64,
    pub(crate) cache_hits: u64,
    pub(crate) rays_total: u64,
    pub(crate) rays_done: u64,
    rays_traced: u64,
    /// Rays of leases under way, by lease.
    rays_under_way: BTreeMap<u64, u64>,
    began_ms: Option<u64>,
    last_ms: u64,
    task_seconds: f64,
    cpu_seconds: f64,
    parts: Parts,
    retries: u64,
    /// Changed since it was last told.
    dirty: bool,
}

/// Progress of a job.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Progress {
    stages: BTreeMap<TaskKind, Stage>,
}

impl Progress {
    fn stage(&mut self, kind: TaskKind) -> &mut Stage {
        let stage = self.stages.entry(kind).or_default();
        stage.dirty = true;
        stage
    }

    /// A task is known to be needed, with the rays it may take.
    pub(crate) fn planned(&mut self, kind: TaskKind, rays: u64) {
        let stage = self.stage(kind);
        stage.total += 1;
        stage.rays_total += rays;
    }

    /// A task's result was there already.
    pub(crate) fn hit(&mut self, kind: TaskKind, rays: u64) {
        let stage = self.stage(kind);
        stage.done += 1;
        stage.cache_hits += 1;
        stage.rays_done += rays;
    }

    /// A task was leased.
    pub(crate) fn began(&mut self, kind: TaskKind, now_ms: u64) {
        self.stage(kind).began_ms.get_or_insert(now_ms);
    }

    /// A task was run to a result.
    pub(crate) fn ran(&mut self, kind: TaskKind, rays: u64, effort: Effort, now_ms: u64) {
        let stage = self.stage(kind);
        stage.done += 1;
        stage.rays_done += rays;
        stage.rays_traced += effort.rays;
        stage.task_seconds += effort.seconds;
        stage.cpu_seconds += effort.cpu_seconds;
        stage.parts.add(&effort.parts);
        stage.last_ms = now_ms;
    }

    /// A lease has come so far; 0 rays when it is over.
    pub(crate) fn under_way(&mut self, kind: TaskKind, lease: u64, rays: u64) {
        let stage = self.stage(kind);
        if rays == 0 {
            stage.rays_under_way.remove(&lease);
        } else {
            stage.rays_under_way.insert(lease, rays);
        }
    }

    /// An attempt failed and is made again.
    pub(crate) fn retried(&mut self, kind: TaskKind) {
        self.stage(kind).retries += 1;
    }

    /// Every task of the kind was answered at once.
    pub(crate) fn answered(&mut self, kind: TaskKind, tasks: u64, rays: u64) {
        let stage = self.stage(kind);
        *stage = Stage {
            total: tasks,
            done: tasks,
            cache_hits: tasks,
            rays_total: rays,
            rays_done: rays,
            dirty: true,
            ..Stage::default()
        };
    }

    /// Tasks and rays of each kind.
    pub(crate) fn totals(&self) -> Vec<(TaskKind, u64, u64)> {
        self.stages.iter().map(|(&kind, stage)| (kind, stage.total, stage.rays_total)).collect()
    }

    /// All stages that have begun, in the order of the data path.
    pub(crate) fn stages(&self) -> Vec<v1::StageProgress> {
        self.stages.iter().map(|(&kind, stage)| stage.shown(kind)).collect()
    }

    /// The stages that changed since the last call.
    pub(crate) fn take_changed(&mut self) -> Vec<v1::StageProgress> {
        let changed = self.stages.iter_mut().filter(|(_, stage)| stage.dirty);
        let shown = changed.map(|(&kind, stage)| {
            stage.dirty = false;
            stage.shown(kind)
        });
        shown.collect()
    }
}

impl Stage {
    fn shown(&self, kind: TaskKind) -> v1::StageProgress {
        let seconds = self.began_ms.map_or(0.0, |began| self.last_ms.saturating_sub(began) as f64 / 1000.0);
        v1::StageProgress {
            kind: v1::TaskKind::from(kind).into(),
            total: self.total,
            done: self.done,
            cache_hits: self.cache_hits,
            rays_total: self.rays_total,
            rays_done: self.rays_done,
            seconds,
            task_seconds: self.task_seconds,
            cpu_seconds: self.cpu_seconds,
            retries: self.retries,
            rays_traced: self.rays_traced + self.rays_under_way.values().sum::<u64>(),
            loading: Some(self.parts.loading),
            building: Some(self.parts.building),
            tracing: Some(self.parts.tracing),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_hits_and_runs_apart() {
        let mut progress = Progress::default();
        for rays in [100, 200, 300] {
            progress.planned(TaskKind::Trace, rays);
        }
        progress.hit(TaskKind::Trace, 100);
        progress.began(TaskKind::Trace, 1000);
        progress.under_way(TaskKind::Trace, 1, 50);
        assert_eq!(progress.stages()[0].rays_traced, 50);
        progress.under_way(TaskKind::Trace, 1, 0);
        let tracing = v1::PartTime { seconds: 0.4, cpu_seconds: 0.3 };
        let parts = Parts { tracing, ..Parts::default() };
        let effort = Effort { seconds: 0.5, cpu_seconds: 0.4, rays: 150, parts };
        progress.ran(TaskKind::Trace, 200, effort, 3500);
        let stage = &progress.take_changed()[0];
        assert_eq!((stage.total, stage.done, stage.cache_hits), (3, 2, 1));
        assert_eq!((stage.rays_total, stage.rays_done, stage.rays_traced), (600, 300, 150));
        assert_eq!((stage.seconds, stage.task_seconds), (2.5, 0.5));
        assert_eq!((stage.tracing, stage.building), (Some(tracing), Some(v1::PartTime::default())));
        assert!(progress.take_changed().is_empty());
    }
}
