//! Up to 64 rays through one tree together.
//!
//! A node is fetched once for all rays that enter it, and its boxes are tested against eight of them at once. Rays that start near
//! each other (one sample's, or those of neighbouring samples) share the upper levels, which is most of their way, and there
//! the loop over rays is free of branches that depend on data: what a ray alone spends most of its time on is waiting
//! for the node and for mispredicted branches. Where few rays are left, each goes on [alone](crate::alone).
//!
//! Sources: Barringer and Akenine-Möller 2014, "Dynamic ray stream traversal" (rays sorted into streams on the way down),
//! Fuetterling et al. 2015, "Efficient ray tracing kernels for modern CPU architectures" (masks of rays and distances that
//! are kept). Deviation: a stream is a mask of 64 bits, so that rays are never copied. Where few rays are left of each group
//! of eight, each is tested against the eight boxes instead, and the bytes that come of it are transposed. A child's turn is
//! by the first ray that enters it; when it comes, its rays are tested again by the distances that were kept.
//!
//! The order of visits changes no result: see [`crate::triangle`], `HIT_SLACK` in [`crate::ray`] and the tie rule.

use crate::{
    Hit,
    lanes::Lanes,
    node::{BvhLink, LEAF_BIT, MAX_DEPTH, MAX_STACK, WideNode},
    path::{Compiled, Kernel},
    ray::{FARTHEST, HIT_SLACK, WIDEN, narrow},
    rays::{BUNDLE, Column, GROUP, Rays, row},
};

/// So many rays in the mean group make it worth while to test one box against groups, not eight boxes against each ray.
const WORTH_WHILE: u32 = 3;

/// Where no more rays than this are left, each goes on alone.
const FEW: u32 = 3;

/// A child that waits for its turn.
#[derive(Clone, Copy, Debug, Default)]
struct Waiting {
    /// Rays that entered its box.
    mask: u64,
    reference: u32,
    slot: u8,
    /// Distances of the node lie ray by ray, not slot by slot.
    is_by_ray: bool,
    /// Depth of the node whose child it is.
    depth: u8,
    /// Where the first of the rays enters.
    near: f32,
}

/// Distances at which rays enter the children of a node: a column for each slot, or eight for each ray, one after the other.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Distances([Column; 8]);

impl Distances {
    #[inline(always)]
    fn of_ray(&mut self, ray: usize) -> &mut [f32; 8] {
        self.0[ray / 8 % 8].group_mut(ray % 8)
    }

    /// Of a ray, where they lie ray by ray.
    #[inline(always)]
    fn get(&self, ray: usize, slot: usize) -> f32 {
        self.0[ray / 8 % 8].get(ray % 8 * 8 + slot)
    }
}

/// What the way through a tree needs to remember; what it holds before does not matter.
#[derive(Debug)]
pub(crate) struct Memory {
    waiting: [Waiting; MAX_STACK],
    /// Of the nodes on the way down to the current one.
    distances: [Distances; MAX_DEPTH],
}

impl Memory {
    pub(crate) const NEW: Self = Self {
        waiting: [Waiting { mask: 0, reference: 0, slot: 0, is_by_ray: false, depth: 0, near: 0.0 }; MAX_STACK],
        distances: [Distances([Column::ZERO; 8]); MAX_DEPTH],
    };
}

/// The best hits so far.
#[derive(Debug)]
pub(crate) struct Hits {
    best: [Hit; BUNDLE],
    /// Boxes beyond this are not entered: the closest hit's distance, widened; below 0 for a ray that wants no more.
    reach: Column,
}

impl Hits {
    pub(crate) const NEW: Self = Self { best: [Hit::MISS; BUNDLE], reach: Column::of(-1.0) };

    /// Starts a ray that sees nothing beyond `t_max`.
    pub(crate) fn start(&mut self, ray: usize, t_max: f32) {
        self.set::<false>(ray, Hit { t: t_max, ..Hit::MISS });
    }

    /// Rays from here on are of no bundle.
    #[inline(always)]
    pub(crate) fn end(&mut self, count: usize) {
        self.reach.fill_from(count, -1.0);
    }

    /// The best hit of a ray, or of no instance.
    #[inline(always)]
    pub(crate) fn get(&self, ray: usize) -> Hit {
        self.best[ray % BUNDLE]
    }

    /// A ray wants no more.
    #[inline(always)]
    pub(crate) fn stop(&mut self, ray: usize) {
        self.reach.set(ray, -1.0);
    }

    /// With `ANY`, a ray that has hit something wants no more.
    #[inline(always)]
    pub(crate) fn set<const ANY: bool>(&mut self, ray: usize, hit: Hit) {
        self.best[ray % BUNDLE] = hit;
        self.reach.set(ray, if ANY && hit.instance != u32::MAX { -1.0 } else { hit.t * HIT_SLACK });
    }
}

