//! Whether two tracers find the same hits.

use super::files::{FileHit, RaySet};
use glam::{DVec3, Vec3};
use kiln_core::Mesh;
use serde::Serialize;

/// Distances further apart than this, relative to the greater, count as different.
const T_TOLERANCE: f64 = 1e-5;
/// Share of the rays on which Kiln may be wrong: those that graze an edge, where both answers are right to rounding.
const SHARE_TOLERANCE: f64 = 1e-5;
/// A ray goes through a triangle in f64 if no barycentric coordinate is less than this below 0.
const INSIDE_TOLERANCE: f64 = 1e-6;
/// Disagreements that are listed.
const LISTED: usize = 5;

/// How the closest hits of all rays compare.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Agreement {
    /// The other tracer.
    pub(super) against: String,
    pub(super) rays: usize,
    pub(super) kiln_hits: usize,
    pub(super) peer_hits: usize,
    /// One hits, the other misses.
    pub(super) hit_differs: usize,
    /// Both hit, at distances that differ by more than [`T_TOLERANCE`].
    pub(super) distance_differs: usize,
    /// Of the rays that differ, those whose first hit in f64, of the two that were found, is not Kiln's.
    pub(super) kiln_wrong: usize,
    /// Kiln's hits whose distance is further than [`T_TOLERANCE`] from where the ray meets the triangle's plane in f64: rays
    /// that graze a surface, or start near it.
    pub(super) kiln_off_f64: usize,
    /// The same of the other's hits.
    pub(super) peer_off_f64: usize,
    /// Different triangles at the same distance: edges, and faces that coincide.
    pub(super) ties: usize,
    /// The same triangle at the same distance, but from the other side: of coincident faces of opposite winding Kiln
    /// makes one that is front from either side.
    pub(super) side_differs: usize,
    /// Greatest relative difference of distances within the tolerance.
    pub(super) greatest_within: f64,
    /// Mean relative difference of distances within the tolerance.
    pub(super) mean_within: f64,
    /// The worst, hits against misses first.
    pub(super) worst: Vec<Disagreement>,
}

/// A ray on which they differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Disagreement {
    pub(super) ray: usize,
    pub(super) origin: [f32; 3],
    pub(super) direction: [f32; 3],
    pub(super) kiln: FileHit,
    pub(super) peer: FileHit,
    /// Distance to the plane of Kiln's triangle, or of the other's where Kiln misses, in f64.
    pub(super) f64_t: f64,
    /// Relative difference of the distances; infinite where one misses.
    #[serde(skip)]
    difference: f64,
}

impl Agreement {
    /// Compares hits of the same rays, in the same order, on triangles of a mesh.
    pub(super) fn of(against: &str, rays: &RaySet, mesh: &Mesh, kiln: &[FileHit], peer: &[FileHit]) -> Self {
        let count_hits = |hits: &[FileHit]| hits.iter().filter(|hit| hit.is_hit()).count();
        let mut found = Self {
            against: against.to_owned(),
            rays: kiln.len(),
            kiln_hits: count_hits(kiln),
            peer_hits: count_hits(peer),
            hit_differs: 0,
            distance_differs: 0,
            kiln_wrong: 0,
            kiln_off_f64: 0,
            peer_off_f64: 0,
            ties: 0,
            side_differs: 0,
            greatest_within: 0.0,
            mean_within: 0.0,
            worst: Vec::new(),
        };
        let mut within = 0.0;
        for (ray, (kiln, peer)) in kiln.iter().zip(peer).enumerate() {
            let difference = difference(kiln, peer);
            let (origin, direction) = rays.ray(ray);
            let f64_t = |hit: &FileHit| plane_distance(mesh, hit, origin, direction);
            found.kiln_off_f64 += usize::from(is_off(kiln, f64_t(kiln)));
            found.peer_off_f64 += usize::from(is_off(peer, f64_t(peer)));
            if difference > T_TOLERANCE {
                let is_miss = kiln.is_hit() != peer.is_hit();
                *(if is_miss { &mut found.hit_differs } else { &mut found.distance_differs }) += 1;
                let [kiln_t, peer_t] = [kiln, peer].map(|hit| confirmed(mesh, hit, origin, direction));
                found.kiln_wrong += usize::from(!is_first(kiln, kiln_t, peer_t));
                let f64_t = f64_t(if kiln.is_hit() { kiln } else { peer });
                found.list(Disagreement { ray, origin, direction, kiln: *kiln, peer: *peer, f64_t, difference });
            } else if kiln.is_hit() {
                within += difference;
                found.add_same(kiln, peer, difference);
            }
        }
        found.mean_within = within / found.kiln_hits.max(1) as f64;
        found
    }

