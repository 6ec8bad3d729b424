//! Shrubs near each other, up to 16 in one leaf of the tree.
//!
//! A leaf of many things costs nodes little: with its records and its part of the nodes a shrub takes some 20 bytes. What it
//! would cost rays is kept low by a test of eight shrubs at once, against the spheres around their boxes, for which no axes have to be unpacked.
//!
//! Groups are full: shrubs are parted by the surface area heuristic (Goldsmith and Salmon 1987) at multiples of 16 along
//! an axis, until 16 are left. A group that is too large for 16 bits of its lattice is parted again.

use super::shrub::{FogBox, LEAST_HALF, STEP_M, Shrub, ShrubRecord, large_float};
use crate::{boxed::Boxed, lanes::Lanes};
use glam::{IVec3, Vec3};

/// Shrubs of a group at most.
pub(super) const MOST: usize = 16;

// What the bits of a run, and of a mask of shrubs, have room for.
const _: () = assert!(MOST <= 32 && MOST.is_multiple_of(8));

/// Steps of the lattice that a group may be wide.
const WIDTH: i32 = 1 << 16;

/// Runs above this are parted on several threads.
const LARGE: usize = 4096;

/// After so many cuts on the way to a group the rest are halves, lest the work be quadratic where shrubs crowd towards a point.
const CUTS: usize = 24;

/// Eight shrubs, a row for each word.
type Block = [[u32; 8]; 4];

/// Where the shrubs of a group are.
#[derive(Clone, Copy, Debug)]
struct Group {
    base: [i32; 3],
    /// First block in the upper 27 bits, then shrubs less one.
    run: u32,
}

impl Group {
    #[inline(always)]
    fn first_block(&self) -> usize {
        (self.run >> 5) as usize
    }

    #[inline(always)]
    fn count(&self) -> usize {
        self.run as usize % MOST + 1
    }
}

/// All shrubs that records stand for.
#[derive(Debug, Default)]
pub(crate) struct Groups {
    groups: Vec<Group>,
    blocks: Vec<Block>,
}

/// Shrubs that share a leaf.
#[derive(Clone, Copy, Debug)]
pub struct ShrubGroup<'a> {
    groups: &'a Groups,
    group: &'a Group,
}

impl<'a> ShrubGroup<'a> {
    /// What the records of its shrubs are relative to, see [`ShrubRecord::unpacked`].
    pub fn base(self) -> [i32; 3] {
        self.group.base
    }

    /// The record of each shrub, 1 to 16.
    pub fn records(self) -> impl ExactSizeIterator<Item = ShrubRecord> + 'a {
        (0..self.group.count()).map(move |index| self.groups.record(self.group, index))
    }
}

/// The spheres around the boxes of a group, which its shrubs are tested by first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spheres {
    count: usize,
    /// Centers, a row of eight for each axis.
    center: [[[f32; 8]; MOST / 8]; 3],
    /// Squares of radii.
    square: [[f32; 8]; MOST / 8],
}

impl Spheres {
    pub(crate) const NEW: Self = Self { count: 0, center: [[[0.0; 8]; MOST / 8]; 3], square: [[0.0; 8]; MOST / 8] };
}

/// Slack of squares of radii, and of squares of the way to a center. The way from a ray to a center, which is rounded by less than 5e-7 of
/// the center's distance, is then never too long: `(r + e)² ≤ r² (1 + 2⁻⁷) + e² (1 + 2⁷)`.
const RADIUS_SLACK: f32 = 1.0 + 1.0 / 128.0;
const WAY_SLACK: f32 = 1.0 / 17_179_869_184.0;

impl Groups {
    /// Of shrubs, with the box around each group.
    pub(super) fn of(shrubs: Vec<Shrub>) -> (Self, Vec<[Vec3; 2]>) {
        let mut boxed: Vec<Placed> = shrubs.into_iter().map(Placed::new).collect();
        let mut groups = Self::default();
        let mut boxes = Vec::new();
        let mut rest = boxed.as_mut_slice();
        for count in part(rest, CUTS) {
            let (run, behind) = std::mem::take(&mut rest).split_at_mut(count);
            boxes.push(groups.push(run));
            rest = behind;
        }
        groups.groups.shrink_to_fit();
        groups.blocks.shrink_to_fit();
        (groups, boxes)
    }

    fn push(&mut self, run: &[Placed]) -> [Vec3; 2] {
        let base = run.iter().fold(IVec3::MAX, |base, placed| base.min(placed.place())).to_array();
        let first = self.blocks.len() as u32;
        for eight in run.chunks(8) {
            let mut block = [[0; 8]; 4];
            for (lane, placed) in eight.iter().enumerate() {
                let ShrubRecord(words) = placed.shrub.record(base);
                block.iter_mut().zip(words).for_each(|(row, word)| row[lane] = word);
            }
            self.blocks.push(block);
        }
        self.groups.push(Group { base, run: first << 5 | (run.len() as u32 - 1) });
        let hull = run.iter().fold(Boxed::EMPTY, |hull, placed| hull.join(&placed.bounds));
        [hull.min(), hull.max()]
    }

