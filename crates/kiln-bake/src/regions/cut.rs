//! What is wrong with a box, and where to cut it.

use super::{
    mixture::{Mixture, room_counts},
    profile::{Layer, Profile, Span},
    rooms::LEAST_ROOM,
    voxels::Voxels,
};

/// What a box must be for one model to describe the space in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Demands {
    /// Longest edge, cells.
    pub(super) edge: usize,
    /// Least part of the volume that is free, of small boxes and of the largest: little is wasted in what is small.
    fill: [f64; 2],
    /// How open its narrowest place must be, beside what is wide on both sides of it: a door is narrow, the end of a room is
    /// not, nor is what stands in a room.
    width: f64,
    /// The greatest part of the free cells that may not be connected with the rest inside the box.
    apart: f64,
    /// The greatest part of them that may be of other rooms than most.
    strange: f64,
}

impl Demands {
    /// Of a box that is to be.
    pub(super) const fn usual(edge: usize) -> Self {
        Self { edge, fill: [0.5, 0.75], width: 0.5, apart: 0.1, strange: 0.35 }
    }

    /// Of a box that something small is added to, which is no room.
    pub(super) const fn lax(edge: usize) -> Self {
        Self { edge, fill: [0.35, 0.6], width: 0.2, apart: 0.2, strange: 0.35 }
    }

    /// Least part of a box's volume that is free.
    pub(super) fn fill(&self, span: &Span) -> f64 {
        let [small, large] = self.fill;
        small + (large - small) * (libm::cbrt(span.volume() as f64) / self.edge as f64).min(1.0)
    }
}

/// Free cells without which nothing is a box of its own, if it can be helped.
pub(super) const LEAST_PART: usize = 64;

/// How far a box is from what is demanded: 0 if it is as it should be.
pub(super) fn defect(voxels: &Voxels, profile: &Profile, demands: &Demands) -> f64 {
    let over = (0..3).map(|axis| profile.span.extent(axis)).max().unwrap_or(0) as f64 / demands.edge as f64;
    let fill = profile.free as f64 / profile.span.volume().max(1) as f64;
    let width = profile.layers.iter().map(|layers| width(layers)).fold(1.0, f64::min);
    let short = |value: f64, least: f64| (1.0 - value / least).max(0.0);
    let defect = (over - 1.0).max(0.0) + short(fill, demands.fill(&profile.span)) + short(width, demands.width);
    // The costliest question last.
    let is_bad = || is_mixed(voxels, profile, demands) || apart(voxels, profile) > demands.apart;
    if defect == 0.0 && is_bad() { 0.5 } else { defect }
}

/// The narrowest place between two layers, as part of the smaller of the widest layers on its sides.
fn width(layers: &[Layer]) -> f64 {
    let mut after = vec![(0, 0); layers.len() + 1];
    for (index, layer) in layers.iter().enumerate().rev() {
        let (widest, sum) = after[index + 1];
        after[index] = (layer.free.max(widest), layer.free + sum);
    }
    let (mut widest, mut sum, mut narrowest) = (0, 0, 1.0f64);
    for (layer, (widest_after, sum_after)) in layers.iter().zip(&after[1..]) {
        (widest, sum) = (layer.free.max(widest), layer.free + sum);
        if sum >= LEAST_PART && *sum_after >= LEAST_PART {
            narrowest = narrowest.min(layer.open as f64 / widest.min(*widest_after) as f64);
        }
    }
    narrowest
}

/// Whether a box holds most of a room that it is not for, or is for no room in particular.
fn is_mixed(voxels: &Voxels, profile: &Profile, demands: &Demands) -> bool {
    let mut rooms = room_counts(voxels, &profile.span);
    let Some((largest, _)) = rooms.pop() else { return false };
    let holds_another = rooms.iter().any(|(count, room)| {
        let size = voxels.rooms.sizes.get(*room as usize).copied().unwrap_or(usize::MAX);
        size >= LEAST_ROOM && *count > size / 2
    });
    holds_another || (profile.free - largest) as f64 > demands.strange * profile.free as f64
}

