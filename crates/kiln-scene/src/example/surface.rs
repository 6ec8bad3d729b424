//! Surfaces that examples are put together from: rectangles, solids cut out of a grid, mapped patches.
//!
//! Faces are counter-clockwise seen from the side that the normals point to. Each flat side has vertices of its
//! own, so that hard edges stay hard; neighbouring sides use the same grid lines, so that closed solids are
//! watertight without T-junctions.

use glam::{DAffine3, DVec3};
use std::collections::BTreeMap;

/// Triangles with a position and a unit normal at each vertex.
#[derive(Clone, Debug, Default)]
pub(super) struct Surface {
    pub(super) positions: Vec<DVec3>,
    pub(super) normals: Vec<DVec3>,
    pub(super) faces: Vec<[u32; 3]>,
}

impl Surface {
    /// A grid of points over parameters, the front where ∂u × ∂v points. `point` gives position and normal.
    pub(super) fn patch(us: &[f64], vs: &[f64], point: impl Fn(f64, f64) -> (DVec3, DVec3)) -> Self {
        Self::patch_where(us, vs, point, |_, _| true)
    }

    /// The same, with only the cells whose middle `keep` wants; points that no cell uses are left out.
    pub(super) fn patch_where(
        us: &[f64],
        vs: &[f64],
        point: impl Fn(f64, f64) -> (DVec3, DVec3),
        keep: impl Fn(f64, f64) -> bool,
    ) -> Self {
        let mut surface = Self::default();
        let mut vertices = BTreeMap::new();
        for (j, v) in vs.windows(2).enumerate() {
            for (i, u) in us.windows(2).enumerate() {
                if !keep(0.5 * (u[0] + u[1]), 0.5 * (v[0] + v[1])) {
                    continue;
                }
                let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
                let corners = corners.map(|(i, j)| {
                    *vertices.entry((i, j)).or_insert_with(|| {
                        let (position, normal) = point(us[i], vs[j]);
                        surface.vertex(position, normal)
                    })
                });
                surface.quad(corners, (i + j) % 2 == 1);
            }
        }
        surface
    }

    /// A rectangle of cells: `origin + u · u_axis + v · v_axis`, the front where u_axis × v_axis points.
    pub(super) fn rectangle(us: &[f64], vs: &[f64], origin: DVec3, u_axis: DVec3, v_axis: DVec3) -> Self {
        let normal = u_axis.cross(v_axis).normalize();
        Self::patch(us, vs, |u, v| (origin + u * u_axis + v * v_axis, normal))
    }

    /// A horizontal rectangle seen from above.
    pub(super) fn floor(xs: &[f64], zs: &[f64], y: f64) -> Self {
        Self::rectangle(zs, xs, DVec3::Y * y, DVec3::Z, DVec3::X)
    }

    /// The boundary of the filled cells of a grid, facing away from them; closed, its flat sides separate.
    ///
    /// Two filled cells must not touch at an edge alone.
    pub(super) fn solid(lines: [&[f64]; 3], filled: impl Fn(DVec3) -> bool) -> Self {
        let cells = lines.map(|line| line.len() - 1);
        let middle = |axis: usize, i: usize| 0.5 * (lines[axis][i] + lines[axis][i + 1]);
        let is_filled = |cell: [usize; 3]| {
            (0..3).all(|axis| cell[axis] < cells[axis])
                && filled(DVec3::from_array(std::array::from_fn(|axis| middle(axis, cell[axis]))))
        };
        let mut solid = SolidSides { lines, surface: Self::default(), vertices: BTreeMap::new() };
        for x in 0..cells[0] {
            for y in 0..cells[1] {
                for z in 0..cells[2] {
                    let cell = [x, y, z];
                    if !is_filled(cell) {
                        continue;
                    }
                    for axis in 0..3 {
                        // The neighbour before the first cell wraps to the greatest index, which is not filled.
                        let neighbour = |step: usize| {
                            let mut other = cell;
                            other[axis] = other[axis].wrapping_add(step);
                            other
                        };
                        if !is_filled(neighbour(1)) {
                            solid.side(cell, axis, true);
                        }
                        if !is_filled(neighbour(usize::MAX)) {
                            solid.side(cell, axis, false);
                        }
                    }
                }
            }
        }
        solid.surface
    }

    /// A closed box between the first and last grid lines.
    pub(super) fn block(xs: &[f64], ys: &[f64], zs: &[f64]) -> Self {
        Self::solid([xs, ys, zs], |_| true)
    }

