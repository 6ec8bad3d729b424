//! Foliage as the tracers of other backends read it.

use super::{CrossingMesh, Foliage, Placed, ShrubGroup, What};
use crate::{BvhChild, MeshBvh, Place};
use glam::Vec3;
use kiln_core::FoliageMode;
use std::sync::Arc;

/// What a leaf of the tree does to rays.
#[derive(Clone, Copy, Debug)]
pub enum FoliageView<'a> {
    /// A tree: each of its faces takes its depth wherever it is crossed.
    Crossings {
        /// Its faces.
        mesh: &'a Arc<CrossingMesh>,
        /// Where it is.
        place: &'a Place,
    },
    /// One box of fog.
    Fog {
        /// Least corner, object space.
        min: Vec3,
        /// Greatest corner.
        max: Vec3,
        /// Binary logarithms of what is kept, for each metre in world space, times 2²⁴; above 0 and below 2⁴².
        rate: i64,
        /// Where it is.
        place: &'a Place,
    },
    /// Up to 16 shrubs.
    Shrubs(ShrubGroup<'a>),
}

impl Foliage {
    /// What rays are worth.
    pub fn mode(&self) -> FoliageMode {
        self.mode
    }

    /// The children of a node of the tree over everything; a leaf is one thing, of [`Self::leaf`]. There is no node where there
    /// is nothing; else the root is node 0.
    pub fn children(&self, node: u32) -> impl Iterator<Item = BvhChild> {
        self.nodes[node as usize].slots()
    }

    /// What a leaf names.
    pub fn leaf(&self, index: u32) -> FoliageView<'_> {
        let index = index as usize;
        if index < self.groups.len() {
            return FoliageView::Shrubs(self.groups.view(index));
        }
        let Placed { place, what, .. } = &self.objects[index - self.groups.len()];
        match what {
            What::Crossings(mesh) => FoliageView::Crossings { mesh, place },
            What::Fog { min, max, rate } => FoliageView::Fog { min: *min, max: *max, rate: *rate, place },
        }
    }

    /// All that leaves name, by index.
    pub fn leaves(&self) -> impl Iterator<Item = FoliageView<'_>> {
        (0..(self.groups.len() + self.objects.len()) as u32).map(|index| self.leaf(index))
    }
}

impl CrossingMesh {
    /// The tree over its faces that keep a part.
    pub fn bvh(&self) -> &MeshBvh {
        &self.bvh
    }

    /// What a triangle takes, by the id that [`MeshBvh::triangle`] tells: a depth in the units of [`kiln_core::OpticalDepth`].
    pub fn depth_of(&self, primitive: u32) -> u32 {
        self.depth(primitive)
    }
}
