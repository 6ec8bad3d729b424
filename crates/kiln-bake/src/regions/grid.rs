//! The lattice of cells that a level's space is cut into.

use super::{MakeError, SolidObject};
use glam::DVec3;
use kiln_core::{Bounds, Class};

/// The most cells: with all that is kept of each they take up to 1.2 GB.
pub(super) const MOST_CELLS: f64 = 67_108_864.0;

/// Cells that the size of a cell is chosen for, where it need not be larger than is good for people.
const USUAL_CELLS: f64 = 1.0e6;

/// Largest cell that is chosen, if the level has not too many of them: doors are wider.
const LARGEST_CELL_M: f64 = 0.5;

/// Places between two cells that the lattice can begin at.
const PHASES: usize = 32;

/// Cosine between an axis and the normal of a face that the lattice is aligned to.
const ALIGNED: f64 = 0.999;

/// Cubes over part of a level, x first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    /// Least corner, metres relative to the level's origin.
    pub(super) origin: DVec3,
    /// Edge of a cell, metres.
    pub(super) cell_m: f64,
    /// Cells along each axis.
    pub(super) size: [usize; 3],
}

impl Grid {
    /// A lattice over some bounds and as much air above them.
    pub(super) fn over(
        objects: &[SolidObject<'_>],
        mut bounds: Bounds,
        air_m: f64,
        cell_m: Option<f64>,
    ) -> Result<Self, MakeError> {
        bounds.max.y += air_m;
        let cell_m = cell_size(bounds.max - bounds.min, cell_m)?;
        let phase = phase(objects, cell_m);
        // One cell more on each side, so that a surface on the bounds lies between two cells.
        let origin = phase + (((bounds.min - phase) / cell_m).floor() - 1.0) * cell_m;
        let size = ((bounds.max - origin) / cell_m).ceil() + 1.0;
        Ok(Self { origin, cell_m, size: size.to_array().map(|n| n.max(1.0) as usize) })
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.size.iter().product()
    }

    /// How far apart neighbours along an axis are in the order of cells.
    pub(super) fn stride(&self, axis: usize) -> usize {
        self.size[..axis].iter().product()
    }

    pub(super) fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.size[0] * (y + self.size[1] * z)
    }

    pub(super) fn coordinates(&self, index: usize) -> [usize; 3] {
        [index % self.size[0], index / self.size[0] % self.size[1], index / self.stride(2)]
    }

    /// The corner of a cell that is nearest the origin, metres relative to the level's origin.
    pub(super) fn corner(&self, cell: [usize; 3]) -> DVec3 {
        self.origin + DVec3::from(cell.map(|n| n as f64)) * self.cell_m
    }

    /// The middle of a cell, likewise.
    pub(super) fn center(&self, cell: [usize; 3]) -> DVec3 {
        self.corner(cell) + 0.5 * self.cell_m
    }

    /// The cell that a point is in.
    pub(super) fn cell_of(&self, point: DVec3) -> Option<[usize; 3]> {
        let place = ((point - self.origin) / self.cell_m).floor();
        let end = DVec3::from(self.size.map(|n| n as f64));
        (place.cmpge(DVec3::ZERO).all() && place.cmplt(end).all()).then(|| place.to_array().map(|n| n as usize))
    }
}

/// The size of cells that is asked for, or one that suits a level of some extents.
fn cell_size(size: DVec3, asked: Option<f64>) -> Result<f64, MakeError> {
    // What lies on no cell's bounds, and the cells around.
    let cells = |cell: f64| ((size / cell).ceil() + 3.0).element_product();
    if let Some(cell_m) = asked {
        let too_many = || MakeError::TooManyCells { cell_m, cells: cells(cell_m), least_m: least_cell(cell_m, cells) };
        return if cells(cell_m) <= MOST_CELLS { Ok(cell_m) } else { Err(too_many()) };
    }
    // A flat level has no volume, a point not even a length.
    let least = (size.max_element() / 1024.0).max(f64::MIN_POSITIVE.sqrt());
    let usual = libm::cbrt(size.element_product() / USUAL_CELLS).max(least).min(LARGEST_CELL_M);
    Ok(if cells(usual) <= MOST_CELLS { usual } else { least_cell(usual, cells) })
}

