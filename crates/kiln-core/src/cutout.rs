//! Faces with holes: where a texture says that a face is there.
//!
//! Alpha-tested materials (glTF's `alphaMode: MASK`) are reduced to what rays need: one bit for each texel, and the texture
//! coordinates of the faces' corners.

use crate::Mesh;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What a texture is beyond its edges, along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
pub enum Wrap {
    /// The same again.
    #[default]
    Repeat,
    /// The same in a mirror, in turn.
    Mirrored,
    /// As at the edge.
    Clamp,
}

impl Wrap {
    /// The texel of a row of `size` that a cell falls on, which may be beyond either end; 0 where `size` is.
    pub fn texel(self, cell: i64, size: u32) -> u32 {
        let count = i64::from(size.max(1));
        let texel = match self {
            Self::Repeat => cell.rem_euclid(count),
            Self::Clamp => cell.clamp(0, count - 1),
            Self::Mirrored => {
                let both = cell.rem_euclid(2 * count);
                both.min(2 * count - 1 - both)
            }
        };
        u32::try_from(texel).unwrap_or(0)
    }
}

/// Where a texture is opaque: a bit for each texel.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Mask {
    /// Texels along u and along v.
    size: [u32; 2],
    wrap: [Wrap; 2],
    /// Rows of whole bytes, the first at v = 0; the lowest bit of a byte is the first texel.
    bits: Vec<u8>,
}

impl Mask {
    /// A mask of so many texels along u and v, none of which is 0, from what each texel is.
    pub fn new(size: [u32; 2], wrap: [Wrap; 2], is_opaque: impl Fn([u32; 2]) -> bool) -> Self {
        let [width, height] = size;
        let byte = |row: u32, byte: u32| {
            let texels = (0..8).filter(|bit| 8 * byte + bit < width && is_opaque([8 * byte + bit, row]));
            texels.fold(0u8, |bits, bit| bits | 1 << bit)
        };
        let bits = (0..height).flat_map(|row| (0..width.div_ceil(8)).map(move |at| (row, at)));
        Self { size, wrap, bits: bits.map(|(row, at)| byte(row, at)).collect() }
    }

    /// The same everywhere.
    pub fn uniform(is_opaque: bool) -> Self {
        Self::new([1, 1], [Wrap::Clamp; 2], |_| is_opaque)
    }

    /// What all texels are, if they are all the same.
    pub fn all(&self) -> Option<bool> {
        let [width, height] = self.size;
        let texels = || (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
        let first = self.texel([0, 0]);
        texels().all(|at| self.texel(at) == first).then_some(first)
    }

    /// Texels along u and along v.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// How it goes on beyond its edges, along u and along v.
    pub fn wrap(&self) -> [Wrap; 2] {
        self.wrap
    }

    /// Memory of the bits, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.bits.len()
    }

    /// Whether a texel within the texture is opaque.
    #[inline]
    fn texel(&self, [x, y]: [u32; 2]) -> bool {
        let row = self.size[0].div_ceil(8) as usize;
        let byte = self.bits.get(y as usize * row + x as usize / 8);
        byte.is_some_and(|byte| byte >> (x % 8) & 1 == 1)
    }

    /// Whether the nearest texel is opaque. Coordinates that are no number are those of the first texel.
    #[expect(clippy::cast_possible_truncation, reason = "casts saturate, as cells beyond any texture may")]
    #[inline]
    pub fn is_opaque(&self, uv: [f64; 2]) -> bool {
        let texel = |axis: usize| {
            let cell = (uv[axis] * f64::from(self.size[axis])).floor() as i64;
            self.wrap[axis].texel(cell, self.size[axis])
        };
        self.texel([texel(0), texel(1)])
    }
}

/// The masks of a mesh's faces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct Cutouts {
    /// The masks, which [`crate::FaceGroup::cutout`] refers to.
    pub masks: Vec<Arc<Mask>>,
    /// Texture coordinates of the corners of each face that has a mask, in the order of these faces.
    pub corners: Vec<[[f32; 2]; 3]>,
}

/// A face that is there only where its mask is opaque.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutoutFace {
    /// The face of the mesh.
    pub face: usize,
    /// Index into [`Cutouts::masks`].
    pub mask: u16,
    /// Texture coordinates of its corners, in their order.
    pub corners: [[f32; 2]; 3],
}

impl Mesh {
    /// The faces with masks, in their order.
    pub fn cutout_faces(&self) -> impl Iterator<Item = CutoutFace> {
        let masked = (0..self.faces.len()).filter_map(|face| Some((face, self.group(face).cutout?)));
        // In this order no face is looked at where there are none.
        self.cutouts.corners.iter().zip(masked).map(|(corners, (face, mask))| CutoutFace {
            face,
            mask,
            corners: *corners,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirrored, Wrap::Clamp];

    #[test]
    fn textures_go_on_beyond_their_edges() {
        let row = |wrap: Wrap| (-4..8).map(|cell| wrap.texel(cell, 3)).collect::<Vec<_>>();
        assert_eq!(row(Wrap::Repeat), [2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1]);
        assert_eq!(row(Wrap::Mirrored), [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1]);
        assert_eq!(row(Wrap::Clamp), [0, 0, 0, 0, 0, 1, 2, 2, 2, 2, 2, 2]);
    }

    #[test]
    fn texels_are_found_again() {
        let is_opaque = |[x, y]: [u32; 2]| (x * x + 3 * y).is_multiple_of(5);
        for size in [[1, 1], [8, 3], [13, 7], [64, 2]] {
            let mask = Mask::new(size, [Wrap::Repeat; 2], is_opaque);
            for (x, y) in (0..size[0]).flat_map(|x| (0..size[1]).map(move |y| (x, y))) {
                let middle = |at: u32, size: u32| (f64::from(at) + 0.5) / f64::from(size);
                let uv = [middle(x, size[0]) - 3.0, middle(y, size[1]) + 2.0];
                assert_eq!(mask.is_opaque(uv), is_opaque([x, y]), "{size:?} {x} {y}");
            }
        }
        assert_eq!([true, false].map(|opaque| Mask::uniform(opaque).all()), [Some(true), Some(false)]);
        assert_eq!(Mask::new([9, 2], [Wrap::Clamp; 2], |at| at != [8, 1]).all(), None);
    }

    proptest! {
        /// Whatever bytes say that a mask is, and wherever it is asked.
        #[test]
        fn nothing_panics(size: [u32; 2], bits: Vec<u8>, u in any::<f64>(), v in any::<f64>(), wraps in [0..3usize, 0..3usize]) {
            let mask = Mask { size, wrap: wraps.map(|wrap| WRAPS[wrap]), bits };
            mask.is_opaque([u, v]);
        }
    }
}