/// What the leaves of a tree hold, for bundles.
pub(crate) trait BundleLeaves {
    /// Asks for a leaf that will be visited soon.
    fn prefetch<V: Compiled>(&self, first: u32);

    /// Takes note of what the rays of a mask hit in a leaf.
    fn visit<V: Compiled, const ANY: bool, const SHARED: bool>(
        &mut self,
        first: u32,
        count: u32,
        mask: u64,
        rays: &Rays,
        hits: &mut Hits,
    );

    /// Takes one ray on alone from a node.
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits);
}

/// Takes the rays of a mask to the leaves that they enter before their closest hits, near ones first. With `SHARED` they all
/// have the same origin, which costs less; with `ANY` each ends at its first hit.
pub(crate) struct Walk<'a, L, const ANY: bool, const SHARED: bool> {
    pub(crate) nodes: &'a [WideNode],
    pub(crate) leaves: &'a mut L,
    pub(crate) rays: &'a Rays,
    pub(crate) mask: u64,
    pub(crate) hits: &'a mut Hits,
    pub(crate) memory: &'a mut Memory,
}

impl<L: BundleLeaves, const ANY: bool, const SHARED: bool> Kernel for Walk<'_, L, ANY, SHARED> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { nodes, leaves, rays, mask, hits, memory } = self;
        let (mut current, mut mask, mut depth, mut top) = (0, mask, 0, 0);
        if nodes.is_empty() || mask == 0 {
            return;
        }
        loop {
            match BvhLink::of_reference(current) {
                BvhLink::Node(index) => {
                    let node = &nodes[index as usize];
                    let bottom = top;
                    top = enter::<V, SHARED>(Entering { node, rays, mask, hits, depth }, memory, top);
                    for waiting in &memory.waiting[bottom..top] {
                        match BvhLink::of_reference(waiting.reference) {
                            BvhLink::Node(index) => {
                                V::prefetch(nodes.get(index as usize..=index as usize).unwrap_or_default());
                            }
                            BvhLink::Leaf { first, .. } => leaves.prefetch::<V>(first),
                        }
                    }
                }
                BvhLink::Leaf { first, count } => leaves.visit::<V, ANY, SHARED>(first, count, mask, rays, hits),
            }
            loop {
                if top == 0 {
                    return;
                }
                top -= 1;
                let next = memory.waiting[top];
                mask = still_entered::<V>(&memory.distances[usize::from(next.depth)], &next, hits);
                if mask == 0 {
                    continue;
                }
                if next.reference & LEAF_BIT == 0 && mask.count_ones() <= FEW {
                    while mask != 0 {
                        let ray = mask.trailing_zeros() as usize;
                        mask &= mask - 1;
                        leaves.walk_alone::<V, ANY>(next.reference, ray, rays, hits);
                    }
                    continue;
                }
                (current, depth) = (next.reference, usize::from(next.depth) + 1);
                break;
            }
        }
    }
}

/// Rays of a waiting child that have hit nothing before its box.
#[inline(always)]
fn still_entered<V: Lanes>(distances: &Distances, next: &Waiting, hits: &Hits) -> u64 {
    let slot = usize::from(next.slot) % 8;
    let mut entered = 0;
    if next.is_by_ray {
        let mut rest = next.mask;
        while rest != 0 {
            let ray = rest.trailing_zeros() as usize % BUNDLE;
            rest &= rest - 1;
            entered |= u64::from(distances.get(ray, slot) <= hits.reach.get(ray)) << ray;
        }
        return entered;
    }
    for group in 0..BUNDLE / GROUP {
        let near = V::load(distances.0[slot].group(group));
        let is_entered = near.le(V::load(hits.reach.group(group)));
        entered |= u64::from(V::bits(is_entered)) << (group * GROUP);
    }
    entered & next.mask
}

/// Rays that come to a node.
#[derive(Clone, Copy)]
struct Entering<'a> {
    node: &'a WideNode,
    rays: &'a Rays,
    mask: u64,
    hits: &'a Hits,
    depth: usize,
}

/// Tests the boxes of a node's children and puts those that are entered on the stack, the nearest on top. Returns the new
/// top.
#[inline(always)]
fn enter<V: Lanes, const SHARED: bool>(entering: Entering, memory: &mut Memory, top: usize) -> usize {
    let mut groups = 0;
    for group in 0..BUNDLE / GROUP {
        groups += u32::from(in_group(entering.mask, group) != 0);
    }
    if entering.mask.count_ones() >= WORTH_WHILE * groups {
        enter_by_group::<V, SHARED>(entering, memory, top)
    } else {
        enter_by_ray::<V, SHARED>(entering, memory, top)
    }
}

/// The part of a mask that is of a group.
#[inline(always)]
fn in_group(mask: u64, group: usize) -> u64 {
    mask >> (group * GROUP) & (u64::MAX >> (BUNDLE - GROUP))
}

