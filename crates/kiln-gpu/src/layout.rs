//! A scene's geometry as the device reads it: what is where in one array of words of 16 bytes.
//!
//! First come the records of instances, each of the size of a node: for the software traversal among the nodes of the tree
//! over them, for ray queries by index. Then comes for each mesh what leads to its triangles (nodes; for ray queries a table
//! of the boxes' runs of triangles), and its triangles. Last comes foliage ([`crate::foliage`]).

use crate::{
    foliage::FoliageLayout,
    node::WideNode,
    triangle::TriangleRecord,
    upload::Upload,
    widen::{WideTree, widen},
};
use bytemuck::{Pod, Zeroable, cast, cast_slice};
use kiln_trace::{MeshBvh, Scene, SceneInstance, TraceError};

/// Bytes of a word of the geometry.
pub(crate) const WORD_BYTES: u64 = 16;
pub(crate) const NODE_WORDS: u64 = 5;
pub(crate) const TRIANGLE_WORDS: u64 = 3;
/// Keep in sync with `ray_query.wgsl`.
const RUNS_PER_WORD: usize = 4;

/// Entries of the stack are a multiple of this, so that few shaders are compiled.
const STACK_STEP: u32 = 4;

/// The record of an instance: rows of the inverse transform, then where its mesh starts.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct InstanceRecord {
    object_from_world: [[f32; 4]; 3],
    /// First word of the nodes, or of the table of runs.
    first_word: u32,
    triangle_words: u32,
    instance: u32,
    padding: [u32; 5],
}

const _: () = {
    assert!(size_of::<WideNode>() as u64 == NODE_WORDS * WORD_BYTES);
    assert!(size_of::<InstanceRecord>() == size_of::<WideNode>());
    assert!(size_of::<TriangleRecord>() as u64 == TRIANGLE_WORDS * WORD_BYTES);
};

/// The device's trees, and where they go, in words.
pub(crate) struct Layout<'a> {
    pub(crate) ray_queries: bool,
    pub(crate) top: WideTree,
    pub(crate) meshes: Vec<WideTree>,
    /// First words of what leads to the triangles of each mesh, and of these.
    starts: Vec<[u64; 2]>,
    /// Behind all meshes.
    pub(crate) foliage: Option<FoliageLayout<'a>>,
    pub(crate) total_words: u64,
}

impl<'a> Layout<'a> {
    pub(crate) fn of(scene: &'a Scene, ray_queries: bool) -> Self {
        let top = if scene.is_empty() { WideTree::default() } else { widen(scene) };
        let of_mesh = |mesh: &MeshBvh| if mesh.is_empty() { WideTree::default() } else { widen(mesh) };
        let meshes: Vec<WideTree> = scene.meshes.iter().map(|mesh| of_mesh(mesh)).collect();
        let records = if ray_queries { scene.instances.len() } else { top.nodes.len() };
        let mut at = records as u64 * NODE_WORDS;
        let mut starts = Vec::with_capacity(meshes.len());
        for mesh in &meshes {
            let nodes = mesh.nodes.len() as u64 * NODE_WORDS;
            let table = mesh.runs().count().div_ceil(RUNS_PER_WORD) as u64;
            let triangles = at + if ray_queries { table } else { nodes };
            starts.push([at, triangles]);
            at = triangles + mesh.leaves.len() as u64 * TRIANGLE_WORDS;
        }
        let foliage = FoliageLayout::of(scene, at);
        let total_words = foliage.as_ref().map_or(at, |foliage| foliage.end_word).max(1);
        Self { ray_queries, top, meshes, starts, foliage, total_words }
    }

    /// Entries that no path through both levels exceeds: each node leaves one group behind, but for the last.
    pub(crate) fn stack_entries(&self) -> u32 {
        let deepest = self.meshes.iter().map(|mesh| mesh.depth).max().unwrap_or(0);
        let walked = if self.ray_queries { None } else { Some(self.top.depth + deepest) };
        let depth = walked.max(self.foliage.as_ref().map(FoliageLayout::depth));
        depth.map_or(0, |depth| depth.next_multiple_of(STACK_STEP).max(STACK_STEP))
    }

    #[expect(clippy::cast_possible_truncation, reason = "`shape` has checked the greatest word")]
    fn record(&self, instance: &SceneInstance) -> WideNode {
        let [first, triangles] = self.starts[instance.mesh()];
        cast(InstanceRecord {
            object_from_world: instance.place.object_from_world,
            first_word: first as u32,
            triangle_words: triangles as u32,
            instance: instance.object,
            padding: [0; 5],
        })
    }

    fn records(&self, scene: &Scene) -> Vec<WideNode> {
        if self.ray_queries {
            return scene.instances.iter().map(|instance| self.record(instance)).collect();
        }
        let mut records = self.top.nodes.clone();
        for &(at, index) in &self.top.leaf_records {
            records[at] = self.record(&scene.instances[index as usize]);
        }
        records
    }

    /// Sends everything, in the order of `starts`.
    pub(crate) fn send(&self, scene: &Scene, mut upload: Upload<'_>) -> Result<(), TraceError> {
        upload.write(cast_slice(&self.records(scene)))?;
        for (mesh, tree) in scene.meshes.iter().zip(&self.meshes) {
            if self.ray_queries {
                upload.write(cast_slice(&table(tree)))?;
            } else {
                upload.write(cast_slice(&tree.nodes))?;
            }
            for run in tree.leaves.chunks(1 << 16) {
                let triangles: Vec<TriangleRecord> = run.iter().map(|&i| TriangleRecord::of(mesh, i)).collect();
                upload.write(cast_slice(&triangles))?;
            }
        }
        if let Some(foliage) = &self.foliage {
            foliage.send(&mut upload)?;
        }
        upload.finish()
    }
}

/// For each box of a mesh its first triangle, times 8, and their number; whole words.
fn table(tree: &WideTree) -> Vec<u32> {
    let mut table: Vec<u32> = tree.runs().map(|run| (run.start << 3) | (run.end - run.start)).collect();
    table.resize(table.len().next_multiple_of(RUNS_PER_WORD), 0);
    table
}
