//! Nodes of up to eight children.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Set in a reference to a leaf. The three bits below hold the number of its things less one, the others the first thing;
/// without it, a reference is the index of a node.
pub(crate) const LEAF_BIT: u32 = 1 << 31;

/// Things that a leaf can name.
pub(crate) const MAX_LEAF: usize = 8;

/// Things that a tree can have: what the bits of a reference leave.
pub(crate) const MAX_THINGS: usize = 1 << 28;

/// Levels of the deepest tree that is accepted.
pub(crate) const MAX_DEPTH: usize = 32;

/// Entries of a stack that no tree overflows: at each level seven children wait, and the last puts eight on it.
pub(crate) const MAX_STACK: usize = 7 * MAX_DEPTH + 8;

/// An inner node with the boxes of up to eight children, one child in each lane.
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct WideNode {
    /// Least x, y, z, then greatest x, y, z of the eight children. Those of unused slots are infinite, so that no ray enters
    /// them: on each axis it comes to both planes beyond [`crate::ray::FARTHEST`], or has left them behind.
    pub(crate) bounds: [[f32; 8]; 6],
    /// References; unused slots have `u32::MAX`.
    pub(crate) children: [u32; 8],
}

const _: () = assert!(size_of::<WideNode>() == 224);

/// What a slot of a node leads to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BvhChild {
    /// Least corner of its box.
    pub min: Vec3,
    /// Greatest corner of its box.
    pub max: Vec3,
    /// What is in the box.
    pub link: BvhLink,
}

/// A node or a leaf of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BvhLink {
    /// Index of an inner node.
    Node(u32),
    /// A run of what the tree is over: triangles of a mesh, one instance of a scene.
    Leaf {
        /// Index of the first one.
        first: u32,
        /// How many, 1 to 8.
        count: u32,
    },
}

impl BvhLink {
    /// As a reference in a node.
    pub(crate) fn to_reference(self) -> u32 {
        match self {
            Self::Node(index) => index,
            Self::Leaf { first, count } => LEAF_BIT | (count - 1) << 28 | first,
        }
    }

    /// From a reference in a used slot.
    #[inline(always)]
    pub(crate) fn of_reference(reference: u32) -> Self {
        if reference & LEAF_BIT == 0 {
            Self::Node(reference)
        } else {
            Self::Leaf { first: reference & (MAX_THINGS as u32 - 1), count: (reference >> 28 & 7) + 1 }
        }
    }
}

impl WideNode {
    /// A node without children.
    pub(crate) const EMPTY: Self = Self { bounds: [[f32::INFINITY; 8]; 6], children: [u32::MAX; 8] };

    /// A node with up to eight children.
    pub(crate) fn new(children: &[BvhChild]) -> Self {
        let mut node = Self::EMPTY;
        for (slot, child) in children.iter().enumerate() {
            for axis in 0..3 {
                node.bounds[axis][slot] = child.min[axis];
                node.bounds[axis + 3][slot] = child.max[axis];
            }
            node.children[slot] = child.link.to_reference();
        }
        node
    }

    /// The used slots.
    pub(crate) fn slots(&self) -> impl Iterator<Item = BvhChild> {
        let corner = |slot: usize, base: usize| Vec3::from_array([0, 1, 2].map(|axis| self.bounds[base + axis][slot]));
        (0..8).filter(|&slot| self.children[slot] != u32::MAX).map(move |slot| BvhChild {
            min: corner(slot, 0),
            max: corner(slot, 3),
            link: BvhLink::of_reference(self.children[slot]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_are_links() {
        let last = MAX_THINGS as u32 - 1;
        let links = [
            BvhLink::Node(0),
            BvhLink::Node(LEAF_BIT - 1),
            BvhLink::Leaf { first: 0, count: 1 },
            BvhLink::Leaf { first: 12345, count: 8 },
            BvhLink::Leaf { first: last - 7, count: 8 },
        ];
        for link in links {
            assert_eq!(BvhLink::of_reference(link.to_reference()), link);
            assert_ne!(link.to_reference(), u32::MAX);
        }
    }
}
