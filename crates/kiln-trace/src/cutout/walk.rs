//! Takes bundles of rays to the faces with holes that are nearer than what they hit so far.

use super::CutoutMesh;
use crate::{
    Hit, Scene,
    alone::{self, Leaves, MeshLeaves, Stack, precedes},
    bundle::{self, BundleLeaves, Hits, Memory},
    cutout::SceneCutouts,
    levels::go_alone,
    node::MAX_LEAF,
    path::Compiled,
    ray::TracedRay,
    rays::{BUNDLE, Rays},
    triangle::entry,
};

/// The instances that have cutouts, for a bundle of rays.
pub(crate) struct CutoutBundle<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) cutouts: &'a SceneCutouts,
    pub(crate) object: &'a mut Rays,
    pub(crate) memory: &'a mut Memory,
    pub(crate) stack: &'a mut Stack,
}

impl BundleLeaves for CutoutBundle<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, _: u32) {}

    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool, const SHARED: bool>(
        &mut self,
        first: u32,
        _: u32,
        mask: u64,
        rays: &Rays,
        hits: &mut Hits,
    ) {
        let instance = &self.scene.instances[first as usize];
        let Some(mesh) = &self.cutouts.meshes[instance.mesh()] else { return };
        let rays = if instance.is_identity() {
            rays
        } else {
            self.object.put_seen_from(&instance.place, rays, mask);
            &*self.object
        };
        let leaves = &mut FacesBundle { faces: Faces { mesh, instance: instance.object }, stack: self.stack };
        let (nodes, memory) = (&*mesh.bvh.nodes, &mut *self.memory);
        let walk: bundle::Walk<'_, _, ANY, SHARED> = bundle::Walk { nodes, leaves, rays, mask, hits, memory };
        V::compiled(walk);
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let leaves = &mut CutoutsAlone { scene: self.scene, cutouts: self.cutouts };
        go_alone::<V, _, ANY>(&self.cutouts.nodes, leaves, start, ray, rays, hits, self.stack);
    }
}

/// The instances that have cutouts, for one ray.
struct CutoutsAlone<'a> {
    scene: &'a Scene,
    cutouts: &'a SceneCutouts,
}

impl Leaves for CutoutsAlone<'_> {
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
        let instance = &self.scene.instances[first as usize];
        let Some(mesh) = &self.cutouts.meshes[instance.mesh()] else { return };
        let leaves = &mut Faces { mesh, instance: instance.object };
        let ray = instance.ray(ray);
        let nodes = &*mesh.bvh.nodes;
        V::compiled(alone::Walk::<_, ANY> { nodes, leaves, start: 0, ray: &ray, best, stack, bottom: top });
    }
}

/// The faces of a mesh, for a bundle of rays.
struct FacesBundle<'a> {
    faces: Faces<'a>,
    stack: &'a mut Stack,
}

impl BundleLeaves for FacesBundle<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, first: u32) {
        self.faces.mesh.bvh.triangles.words().prefetch::<V>(first);
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
            let mut best = hits.get(ray);
            if self.faces.test::<V>(first, count, &rays.alone(ray), &mut best) {
                hits.set::<ANY>(ray, best);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let nodes = &self.faces.mesh.bvh.nodes;
        go_alone::<V, _, ANY>(nodes, &mut self.faces, start, ray, rays, hits, self.stack);
    }
}

/// The faces of a mesh, seen through an instance.
#[derive(Clone, Copy)]
struct Faces<'a> {
    mesh: &'a CutoutMesh,
    instance: u32,
}

impl Leaves for Faces<'_> {
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

impl Faces<'_> {
    /// Takes note of what a ray hits in a leaf, and says whether it was anything.
    #[inline(always)]
    fn test<V: Compiled>(&self, first: u32, count: u32, ray: &TracedRay, best: &mut Hit) -> bool {
        let as_whole = MeshLeaves { triangles: self.mesh.bvh.triangles.words(), instance: self.instance };
        let leaf = as_whole.triangles.leaf(first, count);
        let (mut lanes, margins) = leaf.edges::<V>(ray.origin).crossed(ray.direction);
        let mut is_better = false;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % MAX_LEAF;
            lanes &= lanes - 1;
            let seen = leaf.seen(lane, ray.origin);
            let entry = || entry(leaf.corners(lane), ray.origin, ray.inverse);
            let Some(met) = seen.meet(ray.direction, margins[lane], best.t, entry) else {
                continue;
            };
            let hit = as_whole.hit(seen.primitive, met);
            if precedes(&hit, best) && self.mesh.holes.is_there(seen.primitive, leaf.corners(lane), ray) {
                *best = hit;
                is_better = true;
            }
        }
        is_better
    }
}