    pub(super) fn len(&self) -> usize {
        self.groups.len()
    }

    /// Shrubs in all groups.
    pub(super) fn shrubs(&self) -> usize {
        self.groups.iter().map(Group::count).sum()
    }

    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(self.groups.as_slice()) + size_of_val(self.blocks.as_slice())
    }

    /// A group as others read it.
    pub(super) fn view(&self, group: usize) -> ShrubGroup<'_> {
        ShrubGroup { groups: self, group: &self.groups[group] }
    }

    #[inline(always)]
    fn record(&self, group: &Group, index: usize) -> ShrubRecord {
        let (block, lane) = (&self.blocks[group.first_block() + index / 8], index % 8);
        ShrubRecord([block[0][lane], block[1][lane], block[2][lane], block[3][lane]])
    }

    /// All shrubs of a group.
    pub(super) fn boxes(&self, group: usize) -> impl Iterator<Item = FogBox> {
        (0..self.groups[group].count()).map(move |index| self.shrub(group, index))
    }

    /// A shrub of a group.
    #[inline(always)]
    pub(super) fn shrub(&self, group: usize, index: usize) -> FogBox {
        let group = &self.groups[group];
        self.record(group, index).unpacked(group.base)
    }

    #[inline(always)]
    pub(super) fn prefetch<V: Lanes>(&self, group: usize) {
        if let Some(group) = self.groups.get(group) {
            let first = group.first_block();
            V::prefetch(self.blocks.get(first..first + group.count().div_ceil(8)).unwrap_or_default());
        }
    }

    /// Unpacks what the shrubs of a group are tested by first.
    #[inline(always)]
    pub(super) fn spheres(&self, group: usize, spheres: &mut Spheres) {
        let group = &self.groups[group];
        spheres.count = group.count();
        let first = group.first_block();
        let [bx, by, bz] = group.base;
        for (at, block) in self.blocks[first..first + group.count().div_ceil(8)].iter().enumerate() {
            let at = at % (MOST / 8);
            for (lane, &a) in block[0].iter().enumerate() {
                let (b, c) = (block[1][lane], block[2][lane]);
                spheres.center[0][at][lane] = (bx + (a & 0xffff).cast_signed()) as f32 * STEP_M;
                spheres.center[1][at][lane] = (by + (a >> 16).cast_signed()) as f32 * STEP_M;
                spheres.center[2][at][lane] = (bz + (b & 0xffff).cast_signed()) as f32 * STEP_M;
                let x = large_float(b >> 16 & 0xfff, LEAST_HALF);
                let y = large_float(c & 0xfff, LEAST_HALF);
                let z = large_float(c >> 12 & 0xfff, LEAST_HALF);
                spheres.square[at][lane] = (x * x + y * y + z * z) * RADIUS_SLACK;
            }
        }
    }
}

impl Spheres {
    /// Bit i: whether a ray of unit direction comes to the i-th sphere up to `t_max`.
    #[inline(always)]
    pub(super) fn met<V: Lanes>(&self, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> u32 {
        let mut met = 0;
        let (zero, most, way_slack) = (V::splat(0.0), V::splat(t_max), V::splat(WAY_SLACK));
        let (ox, oy, oz) = (V::splat(origin[0]), V::splat(origin[1]), V::splat(origin[2]));
        let (dx, dy, dz) = (V::splat(direction[0]), V::splat(direction[1]), V::splat(direction[2]));
        for at in 0..self.count.div_ceil(8) {
            let at = at % (MOST / 8);
            let x = V::load(&self.center[0][at]).sub(ox);
            let y = V::load(&self.center[1][at]).sub(oy);
            let z = V::load(&self.center[2][at]).sub(oz);
            let t = x.mul(dx).add(y.mul(dy)).add(z.mul(dz)).max(zero).min(most);
            let (x, y, z) = (x.sub(t.mul(dx)), y.sub(t.mul(dy)), z.sub(t.mul(dz)));
            let away = x.mul(x).add(y.mul(y)).add(z.mul(z));
            let limit = V::load(&self.square[at]).add(t.mul(t).mul(way_slack));
            met |= V::bits(away.le(limit)) << (8 * at);
        }
        met & (u32::MAX >> (32 - self.count.clamp(1, 32)))
    }
}

/// A shrub and its box.
#[derive(Clone, Copy)]
struct Placed {
    shrub: Shrub,
    bounds: Boxed,
}

impl Placed {
    fn new(shrub: Shrub) -> Self {
        let [min, max] = shrub.unpacked().bounds();
        Self { shrub, bounds: Boxed::new(0, min, max) }
    }

