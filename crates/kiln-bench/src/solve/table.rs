//! The results as Markdown.

use super::compare::{CaseResult, SolverResult};
use crate::spread::Spread;
use std::fmt::Write;

/// How to come by the peers' columns.
pub(super) const HOW_TO_GET_PEERS: &str = "No --peer: build it by the command at the head of tests/peers/solve.cpp.";

const HEAD: &str = "\
| matrix | α | solver | runs | CPU s | wall s | peak MB | iterations | max residual | max abs(x − x_direct) | Kiln's CPU / its | Kiln's memory / its |
|---|---|---|---|---|---|---|---|---|---|---|---|
";

/// The table of all cases.
pub(super) fn render(cases: &[CaseResult]) -> String {
    let mut text = String::from(HEAD);
    for case in cases {
        for (place, solver) in case.solvers.iter().enumerate() {
            // The first direct solver is what the others are compared with.
            row(&mut text, case, solver, place == 1);
        }
    }
    text.push('\n');
    for case in cases.iter().filter(|case| case.alpha == cases[0].alpha) {
        let CaseResult { name, unknowns, entries, columns, components, largest, .. } = case;
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "- {name}: {unknowns} unknowns in {components} components, the largest of {largest}; {entries} entries \
             of the lower triangle, {columns} right-hand sides."
        );
    }
    text
}

fn row(text: &mut String, case: &CaseResult, solver: &SolverResult, is_reference: bool) {
    let Some(first) = solver.outcomes.first() else { return };
    let cpu = Spread::of(solver.outcomes.iter().map(|outcome| outcome.cpu_secs));
    let wall = Spread::of(solver.outcomes.iter().map(|outcome| outcome.wall_secs));
    let peak = solver.outcomes.iter().map(|outcome| outcome.peak_kib).max().unwrap_or(0);
    let _ = writeln!(
        text,
        "| {} | {} | {} | {} | {} | {} | {} | {} | {:.1e} | {} | {} | {} |",
        case.name,
        case.alpha,
        first.solver,
        solver.outcomes.len(),
        spread(cpu, 2),
        spread(wall, 2),
        peak / 1024,
        first.iterations.map_or_else(String::new, |count| count.to_string()),
        solver.residual,
        solver.off_direct.filter(|_| !is_reference).map_or_else(String::new, |off| format!("{off:.1e}")),
        spread(solver.kiln_cpu_ratio, 3),
        spread(solver.kiln_memory_ratio, 2),
    );
}

/// `median (min–max)`, or nothing.
fn spread(spread: Option<Spread>, digits: usize) -> String {
    spread.map_or_else(String::new, |spread| spread.text(digits))
}
