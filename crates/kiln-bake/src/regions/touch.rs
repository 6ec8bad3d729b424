//! Which cells a surface comes into: a superset, for it only says where rays are needed.

use super::{SolidObject, grid::Grid};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Triangles are grown by this much, cells, beyond the rounding of what tracers see of them.
const SLACK: f64 = 1e-3;

/// One over how many roundings of f32 a coordinate may be off.
const ROUNDING: f64 = 1.0 / 1_048_576.0;

/// A bit for each cell.
pub(super) struct CellBits(Vec<AtomicU64>);

impl CellBits {
    fn new(count: usize) -> Self {
        Self(std::iter::repeat_with(AtomicU64::default).take(count.div_ceil(64)).collect())
    }

    fn insert(&self, index: usize) {
        self.0[index / 64].fetch_or(1 << (index % 64), Ordering::Relaxed);
    }

    #[cfg(test)]
    pub(super) fn all(count: usize) -> Self {
        Self(std::iter::repeat_with(|| AtomicU64::new(u64::MAX)).take(count.div_ceil(64)).collect())
    }

    pub(super) fn contains(&self, index: usize) -> bool {
        self.0[index / 64].load(Ordering::Relaxed) >> (index % 64) & 1 == 1
    }
}

/// The cells that some face comes into, and perhaps some beside them.
pub(super) fn touched(grid: &Grid, objects: &[SolidObject<'_>]) -> CellBits {
    let bits = CellBits::new(grid.len());
    objects.par_iter().for_each(|object| {
        let faces: Vec<usize> = object.solid_faces().collect();
        faces.par_iter().for_each(|face| {
            let corners = object.corners(*face);
            let far = corners.iter().fold(DVec3::ZERO, |far, corner| far.max(corner.abs())).max_element();
            let slack = SLACK + far * ROUNDING / grid.cell_m;
            let corners = corners.map(|corner| (corner - grid.origin) / grid.cell_m);
            cells_of(corners, slack, grid.size, |cell| bits.insert(grid.index(cell)));
        });
    });
    bits
}

/// Whole numbers from the floor of one number to that of another, within 0 and an end.
fn whole(low: f64, high: f64, end: usize) -> std::ops::Range<usize> {
    let within = |x: f64| x.clamp(0.0, end as f64) as usize;
    within(low.floor())..within(high.floor() + 1.0)
}

/// Calls a function with each cell that a triangle comes near, in units of cells: along the axis that the triangle faces most, those
/// cells between which its plane passes; across it, those that its edges do not leave out.
fn cells_of(corners: [DVec3; 3], slack: f64, size: [usize; 3], mut found: impl FnMut([usize; 3])) {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    if !(normal.is_finite() && normal != DVec3::ZERO) {
        return;
    }
    let steep = normal.abs();
    let axis = (0..3).fold(0, |best, axis| if steep[axis] > steep[best] { axis } else { best });
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let (low, high) = (a.min(b).min(c) - slack, a.max(b).max(c) + slack);
    let (du, dv) = (-normal[u] / normal[axis], -normal[v] / normal[axis]);
    let reach = 0.5 * (du.abs() + dv.abs()) + slack;
    let edges = edges([a, b, c].map(|p| [p[u], p[v]]), slack);
    for iv in whole(low[v], high[v], size[v]) {
        for iu in whole(low[u], high[u], size[u]) {
            let middle = [iu as f64 + 0.5, iv as f64 + 0.5];
            if edges.iter().any(|[x, y, rest]| x * middle[0] + y * middle[1] + rest < 0.0) {
                continue;
            }
            let height = a[axis] + du * (middle[0] - a[u]) + dv * (middle[1] - a[v]);
            let (from, to) = ((height - reach).max(low[axis]), (height + reach).min(high[axis]));
            for along in whole(from, to, size[axis]) {
                let mut cell = [0; 3];
                (cell[u], cell[v], cell[axis]) = (iu, iv, along);
                found(cell);
            }
        }
    }
}

/// Edges of a triangle in the plane, as functions that are negative for the centres of unit squares wholly beyond them.
fn edges(points: [[f64; 2]; 3], slack: f64) -> [[f64; 3]; 3] {
    let [a, b, c] = points;
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    std::array::from_fn(|i| {
        let (from, to) = (points[i], points[(i + 1) % 3]);
        let [x, y] = [(from[1] - to[1]) * area.signum(), (to[0] - from[0]) * area.signum()];
        [x, y, (x.abs() + y.abs()) * (0.5 + slack) - x * from[0] - y * from[1]]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn cells(corners: [DVec3; 3]) -> BTreeSet<[usize; 3]> {
        let mut found = BTreeSet::new();
        cells_of(corners, SLACK, [8, 8, 8], |cell| {
            found.insert(cell);
        });
        found
    }

    #[test]
    fn a_face_between_cells_is_in_both() {
        let found = cells([DVec3::new(1.2, 3.0, 1.2), DVec3::new(2.8, 3.0, 1.2), DVec3::new(1.2, 3.0, 2.8)]);
        let expected = [[1, 1], [2, 1], [1, 2], [2, 2]].iter().flat_map(|[x, z]| [[*x, 2, *z], [*x, 3, *z]]).collect();
        assert!(found.is_subset(&expected) && found.len() >= 6, "{found:?}");
    }

    proptest! {
        /// Every cell that a point of the triangle is in is found, and none far from it.
        #[test]
        fn cells_of_points_are_found(
            corners in prop::array::uniform3(prop::array::uniform3(-1.0f64..9.0)),
            weights in proptest::collection::vec(prop::array::uniform2(0.0f64..1.0), 64),
        ) {
            let corners = corners.map(DVec3::from);
            let found = cells(corners);
            let [a, b, c] = corners;
            for [s, t] in weights {
                let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
                let point = a + (b - a) * s + (c - a) * t;
                if point.min_element() >= 0.0 && point.max_element() < 8.0 {
                    prop_assert!(found.contains(&point.to_array().map(|x| x as usize)), "{point}");
                }
            }
            let normal = (b - a).cross(c - a).normalize_or_zero();
            for cell in found {
                let center = DVec3::from(cell.map(|x| x as f64 + 0.5));
                prop_assert!((center - a).dot(normal).abs() < 1.8);
            }
        }
    }
}
