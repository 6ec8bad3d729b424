//! A triangle on the device; the host side of `triangle.wgsl`.
//!
//! 48 bytes, three words of 16: a corner each, and the id beside the first. Ten words of 4 bytes would do, but
//! then a triangle would take ten loads instead of three, none of them aligned: bytes are dear where they come from
//! memory, and there a line of 64 or 128 bytes is read whatever is asked for.
//!
//! Whether a ray is inside is said by the watertight edge functions. Products of these and of the shear pass through `rounded`, an
//! exclusive or with a zero that no compiler can see through. Drivers may fuse a product into a sum (WGSL cannot forbid it), and
//! edge functions of neighbouring faces would no longer be exact negatives: rays would slip through. Elsewhere fusing does no
//! harm.
//!
//! How far away the hit is says the triangle's plane, `n (a − o) / n d` with `n = (b − a) × (c − a)`: its error is some units
//! in the last place of the distance from the ray's origin to `a`, over the cosine, where that of the edge functions grows with the distance
//! over the triangle's size, too. The distance is then kept between those at which the ray enters and leaves the triangle's own box, to
//! rounding, and rounded to 18 bits, as on the CPU, so that coincident faces tie. So no box that holds the triangle is further behind its
//! hit than the slack that `node.wgsl` gives hits; and slivers and rays in the plane, whose distance is mostly error, get one that
//! lies where the triangle does.
//! Corners lie in the order of their bits, with a bit where that is not the winding: coincident faces have distances that are equal bit
//! for bit, in whatever order and winding their meshes have them, and the tie rule decides.

use bytemuck::{Pod, Zeroable};
use kiln_trace::{CrossingMesh, MeshBvh};

/// Set in the rank of a back-face hit; keep in sync with `triangle.wgsl`.
pub(crate) const BACK_BIT: u32 = 1 << 31;
/// The rank of no hit; keep in sync with `triangle.wgsl`.
pub(crate) const MISS_RANK: u32 = BACK_BIT - 1;

/// A triangle of a mesh.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct TriangleRecord {
    a: [f32; 3],
    /// Face index with `TWO_SIDED_BIT` and `FLIPPED_BIT`.
    primitive: u32,
    b: [f32; 3],
    /// What is lost where it is crossed; 0 where it stops rays.
    depth: u32,
    c: [f32; 3],
    padding_c: u32,
}

const _: () = assert!(size_of::<TriangleRecord>() == 48);

impl TriangleRecord {
    /// The triangle that a leaf of a mesh names.
    pub(crate) fn of(mesh: &MeshBvh, index: u32) -> Self {
        let (corners, primitive) = mesh.triangle(index);
        let [a, b, c] = corners.map(|corner| corner.to_array());
        Self { a, primitive, b, depth: 0, c, padding_c: 0 }
    }

    /// The triangle that a leaf of a mesh of trees names.
    pub(crate) fn crossed(mesh: &CrossingMesh, index: u32) -> Self {
        let record = Self::of(mesh.bvh(), index);
        Self { depth: mesh.depth_of(record.primitive), ..record }
    }
}