    fn add_same(&mut self, kiln: &FileHit, peer: &FileHit, difference: f64) {
        self.greatest_within = self.greatest_within.max(difference);
        self.ties += usize::from(kiln.triangle != peer.triangle);
        self.side_differs += usize::from(kiln.triangle == peer.triangle && kiln.is_back != peer.is_back);
    }

    fn list(&mut self, disagreement: Disagreement) {
        let at = self.worst.partition_point(|listed| listed.difference >= disagreement.difference);
        self.worst.insert(at, disagreement);
        self.worst.truncate(LISTED);
    }

    /// Rays on which they differ.
    pub(super) fn differing(&self) -> usize {
        self.hit_differs + self.distance_differs
    }

    /// Whether Kiln is wrong on at most [`SHARE_TOLERANCE`] of the rays.
    pub(super) fn holds(&self) -> bool {
        self.kiln_wrong as f64 <= SHARE_TOLERANCE * self.rays as f64
    }
}

/// Where a ray meets the plane of the triangle that it hit; not a number without a triangle.
fn plane_distance(mesh: &Mesh, hit: &FileHit, origin: [f32; 3], direction: [f32; 3]) -> f64 {
    if hit.triangle as usize >= mesh.faces.len() {
        return f64::NAN;
    }
    let [a, b, c] = mesh.corners(hit.triangle as usize).map(Vec3::as_dvec3);
    let [origin, direction] = [origin, direction].map(|v| DVec3::from(v.map(f64::from)));
    let normal = (b - a).cross(c - a);
    normal.dot(a - origin) / normal.dot(direction)
}

/// The distance of a hit in f64, if the ray meets its triangle there.
fn confirmed(mesh: &Mesh, hit: &FileHit, origin: [f32; 3], direction: [f32; 3]) -> Option<f64> {
    let t = plane_distance(mesh, hit, origin, direction);
    if !hit.is_hit() || t.is_nan() || t < 0.0 || is_off(hit, t) {
        return None;
    }
    let [a, b, c] = mesh.corners(hit.triangle as usize).map(Vec3::as_dvec3);
    let [origin, direction] = [origin, direction].map(|v| DVec3::from(v.map(f64::from)));
    let (normal, at) = ((b - a).cross(c - a), origin + direction * t);
    let parts = [(a, b), (b, c), (c, a)].map(|(p, q)| (q - p).cross(at - p).dot(normal));
    parts.iter().all(|part| *part >= -INSIDE_TOLERANCE * normal.length_squared()).then_some(t)
}

/// Whether what Kiln found is right, as far as the other's answer can tell.
fn is_first(kiln: &FileHit, kiln_t: Option<f64>, peer_t: Option<f64>) -> bool {
    match (kiln_t, peer_t) {
        (Some(kiln), Some(peer)) => kiln <= peer * (1.0 + T_TOLERANCE),
        (Some(_), None) => true,
        (None, _) => !kiln.is_hit() && peer_t.is_none(),
    }
}

/// Whether a hit is not at a distance that was found in f64, which may be none.
fn is_off(hit: &FileHit, f64_t: f64) -> bool {
    let t = f64::from(hit.t);
    let is_near = (t - f64_t).abs() <= T_TOLERANCE * t.max(f64_t.abs());
    hit.is_hit() && !is_near
}

