//! Trees as bytes, for a cache on the machine that built them.
//!
//! ```text
//! "KILNBVH1"  order of bytes u32  nodes u32  triangles u32  the nodes  for each triangle, in the order of the leaves, its id
//! ```
//! Words are the machine's own: a file of another order of bytes is foreign, and refused. Corners are not stored. They
//! are the mesh's, so that a wrong file can make no other triangles of them; and nothing of the nodes is believed
//! before it is known that they are one tree, not too deep, over each occluding face once, and that every box holds
//! what is in it: whatever the bytes are, rays are traced through that mesh.

use crate::{
    BvhLink, MeshBvh,
    mesh_bvh::{Occluder, occluders},
    node::{MAX_DEPTH, WideNode},
    triangle::{FLIPPED_BIT, TWO_SIDED_BIT, TriangleRuns, face_of},
};
use glam::Vec3;
use kiln_core::{Bounds, FaceGroup, Mesh};

/// Raised with every change of what [`MeshBvh::build`] gives or of the form in which it is stored.
pub const BVH_REV: u32 = 3;

const MAGIC: &[u8; 8] = b"KILNBVH1";
const BYTE_ORDER: u32 = 0x0102_0304;
const HEADER: usize = MAGIC.len() + 3 * WORD;
const WORD: usize = size_of::<u32>();

/// Bytes are no tree of a mesh.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("a stored BVH cannot be used: {problem}; it is built anew")]
pub struct StoredBvhError {
    problem: &'static str,
}

fn wrong(problem: &'static str) -> StoredBvhError {
    StoredBvhError { problem }
}

impl MeshBvh {
    /// The tree as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut ids = vec![0u32; self.triangles.len()];
        for child in self.nodes.iter().flat_map(WideNode::slots) {
            if let BvhLink::Leaf { first, count } = child.link {
                (0..count).for_each(|lane| ids[(first + lane) as usize] = self.triangles.id(first, count, lane));
            }
        }
        let nodes: &[u8] = bytemuck::cast_slice(&self.nodes);
        let mut bytes = Vec::with_capacity(HEADER + nodes.len() + WORD * ids.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(bytemuck::cast_slice(&[BYTE_ORDER, self.nodes.len() as u32, ids.len() as u32]));
        bytes.extend_from_slice(nodes);
        bytes.extend_from_slice(bytemuck::cast_slice(&ids));
        bytes
    }

    /// The tree of a mesh from bytes that [`Self::to_bytes`] gave.
    ///
    /// # Errors
    /// [`StoredBvhError`] for all other bytes, those of another mesh among them. Nothing larger than a small multiple of
    /// bytes and mesh is allocated.
    pub fn from_bytes(bytes: &[u8], mesh: &Mesh) -> Result<Self, StoredBvhError> {
        let (nodes, ids) = split(bytes)?;
        let mut reader = Reader {
            mesh,
            ids: &ids,
            leaves: Vec::new(),
            is_filled: vec![false; ids.len()],
            is_named: vec![false; mesh.faces.len()],
            has_joined: false,
            bounds: Bounds::EMPTY,
        };
        reader.walk(&nodes)?;
        reader.check_is_complete()?;
        let Reader { leaves, bounds, .. } = reader;
        let triangles = TriangleRuns::new(ids.len(), leaves.into_iter(), |index| {
            let id = ids[index as usize];
            (Occluder::new(mesh, face_of(id), id & TWO_SIDED_BIT != 0).corners, id)
        });
        Ok(Self { nodes: nodes.into(), triangles, bounds })
    }
}