    /// Adds a vertex and returns its index.
    pub(super) fn vertex(&mut self, position: DVec3, normal: DVec3) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        self.positions.len() as u32 - 1
    }

    /// Adds two triangles, cut along one diagonal or the other. Alternating cuts keep linear interpolation from
    /// leaning to one side.
    fn quad(&mut self, [a, b, c, d]: [u32; 4], other_diagonal: bool) {
        if other_diagonal {
            self.faces.extend([[a, b, d], [b, c, d]]);
        } else {
            self.faces.extend([[a, b, c], [a, c, d]]);
        }
    }

    /// Appends another surface.
    pub(super) fn append(&mut self, other: &Self) {
        let first = self.positions.len() as u32;
        self.positions.extend_from_slice(&other.positions);
        self.normals.extend_from_slice(&other.normals);
        self.faces.extend(other.faces.iter().map(|face| face.map(|vertex| vertex + first)));
    }

    /// The same surface seen from the other side.
    pub(super) fn flipped(mut self) -> Self {
        for normal in &mut self.normals {
            *normal = -*normal;
        }
        for face in &mut self.faces {
            face.swap(1, 2);
        }
        self
    }

    /// The surface after a motion without scale.
    pub(super) fn moved(mut self, motion: DAffine3) -> Self {
        for position in &mut self.positions {
            *position = motion.transform_point3(*position);
        }
        for normal in &mut self.normals {
            *normal = motion.transform_vector3(*normal);
        }
        self
    }
}

struct SolidSides<'a> {
    lines: [&'a [f64]; 3],
    surface: Surface,
    /// By axis, side and grid point: vertices are shared within a plane and facing only.
    vertices: BTreeMap<(usize, bool, [usize; 3]), u32>,
}

impl SolidSides<'_> {
    /// The side of a cell across an axis, at its upper or lower end.
    fn side(&mut self, cell: [usize; 3], axis: usize, upper: bool) {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| {
            let mut point = cell;
            point[axis] += usize::from(upper);
            // e_b × e_c = e_axis; swapped for the lower side, which faces the other way.
            point[b] += if upper { i } else { j };
            point[c] += if upper { j } else { i };
            let (lines, surface) = (self.lines, &mut self.surface);
            *self.vertices.entry((axis, upper, point)).or_insert_with(|| {
                let position = DVec3::from_array(std::array::from_fn(|axis| lines[axis][point[axis]]));
                surface.vertex(position, DVec3::AXES[axis] * if upper { 1.0 } else { -1.0 })
            })
        });
        self.surface.quad(corners, (cell[b] + cell[c]) % 2 == 1);
    }
}

/// Lines from one value to another, evenly spaced by at most `cell`.
pub(super) fn lines(from: f64, to: f64, cell: f64) -> Vec<f64> {
    let count = ((to - from) / cell - 1e-9).ceil().max(1.0);
    (0..=count as u32).map(|i| from + (to - from) * f64::from(i) / count).collect()
}

/// Lines through several runs `(to, cell)`, one after another.
pub(super) fn line_runs(from: f64, runs: &[(f64, f64)]) -> Vec<f64> {
    let mut all = vec![from];
    for &(to, cell) in runs {
        let start = all[all.len() - 1];
        all.extend_from_slice(&lines(start, to, cell)[1..]);
    }
    all
}

/// Lines at 0 and ±1, ±4, ±16, … up to ±4^last, for planes that reach very far.
pub(super) fn far_lines(last: i32) -> Vec<f64> {
    let positive = (0..=last).map(|i| 4f64.powi(i));
    positive.clone().rev().map(|v| -v).chain([0.0]).chain(positive).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_where_they_should() {
        assert_eq!(lines(0.0, 1.0, 0.25), [0.0, 0.25, 0.5, 0.75, 1.0]);
        assert_eq!(lines(0.0, 1.0, 0.3).len(), 5);
        assert_eq!(lines(2.0, 2.1, 1.0), [2.0, 2.1]);
        assert_eq!(line_runs(0.0, &[(1.0, 0.5), (3.0, 1.0)]), [0.0, 0.5, 1.0, 2.0, 3.0]);
        assert_eq!(far_lines(1), [-4.0, -1.0, 0.0, 1.0, 4.0]);
    }

    #[test]
    fn winding_agrees_with_normals() {
        let ell =
            Surface::solid([&lines(0.0, 2.0, 1.0), &lines(0.0, 2.0, 1.0), &[0.0, 1.0]], |p| p.x < 1.0 || p.y < 1.0);
        assert_eq!(ell.faces.len(), 2 * (2 * 3 + 8));
        let floor = Surface::floor(&[0.0, 1.0], &[0.0, 1.0], 0.5);
        for surface in [&ell, &floor, &ell.clone().flipped()] {
            for face in &surface.faces {
                let [a, b, c] = face.map(|v| surface.positions[v as usize]);
                let normal = (b - a).cross(c - a).normalize();
                assert!(face.iter().all(|&v| surface.normals[v as usize].dot(normal) > 0.999));
            }
        }
        assert!(floor.normals.iter().all(|n| *n == DVec3::Y));
    }

    #[test]
    fn a_patch_leaves_out_unused_points() {
        let us = lines(0.0, 3.0, 1.0);
        let corner = Surface::patch_where(&us, &us, |u, v| (DVec3::new(u, v, 0.0), DVec3::Z), |u, v| u + v < 1.5);
        assert_eq!((corner.positions.len(), corner.faces.len()), (4, 2));
    }
}