/// The smallest cell, rounded up to two digits, of which there are not too many.
fn least_cell(too_small: f64, cells: impl Fn(f64) -> f64) -> f64 {
    let mut cell = too_small;
    while cells(cell) > MOST_CELLS {
        cell *= libm::cbrt(cells(cell) / MOST_CELLS).max(1.01);
    }
    let digit = libm::exp10(libm::log10(cell).floor() - 1.0);
    let rounded = (cell / digit).ceil() * digit;
    // Without the noise of binary fractions, so that the number can be typed.
    format!("{rounded:.12}").parse().unwrap_or(rounded)
}

/// Bounds of all faces that stop rays, without distant scenery if there is anything else.
pub(super) fn bounds(objects: &[SolidObject<'_>]) -> Option<Bounds> {
    let (mut near, mut all) = (Bounds::EMPTY, Bounds::EMPTY);
    for object in objects {
        for face in object.solid_faces() {
            let is_near = object.mesh.group(face).class != Class::Distant;
            for corner in object.corners(face) {
                all.add(corner);
                if is_near {
                    near.add(corner);
                }
            }
        }
    }
    [near, all].into_iter().find(|bounds| !bounds.is_empty())
}

/// Where between two cells the lattice begins along each axis, metres: so that walls and floors lie on the faces of cells as
/// far as they can, for then boxes end there.
fn phase(objects: &[SolidObject<'_>], cell_m: f64) -> DVec3 {
    let mut areas = [[0.0; PHASES]; 3];
    for object in objects {
        for face in object.solid_faces() {
            let [a, b, c] = object.corners(face);
            let normal = (b - a).cross(c - a);
            let area = normal.length();
            for axis in (0..3).filter(|axis| normal[*axis].abs() > ALIGNED * area) {
                let place = (a[axis] / cell_m).rem_euclid(1.0) * PHASES as f64;
                areas[axis][(place.round() as usize) % PHASES] += area;
            }
        }
    }
    DVec3::from(areas.map(|areas| best_phase(&areas) as f64 / PHASES as f64 * cell_m))
}

/// The place from which the squares of the distances to all areas are least: in the middle of a wall with two faces.
fn best_phase(areas: &[f64; PHASES]) -> usize {
    let cost = |phase: &usize| -> f64 {
        let away = |place: usize| place.abs_diff(*phase).min(PHASES - place.abs_diff(*phase));
        areas.iter().enumerate().map(|(place, area)| area * (away(place) as f64).powi(2)).sum()
    };
    (0..PHASES).min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_in_their_places() {
        let grid = Grid { origin: DVec3::new(-1.0, 0.0, 2.0), cell_m: 0.5, size: [4, 3, 5] };
        assert_eq!((grid.len(), grid.stride(0), grid.stride(1), grid.stride(2)), (60, 1, 4, 12));
        for index in 0..grid.len() {
            let cell = grid.coordinates(index);
            assert_eq!((grid.index(cell), grid.cell_of(grid.center(cell))), (index, Some(cell)));
        }
        assert_eq!(grid.cell_of(DVec3::new(-1.1, 0.0, 2.0)), None);
        assert_eq!(grid.cell_of(DVec3::new(1.0, 0.0, 2.0)), None);
    }

    #[test]
    fn least_cells_can_be_typed() {
        let cells = |cell: f64| (1000.0 / cell).powi(3);
        let least = least_cell(0.1, cells);
        assert!(cells(least) <= MOST_CELLS && cells(least) > 0.7 * MOST_CELLS);
        assert_eq!(least.to_string(), "2.5");
    }

    #[test]
    fn lattices_begin_where_most_area_lies() {
        let mut areas = [0.0; PHASES];
        (areas[31], areas[3], areas[10]) = (5.0, 5.0, 0.1);
        assert_eq!(best_phase(&areas), 1);
    }
}
