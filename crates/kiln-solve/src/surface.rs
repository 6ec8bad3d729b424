//! The faces that take part in a solve, by unknowns.

use crate::{frame::Frame, weld::Weld};
use glam::DVec3;
use kiln_core::Mesh;

/// The receiving surface of an instance, in the frame of the solve.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Position of each unknown.
    pub points: Vec<DVec3>,
    /// Unknowns of each face, counter-clockwise as in the mesh.
    pub corners: Vec<[u32; 3]>,
    /// Area of each face, greater than 0, in square units of the frame.
    pub areas: Vec<f64>,
    /// Index in the mesh of each face.
    pub mesh_face: Vec<u32>,
}

impl Surface {
    /// The faces of a mesh whose group receives and whose area is finite and above 0, in the order of the mesh.
    pub fn new(mesh: &Mesh, frame: &Frame, weld: &Weld) -> Self {
        let points = weld.first_vertex.iter().map(|v| frame.point(mesh.positions[*v as usize])).collect();
        let mut surface = Self { points, corners: Vec::new(), areas: Vec::new(), mesh_face: Vec::new() };
        for (face, vertices) in mesh.faces.iter().enumerate().filter(|(face, _)| mesh.group(*face).receives) {
            let corners = vertices.map(|v| weld.unknown_of_vertex[v as usize]);
            let [a, b, c] = corners.map(|u| surface.points[u as usize]);
            let area = 0.5 * (b - a).cross(c - a).length();
            if area > 0.0 && area.is_finite() {
                surface.corners.push(corners);
                surface.areas.push(area);
                surface.mesh_face.push(face as u32);
            }
        }
        surface
    }

    /// Number of unknowns, with those that no face uses.
    pub fn unknown_count(&self) -> usize {
        self.points.len()
    }
}