/// Relative difference of two distances; infinite where one is a miss.
fn difference(a: &FileHit, b: &FileHit) -> f64 {
    match (a.is_hit(), b.is_hit()) {
        (false, false) => 0.0,
        (true, true) => {
            let (a, b) = (f64::from(a.t), f64::from(b.t));
            if a == b { 0.0 } else { (a - b).abs() / a.abs().max(b.abs()) }
        }
        _ => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles in the plane x = 1.
    fn wall() -> Mesh {
        let corners = [[1.0, -1.0, -1.0], [1.0, 2.0, 0.0], [1.0, 0.0, 2.0]];
        Mesh { positions: corners.to_vec(), faces: vec![[0, 1, 2]; 5], ..Mesh::default() }
    }

    fn compare(rays: &RaySet, kiln: &[FileHit], peer: &[FileHit]) -> Agreement {
        Agreement::of("other", rays, &wall(), kiln, peer)
    }

    fn hit(t: f32, triangle: u32) -> FileHit {
        FileHit { t, triangle, is_back: false }
    }

    fn rays(count: usize) -> RaySet {
        let directions: Vec<[f32; 3]> = (0..count).map(|i| [1.0, 0.125 * i as f32, 0.0]).collect();
        let (origins, normals) = (vec![[0.0; 3]], vec![[0.0, 1.0, 0.0]]);
        RaySet { per_point: count, diagonal_m: 1.0, origins, normals, directions }
    }

    #[test]
    fn every_kind_is_counted() {
        let back = FileHit { is_back: true, ..hit(1.0, 3) };
        let kiln = [hit(1.0, 1), hit(1.0, 1), hit(1.0, 1), FileHit::MISS, hit(1.0, 3), FileHit::MISS, hit(2.0, 4)];
        let peer = [hit(1.0, 1), hit(1.0, 2), hit(1.1, 1), hit(1.0, 1), back, FileHit::MISS, hit(2.000_01, 4)];
        let found = compare(&rays(7), &kiln, &peer);
        assert_eq!((found.rays, found.kiln_hits, found.peer_hits), (7, 5, 6));
        assert_eq!((found.hit_differs, found.distance_differs, found.ties, found.side_differs), (1, 1, 1, 1));
        // The wall is at 1: Kiln's miss, its hit at 2, and none of the other's two.
        assert_eq!(found.kiln_wrong, 1);
        // All rays meet the wall at t = 1.
        assert_eq!((found.kiln_off_f64, found.peer_off_f64), (1, 2));
        assert!(found.greatest_within > 4e-6 && found.greatest_within < 6e-6, "{}", found.greatest_within);
        assert_eq!(found.worst.iter().map(|worst| worst.ray).collect::<Vec<_>>(), [3, 2]);
        assert_eq!((found.worst[0].direction, found.worst[0].f64_t), ([1.0, 0.375, 0.0], 1.0));
        assert!(!found.holds());
    }

    #[test]
    fn one_ray_in_a_hundred_thousand_may_be_wrong() {
        let count = 200_000;
        let peer = vec![hit(1.0, 1); count];
        let mut kiln = peer.clone();
        (kiln[5], kiln[6]) = (FileHit::MISS, hit(2.0, 1));
        assert!(compare(&rays(count), &kiln, &peer).holds());
        kiln[7] = FileHit::MISS;
        let found = compare(&rays(count), &kiln, &peer);
        assert!(!found.holds() && found.hit_differs == 2 && found.distance_differs == 1);
        // What the other gets wrong is not Kiln's fault.
        let swapped = compare(&rays(count), &peer, &kiln);
        assert_eq!((swapped.differing(), swapped.kiln_wrong), (3, 0));
    }

    #[test]
    fn the_worst_are_kept() {
        let kiln = vec![hit(1.0, 1); 20];
        let peer: Vec<FileHit> = (0..20).map(|i| hit(1.0 + 0.1 * i as f32, 1)).collect();
        let found = compare(&rays(20), &kiln, &peer);
        assert_eq!(found.worst.iter().map(|worst| worst.ray).collect::<Vec<_>>(), [19, 18, 17, 16, 15]);
    }
}
