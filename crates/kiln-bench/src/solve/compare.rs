//! One matrix, all solvers: runs that take turns, and how far the answers are apart.

use super::{
    outcome::{Outcome, Program},
    system_file,
};
use crate::{BenchError, spread::Spread};
use kiln_solve::ComponentSystem;
use serde::Serialize;
use std::path::PathBuf;

/// The solvers of a comparison and how often each runs.
pub(super) struct Contest {
    pub(super) kiln: Program,
    pub(super) peers: Vec<Peer>,
    pub(super) rounds: usize,
    /// Where systems and answers are put.
    pub(super) folder: PathBuf,
}

/// A direct solver.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    pub(super) program: Program,
    /// Rounds it takes part in: the first so many.
    pub(super) rounds: usize,
}

/// All that was found about one matrix.
#[derive(Debug, Serialize)]
pub(super) struct CaseResult {
    pub(super) name: String,
    pub(super) alpha: f64,
    pub(super) unknowns: usize,
    pub(super) entries: usize,
    pub(super) columns: usize,
    pub(super) components: usize,
    pub(super) largest: usize,
    /// Kiln first.
    pub(super) solvers: Vec<SolverResult>,
}

/// One solver on one matrix.
#[derive(Debug, Serialize)]
pub(super) struct SolverResult {
    /// By round.
    pub(super) outcomes: Vec<Outcome>,
    /// Greatest `|r_i| / A_ii`, formed in f64 here.
    pub(super) residual: f64,
    /// Greatest difference to the first direct solver.
    pub(super) off_direct: Option<f64>,
    /// Kiln's CPU seconds over this solver's, round by round.
    pub(super) kiln_cpu_ratio: Option<Spread>,
    /// Kiln's peak memory over this solver's, round by round.
    pub(super) kiln_memory_ratio: Option<Spread>,
}

impl Contest {
    /// Solves one system by all, after a warm-up of Kiln's.
    pub(super) fn hold(
        &self,
        system: &ComponentSystem<'_>,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Vec<SolverResult>, BenchError> {
        let input = self.folder.join("system");
        system_file::write(&input, system)?;
        let answer = |name: &str| self.folder.join(format!("answer-{name}"));
        self.kiln.run(&input, &answer("kiln"))?;
        let mut outcomes: Vec<Vec<Outcome>> = vec![Vec::new(); 1 + self.peers.len()];
        for round in 0..self.rounds {
            progress(&format!("round {} of {}", round + 1, self.rounds));
            outcomes[0].push(self.kiln.run(&input, &answer("kiln"))?);
            for (peer, outcomes) in self.peers.iter().zip(&mut outcomes[1..]).filter(|(peer, _)| round < peer.rounds) {
                outcomes.push(peer.program.run(&input, &answer(peer.program.name))?);
            }
        }
        let names = std::iter::once("kiln").chain(self.peers.iter().map(|peer| peer.program.name));
        let files: Vec<PathBuf> = names.map(answer).collect();
        assess(system, outcomes, &files)
    }
}

fn assess(
    system: &ComponentSystem<'_>,
    outcomes: Vec<Vec<Outcome>>,
    files: &[PathBuf],
) -> Result<Vec<SolverResult>, BenchError> {
    let read = |file: &PathBuf| system_file::read_answer(file, system.rhs.len());
    let direct = files.get(1).map(read).transpose()?;
    let kiln = outcomes[0].clone();
    let assess_one = |(of_solver, file): (Vec<Outcome>, &PathBuf)| {
        let is_peer = file != &files[0];
        let answer = read(file)?;
        let ratio = |of: fn(&Outcome) -> f64| {
            let pairs = kiln.iter().zip(&of_solver).filter(|_| is_peer);
            Spread::of(pairs.map(|(kiln, peer)| of(kiln) / of(peer)))
        };
        Ok(SolverResult {
            residual: residual(system, &answer),
            off_direct: direct.as_ref().map(|direct| greatest_difference(&answer, direct)),
            kiln_cpu_ratio: ratio(|outcome| outcome.cpu_secs),
            kiln_memory_ratio: ratio(|outcome| outcome.peak_kib as f64),
            outcomes: of_solver,
        })
    };
    outcomes.into_iter().zip(files).filter(|(of_solver, _)| !of_solver.is_empty()).map(assess_one).collect()
}

/// Greatest `|r_i| / A_ii`.
fn residual(system: &ComponentSystem<'_>, x: &[f64]) -> f64 {
    let r = system.matrix.residual(system.columns, x, &system.rhs);
    let of_unknown =
        |(i, r): (usize, &[f64])| r.iter().fold(0.0, |worst, r| greater(worst, r.abs() / system.matrix.diagonal(i)));
    r.chunks_exact(system.columns).enumerate().map(of_unknown).fold(0.0, greater)
}

fn greatest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, greater)
}

/// The greater of two, or not a number where one is none.
fn greater(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_a_number_is_the_greatest() {
        assert!(greatest_difference(&[1.0, f64::NAN, 3.0], &[1.0, 2.0, 1.0]).is_nan());
        assert_eq!(greatest_difference(&[1.0, 2.5], &[1.0, 2.0]), 0.5);
    }
}
