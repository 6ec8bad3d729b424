//! Totals of the farm, and what dashboards are sent.

use super::{
    Dispatcher,
    bakes::{brief, view},
};
use crate::job::{Effort, Phase};
use kiln_core::TaskKind;
use kiln_proto::v1;
use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
    time::{Duration, Instant},
};

/// How long an ended bake is shown to those who watch the farm.
const SHOWN: Duration = Duration::from_secs(10);

/// Totals since the coordinator's start.
#[derive(Debug, Default)]
pub(super) struct Totals {
    kinds: BTreeMap<TaskKind, v1::KindStats>,
    bakes_ended: u64,
    lately: VecDeque<(Instant, v1::Bake)>,
}

impl Totals {
    fn kind(&mut self, kind: TaskKind) -> &mut v1::KindStats {
        let stats = self.kinds.entry(kind).or_default();
        stats.kind = v1::TaskKind::from(kind).into();
        stats
    }

    pub(super) fn hits(&mut self, kind: TaskKind, tasks: u64) {
        self.kind(kind).cache_hits += tasks;
    }

    pub(super) fn ran(&mut self, kind: TaskKind, effort: Effort) {
        let stats = self.kind(kind);
        stats.run += 1;
        stats.rays += effort.rays;
        stats.task_seconds += effort.seconds;
        stats.cpu_seconds += effort.cpu_seconds;
    }

    pub(super) fn failed(&mut self, kind: TaskKind) {
        self.kind(kind).failed += 1;
    }

    pub(super) fn ended(&mut self, bake: v1::Bake) {
        self.bakes_ended += 1;
        self.lately.push_back((Instant::now(), brief(bake)));
        while self.lately.front().is_some_and(|(at, _)| at.elapsed() > SHOWN) {
            self.lately.pop_front();
        }
    }
}

impl Dispatcher {
    pub(super) fn stats(&self) -> v1::FarmStats {
        let (workers, cores, leases) = self.registry.connected();
        let active = self.jobs.values().filter(|job| !matches!(job.phase, Phase::Ended(_)));
        v1::FarmStats {
            workers,
            cores,
            bakes_active: active.count() as u64,
            bakes_ended: self.totals.bakes_ended,
            tasks_open: self.flights.len() as u64,
            leases,
            kinds: self.totals.kinds.values().copied().collect(),
            uptime_ms: self.now_ms(),
        }
    }

    /// Sends the farm's state to those who watch it.
    pub(super) fn publish_farm(&mut self) {
        // The handle keeps one receiver of its own.
        if self.farm.receiver_count() <= 1 {
            return;
        }
        let active = self.jobs.values().filter(|job| !matches!(job.phase, Phase::Ended(_))).map(|job| brief(view(job)));
        let lately = self.totals.lately.iter().filter(|(at, _)| at.elapsed() <= SHOWN).map(|(_, bake)| bake.clone());
        let next = v1::WatchFarmResponse {
            number: self.farm.borrow().number + 1,
            stats: Some(self.stats()),
            workers: self.registry.shown(self.now_ms()),
            bakes: active.chain(lately).collect(),
        };
        self.farm.send_replace(Arc::new(next));
    }
}