/// Puts a child on the stack, above the nearer ones of the same node.
#[inline(always)]
fn push(waiting: &mut [Waiting; MAX_STACK], child: Waiting, bottom: usize, top: usize) {
    let mut at = top;
    while at > bottom && waiting[at - 1].near < child.near {
        waiting[at] = waiting[at - 1];
        at -= 1;
    }
    waiting[at] = child;
}

/// One box against a group of rays at a time.
#[inline(always)]
fn enter_by_group<V: Lanes, const SHARED: bool>(entering: Entering, memory: &mut Memory, bottom: usize) -> usize {
    let Entering { node, rays, mask, hits, depth } = entering;
    let origin = row(&rays.origin, mask.trailing_zeros() as usize);
    let infinite = V::splat(f32::INFINITY);
    let mut top = bottom;
    for slot in 0..8 {
        let reference = node.children[slot];
        if reference == u32::MAX {
            break;
        }
        let mut planes = [infinite; 6];
        for (row, splatted) in planes.iter_mut().enumerate() {
            let plane = node.bounds[row][slot];
            *splatted = V::splat(if SHARED { plane - origin[row % 3] } else { plane });
        }
        let distances = &mut memory.distances[depth].0[slot];
        let (mut entered, mut nearest) = (0, infinite);
        for group in 0..BUNDLE / GROUP {
            if in_group(mask, group) == 0 {
                continue;
            }
            let mut part = [V::splat(0.0), V::splat(FARTHEST)];
            for axis in 0..3 {
                let inverse = V::load(rays.inverse[axis].group(group));
                let (mut low, mut high) = (planes[axis], planes[axis + 3]);
                if !SHARED {
                    let origin = V::load(rays.origin[axis].group(group));
                    (low, high) = (low.sub(origin), high.sub(origin));
                }
                part = narrow(part, [low, high], inverse);
            }
            let [near, far] = part;
            let reach = V::load(hits.reach.group(group));
            let is_entered = near.le(far.mul(V::splat(WIDEN)).min(reach));
            near.store(distances.group_mut(group));
            entered |= u64::from(V::bits(is_entered)) << (group * GROUP);
            nearest = V::select(is_entered, near, infinite).min(nearest);
        }
        entered &= mask;
        if entered != 0 {
            let near = nearest.least();
            let child =
                Waiting { mask: entered, reference, slot: slot as u8, is_by_ray: false, depth: depth as u8, near };
            push(&mut memory.waiting, child, bottom, top);
            top += 1;
        }
    }
    top
}

/// One ray against all boxes at a time.
#[inline(always)]
fn enter_by_ray<V: Lanes, const SHARED: bool>(entering: Entering, memory: &mut Memory, bottom: usize) -> usize {
    let Entering { node, rays, mask, hits, depth } = entering;
    let mut planes = [V::splat(0.0); 6];
    let first = mask.trailing_zeros() as usize % BUNDLE;
    for axis in 0..3 {
        for row in [axis, axis + 3] {
            let plane = V::load(&node.bounds[row]);
            planes[row] = if SHARED { plane.sub(V::splat(rays.origin[axis].get(first))) } else { plane };
        }
    }
    let mut entered = [0u8; BUNDLE];
    let mut nearest = V::splat(f32::INFINITY);
    let mut rest = mask;
    while rest != 0 {
        let ray = rest.trailing_zeros() as usize % BUNDLE;
        rest &= rest - 1;
        let mut part = [V::splat(0.0), V::splat(FARTHEST)];
        for axis in 0..3 {
            let inverse = V::splat(rays.inverse[axis].get(ray));
            let (mut low, mut high) = (planes[axis], planes[axis + 3]);
            if !SHARED {
                let origin = V::splat(rays.origin[axis].get(ray));
                (low, high) = (low.sub(origin), high.sub(origin));
            }
            part = narrow(part, [low, high], inverse);
        }
        let [near, far] = part;
        let is_entered = near.le(far.mul(V::splat(WIDEN)).min(V::splat(hits.reach.get(ray))));
        near.store(memory.distances[depth].of_ray(ray));
        entered[ray] = V::bits(is_entered) as u8;
        nearest = V::select(is_entered, near, V::splat(f32::INFINITY)).min(nearest);
    }
    let mut near = [0.0; 8];
    nearest.store(&mut near);
    let mut top = bottom;
    for (slot, (&near, &reference)) in near.iter().zip(&node.children).enumerate() {
        // A ray that is not finite seems to enter what is not there.
        if reference == u32::MAX {
            break;
        }
        let mask = V::column(&entered, slot as u32);
        if mask != 0 {
            let child = Waiting { mask, reference, slot: slot as u8, is_by_ray: true, depth: depth as u8, near };
            push(&mut memory.waiting, child, bottom, top);
            top += 1;
        }
    }
    top
}
