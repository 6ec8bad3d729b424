//! All components of an instance, on all threads.

use crate::{
    chain::{SolverParams, Workspace, solve_component_in},
    components::Components,
    system::{ComponentAnswer, ComponentSystem},
};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Unknowns of a batch, so that tiny components cost no bookkeeping.
const BATCH: usize = 4096;

/// Components of up to this many unknowns share the room for their system.
const REUSE: usize = 4096;

/// Solves the chosen components, the largest first, and returns the answers by component. The order of work
/// changes no answer.
pub fn solve_all(
    chosen: Vec<usize>,
    components: &Components,
    whole: &ComponentSystem<'_>,
    params: &SolverParams,
) -> Vec<(usize, ComponentAnswer)> {
    let batches = batches(chosen, components);
    let next = AtomicUsize::new(0);
    let work = |_: usize| {
        let (mut answers, mut room, mut part) = (Vec::new(), Workspace::default(), ComponentSystem::default());
        while let Some(batch) = batches.get(next.fetch_add(1, Ordering::Relaxed)) {
            for &c in batch {
                let system = if components.unknowns(c).len() < REUSE {
                    components.part_into(c, whole, &mut part);
                    part.borrowed()
                } else {
                    components.part(c, whole)
                };
                answers.push((c, solve_component_in(&system, params, &mut room)));
            }
        }
        answers
    };
    let workers = (0..rayon::current_num_threads()).into_par_iter().with_max_len(1);
    let mut answers: Vec<_> = workers.flat_map_iter(work).collect();
    answers.sort_unstable_by_key(|(component, _)| *component);
    answers
}

/// Components in runs of some thousand unknowns; the largest first.
fn batches(mut chosen: Vec<usize>, components: &Components) -> Vec<Vec<usize>> {
    let size = |c: &usize| components.unknowns(*c).len();
    chosen.sort_by_key(|c| std::cmp::Reverse(size(c)));
    let mut batches: Vec<Vec<usize>> = Vec::new();
    let mut unknowns = BATCH;
    for component in chosen {
        if unknowns >= BATCH {
            batches.push(Vec::new());
            unknowns = 0;
        }
        unknowns += size(&component);
        if let Some(last) = batches.last_mut() {
            last.push(component);
        }
    }
    batches
}
