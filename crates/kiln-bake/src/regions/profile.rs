//! Boxes of cells, and what is in their layers.

use super::voxels::Voxels;
use rayon::prelude::*;

/// A box of cells, its end excluded; empty where it has no extent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Span {
    pub(super) min: [usize; 3],
    pub(super) max: [usize; 3],
}

impl Span {
    pub(super) const EMPTY: Self = Self { min: [usize::MAX; 3], max: [0; 3] };

    pub(super) fn extent(&self, axis: usize) -> usize {
        self.max[axis].saturating_sub(self.min[axis])
    }

    pub(super) fn volume(&self) -> usize {
        (0..3).map(|axis| self.extent(axis)).product()
    }

    /// The box around both.
    pub(super) fn around(&self, other: &Self) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis].min(other.min[axis])),
            max: std::array::from_fn(|axis| self.max[axis].max(other.max[axis])),
        }
    }

    pub(super) fn overlaps(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] < other.max[axis] && other.min[axis] < self.max[axis])
    }

    /// y and z of its rows of cells.
    pub(super) fn rows(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let (ys, zs) = (self.min[1]..self.max[1], self.min[2]..self.max[2]);
        zs.flat_map(move |z| ys.clone().map(move |y| [y, z]))
    }

    fn add(&mut self, cell: [usize; 3]) {
        *self = self.around(&Self { min: cell, max: cell.map(|at| at + 1) });
    }
}

/// A layer of a box, across an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layer {
    /// Free cells.
    pub(super) free: usize,
    /// Of these, cells that join the next layer.
    pub(super) open: usize,
    /// The box around them.
    pub(super) bounds: Span,
}

impl Layer {
    const NONE: Self = Self { free: 0, open: 0, bounds: Span::EMPTY };

    fn add(&mut self, other: &Self) {
        self.free += other.free;
        self.open += other.open;
        self.bounds = self.bounds.around(&other.bounds);
    }
}

/// The layers of a box across each axis. What joins cells beyond the box counts as open in its last layers only.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Profile {
    pub(super) span: Span,
    pub(super) layers: [Vec<Layer>; 3],
    pub(super) free: usize,
}

/// Boxes of more cells are looked through by several threads.
const CELLS_ALONE: usize = 1 << 16;

impl Profile {
    pub(super) fn of(voxels: &Voxels, span: Span) -> Self {
        let slab = |z: usize| {
            Self::of_part(voxels, Span { min: [span.min[0], span.min[1], z], max: [span.max[0], span.max[1], z + 1] })
        };
        if span.volume() <= CELLS_ALONE {
            return Self::of_part(voxels, span);
        }
        let mut parts = (span.min[2]..span.max[2]).into_par_iter().map(slab).collect::<Vec<Self>>().into_iter();
        let Some(mut whole) = parts.next() else { return Self::of_part(voxels, span) };
        for part in parts {
            for axis in 0..2 {
                whole.layers[axis].iter_mut().zip(&part.layers[axis]).for_each(|(all, layer)| all.add(layer));
            }
            whole.layers[2].extend(&part.layers[2]);
            whole.free += part.free;
        }
        whole.span = span;
        whole
    }

    fn of_part(voxels: &Voxels, span: Span) -> Self {
        let mut layers: [Vec<Layer>; 3] = std::array::from_fn(|axis| vec![Layer::NONE; span.extent(axis)]);
        let mut free = 0;
        for index in voxels.free_in(&span) {
            let cell = voxels.grid.coordinates(index);
            free += 1;
            for axis in 0..3 {
                let layer = &mut layers[axis][cell[axis] - span.min[axis]];
                layer.free += 1;
                layer.open += usize::from(voxels.joins(index, axis));
                layer.bounds.add(cell);
            }
        }
        Self { span, layers, free }
    }

    /// The box around all free cells.
    pub(super) fn tight(&self) -> Span {
        self.layers[0].iter().fold(Span::EMPTY, |bounds, layer| bounds.around(&layer.bounds))
    }
}
