//! Both levels: the tree over the instances, and in each of its leaves the tree of a mesh.

use crate::{
    Hit, Scene,
    alone::{self, Leaves, MeshLeaves, Stack, Waiting},
    bundle::{self, BUNDLE, BundleLeaves, Hits, Memory, Rays},
    node::{MAX_STACK, WideNode},
    path::{Compiled, Kernel},
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
pub(crate) struct TraceBundle<'a, const ANY: bool, const SHARED: bool> {
    pub(crate) scene: &'a Scene,
    pub(crate) count: usize,
    pub(crate) workspace: &'a mut Workspace,
}

impl<const ANY: bool, const SHARED: bool> Kernel for TraceBundle<'_, ANY, SHARED> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { scene, count, workspace } = self;
        let Workspace { origins, directions, hits, world, object, scene_memory, mesh_memory, stack } = workspace;
        for ray in 0..count.min(BUNDLE) {
            world[ray] = TracedRay::new(origins[ray], directions[ray]);
        }
        let mask = u64::MAX >> (BUNDLE - count.clamp(1, BUNDLE));
        let leaves = &mut SceneBundle::<SHARED> { scene, origins, directions, object, mesh_memory, stack };
        let walk: bundle::Walk<'_, _, ANY, SHARED> =
            bundle::Walk { nodes: &scene.nodes, leaves, rays: world, mask, hits, memory: scene_memory };
        walk.run::<V>();
    }
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
    fn prefetch<V: Compiled>(&self, _: u32) {}

    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(&mut self, first: u32, _: u32, mask: u64, rays: &Rays, hits: &mut Hits) {
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
        let leaves = &mut MeshBundle { mesh, stack: self.stack };
        let (nodes, memory) = (mesh.mesh.nodes.as_slice(), &mut *self.mesh_memory);
        let walk: bundle::Walk<'_, _, ANY, SHARED> = bundle::Walk { nodes, leaves, rays, mask, hits, memory };
        V::compiled(walk);
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let (origin, direction) = (self.origins[ray % BUNDLE], self.directions[ray % BUNDLE]);
        let leaves = &SceneAlone { scene: self.scene, origin, direction };
        go_alone::<V, _, ANY>(&self.scene.nodes, leaves, start, ray, rays, hits, self.stack);
    }
}

/// Takes one ray of a bundle on alone.
#[inline(always)]
fn go_alone<V: Compiled, L: Leaves, const ANY: bool>(
    nodes: &[WideNode],
    leaves: &L,
    start: u32,
    ray: usize,
    rays: &Rays,
    hits: &mut Hits,
    stack: &mut Stack,
) {
    let mut best = hits.get(ray);
    let ray_here = &rays[ray % BUNDLE];
    V::compiled(alone::Walk::<_, ANY> { nodes, leaves, start, ray: ray_here, best: &mut best, stack });
    hits.set::<ANY>(ray, best);
}

/// The triangles of a mesh, for a bundle of rays.
struct MeshBundle<'a> {
    mesh: MeshLeaves<'a>,
    stack: &'a mut Stack,
}

impl BundleLeaves for MeshBundle<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, first: u32) {
        self.mesh.mesh.triangles.prefetch::<V>(first);
    }

    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(&mut self, first: u32, count: u32, mask: u64, rays: &Rays, hits: &mut Hits) {
        let mut rest = mask;
        while rest != 0 {
            let ray = rest.trailing_zeros() as usize % BUNDLE;
            rest &= rest - 1;
            let mut best = hits.get(ray);
            if self.mesh.test::<V>(first, count, &rays[ray], &mut best) {
                hits.set::<ANY>(ray, best);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        go_alone::<V, _, ANY>(&self.mesh.mesh.nodes, &self.mesh, start, ray, rays, hits, self.stack);
    }
}

/// The instances of a scene, for one ray.
struct SceneAlone<'a> {
    scene: &'a Scene,
    origin: Vec3,
    direction: Vec3,
}

impl Leaves for SceneAlone<'_> {
    #[inline(always)]
    fn visit<V: Compiled, const ANY: bool>(
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
        let nodes = mesh.mesh.nodes.as_slice();
        V::compiled(alone::Walk::<_, ANY> { nodes, leaves: &mesh, start: 0, ray: &ray, best, stack });
    }
}
