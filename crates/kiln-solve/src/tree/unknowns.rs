//! A model as a system for its local AO: unknowns, regulariser rows, the matrix's pattern and its components.

use super::{alternate::AlternateParams, samples::ModelSamples};
use crate::{
    components::Components,
    edges::{Edges, InteriorEdge},
    frame::Frame,
    matrix::LowerCsc,
    surface::Surface,
    weld::Weld,
};
use glam::DAffine3;
use kiln_core::Mesh;

/// A row of the regulariser: four unknowns and their weights.
pub(crate) type Row = ([u32; 4], [f64; 4]);

/// What all channels and rounds of one model have in common.
#[derive(Clone, Debug)]
pub(crate) struct ModelUnknowns {
    /// The unknown of each vertex.
    pub(crate) of_vertex: Vec<u32>,
    /// Number of unknowns.
    pub(crate) count: usize,
    /// The unknowns of each sample's face.
    pub(crate) corners: Vec<[u32; 3]>,
    /// The area around each unknown, a third of its faces', in the unit of the samples' weights.
    pub(crate) area: Vec<f64>,
    /// Rows of the regulariser, whose sums squared are areas in the same unit.
    pub(crate) rows: Vec<Row>,
    /// A matrix of zeros with room for what samples and rows add.
    pub(crate) pattern: LowerCsc,
    /// The components of that matrix.
    pub(crate) components: Components,
}

impl ModelUnknowns {
    /// Welds a mesh and finds its edges as the solve of an instance does, in object space. The mesh has been checked.
    pub(crate) fn new(mesh: &Mesh, samples: &ModelSamples, params: &AlternateParams) -> Self {
        let frame = Frame::new(mesh, &DAffine3::IDENTITY);
        let weld = frame.as_ref().map(|frame| Weld::new(mesh, frame, params.weld_degrees));
        let surface = frame.as_ref().zip(weld.as_ref()).map(|(frame, weld)| Surface::new(mesh, frame, weld));
        let count = weld.as_ref().map_or(mesh.positions.len(), Weld::unknown_count);
        let of_vertex = weld.map_or_else(|| (0..count as u32).collect(), |weld| weld.unknown_of_vertex);
        let corners: Vec<_> = samples.corners.iter().map(|c| c.map(|vertex| of_vertex[vertex as usize])).collect();
        let (area, rows) = match &surface {
            Some(surface) => weighed(surface, samples.weight.iter().sum()),
            None => (vec![0.0; count], Vec::new()),
        };
        let pairs = || {
            let of_samples = corners.iter().flat_map(|&[a, b, c]| [[a, b], [a, c], [b, c]]);
            let of_rows =
                rows.iter().flat_map(|([a, b, c, d], _)| [[*a, *b], [*a, *c], [*a, *d], [*b, *c], [*b, *d], [*c, *d]]);
            of_samples.chain(of_rows)
        };
        let pattern = LowerCsc::with_pattern(count, pairs);
        let components = Components::of_matrix(&pattern);
        Self { count, area, components, pattern, of_vertex, corners, rows }
    }

    /// The mean over its vertices of each unknown, f32 as it is stored, in [0, 1].
    #[expect(clippy::cast_possible_truncation, reason = "f32 is the precision of the values")]
    pub(crate) fn gather(&self, of_vertices: impl Iterator<Item = f32>) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); self.count];
        for (unknown, value) in self.of_vertex.iter().zip(of_vertices) {
            let (sum, number) = &mut sums[*unknown as usize];
            *sum += f64::from(value).clamp(0.0, 1.0);
            *number += 1.0;
        }
        sums.into_iter().map(|(sum, number)| f64::from((sum / f64::max(number, 1.0)) as f32)).collect()
    }
}

/// Areas around unknowns and regulariser rows, in a unit in which the whole surface is `total`.
fn weighed(surface: &Surface, total: f64) -> (Vec<f64>, Vec<Row>) {
    let whole: f64 = surface.areas.iter().sum();
    let unit = if whole > 0.0 { total / whole } else { 0.0 };
    let mut area = vec![0.0; surface.unknown_count()];
    for (corners, face) in surface.corners.iter().zip(&surface.areas) {
        corners.iter().for_each(|unknown| area[*unknown as usize] += unit * face / 3.0);
    }
    let of_edge =
        |edge: &InteriorEdge| edge.row(surface).map(|row| (edge.unknowns(), row.map(|weight| weight * unit.sqrt())));
    (area, Edges::new(surface).interior.iter().filter_map(of_edge).collect())
}
