//! Takes bundles of rays through foliage: all that they cross counts.

use super::{CrossingMesh, Foliage, Lost, Placed, What};
use crate::{
    Hit,
    alone::{self, Leaves, Stack},
    bundle::{self, BundleLeaves, Hits, Memory},
    levels::go_alone,
    node::MAX_LEAF,
    path::{Compiled, Kernel},
    ray::TracedRay,
    rays::{BUNDLE, Rays},
    triangle::entry,
};
use glam::Vec3;

/// What the way of a bundle through foliage needs.
pub(crate) struct FoliageMemory {
    pub(crate) lost: Lost,
    object: Rays,
    scene_memory: Memory,
    mesh_memory: Memory,
    stack: Stack,
}

impl FoliageMemory {
    pub(crate) const NEW: Self = Self {
        lost: Lost::NEW,
        object: Rays::NEW,
        scene_memory: Memory::NEW,
        mesh_memory: Memory::NEW,
        stack: Stack::NEW,
    };
}

/// Finds what the first `count` rays of a bundle lose before their closest hits, which are known.
pub(crate) struct CrossBundle<'a, const SHARED: bool> {
    pub(crate) foliage: &'a Foliage,
    pub(crate) count: usize,
    pub(crate) rays: &'a Rays,
    pub(crate) hits: &'a mut Hits,
    pub(crate) memory: &'a mut FoliageMemory,
}

impl<const SHARED: bool> Kernel for CrossBundle<'_, SHARED> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { foliage, count, rays, hits, memory } = self;
        let FoliageMemory { lost, object, scene_memory, mesh_memory, stack } = memory;
        lost.start(foliage.mode);
        let mask = u64::MAX >> (BUNDLE - count.clamp(1, BUNDLE));
        let leaves = &mut Objects { foliage, lost, object, memory: mesh_memory, stack };
        let walk: bundle::Walk<'_, _, false, SHARED> =
            bundle::Walk { nodes: &foliage.nodes, leaves, rays, mask, hits, memory: scene_memory };
        walk.run::<V>();
        lost.finish();
    }
}

/// The objects of foliage, for a bundle of rays.
struct Objects<'a> {
    foliage: &'a Foliage,
    lost: &'a mut Lost,
    object: &'a mut Rays,
    memory: &'a mut Memory,
    stack: &'a mut Stack,
}

impl BundleLeaves for Objects<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, first: u32) {
        V::prefetch(self.foliage.objects.get(first as usize..=first as usize).unwrap_or_default());
    }

    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool, const SHARED: bool>(
        &mut self,
        first: u32,
        _: u32,
        mask: u64,
        rays: &Rays,
        hits: &mut Hits,
    ) {
        let Placed { place, what } = &self.foliage.objects[first as usize];
        match what {
            What::Fog { min, max, rate } => {
                let mut rest = mask;
                while rest != 0 {
                    let ray = rest.trailing_zeros() as usize % BUNDLE;
                    rest &= rest - 1;
                    let in_box = InBox { min: *min, max: *max, t_max: hits.get(ray).t };
                    let Some(part) = in_box.part(&place.ray(&rays.alone(ray))) else { continue };
                    if self.lost.go_through(ray, part, *rate) {
                        hits.stop(ray);
                    }
                }
            }
            What::Crossings(mesh) => {
                let rays = if place.is_identity {
                    rays
                } else {
                    self.object.put_seen_from(place, rays, mask);
                    &*self.object
                };
                let leaves = &mut Faces { mesh, lost: self.lost, stack: self.stack };
                let (nodes, memory) = (&*mesh.bvh.nodes, &mut *self.memory);
                let walk: bundle::Walk<'_, _, false, SHARED> = bundle::Walk { nodes, leaves, rays, mask, hits, memory };
                V::compiled(walk);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let leaves = &mut ObjectsAlone { foliage: self.foliage, lost: self.lost, ray };
        go_alone::<V, _, false>(&self.foliage.nodes, leaves, start, ray, rays, hits, self.stack);
    }
}

/// The objects of foliage, for one ray of a bundle.
struct ObjectsAlone<'a> {
    foliage: &'a Foliage,
    lost: &'a mut Lost,
    /// Its index in the bundle.
    ray: usize,
}

