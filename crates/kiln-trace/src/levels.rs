//! Both levels: the tree over the instances, and in each of its leaves the tree of a mesh.

use crate::{
    Hit, Scene,
    alone::{self, Leaves, MeshLeaves, Stack, precedes},
    bundle::{self, BundleLeaves, Hits, Memory},
    cutout::CutoutBundle,
    foliage::{CrossBundle, FoliageMemory},
    node::{MAX_LEAF, WideNode},
    path::{Compiled, Kernel},
    ray::TracedRay,
    rays::{BUNDLE, Rays},
    triangle::{SeenTriangle, entry},
};

/// What a thread traces bundles with. It is large; what it holds before does not matter.
pub(crate) struct Workspace {
    /// In world space.
    pub(crate) rays: Rays,
    pub(crate) hits: Hits,
    object: Rays,
    scene_memory: Memory,
    mesh: MeshMemory,
    /// What the rays lose in foliage, among others.
    pub(crate) foliage: FoliageMemory,
}

/// What the way of a bundle through a mesh needs.
struct MeshMemory {
    memory: Memory,
    stack: Stack,
    seen: [SeenTriangle; MAX_LEAF],
}

impl Workspace {
    pub(crate) fn new() -> Box<Self> {
        Box::new(Self {
            rays: Rays::NEW,
            hits: Hits::NEW,
            object: Rays::NEW,
            scene_memory: Memory::NEW,
            mesh: MeshMemory { memory: Memory::NEW, stack: Stack::NEW, seen: [SeenTriangle::default(); MAX_LEAF] },
            foliage: FoliageMemory::NEW,
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
        let Workspace { rays, hits, object, scene_memory, mesh, .. } = workspace;
        rays.finish();
        hits.end(count);
        let mask = u64::MAX >> (BUNDLE - count.clamp(1, BUNDLE));
        let leaves = &mut SceneBundle { scene, object, memory: mesh };
        let walk: bundle::Walk<'_, _, ANY, SHARED> =
            bundle::Walk { nodes: &scene.nodes, leaves, rays, mask, hits, memory: scene_memory };
        walk.run::<V>();
        if let Some(cutouts) = &scene.cutouts {
            let MeshMemory { memory, stack, .. } = mesh;
            let leaves = &mut CutoutBundle { scene, cutouts, object, memory, stack };
            let walk: bundle::Walk<'_, _, ANY, SHARED> =
                bundle::Walk { nodes: &cutouts.nodes, leaves, rays, mask, hits, memory: scene_memory };
            V::compiled(walk);
        }
    }
}

/// Finds what the first `count` rays of the workspace, whose closest hits are known, lose on their way.
pub(crate) struct GoThrough<'a, const SHARED: bool> {
    pub(crate) scene: &'a Scene,
    pub(crate) count: usize,
    pub(crate) workspace: &'a mut Workspace,
}

impl<const SHARED: bool> Kernel for GoThrough<'_, SHARED> {
    #[inline(always)]
    fn run<V: Compiled>(self) {
        let Self { scene, count, workspace } = self;
        let Workspace { rays, hits, foliage: memory, .. } = workspace;
        match &scene.foliage {
            Some(foliage) => CrossBundle::<SHARED> { foliage, count, rays, hits, memory }.run::<V>(),
            None => memory.lost.start_without(),
        }
    }
}

/// The instances of a scene, for a bundle of rays.
struct SceneBundle<'a> {
    scene: &'a Scene,
    object: &'a mut Rays,
    memory: &'a mut MeshMemory,
}

impl BundleLeaves for SceneBundle<'_> {
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
        let mesh = &self.scene.meshes[instance.mesh()];
        let in_mesh = MeshLeaves { triangles: mesh.triangles.words(), instance: instance.object };
        let rays = if instance.is_identity() {
            rays
        } else {
            self.object.put_seen_from(&instance.place, rays, mask);
            &*self.object
        };
        let MeshMemory { memory, stack, seen } = &mut *self.memory;
        let leaves = &mut MeshBundle { nodes: &mesh.nodes, mesh: in_mesh, stack, seen };
        let nodes = &*mesh.nodes;
        let walk: bundle::Walk<'_, _, ANY, SHARED> = bundle::Walk { nodes, leaves, rays, mask, hits, memory };
        V::compiled(walk);
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        let leaves = &mut SceneAlone { scene: self.scene };
        go_alone::<V, _, ANY>(&self.scene.nodes, leaves, start, ray, rays, hits, &mut self.memory.stack);
    }
}

