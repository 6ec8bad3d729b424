//! One solve of a system file by Kiln, in a process of its own: what `kiln bench solve` starts again and again.

use super::{outcome::Outcome, system_file};
use crate::{BenchError, clock::Stopwatch, memory::status_kib};
use kiln_core::ComponentMethod;
use kiln_solve::{ComponentAnswer, ComponentSystem, SolverParams, components::Components, parallel::solve_all};
use std::{collections::BTreeMap, path::Path};

/// Solves, writes the answer, and tells what it took. Time is that of everything from the matrix to the answer:
/// parting the components, solving and certifying them.
pub(super) fn run(system: &Path, answer: &Path) -> Result<Outcome, BenchError> {
    let whole = system_file::read(system)?;
    let input_kib = status_kib("VmRSS:");
    let watch = Stopwatch::start();
    let (x, answers) = solve(&whole);
    let cost = watch.read();
    let mut methods: BTreeMap<ComponentMethod, u64> = BTreeMap::new();
    answers.iter().for_each(|(_, answer)| *methods.entry(answer.method).or_default() += 1);
    let outcome = Outcome {
        solver: "Kiln".to_owned(),
        cpu_secs: cost.cpu_secs,
        wall_secs: cost.wall_secs,
        input_kib,
        peak_kib: status_kib("VmHWM:"),
        factor_entries: None,
        iterations: answers.iter().map(|(_, answer)| answer.iterations).max(),
        methods: methods.into_iter().collect(),
    };
    system_file::write_answer(answer, &x)?;
    Ok(outcome)
}

/// The answer of a whole system, and what each component's was.
fn solve(whole: &ComponentSystem<'_>) -> (Vec<f64>, Vec<(usize, ComponentAnswer)>) {
    let components = Components::of_matrix(&whole.matrix);
    let all = (0..components.count()).collect();
    let answers = solve_all(all, &components, whole, &SolverParams::default());
    let mut x = vec![0.0; whole.rhs.len()];
    for (component, answer) in &answers {
        let corrections = answer.correction.chunks_exact(whole.columns);
        for (unknown, correction) in components.unknowns(*component).iter().zip(corrections) {
            x[*unknown as usize * whole.columns..][..whole.columns].copy_from_slice(correction);
        }
    }
    (x, answers)
}
