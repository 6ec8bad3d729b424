//! Watertight intersection of rays with up to eight triangles at once.
//!
//! Whether the line of a ray goes through a triangle is said by three edge functions, d · ((p + q) × (p − q)) for each edge from p
//! to q, its ends relative to the ray's origin (Jones 2000, "Intersecting a ray and a triangle with Plücker coordinates"; the
//! same as 2 d · (q × p), but with errors that grow with the edge, not with the square of its distance). Those of a shared edge are
//! exact negatives of each other (no fused multiply-add is used), so that no ray slips through; a ray on an edge (a function of
//! exactly 0) hits both faces. The products of p and q are common to all rays of one origin: a bundle computes them once
//! for a leaf, and then each ray costs three scalar products, which is why this form was taken, not a shear for each ray
//! (Woop, Benthin and Wald 2013), which `triangle.wgsl` of `kiln-gpu` has.
//!
//! Distances do not come from the edge functions, whose errors grow with the triangle, not with the distance,
//! but from the triangle's plane in f64, rounded to 18 bits (an error of at most 4e-6 of them) so that coincident faces tie. Where
//! rounding may have decided that the ray goes through the triangle, it must also enter the triangle's own box, and the
//! distance is no nearer than that, by the arithmetic that all boxes are tested with. Roundings are monotonic, so a box around
//! others is entered where one of them is, and no later. Elsewhere the ray goes through the triangle for certain, and so enters
//! all boxes around it, no later but for rounding, which `HIT_SLACK` covers. So whatever the tree, what it finds is what
//! testing every triangle finds, to the bit.

use crate::{lanes::Lanes, node::MAX_LEAF, pages::Pages, ray::WIDEN};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Set in a primitive id whose face counts as front from either side.
pub const TWO_SIDED_BIT: u32 = 1 << 31;

/// Set in a primitive id whose corners are in the order of the other winding. Corners are kept in an order of their own, so
/// that coincident faces have the same distance to the bit, whichever corner they begin with and whichever way they face.
pub const FLIPPED_BIT: u32 = 1 << 30;

/// The face that a primitive id names.
pub(crate) fn face_of(primitive: u32) -> u32 {
    primitive & !(TWO_SIDED_BIT | FLIPPED_BIT)
}

/// Words of a triangle: nine coordinates and its id.
const WORDS: usize = 10;

/// Triangles that one task of the thread pool writes, about.
const TRIANGLES_PER_TASK: usize = 1 << 13;

/// Words from the first of a leaf on that are read as one piece: what the rows of eight triangles need, and eight lanes more.
const LEAF_WORDS: usize = (WORDS + 1) * MAX_LEAF;

/// Words after the last triangle, so that there are [`LEAF_WORDS`] from the first of any leaf on.
const SLACK: usize = LEAF_WORDS - WORDS;

/// The triangles of a mesh in the order of its tree's leaves.
///
/// The triangles of a leaf, n in number, are ten rows of n words: x, y, z of the first corners, of the second and of the
/// third, then the ids. Eight lanes are read of each row, whose last ones belong to what follows and do not count:
/// so no word is wasted on lanes that are not used.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TriangleRuns {
    words: Pages<f32>,
    /// Bit i: triangle i is the first of a leaf. One bit more, set, ends the last leaf.
    begins: Vec<u64>,
    count: usize,
}

impl TriangleRuns {
    /// The triangles of leaves, which are runs of all; `triangle` tells the corners and id of each.
    pub(crate) fn new(
        count: usize,
        leaves: impl Iterator<Item = (u32, u32)>,
        triangle: impl Fn(u32) -> ([Vec3; 3], u32) + Sync,
    ) -> Self {
        let mut begins = vec![0; count / 64 + 1];
        begins[count / 64] = 1 << (count % 64);
        leaves.for_each(|(first, _)| begins[first as usize / 64] |= 1 << (first % 64));
        let mut words = Pages::zeroed(WORDS * count + SLACK);
        let mut runs = Self { words: Pages::default(), begins, count };
        // Whole leaves for each task.
        let (mut parts, mut rest, mut first) = (Vec::new(), &mut *words, 0);
        while first < count {
            let end = runs.begin_from((first + TRIANGLES_PER_TASK).min(count));
            let (part, after) = rest.split_at_mut(WORDS * (end - first));
            parts.push((first, part));
            (rest, first) = (after, end);
        }
        parts.into_par_iter().for_each(|(first, words)| runs.fill(first, words, &triangle));
        runs.words = words;
        runs
    }