impl Leaves for ObjectsAlone<'_> {
    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(
        &mut self,
        first: u32,
        _: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut Stack,
        top: usize,
    ) {
        let Placed { place, what } = &self.foliage.objects[first as usize];
        let seen = place.ray(ray);
        match what {
            What::Fog { min, max, rate } => {
                if let Some(part) = (InBox { min: *min, max: *max, t_max: best.t }).part(&seen) {
                    self.lost.go_through(self.ray, part, *rate);
                }
            }
            What::Crossings(mesh) => {
                let leaves = &mut FacesAlone { mesh, lost: self.lost, ray: self.ray };
                let nodes = &*mesh.bvh.nodes;
                let walk = alone::Walk::<_, ANY> { nodes, leaves, start: 0, ray: &seen, best, stack, bottom: top };
                V::compiled(walk);
            }
        }
    }
}

/// A box, and how far a ray goes.
struct InBox {
    min: Vec3,
    max: Vec3,
    t_max: f32,
}

impl InBox {
    /// The part of a ray that is in the box.
    #[inline(always)]
    fn part(&self, ray: &TracedRay) -> Option<[f32; 2]> {
        let (origin, inverse) = (Vec3::from_array(ray.origin), Vec3::from_array(ray.inverse));
        let [low, high] = [self.min, self.max].map(|plane| (plane - origin) * inverse);
        let near = low.min(high).max_element().max(0.0);
        let far = low.max(high).min_element().min(self.t_max);
        (near < far).then_some([near, far])
    }
}

/// The faces of a tree, for a bundle of rays.
struct Faces<'a> {
    mesh: &'a CrossingMesh,
    lost: &'a mut Lost,
    stack: &'a mut Stack,
}

impl BundleLeaves for Faces<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, first: u32) {
        self.mesh.bvh.triangles.words().prefetch::<V>(first);
    }

    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool, const SHARED: bool>(
        &mut self,
        first: u32,
        count: u32,
        mask: u64,
        rays: &Rays,
        hits: &mut Hits,
    ) {
        let mut rest = mask;
        while rest != 0 {
            let ray = rest.trailing_zeros() as usize % BUNDLE;
            rest &= rest - 1;
            let leaf = Leaf { mesh: self.mesh, first, count, t_max: hits.get(ray).t };
            if leaf.cross::<V>(&rays.alone(ray), ray, self.lost) {
                hits.stop(ray);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let leaves = &mut FacesAlone { mesh: self.mesh, lost: self.lost, ray };
        go_alone::<V, _, false>(&self.mesh.bvh.nodes, leaves, start, ray, rays, hits, self.stack);
    }
}

/// The faces of a tree, for one ray of a bundle.
struct FacesAlone<'a> {
    mesh: &'a CrossingMesh,
    lost: &'a mut Lost,
    /// Its index in the bundle.
    ray: usize,
}

impl Leaves for FacesAlone<'_> {
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
        Leaf { mesh: self.mesh, first, count, t_max: best.t }.cross::<V>(ray, self.ray, self.lost);
    }
}

/// Faces that are tested side by side, and how far a ray goes.
struct Leaf<'a> {
    mesh: &'a CrossingMesh,
    first: u32,
    count: u32,
    t_max: f32,
}

impl Leaf<'_> {
    /// Takes note of each face that a ray crosses. Returns whether the ray has lost all there was.
    #[inline(always)]
    fn cross<V: Compiled>(&self, ray: &TracedRay, index: usize, lost: &mut Lost) -> bool {
        let leaf = self.mesh.bvh.triangles.words().leaf(self.first, self.count);
        let (mut lanes, margins) = leaf.edges::<V>(ray.origin).crossed(ray.direction);
        let mut all_lost = false;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % MAX_LEAF;
            lanes &= lanes - 1;
            let seen = leaf.seen(lane, ray.origin);
            let entry = || entry(leaf.corners(lane), ray.origin, ray.inverse);
            if let Some((t, _)) = seen.meet(ray.direction, margins[lane], self.t_max, entry)
                && self.mesh.is_there(seen.primitive, leaf.corners(lane), ray)
            {
                all_lost |= lost.cross(index, t, self.mesh.depth(seen.primitive));
            }
        }
        all_lost
    }
}
