//! Both levels: the tree over the instances, and in each of its leaves the tree of a mesh.

use crate::{
    Hit, Scene,
    alone::{Leaves, MeshLeaves, Stack, Waiting},
    bundle::{self, BUNDLE, BundleLeaves, Hits, Memory, Rays},
    node::MAX_STACK,
    path::Kernels,
    ray::TracedRay,
};
use glam::Vec3;

/// What a thread traces bundles with. It is large; what it holds before does not matter.
pub(crate) struct Workspace {
    pub(crate) origins: [Vec3; BUNDLE],
    pub(crate) directions: [Vec3; BUNDLE],
    pub(crate) hits: Hits,
    world: Rays,
    object: Rays,
    scene_memory: Memory,
    mesh_memory: Memory,
    stack: Stack,
}

impl Workspace {
    pub(crate) fn new() -> Box<Self> {
        let ray = TracedRay::default();
        Box::new(Self {
            origins: [Vec3::ZERO; BUNDLE],
            directions: [Vec3::ZERO; BUNDLE],
            hits: Hits::NEW,
            world: [ray; BUNDLE],
            object: [ray; BUNDLE],
            scene_memory: Memory::NEW,
            mesh_memory: Memory::NEW,
            stack: [Waiting::default(); 2 * MAX_STACK],
        })
    }
}

/// Traces the first `count` rays of the workspace, whose hits have been started.
#[inline(always)]
pub(crate) fn trace_bundle<V: Kernels, const ANY: bool, const SHARED: bool>(
    scene: &Scene,
    count: usize,
    workspace: &mut Workspace,
) {
    let Workspace { origins, directions, hits, world, object, scene_memory, mesh_memory, stack } = workspace;
    for ray in 0..count.min(BUNDLE) {
        world[ray] = TracedRay::new(origins[ray], directions[ray]);
    }
    let mask = u64::MAX >> (BUNDLE - count.clamp(1, BUNDLE));
    let mut leaves = SceneBundle::<SHARED> { scene, origins, directions, object, mesh_memory, stack };
    bundle::walk::<V, _, ANY, SHARED>(&scene.nodes, &mut leaves, world, mask, hits, scene_memory);
}

/// The instances of a scene, for a bundle of rays.
struct SceneBundle<'a, const SHARED: bool> {
    scene: &'a Scene,
    origins: &'a [Vec3; BUNDLE],
    directions: &'a [Vec3; BUNDLE],
    object: &'a mut Rays,
    mesh_memory: &'a mut Memory,
    stack: &'a mut Stack,
}

impl<const SHARED: bool> BundleLeaves for SceneBundle<'_, SHARED> {
    #[inline(always)]
    fn prefetch<V: Kernels>(&self, _: u32) {}

    #[inline(always)]
    fn visit<V: Kernels, const ANY: bool>(&mut self, first: u32, _: u32, mask: u64, rays: &Rays, hits: &mut Hits) {
        let instance = &self.scene.instances[first as usize];
        let mesh = MeshLeaves { mesh: &self.scene.meshes[instance.mesh as usize], instance: first };
        let rays = if instance.is_identity {
            rays
        } else {
            let mut rest = mask;
            while rest != 0 {
                let ray = rest.trailing_zeros() as usize % BUNDLE;
                rest &= rest - 1;
                self.object[ray] = instance.ray(self.origins[ray], self.directions[ray]);
            }
            &*self.object
        };
        let mut leaves = MeshBundle { mesh, stack: self.stack };
        V::walk_mesh::<ANY, SHARED>(&mut leaves, rays, mask, hits, self.mesh_memory);
    }

    #[inline(always)]
    fn walk_alone<V: Kernels, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let (origin, direction) = (self.origins[ray % BUNDLE], self.directions[ray % BUNDLE]);
        let leaves = SceneAlone { scene: self.scene, origin, direction };
        let mut best = hits.get(ray);
        V::walk_scene_alone::<ANY>(&leaves, start, &rays[ray % BUNDLE], &mut best, self.stack);
        hits.set::<ANY>(ray, best);
    }
}

/// The triangles of a mesh, for a bundle of rays.
pub(crate) struct MeshBundle<'a> {
    pub(crate) mesh: MeshLeaves<'a>,
    stack: &'a mut Stack,
}

impl BundleLeaves for MeshBundle<'_> {
    #[inline(always)]
    fn prefetch<V: Kernels>(&self, first: u32) {
        self.mesh.mesh.triangles.prefetch::<V>(first);
    }

    #[inline(always)]
    fn visit<V: Kernels, const ANY: bool>(&mut self, first: u32, count: u32, mask: u64, rays: &Rays, hits: &mut Hits) {
        let mut rest = mask;
        while rest != 0 {
            let ray = rest.trailing_zeros() as usize % BUNDLE;
            rest &= rest - 1;
            let mut best = hits.get(ray);
            let found = self.mesh.mesh.triangles.intersect::<V>(first, count, &rays[ray], best.t);
            if found.mask != 0 {
                self.mesh.record(first, count, &found, &mut best);
                hits.set::<ANY>(ray, best);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Kernels, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let mut best = hits.get(ray);
        V::walk_mesh_alone::<ANY>(&self.mesh, start, &rays[ray % BUNDLE], &mut best, self.stack);
        hits.set::<ANY>(ray, best);
    }
}

/// The instances of a scene, for one ray.
pub(crate) struct SceneAlone<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) origin: Vec3,
    pub(crate) direction: Vec3,
}

impl Leaves for SceneAlone<'_> {
    #[inline(always)]
    fn visit<V: Kernels, const ANY: bool>(
        &self,
        first: u32,
        _: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut [Waiting],
    ) {
        let instance = &self.scene.instances[first as usize];
        let mesh = MeshLeaves { mesh: &self.scene.meshes[instance.mesh as usize], instance: first };
        let ray = if instance.is_identity { *ray } else { instance.ray(self.origin, self.direction) };
        V::walk_mesh_alone::<ANY>(&mesh, 0, &ray, best, stack);
    }
}
