//! Rooms: parts of a space that are wide, with what is narrow between them.
//!
//! A watershed of the distance to what is not open: cells are added from the widest place down, each to the rooms that it
//! joins; where two meet they become one, unless the place is a bottleneck, half as wide as the widest place of either. So a room
//! ends at its doors and windows, while what stands in it, or a hill between two valleys, parts nothing.

use super::voxels::{OPEN, Rooms, Voxels};

/// A place is a bottleneck if it is no wider than this part of what is on both its sides.
const BOTTLENECK: f64 = 0.5;

/// What has fewer cells is no room, nor what has fewer when it meets another: then its narrow parts are still to come.
pub(super) const LEAST_ROOM: usize = 256;
const LEAST_BASIN: u32 = 64;

const NONE: u32 = u32::MAX;

/// Finds the rooms of all free cells.
pub(super) fn find_rooms(voxels: &mut Voxels) {
    let (order, clearance) = clearance(voxels);
    let count = voxels.cells.len();
    let mut basins = Basins { parent: vec![NONE; count], peak: clearance.clone(), size: vec![0; count] };
    for &cell in order.iter().rev() {
        basins.add(voxels, &clearance, cell);
    }
    voxels.rooms = basins.rooms(&order);
}

/// Free cells in the order of their distance to what is not open, cells along axes, and that distance: 1 beside it. What is free no
/// longer, for it is too high in open air, is open.
fn clearance(voxels: &Voxels) -> (Vec<u32>, Vec<u16>) {
    let mut clearance = vec![0u16; voxels.cells.len()];
    let mut order = Vec::new();
    for index in (0..voxels.cells.len()).filter(|index| voxels.is_free(*index) && is_beside_wall(voxels, *index)) {
        clearance[index] = 1;
        order.push(index as u32);
    }
    let mut next = 0;
    while let Some(&cell) = order.get(next) {
        next += 1;
        let farther = clearance[cell as usize].saturating_add(1);
        voxels.for_neighbours(cell as usize, |neighbour| {
            if clearance[neighbour] == 0 {
                clearance[neighbour] = farther;
                order.push(neighbour as u32);
            }
        });
    }
    (order, clearance)
}

/// Whether a cell does not see one of its neighbours.
fn is_beside_wall(voxels: &Voxels, index: usize) -> bool {
    (0..3).any(|axis| {
        let stride = voxels.grid.stride(axis);
        let before = index.checked_sub(stride).is_some_and(|before| voxels.cells[before] & OPEN[axis] != 0);
        voxels.cells[index] & OPEN[axis] == 0 || !before
    })
}

/// Sets of cells, each by its first; what is known of a set is kept with that.
struct Basins {
    parent: Vec<u32>,
    /// The greatest clearance in the set.
    peak: Vec<u16>,
    size: Vec<u32>,
}

impl Basins {
    fn root(&mut self, cell: u32) -> u32 {
        let mut cell = cell;
        while self.parent[cell as usize] != cell {
            let above = self.parent[self.parent[cell as usize] as usize];
            self.parent[cell as usize] = above;
            cell = above;
        }
        cell
    }

    /// Adds a cell that is no wider than any that is there to the set of its widest neighbour.
    fn add(&mut self, voxels: &Voxels, clearance: &[u16], cell: u32) {
        let mut neighbours = Vec::with_capacity(6);
        voxels.for_neighbours(cell as usize, |neighbour| {
            if self.parent[neighbour] != NONE {
                neighbours.push(neighbour as u32);
            }
        });
        neighbours.sort_unstable_by_key(|neighbour| (std::cmp::Reverse(clearance[*neighbour as usize]), *neighbour));
        self.size[cell as usize] = 1;
        let Some((&widest, others)) = neighbours.split_first() else {
            self.parent[cell as usize] = cell;
            return;
        };
        let home = self.root(widest);
        self.parent[cell as usize] = home;
        self.size[home as usize] += 1;
        for &other in others {
            self.meet(cell, other, clearance[cell as usize]);
        }
    }

    /// Makes one of the sets of two cells that see each other, if the place is wide or one of them is small.
    fn meet(&mut self, one: u32, other: u32, width: u16) {
        let [a, b] = [one, other].map(|cell| self.root(cell) as usize);
        let is_narrow = f64::from(width) <= BOTTLENECK * f64::from(self.peak[a].min(self.peak[b]));
        let is_small = self.size[a].min(self.size[b]) < LEAST_BASIN;
        if a == b || is_narrow && !is_small {
            return;
        }
        // Of equals, the first.
        let (low, high) = if (self.peak[a], b) < (self.peak[b], a) { (a, b) } else { (b, a) };
        self.parent[low] = high as u32;
        self.size[high] += self.size[low];
    }

    /// Numbers the sets.
    fn rooms(mut self, order: &[u32]) -> Rooms {
        let mut rooms = Rooms { of: vec![NONE; self.parent.len()], sizes: Vec::new() };
        for &cell in order {
            let root = self.root(cell) as usize;
            if rooms.of[root] == NONE {
                rooms.of[root] = rooms.sizes.len() as u32;
                rooms.sizes.push(self.size[root] as usize);
            }
            rooms.of[cell as usize] = rooms.of[root];
        }
        rooms
    }
}
