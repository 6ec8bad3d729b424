//! Faces with holes: geometry that is there only where a texture says so.
//!
//! A scene has a tree of its own over the instances of meshes with such faces, and only scenes that have any go through it:
//! once a bundle's closest hits among whole faces are known, what is nearer among these takes their place. A ray that crosses
//! a face looks at its texture there ([`Holes`]); where that is transparent nothing was hit. All that asks for hits, the
//! closest or any, so goes through holes, and back faces count as those of whole faces do.

mod holes;
mod walk;

pub(crate) use holes::Holes;
pub(crate) use walk::CutoutBundle;

use crate::{MeshBvh, node::WideNode};
use kiln_core::Mesh;
use std::sync::Arc;

/// The faces of a mesh that stop rays but for their holes.
#[derive(Debug)]
pub struct CutoutMesh {
    pub(crate) bvh: MeshBvh,
    pub(crate) holes: Holes,
}

impl CutoutMesh {
    /// Of a mesh; `None` if it has no such face.
    pub fn build(mesh: &Mesh) -> Option<Self> {
        if !mesh.groups.iter().any(kiln_core::FaceGroup::stops_where_opaque) {
            return None;
        }
        let bvh = MeshBvh::build_over(mesh, kiln_core::FaceGroup::stops_where_opaque);
        (!bvh.is_empty()).then(|| Self { bvh, holes: Holes::of(mesh) })
    }

    /// Memory of nodes, triangles and texture coordinates, bytes; that of masks, which meshes share, is not in it.
    pub fn memory_bytes(&self) -> usize {
        self.bvh.memory_bytes() + self.holes.memory_bytes()
    }
}

/// The cutouts of a scene.
#[derive(Debug)]
pub(crate) struct SceneCutouts {
    /// Tree over the instances that have any; a leaf's index is an instance's.
    pub(crate) nodes: Vec<WideNode>,
    /// Those of each mesh of the scene, if it has any.
    pub(crate) meshes: Vec<Option<Arc<CutoutMesh>>>,
}

impl SceneCutouts {
    /// Memory of the tree and of all meshes, bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        let meshes: usize = self.meshes.iter().flatten().map(|mesh| mesh.memory_bytes()).sum();
        size_of_val(self.nodes.as_slice()) + meshes
    }
}
