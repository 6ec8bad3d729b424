//! Which instructions the kernels are compiled for, chosen at run time.

use crate::{
    Hit, Scene,
    alone::{self, MeshLeaves, Waiting},
    bundle::{self, Hits, Memory, Rays},
    lanes::{Lanes, Portable},
    levels::{self, MeshBundle, SceneAlone, Workspace},
    ray::TracedRay,
};

/// Instructions that the CPU tracer uses. Results are the same bits on all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Path {
    /// AVX2, on x86-64.
    Avx2,
    /// What the target always has.
    Portable,
}

impl Path {
    /// The fastest that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if crate::avx2::is_available() {
            return Self::Avx2;
        }
        Self::Portable
    }
}

/// The kernels that are compiled once for each path, instead of being inlined where they are called.
pub(crate) trait Kernels: Lanes {
    fn trace_bundle<const ANY: bool, const SHARED: bool>(scene: &Scene, count: usize, workspace: &mut Workspace);

    fn walk_mesh<const ANY: bool, const SHARED: bool>(
        leaves: &mut MeshBundle<'_>,
        rays: &Rays,
        mask: u64,
        hits: &mut Hits,
        memory: &mut Memory,
    );

    fn walk_mesh_alone<const ANY: bool>(
        leaves: &MeshLeaves<'_>,
        start: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut [Waiting],
    );

    fn walk_scene_alone<const ANY: bool>(
        leaves: &SceneAlone<'_>,
        start: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut [Waiting],
    );
}

impl Kernels for Portable {
    #[inline(never)]
    fn trace_bundle<const ANY: bool, const SHARED: bool>(scene: &Scene, count: usize, workspace: &mut Workspace) {
        levels::trace_bundle::<Self, ANY, SHARED>(scene, count, workspace);
    }

    #[inline(never)]
    fn walk_mesh<const ANY: bool, const SHARED: bool>(
        leaves: &mut MeshBundle<'_>,
        rays: &Rays,
        mask: u64,
        hits: &mut Hits,
        memory: &mut Memory,
    ) {
        let mesh = leaves.mesh.mesh;
        bundle::walk::<Self, _, ANY, SHARED>(&mesh.nodes, leaves, rays, mask, hits, memory);
    }

    #[inline(never)]
    fn walk_mesh_alone<const ANY: bool>(
        leaves: &MeshLeaves<'_>,
        start: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut [Waiting],
    ) {
        alone::walk::<Self, _, ANY>(&leaves.mesh.nodes, leaves, start, ray, best, stack);
    }

    #[inline(never)]
    fn walk_scene_alone<const ANY: bool>(
        leaves: &SceneAlone<'_>,
        start: u32,
        ray: &TracedRay,
        best: &mut Hit,
        stack: &mut [Waiting],
    ) {
        alone::walk::<Self, _, ANY>(&leaves.scene.nodes, leaves, start, ray, best, stack);
    }
}
