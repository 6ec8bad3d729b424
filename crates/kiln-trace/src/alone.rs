//! One ray through one tree: near children first, popped nodes tested again against the closest hit.

use crate::{
    Hit,
    lanes::Lanes,
    mesh_bvh::MeshBvh,
    node::{BvhLink, LEAF_BIT, MAX_STACK, WideNode},
    path::{Compiled, Kernel},
    ray::{HIT_SLACK, TracedRay, WIDEN},
    triangle::{FLIPPED_BIT, TWO_SIDED_BIT, face_of, meet},
};

/// A child that waits for its turn, and the distance of its box.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Waiting {
    reference: u32,
    near: f32,
}

/// Room for the children that wait on the way through both levels.
pub(crate) type Stack = [Waiting; 2 * MAX_STACK];

/// What the leaves of a tree hold.
pub(crate) trait Leaves {
    /// Takes note of what a ray hits in a leaf. `stack` is free to use.
    fn visit<V: Compiled, const ANY: bool>(
        &self,
        first: u32,
        count: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut [Waiting],
    );
}

/// The triangles of a mesh, seen through an instance.
#[derive(Clone, Copy)]
pub(crate) struct MeshLeaves<'a> {
    pub(crate) mesh: &'a MeshBvh,
    pub(crate) instance: u32,
}

impl Leaves for MeshLeaves<'_> {
    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(
        &self,
        first: u32,
        count: u32,
        ray: &TracedRay,
        best: &mut Hit,
        _: &mut [Waiting],
    ) {
        self.test::<V>(first, count, ray, best);
    }
}

impl MeshLeaves<'_> {
    /// Takes note of what a ray hits in a leaf; whether that is anything that comes before the best.
    #[inline(always)]
    pub(crate) fn test<V: Compiled>(&self, first: u32, count: u32, ray: &TracedRay, best: &mut Hit) -> bool {
        let triangles = &self.mesh.triangles;
        let (mut lanes, margins) = triangles.crossed::<V>(first, count, ray);
        let mut is_better = false;
        while lanes != 0 {
            let lane = lanes.trailing_zeros();
            lanes &= lanes - 1;
            let corners = triangles.corners(first, count, lane);
            let Some((t, is_counter_clockwise)) = meet(corners, ray, margins[lane as usize & 7], best.t) else {
                continue;
            };
            let primitive = triangles.id(first, count, lane);
            let is_front = is_counter_clockwise == (primitive & FLIPPED_BIT == 0);
            let back_face = !is_front && primitive & TWO_SIDED_BIT == 0;
            let hit = Hit { t, instance: self.instance, primitive: face_of(primitive), back_face };
            if precedes(&hit, best) {
                *best = hit;
                is_better = true;
            }
        }
        is_better
    }
}

/// The tie rule: at equal distances front faces come first, then the lowest instance, then the lowest face.
#[inline(always)]
fn precedes(hit: &Hit, best: &Hit) -> bool {
    let key = |h: &Hit| (h.back_face, h.instance, h.primitive);
    hit.t < best.t || (hit.t == best.t && key(hit) < key(best))
}

/// Entry distance of each child's box, and the children that are entered up to `t_max`, times [`HIT_SLACK`].
#[inline(always)]
fn enter<V: Lanes>(node: &WideNode, ray: &TracedRay, t_max: f32) -> ([f32; 8], u32) {
    let mut near = V::splat(0.0);
    let mut far = V::splat(f32::INFINITY);
    for axis in 0..3 {
        let (origin, inverse) = (V::splat(ray.origin[axis]), V::splat(ray.inverse[axis]));
        let near_plane = V::load(&node.bounds[usize::from(ray.near[axis])]);
        let far_plane = V::load(&node.bounds[ray.far(axis)]);
        near = near_plane.sub(origin).mul(inverse).max(near);
        far = far_plane.sub(origin).mul(inverse).min(far);
    }
    let far = far.mul(V::splat(WIDEN)).min(V::splat(t_max * HIT_SLACK));
    let mut distances = [0.0; 8];
    near.store(&mut distances);
    (distances, V::bits(near.le(far)))
}

/// Takes a ray to the leaves that it enters before its closest hit, near ones first, from a node on. With `ANY` it ends at the
/// first hit.
pub(crate) struct Walk<'a, L, const ANY: bool> {
    pub(crate) nodes: &'a [WideNode],
    pub(crate) leaves: &'a L,
    pub(crate) start: u32,
    pub(crate) ray: &'a TracedRay,
    pub(crate) best: &'a mut Hit,
    pub(crate) stack: &'a mut [Waiting],
}

impl<L: Leaves, const ANY: bool> Kernel for Walk<'_, L, ANY> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { nodes, leaves, start, ray, best, stack } = self;
        let mut top = 0;
        let mut current = start;
        if nodes.is_empty() {
            return;
        }
        loop {
            if current & LEAF_BIT == 0 {
                let node = &nodes[current as usize];
                let (near, mut mask) = enter::<V>(node, ray, best.t);
                if mask != 0 {
                    let bottom = top;
                    while mask != 0 {
                        let slot = mask.trailing_zeros() as usize & 7;
                        mask &= mask - 1;
                        // Insertion keeps the nearest of this node's children on top.
                        let waiting = Waiting { reference: node.children[slot], near: near[slot] };
                        let mut at = top;
                        while at > bottom && stack[at - 1].near < waiting.near {
                            stack[at] = stack[at - 1];
                            at -= 1;
                        }
                        stack[at] = waiting;
                        top += 1;
                    }
                    top -= 1;
                    current = stack[top].reference;
                    continue;
                }
            } else if let BvhLink::Leaf { first, count } = BvhLink::of_reference(current) {
                leaves.visit::<V, ANY>(first, count, ray, best, &mut stack[top..]);
                if ANY && best.instance != u32::MAX {
                    return;
                }
            }
            loop {
                if top == 0 {
                    return;
                }
                top -= 1;
                if stack[top].near <= best.t * HIT_SLACK {
                    current = stack[top].reference;
                    break;
                }
            }
        }
    }
}
