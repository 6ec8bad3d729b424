//! One ray through one tree: near children first, popped nodes tested again against the closest hit.

use crate::{
    Hit,
    lanes::Lanes,
    node::{BvhLink, LEAF_BIT, MAX_STACK, WideNode},
    path::{Compiled, Kernel},
    ray::{FARTHEST, HIT_SLACK, TracedRay, WIDEN, narrow},
    triangle::{FLIPPED_BIT, TWO_SIDED_BIT, TriangleWords, entry, face_of},
};

/// A child that waits for its turn, and the distance of its box.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Waiting {
    reference: u32,
    near: f32,
}

/// Room for the children that wait on the way through both levels, in a number that makes checks of an index cheap.
const STACK: usize = (2 * MAX_STACK).next_power_of_two();

/// The children that wait on the way through both levels.
#[derive(Debug)]
pub(crate) struct Stack([Waiting; STACK]);

impl Stack {
    pub(crate) const NEW: Self = Self([Waiting { reference: 0, near: 0.0 }; STACK]);

    #[inline(always)]
    fn get(&self, at: usize) -> Waiting {
        self.0[at % STACK]
    }

    #[inline(always)]
    fn set(&mut self, at: usize, waiting: Waiting) {
        self.0[at % STACK] = waiting;
    }

    /// Puts a child where it belongs among those of the same node, which begin at `bottom`, nearest on top.
    #[inline(always)]
    fn insert(&mut self, child: Waiting, bottom: usize, top: usize) {
        let mut at = top;
        while at > bottom && self.get(at - 1).near < child.near {
            self.set(at, self.get(at - 1));
            at -= 1;
        }
        self.set(at, child);
    }
}

/// What the leaves of a tree hold.
pub(crate) trait Leaves {
    /// Takes note of what a ray hits in a leaf. The stack is free to use from `top` on.
    fn visit<V: Compiled, const ANY: bool>(
        &mut self,
        first: u32,
        count: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut Stack,
        top: usize,
    );
}

/// The triangles of a mesh, seen through an instance.
#[derive(Clone, Copy)]
pub(crate) struct MeshLeaves<'a> {
    pub(crate) triangles: TriangleWords<'a>,
    pub(crate) instance: u32,
}

impl Leaves for MeshLeaves<'_> {
    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(
        &mut self,
        first: u32,
        count: u32,
        ray: &TracedRay,
        best: &mut Hit,
        _: &mut Stack,
        _: usize,
    ) {
        self.test::<V>(first, count, ray, best);
    }
}

impl MeshLeaves<'_> {
    /// Takes note of what a ray hits in a leaf.
    #[inline(always)]
    fn test<V: Compiled>(&self, first: u32, count: u32, ray: &TracedRay, best: &mut Hit) {
        let leaf = self.triangles.leaf(first, count);
        let (mut lanes, margins) = leaf.edges::<V>(ray.origin).crossed(ray.direction);
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % 8;
            lanes &= lanes - 1;
            let seen = leaf.seen(lane, ray.origin);
            let entry = || entry(leaf.corners(lane), ray.origin, ray.inverse);
            let Some(met) = seen.meet(ray.direction, margins[lane], best.t, entry) else {
                continue;
            };
            let hit = self.hit(seen.primitive, met);
            if precedes(&hit, best) {
                *best = hit;
            }
        }
    }

    /// What a ray hits that has met the plane of a triangle.
    #[inline(always)]
    pub(crate) fn hit(&self, primitive: u32, (t, is_counter_clockwise): (f32, bool)) -> Hit {
        let is_front = is_counter_clockwise == (primitive & FLIPPED_BIT == 0);
        let back_face = !is_front && primitive & TWO_SIDED_BIT == 0;
        Hit { t, instance: self.instance, primitive: face_of(primitive), back_face }
    }
}

/// The tie rule: at equal distances front faces come first, then the lowest instance, then the lowest face.
#[inline(always)]
pub(crate) fn precedes(hit: &Hit, best: &Hit) -> bool {
    let key = |h: &Hit| (h.back_face, h.instance, h.primitive);
    hit.t < best.t || (hit.t == best.t && key(hit) < key(best))
}

/// Entry distance of each child's box, and the children that are entered up to `t_max`, times [`HIT_SLACK`].
#[inline(always)]
fn enter<V: Lanes>(node: &WideNode, ray: &TracedRay, t_max: f32) -> ([f32; 8], u32) {
    let mut part = [V::splat(0.0), V::splat(FARTHEST)];
    for axis in 0..3 {
        let origin = V::splat(ray.origin[axis]);
        let (low, high) = (V::load(&node.bounds[axis]).sub(origin), V::load(&node.bounds[axis + 3]).sub(origin));
        part = narrow(part, [low, high], V::splat(ray.inverse[axis]));
    }
    let [near, far] = part;
    let far = far.mul(V::splat(WIDEN)).min(V::splat(t_max * HIT_SLACK));
    let mut distances = [0.0; 8];
    near.store(&mut distances);
    (distances, V::bits(near.le(far)))
}

/// Takes a ray to the leaves that it enters before its closest hit, near ones first, from a node on. With `ANY` it ends at the
/// first hit.
pub(crate) struct Walk<'a, L, const ANY: bool> {
    pub(crate) nodes: &'a [WideNode],
    pub(crate) leaves: &'a mut L,
    pub(crate) start: u32,
    pub(crate) ray: &'a TracedRay,
    pub(crate) best: &'a mut Hit,
    pub(crate) stack: &'a mut Stack,
    /// Where the free part of the stack begins.
    pub(crate) bottom: usize,
}

impl<L: Leaves, const ANY: bool> Kernel for Walk<'_, L, ANY> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { nodes, leaves, start, ray, best, stack, bottom } = self;
        let mut top = bottom;
        let mut current = start;
        if nodes.is_empty() {
            return;
        }
        loop {
            if current & LEAF_BIT == 0 {
                let node = &nodes[current as usize];
                let (near, mut mask) = enter::<V>(node, ray, best.t);
                if mask != 0 {
                    let mut nearest = child(node, &near, &mut mask);
                    let first = top;
                    while mask != 0 {
                        let other = child(node, &near, &mut mask);
                        if other.near < nearest.near {
                            stack.set(top, nearest);
                            nearest = other;
                        } else {
                            stack.insert(other, first, top);
                        }
                        top += 1;
                    }
                    current = nearest.reference;
                    continue;
                }
            } else if let (true, BvhLink::Leaf { first, count }) = (current != u32::MAX, BvhLink::of_reference(current))
            {
                // A ray that is not finite seems to enter what is not there.
                leaves.visit::<V, ANY>(first, count, ray, best, stack, top);
                if ANY && best.instance != u32::MAX {
                    return;
                }
            }
            loop {
                if top == bottom {
                    return;
                }
                top -= 1;
                let next = stack.get(top);
                if next.near <= best.t * HIT_SLACK {
                    current = next.reference;
                    break;
                }
            }
        }
    }
}

/// Takes the first child from a mask.
#[inline(always)]
fn child(node: &WideNode, near: &[f32; 8], mask: &mut u32) -> Waiting {
    let slot = mask.trailing_zeros() as usize % 8;
    *mask &= *mask - 1;
    Waiting { reference: node.children[slot], near: near[slot] }
}