    fn place(&self) -> IVec3 {
        IVec3::from_array(self.shrub.place)
    }
}

/// Brings shrubs in the order of their groups, the first `cuts` on each way to one by cost. Returns how many each has.
fn part(run: &mut [Placed], cuts: usize) -> Vec<usize> {
    let fits = |run: &[Placed]| {
        let places = || run.iter().map(Placed::place);
        let (low, high) = (places().fold(IVec3::MAX, IVec3::min), places().fold(IVec3::MIN, IVec3::max));
        (high.as_i64vec3() - low.as_i64vec3()).max_element() < i64::from(WIDTH)
    };
    if run.is_empty() {
        return Vec::new();
    }
    if run.len() <= MOST && fits(run) {
        return vec![run.len()];
    }
    let step = if run.len() > MOST { MOST } else { 1 };
    let (axis, at) = if cuts > 0 {
        let ways = [0, 1, 2].map(|axis| cheapest(run, axis, step));
        let (_, axis, at) = ways.into_iter().reduce(cheaper).unwrap_or((0.0, 0, step));
        (axis, at)
    } else {
        let hull = run.iter().fold(Boxed::EMPTY, |hull, placed| hull.join(&placed.bounds));
        (hull.longest_axis(), (run.len() / 2).next_multiple_of(step))
    };
    sort(run, axis);
    let is_large = run.len() > LARGE;
    let (left, right) = run.split_at_mut(at);
    let cuts = cuts.saturating_sub(1);
    let (mut left, right) = if is_large {
        rayon::join(|| part(left, cuts), || part(right, cuts))
    } else {
        (part(left, cuts), part(right, cuts))
    };
    left.extend(right);
    left
}

fn sort(run: &mut [Placed], axis: usize) {
    run.sort_unstable_by_key(|placed| (placed.shrub.place[axis], placed.shrub));
}

/// Cost, axis and place of a cut.
type Way = (f32, usize, usize);

fn cheaper(a: Way, b: Way) -> Way {
    if b.0 < a.0 { b } else { a }
}

/// The cheapest cut along an axis at a multiple of `step`.
fn cheapest(run: &mut [Placed], axis: usize, step: usize) -> Way {
    sort(run, axis);
    let hull = |run: &[Placed]| run.iter().fold(Boxed::EMPTY, |hull, placed| hull.join(&placed.bounds));
    let hulls: Vec<Boxed> = run.chunks(step).map(hull).collect();
    let cuts = hulls.len() - 1;
    let mut behind = vec![0.0; cuts];
    let mut hull = Boxed::EMPTY;
    for (cut, cost) in behind.iter_mut().enumerate().rev() {
        hull = hull.join(&hulls[cut + 1]);
        *cost = hull.half_area() * (cuts - cut) as f32;
    }
    hull = Boxed::EMPTY;
    let way = |(cut, behind): (usize, &f32)| {
        hull = hull.join(&hulls[cut]);
        (hull.half_area() * (cut + 1) as f32 + behind, axis, (cut + 1) * step)
    };
    behind.iter().enumerate().map(way).fold((f32::INFINITY, axis, step), cheaper)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{lanes::Portable, node::WideNode, ray::TracedRay};
    use glam::{DAffine3, DQuat, DVec3};
    use kiln_core::{Bounds, Fog};
    use proptest::prelude::*;

    fn shrub(at: DVec3, half: f64, turn: f64) -> Shrub {
        let fog = Fog { bounds: Bounds { min: -DVec3::splat(half), max: DVec3::splat(half) }, density_per_m: 0.5 };
        let place = DAffine3::from_rotation_translation(DQuat::from_axis_angle(DVec3::ONE.normalize(), turn), at);
        Shrub::of(&fog, &place).expect("a record has room")
    }

    /// Each is in one group, which has room for it, and in its box.
    fn check(shrubs: &[Shrub]) -> Groups {
        let (groups, boxes) = Groups::of(shrubs.to_vec());
        assert_eq!((groups.len(), groups.shrubs()), (boxes.len(), shrubs.len()));
        let mut found = Vec::new();
        for (index, [min, max]) in boxes.iter().enumerate() {
            let (base, records) = (groups.view(index).base(), groups.view(index).records());
            assert!((1..=MOST).contains(&records.len()));
            for (at, record) in records.enumerate() {
                let unpacked = record.unpacked(base);
                assert_eq!(groups.shrub(index, at), unpacked);
                let [low, high] = unpacked.bounds();
                assert!(low.cmpge(*min).all() && high.cmple(*max).all());
                found.push(unpacked);
            }
        }
        let bits = |fog: &FogBox| {
            let floats = [fog.center, fog.half, fog.axes.x_axis, fog.axes.y_axis, fog.axes.z_axis];
            (floats.map(|v| v.to_array().map(f32::to_bits)), fog.rate)
        };
        let sorted = |all: Vec<FogBox>| {
            let mut all: Vec<_> = all.iter().map(bits).collect();
            all.sort_unstable();
            all
        };
        assert!(sorted(found) == sorted(shrubs.iter().map(Shrub::unpacked).collect()));
        groups
    }

    fn random(state: &mut u32) -> f64 {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(*state >> 8) / 16_777_216.0
    }

    proptest! {
        #[test]
        fn groups_are_sound(
            places in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 0..300),
            spread in prop::sample::select(vec![0.0, 1.0, 30.0, 2000.0, 60_000.0]),
        ) {
            let shrubs: Vec<Shrub> =
                places.iter().enumerate().map(|(i, at)| shrub(DVec3::from_array(*at) * spread, 0.3 + 0.1 * (i % 5) as f64, i as f64)).collect();
            check(&shrubs);
        }

        /// A ray that comes to a box comes to the sphere, however far it starts.
        #[test]
        fn spheres_keep_no_ray_from_a_box(
            places in prop::collection::vec(prop::array::uniform3(-3.0f64..3.0), 1..17), aim in any::<prop::sample::Index>(),
            inside in prop::array::uniform3(-1.0f64..1.0), turn in 0.0f64..6.0, axis in prop::array::uniform3(-1.0f64..1.0),
            away in prop::sample::select(vec![0.0, 2.0, 300.0, 5000.0]), beyond in 0.0f64..1.0,
        ) {
            let axis = DVec3::from_array(axis);
            prop_assume!(axis.length() > 0.1);
            let shrubs: Vec<Shrub> = places.iter().map(|at| shrub(DVec3::from_array(*at), 0.1 + at[0].abs() / 3.0, turn)).collect();
            let (groups, _) = Groups::of(shrubs);
            let mut spheres = Spheres::NEW;
            groups.spheres(0, &mut spheres);
            let at = aim.index(groups.shrubs());
            let fog = groups.shrub(0, at);
            let point = fog.center.as_dvec3() + fog.axes.as_dmat3() * (DVec3::from_array(inside) * fog.half.as_dvec3());
            let direction = axis.normalize();
            let ray = TracedRay::new((point - away * direction).as_vec3(), direction.as_vec3());
            let t_max = (away + beyond) as f32;
            let met = spheres.met::<Portable>(ray.origin, ray.direction, t_max);
            for index in 0..groups.shrubs() {
                let is_met = {
                    let fog = groups.shrub(0, index);
                    fog.part(fog.bounds(), &ray, t_max).is_some()
                };
                prop_assert!(!is_met || met >> index & 1 == 1);
            }
            prop_assert!(met >> at & 1 == 1);
            prop_assert_eq!(met >> groups.shrubs(), 0);
            prop_assert_eq!(spheres.met::<Portable>(ray.origin, [f32::NAN; 3], t_max), 0);
        }
    }

