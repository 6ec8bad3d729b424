//! What is known of each cell.

use super::{grid::Grid, profile::Span};

/// The cell's centre is where something may be.
pub(super) const FREE: u8 = 1;
/// It sees the next cell's centre along each axis.
pub(super) const OPEN: [u8; 3] = [2, 4, 8];
/// It does not see the cell below, but the front of a face.
pub(super) const FLOOR: u8 = 16;
/// Nothing is above it.
pub(super) const SKY: u8 = 64;
/// A pass has been here.
pub(super) const SEEN: u8 = 32;

/// Cells of a lattice, each with its bits.
#[derive(Clone, Debug)]
pub(super) struct Voxels {
    pub(super) grid: Grid,
    pub(super) cells: Vec<u8>,
    pub(super) rooms: Rooms,
}

/// The room of each free cell; none, as long as they are not known.
#[derive(Clone, Debug, Default)]
pub(super) struct Rooms {
    pub(super) of: Vec<u32>,
    /// Cells of each room.
    pub(super) sizes: Vec<usize>,
}

impl Voxels {
    pub(super) fn new(grid: Grid, cells: Vec<u8>) -> Self {
        Self { grid, cells, rooms: Rooms::default() }
    }

    /// The room that a free cell is in.
    pub(super) fn room(&self, index: usize) -> u32 {
        self.rooms.of.get(index).copied().unwrap_or(0)
    }

    pub(super) fn is_free(&self, index: usize) -> bool {
        self.cells[index] & FREE != 0
    }

    /// Whether a cell and the next along an axis are both free and see each other.
    pub(super) fn joins(&self, index: usize, axis: usize) -> bool {
        self.cells[index] & (FREE | OPEN[axis]) == FREE | OPEN[axis] && self.is_free(index + self.grid.stride(axis))
    }

    /// Calls a function with each neighbour that a free cell joins.
    pub(super) fn for_neighbours(&self, index: usize, mut found: impl FnMut(usize)) {
        for axis in 0..3 {
            let stride = self.grid.stride(axis);
            if self.joins(index, axis) {
                found(index + stride);
            }
            // The last cell before this along the axis may be in another row, but then it joins nothing.
            if index >= stride && self.joins(index - stride, axis) {
                found(index - stride);
            }
        }
    }

    /// Indices of the free cells of a box, ascending.
    pub(super) fn free_in(&self, span: &Span) -> impl Iterator<Item = usize> {
        span.rows()
            .flat_map(|[y, z]| {
                let start = self.grid.index([span.min[0], y, z]);
                start..start + span.max[0] - span.min[0]
            })
            .filter(|index| self.is_free(*index))
    }

    /// Free cells of a box.
    pub(super) fn count(&self, span: &Span) -> u64 {
        self.free_in(span).count() as u64
    }
}