    /// Number of triangles.
    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// The first beginning of a leaf from a triangle on.
    fn begin_from(&self, triangle: usize) -> usize {
        let is_first = |i: &usize| self.begins[i / 64] >> (i % 64) & 1 == 1;
        (triangle..self.count).find(is_first).unwrap_or(self.count)
    }

    /// Writes the rows of leaves from the first on.
    fn fill(&self, mut first: usize, mut words: &mut [f32], triangle: &impl Fn(u32) -> ([Vec3; 3], u32)) {
        while !words.is_empty() {
            let n = self.begin_from(first + 1) - first;
            let (rows, rest) = words.split_at_mut(WORDS * n);
            for lane in 0..n {
                let (corners, id) = triangle((first + lane) as u32);
                let coordinates = corners.iter().flat_map(Vec3::to_array);
                for (row, word) in coordinates.chain([f32::from_bits(id)]).enumerate() {
                    rows[row * n + lane] = word;
                }
            }
            (words, first) = (rest, first + n);
        }
    }

    /// First triangle and number of triangles of the leaf that a triangle is in.
    fn leaf_of(&self, index: u32) -> (u32, u32) {
        let is_first = |i: u32| self.begins[i as usize / 64] >> (i % 64) & 1 == 1;
        let first = (0..=index).rev().find(|&i| is_first(i)).unwrap_or(0);
        let end = (index + 1..).find(|&i| is_first(i)).unwrap_or(index + 1);
        (first, end - first)
    }

    /// Corners and id of a triangle.
    pub(crate) fn triangle(&self, index: u32) -> ([Vec3; 3], u32) {
        let (first, count) = self.leaf_of(index);
        let lane = index - first;
        let leaf = self.leaf(first, count);
        (leaf.corners(lane as usize), leaf.id(lane as usize))
    }

    /// Id of a lane of a leaf.
    #[inline(always)]
    pub(crate) fn id(&self, first: u32, count: u32, lane: u32) -> u32 {
        self.leaf(first, count).id(lane as usize)
    }

    /// The triangles as they are traced.
    #[inline(always)]
    pub(crate) fn words(&self) -> TriangleWords<'_> {
        TriangleWords(&self.words)
    }

    /// A leaf.
    pub(crate) fn leaf(&self, first: u32, count: u32) -> Leaf<'_> {
        self.words().leaf(first, count)
    }

    /// Size in memory, bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        size_of_val(&*self.words) + size_of_val(self.begins.as_slice())
    }
}

/// The words of a mesh's triangles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleWords<'a>(&'a [f32]);

impl<'a> TriangleWords<'a> {
    /// Asks for the first lines of a leaf.
    #[inline(always)]
    pub(crate) fn prefetch<V: Lanes>(&self, first: u32) {
        let at = WORDS * first as usize;
        V::prefetch(self.0.get(at..at + 48).unwrap_or_default());
    }

    /// A leaf.
    #[inline(always)]
    pub(crate) fn leaf(&self, first: u32, count: u32) -> Leaf<'a> {
        let words = self.0[WORDS * first as usize..].first_chunk().expect("there is slack after the last leaf");
        Leaf { words, count: (count as usize - 1) % MAX_LEAF + 1 }
    }
}

/// The triangles of a leaf.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leaf<'a> {
    words: &'a [f32; LEAF_WORDS],
    /// 1 to 8.
    count: usize,
}

