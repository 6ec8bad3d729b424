//! Surfaces made by code: sheets, boxes, and the room that most cases damage.

use glam::{DVec3, dvec3};

/// Triangles, counter-clockwise seen from the front. Vertices are shared within a plane side, not across hard edges.
#[derive(Clone, Debug, Default)]
pub(crate) struct Surface {
    pub(crate) positions: Vec<DVec3>,
    pub(crate) faces: Vec<[u32; 3]>,
}

impl Surface {
    /// A parallelogram of `cells` along `u` and `v`, which looks along `u × v`.
    pub(crate) fn sheet(corner: DVec3, u: DVec3, v: DVec3, cells: [u32; 2]) -> Self {
        let mut sheet = Self::default();
        let [columns, rows] = cells;
        for j in 0..=rows {
            for i in 0..=columns {
                let (s, t) = (f64::from(i) / f64::from(columns), f64::from(j) / f64::from(rows));
                sheet.positions.push(corner + u * s + v * t);
            }
        }
        for j in 0..rows {
            for i in 0..columns {
                let a = j * (columns + 1) + i;
                let (b, c, d) = (a + 1, a + columns + 1, a + columns + 2);
                sheet.faces.extend([[a, b, d], [a, d, c]]);
            }
        }
        sheet
    }

    /// A box that looks outwards, of two by two cells a side.
    pub(crate) fn cuboid(min: DVec3, max: DVec3) -> Self {
        let size = max - min;
        let (x, y, z) = (DVec3::X * size, DVec3::Y * size, DVec3::Z * size);
        let sides = [(min, y, x), (min, z, y), (min, x, z), (max, -x, -y), (max, -y, -z), (max, -z, -x)];
        let mut all = Self::default();
        sides.into_iter().for_each(|(corner, u, v)| all.append(&Self::sheet(corner, u, v, [2, 2])));
        all
    }

    /// Adds another surface after this one: vertices and faces that are there keep their indices.
    pub(crate) fn append(&mut self, other: &Self) {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.faces.extend(other.faces.iter().map(|face| face.map(|vertex| vertex + first)));
    }

    /// The surface with its positions moved.
    pub(crate) fn map(&self, of: impl Fn(DVec3) -> DVec3) -> Self {
        Self { positions: self.positions.iter().map(|p| of(*p)).collect(), faces: self.faces.clone() }
    }

    /// The surface seen from behind.
    pub(crate) fn flipped(&self) -> Self {
        Self { positions: self.positions.clone(), faces: self.faces.iter().map(|&[a, b, c]| [a, c, b]).collect() }
    }

    /// The faces that satisfy a condition on their centroid; all vertices stay.
    pub(crate) fn filtered(&self, keep: impl Fn(DVec3) -> bool) -> Self {
        let centroid = |face: &[u32; 3]| face.iter().map(|v| self.positions[*v as usize]).sum::<DVec3>() / 3.0;
        let faces = self.faces.iter().filter(|face| keep(centroid(face))).copied().collect();
        Self { positions: self.positions.clone(), faces }
    }
}

/// A floor of 4 × 4 m with a wall along one side, all coordinates multiples of half a metre.
pub(crate) fn floor_and_wall() -> Surface {
    let mut surface = Surface::sheet(DVec3::ZERO, DVec3::Z * 4.0, DVec3::X * 4.0, [8, 8]);
    surface.append(&Surface::sheet(DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 2.0, [8, 4]));
    surface
}

/// Floor, wall and a box that floats half a metre above the floor, so that all of it can be seen.
pub(crate) fn room() -> Surface {
    let mut surface = floor_and_wall();
    surface.append(&Surface::cuboid(dvec3(1.0, 0.5, 1.0), dvec3(2.0, 1.5, 2.0)));
    surface
}

/// Half-distances that suit [`room`], metres.
pub(crate) const HALF_DISTANCES_M: [f64; 2] = [0.5, 8.0];
