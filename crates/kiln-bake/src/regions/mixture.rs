//! How rooms are mixed in a box, and how well cuts part them.

use super::{
    profile::{Profile, Span},
    rooms::LEAST_ROOM,
    voxels::Voxels,
};
use std::collections::BTreeMap;

/// Rooms that are told from each other and from the rest, those with the most cells.
const TOLD: usize = 4;

/// What counts as a room's: fewer of its cells are what a box has caught at the border.
const LEAST_SHARE: usize = LEAST_ROOM / 4;

/// Cells of the largest rooms, and of all others.
type Counts = [usize; TOLD + 1];

/// Cells of each room in each layer of a box across each axis.
pub(super) struct Mixture {
    layers: [Vec<Counts>; 3],
    all: Counts,
}

impl Mixture {
    /// `None` if all is one room, but for what is caught at the border.
    pub(super) fn of(voxels: &Voxels, profile: &Profile) -> Option<Self> {
        let rooms = room_counts(voxels, &profile.span);
        if rooms.iter().rev().nth(1).is_none_or(|(count, _)| *count < LEAST_SHARE) {
            return None;
        }
        let told: Vec<u32> = rooms.iter().rev().take(TOLD).map(|(_, room)| *room).collect();
        let layers = std::array::from_fn(|axis| vec![Counts::default(); profile.span.extent(axis)]);
        let mut mixture = Self { layers, all: Counts::default() };
        for index in voxels.free_in(&profile.span) {
            let room = told.iter().position(|told| *told == voxels.room(index)).unwrap_or(TOLD);
            let cell = voxels.grid.coordinates(index);
            for (axis, layers) in mixture.layers.iter_mut().enumerate() {
                layers[cell[axis] - profile.span.min[axis]][room] += 1;
            }
            mixture.all[room] += 1;
        }
        Some(mixture)
    }

    /// What is left of the mixture after a cut behind each layer across an axis: 1 if nothing is parted, 0 if all is.
    pub(super) fn left(&self, axis: usize) -> impl Iterator<Item = f64> {
        let before = disorder(&self.all).max(f64::MIN_POSITIVE);
        let mut sum = Counts::default();
        self.layers[axis].iter().map(move |layer| {
            sum.iter_mut().zip(layer).for_each(|(sum, count)| *sum += count);
            let rest: Counts = std::array::from_fn(|room| self.all[room] - sum[room]);
            (disorder(&sum) + disorder(&rest)) / before
        })
    }
}

/// Cells of each room in a box, the largest last.
pub(super) fn room_counts(voxels: &Voxels, span: &Span) -> Vec<(usize, u32)> {
    let mut rooms: BTreeMap<u32, usize> = BTreeMap::new();
    let mut cells = voxels.free_in(span).peekable();
    while let Some(index) = cells.next() {
        let room = voxels.room(index);
        let mut count = 1;
        // Neighbours are mostly of one room.
        while cells.next_if(|next| voxels.room(*next) == room).is_some() {
            count += 1;
        }
        *rooms.entry(room).or_default() += count;
    }
    let mut counts: Vec<(usize, u32)> = rooms.into_iter().map(|(room, count)| (count, room)).collect();
    counts.sort_unstable();
    counts
}

/// Entropy of the rooms of some cells, times their number.
fn disorder(counts: &Counts) -> f64 {
    let all = counts.iter().sum::<usize>() as f64;
    let one = |count: &usize| if *count > 0 { *count as f64 * libm::log2(all / *count as f64) } else { 0.0 };
    counts.iter().map(one).sum()
}