impl Leaf<'_> {
    /// Eight words of a row.
    #[inline(always)]
    fn row(&self, row: usize) -> &[f32; 8] {
        self.words[row * self.count..].first_chunk().expect("eight words follow every row")
    }

    /// A word of a row.
    #[inline(always)]
    fn word(&self, row: usize, lane: usize) -> f32 {
        self.words[row * self.count + lane % MAX_LEAF]
    }

    /// Corners of a triangle.
    #[inline(always)]
    pub(crate) fn corners(&self, lane: usize) -> [Vec3; 3] {
        let corner = |row: usize| Vec3::new(self.word(row, lane), self.word(row + 1, lane), self.word(row + 2, lane));
        [corner(0), corner(3), corner(6)]
    }

    /// Id of a triangle.
    #[inline(always)]
    pub(crate) fn id(&self, lane: usize) -> u32 {
        self.word(9, lane).to_bits()
    }

    /// The edges of the triangles as rays from an origin see them.
    #[inline(always)]
    pub(crate) fn edges<V: Lanes>(&self, origin: [f32; 3]) -> Edges<V> {
        let (a, b, c) = (self.relative::<V>(0, origin), self.relative::<V>(3, origin), self.relative::<V>(6, origin));
        Edges { normals: [beside(b, c), beside(c, a), beside(a, b)], used: (1 << self.count) - 1 }
    }

    /// Corners relative to an origin, from a row on.
    #[inline(always)]
    fn relative<V: Lanes>(&self, row: usize, origin: [f32; 3]) -> [V; 3] {
        let x = V::load(self.row(row)).sub(V::splat(origin[0]));
        let y = V::load(self.row(row + 1)).sub(V::splat(origin[1]));
        let z = V::load(self.row(row + 2)).sub(V::splat(origin[2]));
        [x, y, z]
    }

    /// A triangle as rays from an origin see it.
    #[inline(always)]
    pub(crate) fn seen(&self, lane: usize, origin: [f32; 3]) -> SeenTriangle {
        let [a, b, c] = self.corners(lane).map(Vec3::as_dvec3);
        let (ab, ac, from_origin) = (b - a, c - a, a - Vec3::from_array(origin).as_dvec3());
        let normal = ab.cross(ac);
        // More than any coordinate of a corner relative to the origin.
        let extent = (from_origin.abs() + ab.abs() + ac.abs()).element_sum();
        SeenTriangle {
            normal,
            height: normal.dot(from_origin),
            error: EDGE_ERROR * extent * extent,
            primitive: self.id(lane),
        }
    }
}

/// For each edge of up to eight triangles the vector that tells on which side of it a ray from some origin passes.
#[derive(Clone, Copy)]
pub(crate) struct Edges<V> {
    normals: [[V; 3]; 3],
    /// Lanes that have triangles.
    used: u32,
}

impl<V: Lanes> Edges<V> {
    /// Lanes whose triangles the line of a ray goes through; and how far inside of their edges, as the least of the edge functions.
    #[inline(always)]
    pub(crate) fn crossed(&self, direction: [f32; 3]) -> (u32, [f32; 8]) {
        let [x, y, z] = [V::splat(direction[0]), V::splat(direction[1]), V::splat(direction[2])];
        let [p, q, r] = &self.normals;
        let u = p[0].mul(x).add(p[1].mul(y)).add(p[2].mul(z));
        let v = q[0].mul(x).add(q[1].mul(y)).add(q[2].mul(z));
        let w = r[0].mul(x).add(r[1].mul(y)).add(r[2].mul(z));
        let zero = V::splat(0.0);
        let least = u.min(v).min(w);
        let greatest = u.max(v).max(w);
        // Not negative where all functions have one sign.
        let margin = least.max(zero.sub(greatest));
        let mut margins = [0.0; 8];
        margin.store(&mut margins);
        (V::bits(zero.le(margin)) & self.used, margins)
    }
}

/// A triangle as rays from one origin see it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SeenTriangle {
    /// Across its plane; as long as twice its area.
    normal: DVec3,
    /// The plane's distance from the origin along the normal, times its length.
    height: f64,
    /// Bound on the error of its edge functions, for directions whose coordinates sum up to 1.
    error: f64,
    /// Its id.
    pub(crate) primitive: u32,
}

