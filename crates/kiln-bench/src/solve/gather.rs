//! The linear systems of many instances as one, in the way that Kiln's solve assembles each.

use glam::DAffine3;
use kiln_core::{FaceMoments, Mesh, SolveSettings};
use kiln_solve::{
    ComponentSystem,
    assemble::Assembly,
    components::{Components, assembly_system},
    edges::Edges,
    frame::Frame,
    matrix::LowerCsc,
    surface::Surface,
    weld::Weld,
};
use std::borrow::Cow;

/// The systems added so far, side by side on the diagonal of one.
pub(super) struct Gathered {
    matrix: LowerCsc,
    anchor: Vec<f64>,
    rhs: Vec<f64>,
    hole_ring: Vec<u32>,
    columns: usize,
}

impl Gathered {
    /// No system yet, for `columns` right-hand sides (two for each channel of the moments).
    pub(super) fn new(columns: usize) -> Self {
        let matrix = LowerCsc { column_start: vec![0], row: Vec::new(), value: Vec::new() };
        Self { matrix, anchor: Vec::new(), rhs: Vec::new(), hole_ring: Vec::new(), columns }
    }

    /// Adds the components of an instance; those of no extent have none.
    pub(super) fn add(&mut self, mesh: &Mesh, world: &DAffine3, moments: &FaceMoments, settings: &SolveSettings) {
        let Some(frame) = Frame::new(mesh, world) else { return };
        let surface = Surface::new(mesh, &frame, &Weld::new(mesh, &frame, settings.weld_degrees));
        let assembly = Assembly::new(&surface, &Edges::new(&surface), moments, settings);
        let components = Components::new(&surface);
        let whole = assembly_system(&assembly);
        for component in 0..components.count() {
            self.append(&components.part(component, &whole));
        }
    }

    fn append(&mut self, system: &ComponentSystem<'_>) {
        let (first, entries) = (self.anchor.len() as u32, self.matrix.row.len() as u32);
        self.matrix.row.extend(system.matrix.row.iter().map(|row| row + first));
        self.matrix.value.extend_from_slice(&system.matrix.value);
        self.matrix.column_start.extend(system.matrix.column_start[1..].iter().map(|start| start + entries));
        self.anchor.extend_from_slice(&system.anchor);
        self.hole_ring.extend_from_slice(&system.hole_ring);
        for values in system.rhs.chunks_exact(system.columns) {
            self.rhs.extend_from_slice(&values[..self.columns.min(system.columns)]);
        }
    }

    pub(super) fn finish(self) -> ComponentSystem<'static> {
        ComponentSystem {
            matrix: Cow::Owned(self.matrix),
            anchor: Cow::Owned(self.anchor),
            rhs: Cow::Owned(self.rhs),
            columns: self.columns,
            hole_ring: Cow::Owned(self.hole_ring),
        }
    }
}