    #[test]
    fn a_shrub_takes_less_than_twenty_bytes() {
        let mut state = 7;
        let mut place = || DVec3::new(400.0 * random(&mut state), 3.0 * random(&mut state), 400.0 * random(&mut state));
        let shrubs: Vec<Shrub> =
            (0..8000).map(|i| shrub(place(), 0.4 + 0.1 * f64::from(i % 7), f64::from(i))).collect();
        let groups = check(&shrubs);
        assert_eq!(groups.len(), 500);
        let bytes = groups.memory_bytes() + size_of::<WideNode>() * groups.len().div_ceil(7);
        assert!((bytes as f64) < 19.5 * 8000.0, "{bytes}");
    }

    #[test]
    fn crowds_are_parted() {
        // All towards a point, by halves and by less; all in one place; and more than one thread takes.
        let towards =
            |factor: f64| (0..6000).map(move |i| shrub(DVec3::X * 6e4 * factor.powi(i), 0.2, 0.0)).collect::<Vec<_>>();
        check(&towards(0.5));
        check(&towards(0.995));
        check(&vec![shrub(DVec3::ONE, 0.5, 1.0); 5000]);
        let mut state = 3;
        let many: Vec<Shrub> = (0..40_000)
            .map(|_| shrub(DVec3::new(random(&mut state), random(&mut state), 0.0) * 900.0, 0.4, 0.0))
            .collect();
        assert!((2500..2520).contains(&check(&many).len()));
    }
}