impl SeenTriangle {
    /// Where a ray meets the plane, if its line goes through the triangle by a margin: distance, and whether the corners are
    /// seen counter-clockwise. Nothing behind the ray, beyond `t_max`, or in the plane. `entry` tells where the ray enters the
    /// triangle's own box.
    #[inline(always)]
    pub(crate) fn meet(
        &self,
        direction: [f32; 3],
        margin: f32,
        t_max: f32,
        entry: impl FnOnce() -> Option<f32>,
    ) -> Option<(f32, bool)> {
        let direction = Vec3::from_array(direction).as_dvec3();
        let slope = self.normal.dot(direction);
        // Behind, most of all the surface that the ray starts on.
        if (self.height > 0.0) != (slope > 0.0) {
            return None;
        }
        // Where the slope is 0 this is no number, or infinite.
        let mut t = (self.height / slope) as f32;
        if !(t > 0.0 && t < f32::INFINITY) {
            return None;
        }
        if f64::from(margin) <= self.error * direction.abs().element_sum() {
            t = t.max(entry()?);
        }
        let t = coarse(t);
        (t <= t_max).then_some((t, slope < 0.0))
    }
}

/// Bound on the error of an edge function, for corners whose coordinates relative to the ray's origin are at most 1 and a
/// direction whose coordinates sum up to 1. In units of 2⁻²⁴: sums and differences of corners have errors of 4, so each of their
/// products, at most 4, has one of 20; the difference of two adds 8, the product with the direction 8, the two sums 16.
const EDGE_ERROR: f64 = 80.0 / 16_777_216.0;

/// Where a ray enters the box of a triangle, by the arithmetic of all boxes; nothing if it does not.
#[inline(never)]
pub(crate) fn entry([a, b, c]: [Vec3; 3], origin: [f32; 3], inverse: [f32; 3]) -> Option<f32> {
    let (origin, inverse) = (Vec3::from_array(origin), Vec3::from_array(inverse));
    let [low, high] = [a.min(b).min(c), a.max(b).max(c)].map(|plane| (plane - origin) * inverse);
    // The nearer of both is the one that the direction's sign tells, since roundings are monotonic.
    let near = low.min(high).max_element().max(0.0);
    (near <= low.max(high).min_element() * WIDEN).then_some(near)
}

/// A distance to 18 bits, so that faces of different instances that coincide tie although their rays were rounded on the
/// way into object space: modular kits are full of walls back to back, and the front one is to be found. It keeps the
/// order of distances.
#[inline(always)]
fn coarse(t: f32) -> f32 {
    f32::from_bits((t.to_bits() + 32) & !63)
}

