//! Up to 64 rays through one tree together.
//!
//! A node is fetched once for all rays that enter it, and each of them tests its eight boxes at once. Rays that start near
//! each other (one sample's, or those of neighbouring samples) share the upper levels, which is most of their way, and there
//! the loop over rays is free of branches that depend on data: what a ray alone spends most of its time on is waiting
//! for the node and for mispredicted branches. Where few rays are left, each goes on [alone](crate::alone).
//!
//! Sources: Barringer and Akenine-Möller 2014, "Dynamic ray stream traversal" (rays sorted into streams on the way down),
//! Fuetterling et al. 2015, "Efficient ray tracing kernels for modern CPU architectures" (masks of rays and distances that
//! are kept). Deviation: a stream is a mask of 64 bits, made from bytes of eight boxes each by a transposition, so that rays
//! are never copied; a child's turn is by the first ray that enters it, its rays are tested again by the distances that
//! were kept when its turn comes.
//!
//! The order of visits changes no result: see [`crate::triangle`], `HIT_SLACK` in [`crate::ray`] and the tie rule.

use crate::{
    Hit,
    lanes::Lanes,
    node::{BvhLink, LEAF_BIT, MAX_DEPTH, MAX_STACK, WideNode},
    path::{Compiled, Kernel},
    ray::{HIT_SLACK, TracedRay, WIDEN},
};

/// Rays of a bundle.
pub(crate) const BUNDLE: usize = 64;

/// Where no more rays than this are left, each goes on alone.
const FEW: u32 = 2;

/// A child that waits for its turn.
#[derive(Clone, Copy, Debug, Default)]
struct Waiting {
    /// Rays that entered its box.
    mask: u64,
    reference: u32,
    slot: u8,
    /// Depth of the node whose child it is.
    depth: u8,
    /// Where the first of the rays enters.
    near: f32,
}

/// Distance at which each ray enters each child of a node.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
struct Distances([[f32; 8]; BUNDLE]);

/// What the way through a tree needs to remember; what it holds before does not matter.
#[derive(Debug)]
pub(crate) struct Memory {
    waiting: [Waiting; MAX_STACK],
    /// Of the nodes on the way down to the current one.
    distances: [Distances; MAX_DEPTH],
}

impl Memory {
    pub(crate) const NEW: Self = Self {
        waiting: [Waiting { mask: 0, reference: 0, slot: 0, depth: 0, near: 0.0 }; MAX_STACK],
        distances: [Distances([[0.0; 8]; BUNDLE]); MAX_DEPTH],
    };
}

/// The rays of a bundle as one tree sees them.
pub(crate) type Rays = [TracedRay; BUNDLE];

/// The best hits so far.
#[derive(Debug)]
pub(crate) struct Hits {
    best: [Hit; BUNDLE],
    /// Boxes beyond this are not entered: the closest hit's distance, widened; below 0 for a ray that wants no more.
    reach: [f32; BUNDLE],
}

impl Hits {
    pub(crate) const NEW: Self = Self { best: [Hit::MISS; BUNDLE], reach: [0.0; BUNDLE] };

    /// Starts a ray that sees nothing beyond `t_max`.
    pub(crate) fn start(&mut self, ray: usize, t_max: f32) {
        self.set::<false>(ray, Hit { t: t_max, ..Hit::MISS });
    }

    /// The best hit of a ray, or of no instance.
    #[inline(always)]
    pub(crate) fn get(&self, ray: usize) -> Hit {
        self.best[ray % BUNDLE]
    }

    /// With `ANY`, a ray that has hit something wants no more.
    #[inline(always)]
    pub(crate) fn set<const ANY: bool>(&mut self, ray: usize, hit: Hit) {
        self.best[ray % BUNDLE] = hit;
        self.reach[ray % BUNDLE] = if ANY && hit.instance != u32::MAX { -1.0 } else { hit.t * HIT_SLACK };
    }
}

/// What the leaves of a tree hold, for bundles.
pub(crate) trait BundleLeaves {
    /// Asks for a leaf that will be visited soon.
    fn prefetch<V: Compiled>(&self, first: u32);