/// Nodes and ids, of which nothing is known but their number.
fn split(bytes: &[u8]) -> Result<(Vec<WideNode>, Vec<u32>), StoredBvhError> {
    let (header, rest) = bytes.split_at_checked(HEADER).ok_or(wrong("it is too short"))?;
    let (magic, words) = header.split_at(MAGIC.len());
    let mut counts = [0u32; 3];
    bytemuck::cast_slice_mut(&mut counts).copy_from_slice(words);
    if magic != MAGIC || counts[0] != BYTE_ORDER {
        return Err(wrong("it is of another format or machine"));
    }
    let [nodes, ids] = [counts[1], counts[2]].map(|count| count as usize);
    let node_bytes = nodes.checked_mul(size_of::<WideNode>());
    let total = node_bytes.and_then(|bytes| bytes.checked_add(ids.checked_mul(WORD)?));
    if total != Some(rest.len()) {
        return Err(wrong("it has another length than it says"));
    }
    let (node_bytes, id_bytes) = rest.split_at(nodes * size_of::<WideNode>());
    let mut nodes = vec![WideNode::EMPTY; nodes];
    bytemuck::cast_slice_mut(&mut nodes).copy_from_slice(node_bytes);
    let mut ids = vec![0u32; ids];
    bytemuck::cast_slice_mut(&mut ids).copy_from_slice(id_bytes);
    Ok((nodes, ids))
}

/// Fills the leaves, and checks what it reads.
struct Reader<'a> {
    mesh: &'a Mesh,
    ids: &'a [u32],
    /// First triangle and number of triangles of each.
    leaves: Vec<(u32, u32)>,
    is_filled: Vec<bool>,
    /// Faces that a leaf names.
    is_named: Vec<bool>,
    /// Some face is two-sided only because another one coincides with it.
    has_joined: bool,
    bounds: Bounds,
}

/// A box that something must lie in.
#[derive(Clone, Copy)]
struct Outer {
    min: Vec3,
    max: Vec3,
}

impl Outer {
    /// Never for what is not a number.
    fn holds(&self, min: Vec3, max: Vec3) -> bool {
        min.cmpge(self.min).all() && max.cmple(self.max).all() && min.cmple(max).all()
    }
}

impl Reader<'_> {
    fn walk(&mut self, nodes: &[WideNode]) -> Result<(), StoredBvhError> {
        if nodes.is_empty() {
            return Ok(());
        }
        let mut is_reached = vec![false; nodes.len()];
        is_reached[0] = true;
        let everywhere = Outer { min: Vec3::splat(f32::MIN), max: Vec3::splat(f32::MAX) };
        let mut pending = vec![(0usize, everywhere, 1usize)];
        while let Some((index, outer, depth)) = pending.pop() {
            let node = &nodes[index];
            if depth > MAX_DEPTH {
                return Err(wrong("it is deeper than any that is built"));
            }
            check_unused_slots(node)?;
            for child in node.slots() {
                if !outer.holds(child.min, child.max) {
                    return Err(wrong("a box is not within the one around it"));
                }
                let inner = Outer { min: child.min, max: child.max };
                match child.link {
                    BvhLink::Leaf { first, count } => self.leaf(first as usize, count as usize, &inner)?,
                    BvhLink::Node(child) => {
                        let child = child as usize;
                        match is_reached.get_mut(child) {
                            Some(reached) if !*reached => *reached = true,
                            _ => return Err(wrong("its nodes are no tree")),
                        }
                        pending.push((child, inner, depth + 1));
                    }
                }
            }
        }
        if is_reached.contains(&false) {
            return Err(wrong("nodes hang on no other"));
        }
        Ok(())
    }

    fn leaf(&mut self, first: usize, count: usize, outer: &Outer) -> Result<(), StoredBvhError> {
        let end = first + count;
        let (Some(ids), Some(filled)) = (self.ids.get(first..end), self.is_filled.get_mut(first..end)) else {
            return Err(wrong("a leaf has triangles that are not there"));
        };
        if filled.contains(&true) {
            return Err(wrong("two leaves share a triangle"));
        }
        filled.fill(true);
        ids.iter().try_for_each(|id| self.face(*id, outer))?;
        self.leaves.push((first as u32, count as u32));
        Ok(())
    }

    /// A face that a leaf holds.
    fn face(&mut self, id: u32, outer: &Outer) -> Result<(), StoredBvhError> {
        let face = face_of(id) as usize;
        match self.is_named.get_mut(face) {
            Some(named) if !*named => *named = true,
            _ => return Err(wrong("a face is named twice, or is not the mesh's")),
        }
        let (group, is_two_sided) = (self.mesh.group(face), id & TWO_SIDED_BIT != 0);
        if !group.is_solid() || (group.is_front_from_both_sides() && !is_two_sided) {
            return Err(wrong("a face stops other rays than the mesh says"));
        }
        self.has_joined |= is_two_sided && !group.is_front_from_both_sides();
        let Occluder { corners, primitive } = Occluder::new(self.mesh, face_of(id), is_two_sided);
        if primitive != id {
            return Err(wrong("a face has another winding than the mesh says"));
        }
        let [a, b, c] = corners;
        let (min, max) = (a.min(b).min(c), a.max(b).max(c));
        if !outer.holds(min, max) {
            return Err(wrong("a triangle is not within its leaf's box"));
        }
        self.bounds.add(min.as_dvec3());
        self.bounds.add(max.as_dvec3());
        Ok(())
    }

    /// Every occluding face is in a leaf, but for those that coincide with another.
    fn check_is_complete(&self) -> Result<(), StoredBvhError> {
        if self.is_filled.contains(&false) {
            return Err(wrong("triangles are in no leaf"));
        }
        let occluding = (0..self.mesh.faces.len()).filter(|&face| self.mesh.group(face).is_solid()).count();
        if self.ids.len() == occluding && !self.has_joined {
            return Ok(());
        }
        // Some coincide, which few meshes have: they are looked for again.
        let mut ids: Vec<u32> = self.ids.iter().map(|id| id & !FLIPPED_BIT).collect();
        ids.sort_unstable_by_key(|id| face_of(*id));
        let is_same = occluders(self.mesh, FaceGroup::is_solid) == ids;
        if is_same { Ok(()) } else { Err(wrong("it is the tree of other faces")) }
    }
}

