//! Round surfaces: spheres, disks, cylinders and turned profiles.
//!
//! Where a round shape stands for an exact one, the polygon is scaled so that its area (disk) or volume (sphere)
//! is the exact one: the distance to it is then right on average, and what is left in an integral over directions
//! is of second order in the depth of a facet.

use super::surface::Surface;
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// A sphere about the origin, facing outwards, of `20 · 4^level` triangles, with the volume of the exact sphere.
pub(super) fn sphere(radius: f64, level: u32) -> Surface {
    let (mut points, mut faces) = icosahedron();
    for _ in 0..level {
        (points, faces) = halved(points, &faces);
    }
    let volume: f64 = faces.iter().map(|&f| triple_product(f.map(|v| points[v as usize])) / 6.0).sum();
    let scale = radius * (4.0 / 3.0 * PI / volume).cbrt();
    Surface { positions: points.iter().map(|&p| scale * p).collect(), normals: points, faces }
}

fn triple_product([a, b, c]: [DVec3; 3]) -> f64 {
    a.dot(b.cross(c))
}

/// Unit vectors and outward faces.
fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let signs = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let points: Vec<DVec3> = (0..3)
        .flat_map(|axis| {
            signs.map(|(s, t)| {
                let mut p = [0.0; 3];
                p[axis] = s;
                p[(axis + 1) % 3] = t * golden;
                DVec3::from_array(p).normalize()
            })
        })
        .collect();
    // Neighbours are the pairs at the least distance, and faces the triples of neighbours.
    let near = |a: u32, b: u32| points[a as usize].dot(points[b as usize]) > 0.4;
    let mut faces = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    let outward = triple_product([a, b, c].map(|v| points[v as usize])) > 0.0;
                    faces.push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    (points, faces)
}

/// Each face cut in four at the middles of its edges, which move onto the unit sphere.
fn halved(mut points: Vec<DVec3>, faces: &[[u32; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut middles = BTreeMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            let point = (points[a as usize] + points[b as usize]).normalize();
            points.push(point);
            points.len() as u32 - 1
        })
    };
    let cut = |&[a, b, c]: &[u32; 3]| {
        let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    };
    let faces = faces.iter().flat_map(cut).collect();
    (points, faces)
}

/// Unit vector of a segment's corner in the horizontal plane, counter-clockwise seen from above; the last corner
/// is the first again to the last bit.
fn spoke(corner: f64, segments: u32) -> DVec3 {
    let angle = TAU * (corner % f64::from(segments)) / f64::from(segments);
    DVec3::new(angle.cos(), 0.0, -angle.sin())
}

fn corners(segments: u32) -> Vec<f64> {
    (0..=segments).map(f64::from).collect()
}

/// A horizontal disk about the origin, facing up, of the exact disk's area.
pub(super) fn disk(radius: f64, segments: u32, rings: u32) -> Surface {
    let n = f64::from(segments);
    disk_through(radius * (TAU / (n * (TAU / n).sin())).sqrt(), segments, rings)
}

/// A horizontal disk about the origin, facing up, whose corners are at the radius.
fn disk_through(radius: f64, segments: u32, rings: u32) -> Surface {
    let mut surface = Surface::default();
    let centre = surface.vertex(DVec3::ZERO, DVec3::Y);
    let ring_radius = |ring: u32| radius * f64::from(ring) / f64::from(rings);
    let ring: Vec<u32> =
        (0..segments).map(|i| surface.vertex(ring_radius(1) * spoke(f64::from(i), segments), DVec3::Y)).collect();
    for i in 0..segments {
        surface.faces.push([centre, ring[i as usize], ring[((i + 1) % segments) as usize]]);
    }
    if rings > 1 {
        let radii: Vec<f64> = (1..=rings).map(ring_radius).collect();
        surface
            .append(&Surface::patch(&radii, &corners(segments), |r, corner| (r * spoke(corner, segments), DVec3::Y)));
    }
    surface
}

/// A horizontal tube along x about the origin, facing inwards, whose cross-section has the exact circle's area.
pub(super) fn tube_inside(radius: f64, xs: &[f64], segments: u32) -> Surface {
    let n = f64::from(segments);
    let radius = radius * (TAU / (n * (TAU / n).sin())).sqrt();
    Surface::patch(&corners(segments), xs, |corner, x| {
        let spoke = spoke(corner, segments);
        let radial = DVec3::new(0.0, spoke.x, spoke.z);
        (DVec3::X * x + radius * radial, -radial)
    })
}

/// A profile turned about the vertical axis: runs of points (radius, y) from the bottom up, each run smooth in
/// itself, with hard edges between runs and flat caps at both ends. Closed.
pub(super) fn turned(runs: &[Vec<DVec2>], segments: u32) -> Surface {
    let mut surface = Surface::default();
    for run in runs {
        let parameters: Vec<f64> = (0..run.len() as u32).map(f64::from).collect();
        surface.append(&Surface::patch(&corners(segments), &parameters, |corner, i| {
            let i = i as usize;
            let tangent = (run[(i + 1).min(run.len() - 1)] - run[i.saturating_sub(1)]).normalize();
            let spoke = spoke(corner, segments);
            (run[i].x * spoke + run[i].y * DVec3::Y, tangent.y * spoke - tangent.x * DVec3::Y)
        }));
    }
    let ends = (runs.first().and_then(|run| run.first()), runs.last().and_then(|run| run.last()));
    if let (Some(bottom), Some(top)) = ends {
        let cap = |end: &DVec2| {
            let mut cap = disk_through(end.x, segments, 1);
            cap.positions.iter_mut().for_each(|p| p.y = end.y);
            cap
        };
        surface.append(&cap(bottom).flipped());
        surface.append(&cap(top));
    }
    surface
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sphere_has_its_volume_and_count() {
        for level in 0..4 {
            let sphere = sphere(2.0, level);
            assert_eq!(sphere.faces.len(), 20 << (2 * level));
            assert_eq!(sphere.positions.len(), (10 << (2 * level)) + 2);
            let volume: f64 =
                sphere.faces.iter().map(|f| triple_product(f.map(|v| sphere.positions[v as usize])) / 6.0).sum();
            assert!((volume - 32.0 / 3.0 * PI).abs() < 1e-12);
        }
    }

    #[test]
    fn disk_has_its_area() {
        let disk = disk(1.5, 96, 3);
        let area: f64 = disk
            .faces
            .iter()
            .map(|f| {
                let [a, b, c] = f.map(|v| disk.positions[v as usize]);
                0.5 * (b - a).cross(c - a).y
            })
            .sum();
        assert!((area - 2.25 * PI).abs() < 1e-12, "{area}");
    }

    #[test]
    fn turned_normals_point_out() {
        let cone = turned(&[vec![DVec2::new(2.0, 0.0), DVec2::new(1.0, 1.0)]], 16);
        for (p, n) in cone.positions.iter().zip(&cone.normals) {
            assert!((p - DVec3::Y * 0.5).dot(*n) > 0.0 && n.is_normalized());
        }
    }
}