/// Takes one ray of a bundle on alone.
#[inline(always)]
pub(crate) fn go_alone<V: Compiled, L: Leaves, const ANY: bool>(
    nodes: &[WideNode],
    leaves: &mut L,
    start: u32,
    ray: usize,
    rays: &Rays,
    hits: &mut Hits,
    stack: &mut Stack,
) {
    let mut best = hits.get(ray);
    let ray_alone = &rays.alone(ray);
    V::compiled(alone::Walk::<_, ANY> { nodes, leaves, start, ray: ray_alone, best: &mut best, stack, bottom: 0 });
    hits.set::<ANY>(ray, best);
}

/// The triangles of a mesh, for a bundle of rays.
struct MeshBundle<'a> {
    nodes: &'a [WideNode],
    mesh: MeshLeaves<'a>,
    stack: &'a mut Stack,
    seen: &'a mut [SeenTriangle; MAX_LEAF],
}

impl BundleLeaves for MeshBundle<'_> {
    #[inline(always)]
    fn prefetch<V: Compiled>(&self, first: u32) {
        self.mesh.triangles.prefetch::<V>(first);
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
        let leaf = self.mesh.triangles.leaf(first, count);
        let mut rest = mask;
        let mut origin = rays.origin(rest.trailing_zeros() as usize);
        let mut edges = leaf.edges::<V>(origin.to_array());
        // Lanes whose triangle is known as it is seen from the origin.
        let mut known = 0;
        while rest != 0 {
            let ray = rest.trailing_zeros() as usize % BUNDLE;
            rest &= rest - 1;
            if !SHARED && rays.origin(ray) != origin {
                origin = rays.origin(ray);
                edges = leaf.edges::<V>(origin.to_array());
                known = 0;
            }
            let direction = rays.direction(ray).to_array();
            let (mut lanes, margins) = edges.crossed(direction);
            if lanes == 0 {
                continue;
            }
            let mut best = hits.get(ray);
            let mut is_better = false;
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize % MAX_LEAF;
                lanes &= lanes - 1;
                let seen = &mut self.seen[lane];
                if known >> lane & 1 == 0 {
                    known |= 1 << lane;
                    *seen = leaf.seen(lane, origin.to_array());
                }
                let entry = || entry(leaf.corners(lane), origin.to_array(), rays.inverse(ray));
                let Some(met) = seen.meet(direction, margins[lane], best.t, entry) else {
                    continue;
                };
                let hit = self.mesh.hit(seen.primitive, met);
                if precedes(&hit, &best) {
                    best = hit;
                    is_better = true;
                }
            }
            if is_better {
                hits.set::<ANY>(ray, best);
            }
        }
    }

    #[inline(always)]
    fn walk_alone<V: Compiled, const ANY: bool>(&mut self, start: u32, ray: usize, rays: &Rays, hits: &mut Hits) {
        go_alone::<V, _, ANY>(self.nodes, &mut self.mesh, start, ray, rays, hits, self.stack);
    }
}

/// The instances of a scene, for one ray.
struct SceneAlone<'a> {
    scene: &'a Scene,
}

impl Leaves for SceneAlone<'_> {
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
        let mesh = &self.scene.meshes[instance.mesh()];
        let leaves = &mut MeshLeaves { triangles: mesh.triangles.words(), instance: instance.object };
        let ray = instance.ray(ray);
        let nodes = &*mesh.nodes;
        V::compiled(alone::Walk::<_, ANY> { nodes, leaves, start: 0, ray: &ray, best, stack, bottom: top });
    }
}