/// (p + q) × (p − q), which is 2 q × p.
#[inline(always)]
fn beside<V: Lanes>(p: [V; 3], q: [V; 3]) -> [V; 3] {
    let sum = [p[0].add(q[0]), p[1].add(q[1]), p[2].add(q[2])];
    let edge = [p[0].sub(q[0]), p[1].sub(q[1]), p[2].sub(q[2])];
    [
        sum[1].mul(edge[2]).sub(sum[2].mul(edge[1])),
        sum[2].mul(edge[0]).sub(sum[0].mul(edge[2])),
        sum[0].mul(edge[1]).sub(sum[1].mul(edge[0])),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{lanes::Portable, ray::TracedRay};
    use proptest::prelude::*;

    fn one(corners: [Vec3; 3], origin: Vec3, direction: Vec3) -> Option<(f32, bool)> {
        let flat = ([Vec3::ONE; 3], 4);
        let all = [flat, flat, flat, (corners, 5), flat, (corners, 6)];
        let runs = TriangleRuns::new(6, [(0, 2), (2, 3), (5, 1)].into_iter(), |i| all[i as usize]);
        let ray = TracedRay::new(origin, direction);
        let (lanes, margins) = runs.leaf(2, 3).edges::<Portable>(ray.origin).crossed(ray.direction);
        let meet = |lane: usize| {
            let entry = || entry(runs.leaf(2, 3).corners(lane), ray.origin, ray.inverse);
            let seen = runs.leaf(2, 3).seen(lane, ray.origin);
            seen.meet(ray.direction, margins[lane], f32::INFINITY, entry)
        };
        assert!([0, 2].into_iter().all(|lane| lanes >> lane & 1 == 0 || meet(lane).is_none()), "a flat lane was hit");
        if lanes >> 1 & 1 == 1 { meet(1) } else { None }
    }

    #[test]
    fn front_is_counter_clockwise() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        for direction in [Vec3::NEG_Z, Vec3::new(0.1, -0.2, -3.0)] {
            let origin = Vec3::new(0.25, 0.25, 0.0) - direction * 2.0;
            let (t, front) = one(corners, origin, direction).unwrap();
            assert!((t - 2.0).abs() < 1e-6 && front);
            let (t, front) = one(corners, Vec3::new(0.25, 0.25, 0.0) + direction * 2.0, -direction).unwrap();
            assert!((t - 2.0).abs() < 1e-6 && !front);
        }
        assert_eq!(one(corners, Vec3::new(0.25, 0.25, 1.0), Vec3::Z), None);
        assert_eq!(one(corners, Vec3::new(0.75, 0.75, 1.0), Vec3::NEG_Z), None);
    }

    #[test]
    fn triangles_are_found_again() {
        const COUNT: u32 = 30_000;
        let triangle = |i: u32| ([Vec3::X, Vec3::Y, Vec3::Z].map(|axis| axis * i as f32), i | TWO_SIDED_BIT);
        let mut leaves = Vec::new();
        let mut first = 0;
        for n in (1..=8).cycle() {
            let n = n.min(COUNT - first);
            if n == 0 {
                break;
            }
            leaves.push((first, n));
            first += n;
        }
        // In any order.
        leaves.reverse();
        let runs = TriangleRuns::new(COUNT as usize, leaves.into_iter(), triangle);
        assert!((0..COUNT).all(|i| runs.triangle(i) == triangle(i)));
    }

    fn point() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-1f32..1.0).prop_map(Vec3::from_array)
    }

    proptest! {
        /// Rays through points of a shared edge, and near it, hit at least one of the two faces.
        #[test]
        fn no_ray_slips_through_a_shared_edge(a in point(), b in point(), c in point(), d in point(), origin in point(), s in 0f32..=1.0) {
            // The two faces must lie on different sides of the plane through the edge and the ray.
            let target = a + (b - a) * s;
            let plane = (b - a).cross(target - origin);
            let side = |p: Vec3| plane.dot(p - a);
            let mirrored = |p: Vec3| a + a - p;
            let c = if side(c) > 0.0 { c } else { mirrored(c) };
            let d = if side(d) < 0.0 { d } else { mirrored(d) };
            prop_assume!(side(c) > 1e-3 && side(d) < -1e-3 && (target - origin).length() > 1e-2);
            prop_assume!((0.001..0.999).contains(&s));
            let direction = target - origin;
            let hits = [one([a, b, c], origin, direction), one([b, a, d], origin, direction)];
            prop_assert!(hits.iter().any(Option::is_some));
        }

        /// A coincident face of opposite winding has bit for bit the same distance.
        #[test]
        fn opposite_faces_tie(a in point(), b in point(), c in point(), origin in point(), direction in point()) {
            prop_assume!(direction.length() > 0.1);
            let one_way = one([a, b, c], origin, direction);
            let other_way = one([a, c, b], origin, direction);
            prop_assert_eq!(one_way.is_some(), other_way.is_some());
        }

        /// Against the plane equation in f64.
        #[test]
        fn distances_match_the_plane(a in point(), b in point(), c in point(), origin in point(), s in 0.05f32..0.9, r in 0.05f32..0.9) {
            prop_assume!(s + r < 0.95);
            let normal = (b - a).as_dvec3().cross((c - a).as_dvec3());
            let target = a + (b - a) * s + (c - a) * r;
            let direction = target - origin;
            let slope = normal.dot(direction.as_dvec3());
            prop_assume!(slope.abs() > 0.02);
            let expected = normal.dot((a - origin).as_dvec3()) / slope;
            let (t, front) = one([a, b, c], origin, direction).expect("aimed inside");
            prop_assert!((f64::from(t) - expected).abs() < 1e-4, "{t} {expected}");
            prop_assert_eq!(front, slope < 0.0);
        }
    }
}
