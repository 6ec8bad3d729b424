//! Foliage on the device; the host side of `foliage.wgsl`, `attenuate.wgsl` and `expected.wgsl`.
//!
//! Once the closest hit of a ray is known, all foliage before it counts (kiln-trace's `foliage` says what for). Kernels that value
//! rays have one of three endings, by [`FoliageShape`]: none (`no_foliage.wgsl`), so that a scene without foliage pays nothing, or
//! one for each mode. Closest hits and any hits know of no foliage.
//!
//! # Data
//!
//! Behind the meshes lies the tree over everything, made from the CPU's ([`crate::widen`]), its leaves among its nodes as a scene's
//! instances are. A leaf's record has the rows of a transform and where a tree's mesh starts, or a box of fog and its rate; or it has the
//! base of a group of shrubs and where their records start, a word of 16 bytes for each, as kiln-trace packs them. The
//! triangles of trees are those of opaque meshes, with their depth in a word that is not used there ([`crate::triangle`]).
//!
//! # The way
//!
//! A second walk of both levels, by software with ray queries too: nothing ends it, so there is no closest hit to be culled by, but all
//! that is beyond the first walk's. Whether and where a face is crossed is the test of opaque faces.
//!
//! Mode `Attenuate` keeps one sum, whose order does not matter, and ends where nothing is left. Mode `Expected` needs events by
//! distance: crossings, and where fog begins and ends. The walk keeps the nearest 16 of different distance, sorted by insertion (which moves
//! little, as near children come first); what happens at one distance is one event, since depths and rates are integers that add up. If
//! the list is full, boxes beyond its last event are no longer visited. The ray is then taken past these events, and as long as the list was
//! full and something is left, the walk is done again for the next 16: events up to the last distance do not count in it, and
//! boxes that end before are not visited. A distance is in one list only, with all that happens there, and is the same to the bit in each walk: so
//! nothing is lost or counted twice, however many things coincide, and any number of layers needs the same memory.
//!
//! Rates of fog are 64 bits in two words, as the CPU's, so that what begins also ends, exactly. The rest is the CPU's arithmetic in
//! f32 for all channels at once, but that the walk ends where less than 2⁻³² is left; see `expected.wgsl`.

use crate::{
    layout::{NODE_WORDS, TRIANGLE_WORDS},
    node::WideNode,
    triangle::TriangleRecord,
    upload::Upload,
    widen::{SourceTree, WideTree, widen},
};
use bytemuck::{Pod, Zeroable, cast, cast_slice};
use glam::Vec3;
use kiln_core::FoliageMode;
use kiln_trace::{BvhChild, CrossingMesh, Foliage, FoliageView, Scene, ShrubGroup, TraceError};
use std::{collections::BTreeMap, sync::Arc};

/// Set in the last word of a record of fog, and of one of a group; keep in sync with `foliage.wgsl`.
const FOG_BIT: u32 = 1 << 31;
const GROUP_BIT: u32 = 1 << 30;

/// What rays go through, as far as their shaders differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum FoliageShape {
    Nothing,
    Attenuate,
    Expected,
}

impl FoliageShape {
    pub(crate) fn of(scene: &Scene) -> Self {
        match scene.foliage().map(Foliage::mode) {
            Some(FoliageMode::Attenuate) => Self::Attenuate,
            Some(FoliageMode::Expected) => Self::Expected,
            // Of geometry there are no objects.
            Some(FoliageMode::Geometry) | None => Self::Nothing,
        }
    }
}

impl SourceTree for Foliage {
    const LEAVES_HAVE_RECORDS: bool = true;

    fn children(&self, node: u32) -> Vec<BvhChild> {
        self.children(node).collect()
    }

    fn bounds(&self, _: u32) -> (Vec3, Vec3) {
        (Vec3::NEG_INFINITY, Vec3::INFINITY)
    }
}

/// The record of a leaf: rows of the inverse transform; then where its mesh starts (nodes and triangles), or the corners of a box of
/// fog, each followed by half of the rate. That of a group has no transform, but its base, where its shrubs start, and how many there are.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct LeafRecord {
    object_from_world: [[f32; 4]; 3],
    words: [u32; 8],
}

const _: () = assert!(size_of::<LeafRecord>() == size_of::<WideNode>());

/// A mesh of trees, and the first words of its nodes and triangles.
struct CrossingLayout<'a> {
    mesh: &'a Arc<CrossingMesh>,
    tree: WideTree,
    starts: [u64; 2],
}

