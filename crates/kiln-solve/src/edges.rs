//! Interior edges and the edge regulariser of Kavan, Bargteil and Sloan 2011: the jump of the gradient across an
//! edge, unfolded.
//!
//! An edge counts if exactly one face runs along it in each direction; faces that repeat another one count
//! once. Boundary edges, fans and inconsistent windings contribute nothing. Deviation from the paper: heights of
//! slivers are bounded from below, so that a needle cannot outweigh its surroundings.

use crate::surface::Surface;
use glam::DVec3;

/// The least height of a triangle over an edge, as a fraction of the longest extent of the edge's two triangles.
const LEAST_HEIGHT: f64 = 0.1;
/// Below this fraction of the longest extent a height is rounding error, and the edge is left out.
const NO_HEIGHT: f64 = 1e-12;

/// An edge between two consistently wound faces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InteriorEdge {
    /// The ends a and b, unknowns, a < b.
    pub ends: [u32; 2],
    /// The opposite corners: c of the face that runs from a to b, d of the other.
    pub opposite: [u32; 2],
    /// The two faces, indices into [`Surface::corners`].
    pub faces: [u32; 2],
}

/// The edges of a surface.
#[derive(Clone, Debug, Default)]
pub struct Edges {
    /// The ends of every edge once, the lower first, in lexicographic order.
    pub all: Vec<[u32; 2]>,
    /// The edges that get a regulariser row.
    pub interior: Vec<InteriorEdge>,
}

/// One face's side of an edge, filed under the edge's lower end. Ordered so that the sides of one edge stand
/// together, each direction's by opposite corner.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
struct Side {
    high: u32,
    backward: bool,
    opposite: u32,
    face: u32,
}

impl Edges {
    /// Finds the edges of a surface in time linear in its faces.
    pub fn new(surface: &Surface) -> Self {
        let mut start = vec![0u32; surface.unknown_count() + 1];
        sides(surface).for_each(|(low, _)| start[low as usize + 1] += 1);
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let mut next = start.clone();
        let mut filed = vec![Side::default(); 3 * surface.corners.len()];
        sides(surface).for_each(|(low, side)| {
            let slot = &mut next[low as usize];
            filed[*slot as usize] = side;
            *slot += 1;
        });
        let mut edges = Self::default();
        for low in 0..surface.unknown_count() {
            let bucket = &mut filed[start[low] as usize..start[low + 1] as usize];
            bucket.sort_unstable();
            for side in bucket.chunk_by(|a, b| a.high == b.high) {
                edges.all.push([low as u32, side[0].high]);
                edges.interior.extend(interior(low as u32, side));
            }
        }
        edges
    }
}

/// Every side of every face with the lower end of its edge.
fn sides(surface: &Surface) -> impl Iterator<Item = (u32, Side)> {
    surface.corners.iter().zip(0..).flat_map(|(&[i, j, k], face)| {
        [[i, j, k], [j, k, i], [k, i, j]].map(|[from, to, opposite]| {
            (from.min(to), Side { high: from.max(to), backward: from > to, opposite, face })
        })
    })
}

/// The edge that the sorted sides make, if it is interior.
fn interior(low: u32, sides: &[Side]) -> Option<InteriorEdge> {
    let split = sides.partition_point(|side| !side.backward);
    let (forward, backward) = (single(&sides[..split])?, single(&sides[split..])?);
    // Two faces back to back on the same corners are a sheet, not a surface that goes on.
    (forward.opposite != backward.opposite).then_some(InteriorEdge {
        ends: [low, forward.high],
        opposite: [forward.opposite, backward.opposite],
        faces: [forward.face, backward.face],
    })
}

/// The one side of a direction, if all are repetitions of one face.
fn single(sides: &[Side]) -> Option<Side> {
    let first = *sides.first()?;
    sides.iter().all(|side| side.opposite == first.opposite).then_some(first)
}

impl InteriorEdge {
    /// The four unknowns in the order of [`regulariser_row`].
    pub fn unknowns(&self) -> [u32; 4] {
        [self.ends[0], self.ends[1], self.opposite[0], self.opposite[1]]
    }

    /// The edge's row, or `None` where a triangle has no height over it.
    pub fn row(&self, surface: &Surface) -> Option<[f64; 4]> {
        let points = self.unknowns().map(|u| surface.points[u as usize]);
        regulariser_row(points, self.faces.map(|face| surface.areas[face as usize]))
    }
}