/// The part of the free cells of a box that is not connected, inside it, with the most of them.
fn apart(voxels: &Voxels, profile: &Profile) -> f64 {
    let span = &profile.span;
    let local = |index: usize| {
        let cell = voxels.grid.coordinates(index);
        let is_in = (0..3).all(|axis| (span.min[axis]..span.max[axis]).contains(&cell[axis]));
        is_in.then(|| {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|axis| cell[axis] - span.min[axis]);
            x + span.extent(0) * (y + span.extent(1) * z)
        })
    };
    let mut is_seen = vec![false; span.volume()];
    let mut see = |index: usize| local(index).is_some_and(|place| !std::mem::replace(&mut is_seen[place], true));
    let (mut largest, mut stack) = (0, Vec::new());
    for first in voxels.free_in(span) {
        if !see(first) {
            continue;
        }
        let mut count = 0;
        stack.push(first);
        while let Some(cell) = stack.pop() {
            count += 1;
            voxels.for_neighbours(cell, |next| {
                if see(next) {
                    stack.push(next);
                }
            });
        }
        largest = largest.max(count);
        // The rest cannot be more.
        if 2 * largest >= profile.free {
            break;
        }
    }
    (profile.free - largest) as f64 / profile.free.max(1) as f64
}

/// How much it counts that a cut parts rooms, beside the open area and the volume that are counted as parts of the whole.
const ROOMS: f64 = 4.0;

/// The two parts into which a box is best cut, each the box around its free cells. `None` if it has no two parts.
///
/// The best cut goes through the least open area, parts evenly (normalised cuts: Shi and Malik 2000), leaves the least volume in
/// its parts' boxes, and leaves rooms the least mixed. A box that is too long is cut across an edge that is, so that no more parts
/// come of it than must.
pub(super) fn best_cut(voxels: &Voxels, profile: &Profile, demands: &Demands) -> Option<[Span; 2]> {
    let pieces = |axis: usize, span: &Span| span.extent(axis).div_ceil(demands.edge);
    let whole = [0, 1, 2].map(|axis| pieces(axis, &profile.span));
    let is_too_long = whole.iter().any(|pieces| *pieces > 1);
    let least = if is_too_long { 1 } else { LEAST_PART };
    // What is too long is of many rooms; where they are counts when it is not.
    let mixture = if is_too_long { None } else { Mixture::of(voxels, profile) };
    let costs = (0..3).flat_map(|axis| {
        let mixed: Option<Vec<f64>> = mixture.as_ref().map(|mixture| mixture.left(axis).collect());
        cuts(profile, axis, least).map(move |(layer, cost, parts)| {
            let after: usize = parts.iter().map(|part| pieces(axis, part)).sum();
            let more = if is_too_long { after.saturating_sub(whole[axis]) as f64 } else { 0.0 };
            (cost + more + mixed.as_ref().map_or(0.0, |mixed| ROOMS * mixed[layer]), parts)
        })
    });
    costs.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, parts)| parts)
}

/// Layer, cost and parts of each cut across an axis that leaves enough on both sides.
fn cuts(profile: &Profile, axis: usize, least: usize) -> impl Iterator<Item = (usize, f64, [Span; 2])> + use<> {
    let layers = &profile.layers[axis];
    let mut after = vec![Span::EMPTY; layers.len() + 1];
    for (index, layer) in layers.iter().enumerate().rev() {
        after[index] = after[index + 1].around(&layer.bounds);
    }
    let volume = profile.span.volume() as f64;
    let size = libm::pow(profile.free as f64, 2.0 / 3.0);
    let (mut before, mut sum, mut found) = (Span::EMPTY, 0, Vec::new());
    for (index, (layer, after)) in layers.iter().zip(&after[1..]).enumerate() {
        before = before.around(&layer.bounds);
        sum += layer.free;
        if sum < least || profile.free - sum < least {
            continue;
        }
        let part = sum as f64 / profile.free as f64;
        let open = layer.open as f64 / size / (4.0 * part * (1.0 - part));
        let left = (before.volume() + after.volume()) as f64 / volume;
        found.push((index, open + left, [before, *after]));
    }
    found.into_iter()
}
