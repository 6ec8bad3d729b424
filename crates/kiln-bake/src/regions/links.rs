//! Where boxes meet.

use super::{profile::Span, voxels::Voxels};
use glam::DVec3;
use kiln_core::RegionEdge;
use std::collections::BTreeMap;

/// Faces that cells of two boxes share and see each other through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Link {
    pub(super) faces: u64,
    /// Sum of the places of their middles, in halves of cells: whole numbers, so that their order does not matter.
    sum: [u64; 3],
}

impl Link {
    pub(super) fn add(&mut self, other: &Self) {
        self.faces += other.faces;
        (0..3).for_each(|axis| self.sum[axis] += other.sum[axis]);
    }
}

/// The links between boxes, by their indices, the lower first.
pub(super) fn links(voxels: &Voxels, boxes: &[Span]) -> BTreeMap<[u32; 2], Link> {
    const NONE: u32 = u32::MAX;
    let mut box_of = vec![NONE; voxels.cells.len()];
    for (index, span) in (0u32..).zip(boxes) {
        voxels.free_in(span).for_each(|cell| box_of[cell] = index);
    }
    let mut links: BTreeMap<[u32; 2], Link> = BTreeMap::new();
    for (index, span) in (0u32..).zip(boxes) {
        for cell in voxels.free_in(span) {
            let place = voxels.grid.coordinates(cell);
            for axis in (0..3).filter(|axis| place[*axis] + 1 == span.max[*axis] && voxels.joins(cell, *axis)) {
                let other = box_of[cell + voxels.grid.stride(axis)];
                if other != NONE && other != index {
                    let middle = |along: usize| (2 * place[along] + if along == axis { 2 } else { 1 }) as u64;
                    let face = Link { faces: 1, sum: std::array::from_fn(middle) };
                    links.entry([index.min(other), index.max(other)]).or_default().add(&face);
                }
            }
        }
    }
    links
}

/// The links as edges of regions.
pub(super) fn edges(voxels: &Voxels, boxes: &[Span]) -> Vec<RegionEdge> {
    let grid = &voxels.grid;
    let edge = |(regions, link): ([u32; 2], Link)| RegionEdge {
        regions,
        area_m2: link.faces as f64 * grid.cell_m * grid.cell_m,
        center: grid.origin + DVec3::from(link.sum.map(|sum| sum as f64)) * (0.5 * grid.cell_m / link.faces as f64),
    };
    links(voxels, boxes).into_iter().map(edge).collect()
}
