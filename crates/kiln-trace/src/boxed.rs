//! Axis-aligned boxes, as builders take them.

use glam::{Vec3, Vec4, Vec4Swizzles};

/// Set in every index, so that its bits are a normal number: those of small ones would be denormal, which additions are slow for.
const NORMAL_BIT: u32 = 1 << 30;

/// A box, and the index of what is in it in the fourth lane of its least corner, which nothing is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Boxed {
    low: Vec4,
    high: Vec4,
}

impl Boxed {
    /// Around nothing.
    pub(crate) const EMPTY: Self = Self { low: Vec4::INFINITY, high: Vec4::NEG_INFINITY };

    /// The box of something, from least to greatest corner. Indices are less than 2²⁸, as those in leaves.
    pub(crate) fn new(index: u32, min: Vec3, max: Vec3) -> Self {
        Self { low: min.extend(f32::from_bits(NORMAL_BIT | index)), high: max.extend(0.0) }
    }

    /// The smallest box around others.
    #[inline(always)]
    pub(crate) fn around(boxes: &[Self]) -> Self {
        boxes.iter().fold(Self::EMPTY, |all, one| all.join(one))
    }

    /// The smallest box around points, each the center of a box as [`Self::twice_center`] gives it.
    #[inline(always)]
    pub(crate) fn around_centers(boxes: &[Self]) -> Self {
        let join = |all: Self, center: Vec4| Self { low: all.low.min(center), high: all.high.max(center) };
        boxes.iter().fold(Self::EMPTY, |all, one| join(all, one.twice_center()))
    }

    #[inline(always)]
    pub(crate) fn join(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    pub(crate) fn index(&self) -> u32 {
        self.low.w.to_bits() & !NORMAL_BIT
    }

    /// Least corner.
    pub(crate) fn min(&self) -> Vec3 {
        self.low.truncate()
    }

    /// Greatest corner.
    pub(crate) fn max(&self) -> Vec3 {
        self.high.truncate()
    }

    /// Sum of least and greatest corner; the fourth lane is of no meaning.
    #[inline(always)]
    pub(crate) fn twice_center(&self) -> Vec4 {
        self.low + self.high
    }

    /// Half the surface.
    #[inline(always)]
    pub(crate) fn half_area(&self) -> f32 {
        let size = self.high - self.low;
        let product = size * size.yzxw();
        product.x + product.y + product.z
    }

    /// The axis along which it is longest.
    pub(crate) fn longest_axis(&self) -> usize {
        let size = self.max() - self.min();
        (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0)
    }

    /// Greatest absolute coordinate.
    pub(crate) fn extent(&self) -> f32 {
        self.min().abs().max(self.max().abs()).max_element()
    }
}