/// The weights of the values at a, b, c, d (ends of the edge, opposite corners), whose sum squared is the
/// edge's share of `∫ R_edge² dA`; lengths in, a length out. It vanishes on constants, and on functions linear
/// over the unfolded pair unless a height was bounded.
pub fn regulariser_row([a, b, c, d]: [DVec3; 4], areas: [f64; 2]) -> Option<[f64; 4]> {
    let along = b - a;
    let length = along.length();
    let extent = [length, a.distance(c), b.distance(c), a.distance(d), b.distance(d)].into_iter().fold(0.0, f64::max);
    let heights = areas.map(|area| 2.0 * area / length);
    if !heights.iter().all(|h| h.is_finite() && *h > NO_HEIGHT * extent) {
        return None;
    }
    let [h1, h2] = heights.map(|h| h.max(LEAST_HEIGHT * extent));
    let [s_c, s_d] = [c, d].map(|corner| (corner - a).dot(along) / (length * length));
    let s = (areas[0] + areas[1]) / 3.0;
    let row = [-s * ((1.0 - s_c) / h1 + (1.0 - s_d) / h2), -s * (s_c / h1 + s_d / h2), s / h1, s / h2];
    row.iter().all(|r| r.is_finite()).then_some(row)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn surface(points: &[[f64; 3]], corners: &[[u32; 3]]) -> Surface {
        let points: Vec<_> = points.iter().map(|p| DVec3::from(*p)).collect();
        let area = |[a, b, c]: [u32; 3]| {
            let [a, b, c] = [a, b, c].map(|u| points[u as usize]);
            0.5 * (b - a).cross(c - a).length()
        };
        let areas = corners.iter().map(|c| area(*c)).collect();
        Surface { areas, corners: corners.to_vec(), mesh_face: (0..corners.len() as u32).collect(), points }
    }

    const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn a_square_has_one_interior_edge() {
        let edges = Edges::new(&surface(&SQUARE, &[[0, 1, 2], [0, 2, 3]]));
        assert_eq!(edges.all, [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]);
        assert_eq!(edges.interior, [InteriorEdge { ends: [0, 2], opposite: [3, 1], faces: [1, 0] }]);
    }

    #[test]
    fn inconsistent_windings_and_fans_have_none() {
        assert_eq!(Edges::new(&surface(&SQUARE, &[[0, 1, 2], [0, 3, 2]])).interior, []);
        let fan = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
        assert_eq!(Edges::new(&surface(&fan, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]])).interior, []);
        assert_eq!(Edges::new(&surface(&SQUARE, &[[0, 1, 2], [0, 2, 1]])).interior, [], "a sheet");
    }

    #[test]
    fn repeated_faces_count_once() {
        let once = Edges::new(&surface(&SQUARE, &[[0, 1, 2], [0, 2, 3]]));
        let twice = Edges::new(&surface(&SQUARE, &[[0, 1, 2], [0, 2, 3], [1, 2, 0], [0, 2, 3]]));
        assert_eq!(twice.interior, once.interior);
    }

    #[test]
    fn the_row_of_a_unit_square_by_hand() {
        // Diagonal of the unit square: L = √2, both areas ½, both heights 1/√2, both feet at the middle.
        let [a, b, c, d] = [SQUARE[0], SQUARE[2], SQUARE[3], SQUARE[1]].map(DVec3::from);
        let row = regulariser_row([a, b, c, d], [0.5, 0.5]).unwrap();
        let s_over_h = 2f64.sqrt() / 3.0;
        for (found, expected) in row.iter().zip([-s_over_h, -s_over_h, s_over_h, s_over_h]) {
            assert!((found - expected).abs() < 1e-15, "{row:?}");
        }
    }

    #[test]
    fn the_row_is_the_jump_of_the_gradient_of_a_crease() {
        // f = |y| along the edge y = 0: the gradient jumps by 2, and R = S × jump.
        let points = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.7, 1.5, 0.0], [1.4, -0.8, 0.0]].map(DVec3::from);
        let areas = [1.5, 0.8];
        let row = regulariser_row(points, areas).unwrap();
        let value: f64 = row.iter().zip(points).map(|(r, p)| r * p.y.abs()).sum();
        assert!((value - 2.0 * (areas[0] + areas[1]) / 3.0).abs() < 1e-14, "{value}");
    }

    #[test]
    fn no_height_no_row() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-13, 0.0], [0.5, -1.0, 0.0]].map(DVec3::from);
        assert_eq!(regulariser_row(points, [0.5e-13, 0.5]), None);
    }

    proptest! {
        #[test]
        fn vanishes_on_linear_functions_of_the_unfolded_pair(
            c in (-0.5..1.5f64, 0.5..1.5f64), d in (-0.5..1.5f64, 0.5..1.5f64),
            fold in 0.0..3.0f64, f in (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64), scale in -8i32..9,
        ) {
            let scale = 10f64.powi(scale);
            let flat = [(0.0, 0.0), (1.0, 0.0), c, (d.0, -d.1)];
            let folded = flat.map(|(x, y)| {
                let (sin, cos) = if y < 0.0 { fold.sin_cos() } else { (0.0, 1.0) };
                DVec3::new(x, y * cos, y * sin) * scale
            });
            let areas = [c.1, d.1].map(|h| 0.5 * h * scale * scale);
            let row = regulariser_row(folded, areas).unwrap();
            let value: f64 = row.iter().zip(flat).map(|(r, (x, y))| r * (f.0 + f.1 * x + f.2 * y)).sum();
            prop_assert!(value.abs() <= 1e-13 * scale, "{value}");
            prop_assert!(row.iter().sum::<f64>().abs() <= 1e-14 * scale);
        }

        #[test]
        fn slivers_are_bounded(height in -12.0..-1.0f64, foot in 0.0..1.0f64) {
            let h = 10f64.powf(height);
            let points = [DVec3::ZERO, DVec3::X, DVec3::new(foot, h, 0.0), DVec3::new(0.5, -h, 0.0)];
            let row = regulariser_row(points, [0.5 * h, 0.5 * h]);
            if let Some(row) = row {
                prop_assert!(row.iter().all(|r| r.abs() <= h / 3.0 / LEAST_HEIGHT * 2.0), "{row:?}");
                let greatest = row.iter().fold(0.0, |max: f64, r| max.max(r.abs()));
                prop_assert!(row.iter().sum::<f64>().abs() <= 4.0 * f64::EPSILON * greatest);
            }
        }
    }
}