/// No ray enters a slot that leads nowhere.
fn check_unused_slots(node: &WideNode) -> Result<(), StoredBvhError> {
    let is_sound = |slot: usize| {
        node.children[slot] != u32::MAX || (0..6).all(|row| node.bounds[row][slot] == WideNode::EMPTY.bounds[row][slot])
    };
    if (0..8).all(is_sound) { Ok(()) } else { Err(wrong("a slot without a child has a box")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::{Digest, FaceGroup};
    use proptest::prelude::*;

    /// Hills of `size`² squares in whole numbers; every third face occludes nothing, or from both sides, as asked.
    fn hills(size: u32, groups: [bool; 3], is_doubled: bool) -> Mesh {
        let side = size + 1;
        let height = |x: u32, z: u32| (x * 7 + z * 13 + x * z * 5) % 11;
        let position = |i: u32| [i % side, height(i % side, i / side), i / side].map(|c| c as f32);
        let square = |i: u32| {
            let a = i / size * side + i % size;
            [[a, a + side, a + 1], [a + 1, a + side, a + side + 1]]
        };
        let mut faces: Vec<[u32; 3]> = (0..size * size).flat_map(square).collect();
        if is_doubled {
            faces.extend(faces.clone().into_iter().step_by(4).map(|[a, b, c]| [c, b, a]));
        }
        let group = |occludes: bool, double_sided: bool| FaceGroup { double_sided, occludes, ..FaceGroup::PLAIN };
        Mesh {
            positions: (0..side * side).map(position).collect(),
            normals: vec![[0.0, 1.0, 0.0]; (side * side) as usize],
            face_group: (0..faces.len()).map(|face| (face % 3) as u16).collect(),
            faces,
            groups: vec![group(groups[0], false), group(groups[1], true), group(groups[2], false)],
            ..Mesh::default()
        }
    }

    #[test]
    fn what_is_read_is_what_was_built() {
        for (size, groups, is_doubled) in
            [(1, [true; 3], false), (9, [true; 3], false), (40, [true, true, false], true), (3, [false; 3], false)]
        {
            let mesh = hills(size, groups, is_doubled);
            let built = MeshBvh::build(&mesh);
            let read = MeshBvh::from_bytes(&built.to_bytes(), &mesh);
            assert_eq!(read.as_ref(), Ok(&built));
        }
    }

    #[test]
    fn the_tree_of_another_mesh_is_refused() {
        let mesh = hills(9, [true; 3], true);
        let bytes = MeshBvh::build(&mesh).to_bytes();
        let mut moved = mesh.clone();
        moved.positions[30][1] += 20.0;
        let others =
            [hills(8, [true; 3], true), hills(9, [true, true, false], true), hills(9, [true; 3], false), moved];
        for other in others {
            assert!(MeshBvh::from_bytes(&bytes, &other).is_err());
        }
    }

    /// A stored tree would otherwise be read by a version that builds another one.
    #[test]
    fn another_tree_has_another_revision() {
        let digest = Digest::of(&MeshBvh::build(&hills(60, [true, true, false], true)).to_bytes()).short();
        assert_eq!((BVH_REV, digest.as_str()), (3, "bf5b9836"), "raise BVH_REV and note the new digest");
    }

    #[test]
    fn links_that_lead_astray_are_refused() {
        let mesh = hills(20, [true; 3], false);
        let bytes = MeshBvh::build(&mesh).to_bytes();
        let at = |node: usize, row: usize, slot: usize| HEADER + node * size_of::<WideNode>() + (row * 8 + slot) * WORD;
        let with = |at: usize, word: u32| {
            let mut changed = bytes.clone();
            changed[at..at + WORD].copy_from_slice(&word.to_ne_bytes());
            MeshBvh::from_bytes(&changed, &mesh).err().map(|error| error.problem)
        };
        let leaf = |first: u32, count: u32| BvhLink::Leaf { first, count }.to_reference();
        assert_eq!(with(at(0, 6, 0), 0), Some("its nodes are no tree"), "the root is its own child");
        assert_eq!(with(at(0, 6, 0), 1 << 20), Some("its nodes are no tree"));
        assert_eq!(with(at(0, 6, 0), leaf(1 << 20, 8)), Some("a leaf has triangles that are not there"));
        assert!(with(at(0, 6, 0), leaf(0, 8)).is_some());
        assert!(with(at(0, 6, 0), u32::MAX).is_some(), "a child is left out");
        assert!(with(at(0, 0, 0), f32::NAN.to_bits()).is_some());
        assert!(with(at(0, 0, 0), 1e9f32.to_bits()).is_some(), "a box is shrunk");
        let ids = bytes.len() - WORD;
        assert!(with(ids, u32::MAX).is_some());
    }

    proptest! {
        #[test]
        fn changed_bytes_are_refused_or_make_a_sound_tree(at in any::<prop::sample::Index>(), value in any::<u8>(), cut in 0usize..3) {
            let mesh = hills(12, [true, true, false], true);
            let built = MeshBvh::build(&mesh);
            let mut bytes = built.to_bytes();
            let at = at.index(bytes.len());
            bytes[at] = value;
            bytes.truncate(bytes.len() - cut);
            if let Ok(read) = MeshBvh::from_bytes(&bytes, &mesh) {
                // A box may have grown, within the one around it; the triangles are the same.
                prop_assert_eq!(read.triangles, built.triangles);
                prop_assert_eq!(read.bounds, built.bounds);
            }
        }

        #[test]
        fn any_bytes_are_survived(mut bytes in prop::collection::vec(any::<u8>(), 0..600), nodes in 0u32..4, ids in 0u32..9) {
            let mesh = hills(2, [true; 3], false);
            let _ = MeshBvh::from_bytes(&bytes, &mesh);
            let mut header = MAGIC.to_vec();
            header.extend_from_slice(bytemuck::cast_slice(&[BYTE_ORDER, nodes, ids]));
            bytes.resize(nodes as usize * size_of::<WideNode>() + ids as usize * WORD, 0);
            prop_assert!(MeshBvh::from_bytes(&[header, bytes].concat(), &mesh).is_err());
        }
    }
}