/// The device's trees of foliage, and where they go, in words.
pub(crate) struct FoliageLayout<'a> {
    foliage: &'a Foliage,
    top: WideTree,
    meshes: Vec<CrossingLayout<'a>>,
    /// First word of each leaf's shrubs, from the first of all on, if it is a group.
    groups: BTreeMap<u32, u64>,
    first_shrub: u64,
    pub(crate) first_word: u64,
    pub(crate) end_word: u64,
}

impl<'a> FoliageLayout<'a> {
    /// From a word on; `None` where there is nothing.
    pub(crate) fn of(scene: &'a Scene, first_word: u64) -> Option<Self> {
        let foliage = scene.foliage()?;
        let top = widen(foliage);
        let mut at = first_word + top.nodes.len() as u64 * NODE_WORDS;
        let mut meshes: Vec<CrossingLayout<'a>> = Vec::new();
        let (mut groups, mut shrubs) = (BTreeMap::new(), 0);
        for (index, leaf) in (0..).zip(foliage.leaves()) {
            let mesh = match leaf {
                FoliageView::Crossings { mesh, .. } => mesh,
                FoliageView::Fog { .. } => continue,
                FoliageView::Shrubs(group) => {
                    groups.insert(index, shrubs);
                    shrubs += group.records().len() as u64;
                    continue;
                }
            };
            if meshes.iter().any(|known| Arc::ptr_eq(known.mesh, mesh)) {
                continue;
            }
            let tree = if mesh.bvh().is_empty() { WideTree::default() } else { widen(mesh.bvh()) };
            let triangles = at + tree.nodes.len() as u64 * NODE_WORDS;
            let end = triangles + tree.leaves.len() as u64 * TRIANGLE_WORDS;
            meshes.push(CrossingLayout { mesh, tree, starts: [at, triangles] });
            at = end;
        }
        Some(Self { foliage, top, meshes, groups, first_shrub: at, first_word, end_word: at + shrubs })
    }

    /// Nodes on the longest path through both levels.
    pub(crate) fn depth(&self) -> u32 {
        self.top.depth + self.meshes.iter().map(|mesh| mesh.tree.depth).max().unwrap_or(0)
    }

    /// Sends everything, in the order of the words.
    pub(crate) fn send(&self, upload: &mut Upload<'_>) -> Result<(), TraceError> {
        let mut records = self.top.nodes.clone();
        for &(at, index) in &self.top.leaf_records {
            records[at] = cast(self.record(index));
        }
        upload.write(cast_slice(&records))?;
        for CrossingLayout { mesh, tree, .. } in &self.meshes {
            upload.write(cast_slice(&tree.nodes))?;
            for run in tree.leaves.chunks(1 << 16) {
                let triangles: Vec<TriangleRecord> = run.iter().map(|&i| TriangleRecord::crossed(mesh, i)).collect();
                upload.write(cast_slice(&triangles))?;
            }
        }
        let groups = self.foliage.leaves().filter_map(|leaf| match leaf {
            FoliageView::Shrubs(group) => Some(group),
            FoliageView::Crossings { .. } | FoliageView::Fog { .. } => None,
        });
        let words: Vec<[u32; 4]> = groups.flat_map(ShrubGroup::records).map(|record| record.0).collect();
        upload.write(cast_slice(&words))
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "halves; words are checked to fit")]
    fn record(&self, index: u32) -> LeafRecord {
        match self.foliage.leaf(index) {
            FoliageView::Crossings { mesh, place } => {
                let starts = self.meshes.iter().find(|known| Arc::ptr_eq(known.mesh, mesh)).map(|known| known.starts);
                let [nodes, triangles] = starts.unwrap_or_default();
                let words = [nodes as u32, triangles as u32, 0, 0, 0, 0, 0, 0];
                LeafRecord { object_from_world: place.object_from_world, words }
            }
            FoliageView::Fog { min, max, rate, place } => {
                let [a, b, c] = min.to_array().map(f32::to_bits);
                let [d, e, f] = max.to_array().map(f32::to_bits);
                let words = [a, b, c, rate as u32, d, e, f, (rate >> 32) as u32 | FOG_BIT];
                LeafRecord { object_from_world: place.object_from_world, words }
            }
            FoliageView::Shrubs(group) => {
                let [x, y, z] = group.base().map(i32::cast_unsigned);
                let first = self.first_shrub + self.groups.get(&index).copied().unwrap_or_default();
                let words = [x, y, z, first as u32, 0, 0, 0, GROUP_BIT | group.records().len() as u32];
                LeafRecord { object_from_world: [[0.0; 4]; 3], words }
            }
        }
    }
}