    /// Takes note of what the rays of a mask hit in a leaf.
    fn visit<V: Compiled, const ANY: bool>(&mut self, first: u32, count: u32, mask: u64, rays: &Rays, hits: &mut Hits);

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
                    top = enter::<V, SHARED>(node, rays, mask, hits, depth, memory, top);
                    for waiting in &memory.waiting[bottom..top] {
                        match BvhLink::of_reference(waiting.reference) {
                            BvhLink::Node(index) => {
                                V::prefetch(nodes.get(index as usize..=index as usize).unwrap_or_default());
                            }
                            BvhLink::Leaf { first, .. } => leaves.prefetch::<V>(first),
                        }
                    }
                }
                BvhLink::Leaf { first, count } => leaves.visit::<V, ANY>(first, count, mask, rays, hits),
            }
            loop {
                if top == 0 {
                    return;
                }
                top -= 1;
                let next = memory.waiting[top];
                mask = still_entered(&memory.distances[usize::from(next.depth)], &next, hits);
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
fn still_entered(distances: &Distances, next: &Waiting, hits: &Hits) -> u64 {
    let (mut rest, mut mask) = (next.mask, 0);
    while rest != 0 {
        let ray = rest.trailing_zeros() as usize % BUNDLE;
        rest &= rest - 1;
        let is_entered = distances.0[ray][usize::from(next.slot) % 8] <= hits.reach[ray];
        mask |= u64::from(is_entered) << ray;
    }
    mask
}

/// Tests the boxes of a node's children and puts those that are entered on the stack, the nearest on top. Returns the new
/// top.
#[inline(always)]
fn enter<V: Lanes, const SHARED: bool>(
    node: &WideNode,
    rays: &Rays,
    mask: u64,
    hits: &Hits,
    depth: usize,
    memory: &mut Memory,
    top: usize,
) -> usize {
    // Eight rows for six, so that no index needs a check.
    let mut bounds = [[0.0; 8]; 8];
    let first = mask.trailing_zeros() as usize % BUNDLE;
    for axis in 0..3 {
        for row in [axis, axis + 3] {
            let plane = V::load(&node.bounds[row]);
            let plane = if SHARED { plane.sub(V::splat(rays[first].origin[axis])) } else { plane };
            plane.store(&mut bounds[row]);
        }
    }
    let distances = &mut memory.distances[depth];
    let mut entered = [0u8; BUNDLE];
    let mut nearest = V::splat(f32::INFINITY);
    let mut rest = mask;
    while rest != 0 {
        let index = rest.trailing_zeros() as usize % BUNDLE;
        rest &= rest - 1;
        let ray = &rays[index];
        let mut near = V::splat(0.0);
        let mut far = V::splat(f32::INFINITY);
        for axis in 0..3 {
            let inverse = V::splat(ray.inverse[axis]);
            let mut near_plane = V::load(&bounds[usize::from(ray.near[axis]) % 8]);
            let mut far_plane = V::load(&bounds[ray.far(axis) % 8]);
            if !SHARED {
                let origin = V::splat(ray.origin[axis]);
                (near_plane, far_plane) = (near_plane.sub(origin), far_plane.sub(origin));
            }
            near = near_plane.mul(inverse).max(near);
            far = far_plane.mul(inverse).min(far);
        }
        let is_entered = near.le(far.mul(V::splat(WIDEN)).min(V::splat(hits.reach[index])));
        near.store(&mut distances.0[index]);
        entered[index] = V::bits(is_entered) as u8;
        nearest = V::select(is_entered, near, V::splat(f32::INFINITY)).min(nearest);
    }
    let mut near = [0.0; 8];
    nearest.store(&mut near);
    let bottom = top;
    let mut top = top;
    for (slot, (&near, &reference)) in near.iter().zip(&node.children).enumerate() {
        let mask = V::column(&entered, slot as u32);
        if mask == 0 {
            continue;
        }
        let waiting = Waiting { mask, reference, slot: slot as u8, depth: depth as u8, near };
        let mut at = top;
        while at > bottom && memory.waiting[at - 1].near < waiting.near {
            memory.waiting[at] = memory.waiting[at - 1];
            at -= 1;
        }
        memory.waiting[at] = waiting;
        top += 1;
    }
    top
}
