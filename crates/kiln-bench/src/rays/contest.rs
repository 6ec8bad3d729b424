//! One scene, all tracers: runs that take turns, so that what slows the machine for a while slows all of them.

use super::{
    agree::Agreement,
    case::Case,
    files::{self, FileHit, Paths},
    lap::{Course, Lap, Mode, all_hits},
    peer::{LAPS_PER_START, Peer, PeerBuild},
};
use crate::{BenchError, spread::Spread};
use kiln_trace::Tracer;
use rayon::ThreadPool;
use serde::Serialize;
use std::path::Path;

/// What is run on each scene, and how often.
pub(super) struct Plan {
    pub(super) threads: Vec<usize>,
    pub(super) reps: usize,
    pub(super) stride: usize,
    pub(super) gather: Vec<u32>,
    pub(super) peers: Vec<Peer>,
    /// Rays are traced on the CPU, in small calls that share the threads.
    pub(super) is_cpu: bool,
}

/// One tracer in one mode on so many threads.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Row {
    pub(super) tracer: String,
    pub(super) threads: usize,
    pub(super) mode: String,
    /// By repetition.
    pub(super) laps: Vec<Lap>,
}

/// How Kiln's rate compares with a peer's, by repetition.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Ratios {
    pub(super) cpu: Spread,
    pub(super) wall: Spread,
}

/// A peer's builds on so many threads, by repetition.
#[derive(Clone, Debug, Serialize)]
pub(super) struct PeerBuilds {
    pub(super) tracer: &'static str,
    pub(super) threads: usize,
    pub(super) builds: Vec<PeerBuild>,
}

/// What was found on one scene.
#[derive(Debug, Default, Serialize)]
pub(super) struct Standings {
    /// Kiln's rows come first in each number of threads.
    pub(super) rows: Vec<Row>,
    pub(super) peer_builds: Vec<PeerBuilds>,
    pub(super) agreements: Vec<Agreement>,
}

/// What Kiln's rows call it.
pub(super) const KILN: &str = "Kiln";

impl Plan {
    /// Runs everything on a scene. `paths` has it flattened, for the peers; `folder` is for their hits.
    pub(super) fn hold(
        &self,
        case: &Case,
        tracer: &dyn Tracer,
        paths: &Paths,
        folder: &Path,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Standings, BenchError> {
        let course = Course::new(tracer, case, self.stride, self.is_cpu);
        let pools: Vec<ThreadPool> =
            self.threads.iter().map(|threads| super::pool(*threads)).collect::<Result<_, _>>()?;
        let mut standings = Standings::default();
        if !self.peers.is_empty() {
            progress("agreement");
            standings.agreements = self.agree(case, tracer, paths, &folder.join("hits"))?;
        }
        for rep in 0..self.reps {
            for pool in &pools {
                let threads = pool.current_num_threads();
                progress(&format!("repetition {} of {}, {threads} threads", rep + 1, self.reps));
                standings.add_kiln(&course, pool, &[Mode::Closest, Mode::Any])?;
                for peer in &self.peers {
                    let run = peer.run(paths, self.stride, threads, None)?;
                    standings.add_build(peer.name(), threads, run.build);
                    run.laps.into_iter().for_each(|lap| standings.add(peer.name(), threads, lap));
                }
                let gather: Vec<Mode> = self.gather.iter().map(|rays| Mode::Gather(*rays)).collect();
                standings.add_kiln(&course, pool, &gather)?;
            }
        }
        standings.rows.sort_by_key(|row| row.threads);
        Ok(standings)
    }

    fn agree(
        &self,
        case: &Case,
        tracer: &dyn Tracer,
        paths: &Paths,
        file: &Path,
    ) -> Result<Vec<Agreement>, BenchError> {
        let (kiln, mesh) = (hits(case, tracer)?, case.flat_mesh());
        let compare = |peer: &Peer| {
            // Its rates are of no interest here: one run of points will do.
            peer.run(paths, case.rays.origins.len(), 1, Some(file))?;
            let found = files::read_hits(file, kiln.len())?;
            Ok(Agreement::of(peer.name(), &case.rays, &mesh, &kiln, &found))
        };
        self.peers.iter().map(compare).collect()
    }
}

/// The closest hits of all rays, by the triangles of the flattened scene.
pub(super) fn hits(case: &Case, tracer: &dyn Tracer) -> Result<Vec<FileHit>, BenchError> {
    Ok(case.flat_hits(&all_hits(tracer, &case.rays)?))
}

impl Standings {
    fn add_kiln(&mut self, course: &Course<'_>, pool: &ThreadPool, modes: &[Mode]) -> Result<(), BenchError> {
        for mode in modes {
            let mut best = course.run(*mode, pool)?;
            for _ in 1..LAPS_PER_START {
                best.keep_best(&course.run(*mode, pool)?);
            }
            self.add(KILN, pool.current_num_threads(), best);
        }
        Ok(())
    }

