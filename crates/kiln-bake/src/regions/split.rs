//! Free cells to boxes, from the top down: the worst box is cut first, so that a limit on their number costs least.

use super::{
    cut::{Demands, best_cut, defect},
    profile::{Profile, Span},
    voxels::Voxels,
};
use std::collections::BinaryHeap;

/// Boxes that hold all free cells, and how many of them are not as they should be.
#[derive(Debug)]
pub(super) struct Parts {
    pub(super) boxes: Vec<Span>,
    pub(super) unfinished: u64,
}

/// A box that should be cut, the worst first. A positive number's bits are in its order.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Bad {
    weight: u64,
    span: Span,
    parts: [Span; 2],
}

/// Parts all free cells into boxes no longer than `edge` cells, no more than `most`, in the order of their least corners.
pub(super) fn split(voxels: &Voxels, edge: usize, most: usize) -> Parts {
    let whole = Span { min: [0; 3], max: voxels.grid.size };
    let demands = Demands::usual(edge);
    let (mut boxes, mut bad) = (Vec::new(), BinaryHeap::new());
    let mut sort = |span: Span, bad: &mut BinaryHeap<Bad>| {
        let profile = Profile::of(voxels, span);
        let defect = defect(voxels, &profile, &demands);
        let parts = if defect > 0.0 { best_cut(voxels, &profile, &demands) } else { None };
        match parts {
            Some(parts) => bad.push(Bad { weight: (defect * profile.free as f64).to_bits(), span, parts }),
            None => boxes.push(span),
        }
        boxes.len()
    };
    let mut done = sort(Profile::of(voxels, whole).tight(), &mut bad);
    while done + bad.len() < most {
        let Some(worst) = bad.pop() else { break };
        for part in worst.parts {
            done = sort(part, &mut bad);
        }
    }
    let unfinished = bad.len() as u64;
    boxes.extend(bad.into_iter().map(|bad| bad.span));
    boxes.sort_unstable();
    Parts { boxes, unfinished }
}
