//! Foliage as the tracers of other backends read it.

use super::{CrossingMesh, Foliage, Placed, What};
use crate::{BvhChild, MeshBvh, SceneInstance};
use glam::Vec3;
use kiln_core::FoliageMode;
use std::sync::Arc;

/// What an object does to rays that are taken into its space.
#[derive(Clone, Copy, Debug)]
pub enum FoliageView<'a> {
    /// A tree: each of its faces takes its depth wherever it is crossed.
    Crossings(&'a Arc<CrossingMesh>),
    /// A shrub.
    Fog {
        /// Least corner of its box, object space.
        min: Vec3,
        /// Greatest corner.
        max: Vec3,
        /// Binary logarithms of what is kept, for each metre in world space, times 2²⁴; above 0 and below 2⁴².
        rate: i64,
    },
}

impl Foliage {
    /// What rays are worth.
    pub fn mode(&self) -> FoliageMode {
        self.mode
    }

    /// The children of a node of the tree over all objects; a leaf is one object. There is no node where there is nothing; else
    /// the root is node 0.
    pub fn children(&self, node: u32) -> impl Iterator<Item = BvhChild> {
        self.nodes[node as usize].slots()
    }

    /// All objects by the indices that leaves name: where they are, of which only the transform counts, and what they are.
    pub fn objects(&self) -> impl ExactSizeIterator<Item = (&SceneInstance, FoliageView<'_>)> {
        self.objects.iter().map(|Placed { place, what }| (place, what.view()))
    }
}

impl What {
    fn view(&self) -> FoliageView<'_> {
        match self {
            Self::Crossings(mesh) => FoliageView::Crossings(mesh),
            Self::Fog { min, max, rate } => FoliageView::Fog { min: *min, max: *max, rate: *rate },
        }
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