    fn add(&mut self, tracer: &str, threads: usize, lap: Lap) {
        let is_same = |row: &&mut Row| row.tracer == tracer && row.threads == threads && row.mode == lap.mode;
        match self.rows.iter_mut().find(is_same) {
            Some(row) => row.laps.push(lap),
            None => {
                let mode = lap.mode.clone();
                self.rows.push(Row { tracer: tracer.to_owned(), threads, mode, laps: vec![lap] });
            }
        }
    }

    fn add_build(&mut self, tracer: &'static str, threads: usize, build: PeerBuild) {
        match self.peer_builds.iter_mut().find(|of| of.tracer == tracer && of.threads == threads) {
            Some(of) => of.builds.push(build),
            None => self.peer_builds.push(PeerBuilds { tracer, threads, builds: vec![build] }),
        }
    }

    /// Kiln's rate over a peer's in the same repetition; none for what the other does not do.
    pub(super) fn ratios(&self, row: &Row) -> Option<Ratios> {
        let mode = match row.mode.as_str() {
            mode if row.tracer == KILN || mode.is_empty() => return None,
            mode if mode.starts_with("closest") => Mode::Closest,
            mode if mode.starts_with("occluded") => Mode::Any,
            _ => return None,
        };
        let is_mine = |of: &&Row| of.tracer == KILN && of.threads == row.threads && of.mode == mode.name();
        let kiln = self.rows.iter().find(is_mine)?;
        let ratio = |rate: fn(&Lap) -> f64| {
            Spread::of(kiln.laps.iter().zip(&row.laps).map(|(kiln, peer)| rate(kiln) / rate(peer)))
        };
        Some(Ratios { cpu: ratio(|lap| lap.mrays_per_cpu_second)?, wall: ratio(|lap| lap.mrays_per_wall_second)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lap(mode: &str, cpu: f64) -> Lap {
        let (hit_fraction, mean_t) = (None, None);
        let mode = mode.to_owned();
        Lap { mode, rays: 1, hit_fraction, mean_t, mrays_per_cpu_second: cpu, mrays_per_wall_second: 0.5 * cpu }
    }

    #[test]
    fn ratios_are_by_repetition() {
        let mut standings = Standings::default();
        for (kiln, peer) in [(2.0, 1.0), (3.0, 3.0), (1.0, 2.0)] {
            standings.add(KILN, 1, lap("closest", kiln));
            standings.add("Embree", 1, lap("closest8", peer));
            standings.add("Embree", 2, lap("closest8", peer));
        }
        let ratios = standings.ratios(&standings.rows[1]).unwrap();
        assert_eq!(ratios.cpu, Spread { median: 1.0, min: 0.5, max: 2.0 });
        assert_eq!(ratios.wall, ratios.cpu);
        assert_eq!(standings.ratios(&standings.rows[0]), None, "Kiln is not compared with itself");
        assert_eq!(standings.ratios(&standings.rows[2]), None, "nor with another number of threads");
    }
}
