//! An eight-wide node with quantised boxes; the host side of `node.wgsl`.
//!
//! Source: Ylitie, Karras and Laine 2017, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs".
//! A node is 80 bytes: a corner, a power of two for each axis, and eight boxes whose planes are bytes in these units.
//! Slots are dealt to octants, so that the order (slot ^ octant of the ray) has near children first without a sort.
//! Differences:
//!
//! - A slot's byte names its triangles as first and count, not in unary, and the slots that a ray enters are a mask of
//!   eight bits which is put in order at once, not bit by bit.
//! - Boxes are tested conservatively. A plane is at `p + q s` exactly (p a float, q a byte, s a power of two), and the
//!   byte is rounded outwards, so that the quantised box contains the box. Its distance is computed as `q A + B` with
//!   `A = s · inv`, `B = (p − o) · inv`, `inv = 1/d`. With u = 2⁻²⁴, a division to 2.5 ULP (which is what WGSL and Vulkan
//!   promise: 5 u) and one rounding each for the subtraction, the two products and the sum, the error is at most
//!   `(5 + 4) u (255 |A| + |B|)`. That sum times 10⁻⁶ (16.8 u) is taken from near distances and added to far ones, once a
//!   node and axis (in the sense of Ize 2013, "Robust BVH ray traversal", for a form in which terms cancel). It
//!   is less than a 4,000th of a quantisation step, so it costs no visits that count.
//! - A hit is never nearer than its triangle's own box, `(p − o) · inv` with the same `inv`, in error by 2 u of itself ([`crate::triangle`]).
//!   Beside the 4 u that the sum above has without the division, that is within the slack; so are the 10 u by which the triangle's own
//!   far distance is widened, which its ray must not pass by. A box that holds a nearer hit, or a tie, is never left out, and the
//!   closest hit is that of each triangle alone.
//! - Terms beyond 10³⁷ are cut there, so that no infinity and no NaN occurs, which a driver may assume. That holds for
//!   coordinates up to 10¹⁹.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use std::ops::Range;

/// Children of a node.
pub(crate) const SLOTS: usize = 8;

/// Triangles of a slot at most, so that the first of a node's triangles fits five bits and their number three.
pub(crate) const MAX_RUN: usize = 4;

/// A smaller unit could make a distance's factor subnormal, which a device may take for 0.
const LEAST_EXPONENT: i32 = -64;

/// Greatest exponent of a unit that is finite.
const MOST_EXPONENT: i32 = 127;

/// A node; keep in sync with `node.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct WideNode {
    /// Least corner of all boxes.
    origin: [f32; 3],
    /// Biased exponents of the units of each axis.
    exponents: [u8; 3],
    /// A bit for each slot that is a node.
    node_mask: u8,
    /// Index of the record of the first child that has one.
    child_base: u32,
    /// Of a mesh: the index of the node's first triangle. Of a scene: a bit for each slot that is used.
    leaf_base: u32,
    /// Of a mesh: for each slot with triangles the first of them after `leaf_base`, and 32 times their number.
    runs: [u8; SLOTS],
    /// Bytes of the low and high planes of each axis.
    planes: [[[u8; SLOTS]; 2]; 3],
}

const _: () = assert!(size_of::<WideNode>() == 80);

/// What is in a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SlotContent {
    /// A node with its record.
    Node,
    /// Something else with a record: an instance.
    Record,
    /// So many triangles.
    Run(u8),
}

/// A slot that is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slot {
    pub(crate) min: Vec3,
    pub(crate) max: Vec3,
    pub(crate) content: SlotContent,
}

impl WideNode {
    /// Records lie one after another from `child_base`, triangles from `first_triangle`, both in the order of the slots.
    /// A scene's node has no triangles.
    pub(crate) fn new(slots: &[Option<Slot>; SLOTS], child_base: u32, first_triangle: Option<u32>) -> Self {
        let used = || slots.iter().flatten();
        let min = used().fold(Vec3::INFINITY, |all, slot| all.min(slot.min));
        let max = used().fold(Vec3::NEG_INFINITY, |all, slot| all.max(slot.max));
        let mut node = Self { origin: min.to_array(), child_base, ..Self::zeroed() };
        let units = [0, 1, 2].map(|axis| exponent(f64::from(max[axis]) - f64::from(min[axis])));
        node.exponents = units.map(biased);
        let (mut first, mut used_mask) = (0, 0);
        for (index, slot) in slots.iter().enumerate() {
            let Some(slot) = slot else { continue };
            for (axis, unit) in units.into_iter().enumerate() {
                let unit = f64::from(unit).exp2();
                let steps = |plane: f32| (f64::from(plane) - f64::from(min[axis])) / unit;
                node.planes[axis][0][index] = byte(steps(slot.min[axis]).floor());
                node.planes[axis][1][index] = byte(steps(slot.max[axis]).ceil());
            }
            match slot.content {
                SlotContent::Node => node.node_mask |= 1 << index,
                SlotContent::Record => {}
                SlotContent::Run(count) => {
                    node.runs[index] = first | (count << 5);
                    first += count;
                }
            }
            used_mask |= 1 << index;
        }
        node.leaf_base = first_triangle.unwrap_or(used_mask);
        node
    }

    /// The triangles of each slot that has any, of a mesh's node.
    pub(crate) fn runs(&self) -> impl Iterator<Item = Range<u32>> {
        let base = self.leaf_base;
        let runs = self.runs.into_iter().filter(|run| run >> 5 > 0);
        runs.map(move |run| {
            let first = base + u32::from(run & 31);
            first..first + u32::from(run >> 5)
        })
    }
}

/// The least e with 255 · 2ᵉ ≥ extent.
fn exponent(extent: f64) -> i32 {
    let mut e = LEAST_EXPONENT;
    while e < MOST_EXPONENT && 255.0 * f64::from(e).exp2() < extent {
        e += 1;
    }
    e
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in LEAST_EXPONENT..=MOST_EXPONENT")]
fn biased(exponent: i32) -> u8 {
    (exponent + 127) as u8
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "cut to a byte's range")]
fn byte(steps: f64) -> u8 {
    steps.clamp(0.0, 255.0) as u8
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    impl WideNode {
        /// Low and high corner of a slot's box, exactly.
        pub(crate) fn decoded(&self, slot: usize) -> [[f64; 3]; 2] {
            let unit = |axis: usize| f64::from(f32::from_bits(u32::from(self.exponents[axis]) << 23));
            let plane = |side: usize, axis: usize| f64::from(self.planes[axis][side][slot]) * unit(axis);
            [0, 1].map(|side| [0, 1, 2].map(|axis| f64::from(self.origin[axis]) + plane(side, axis)))
        }

        /// What is in a slot, as index and count: of a record, or of triangles.
        pub(crate) fn content(&self, slot: usize, is_top: bool) -> Option<(SlotContent, u32)> {
            let below = |mask: u32| (mask & ((1 << slot) - 1)).count_ones();
            let (bit, nodes) = (1u32 << slot, u32::from(self.node_mask));
            let records = if is_top { self.leaf_base } else { nodes };
            if records & bit != 0 {
                let content = if nodes & bit != 0 { SlotContent::Node } else { SlotContent::Record };
                return Some((content, self.child_base + below(records)));
            }
            let (first, count) = (self.runs[slot] & 31, self.runs[slot] >> 5);
            (count > 0).then(|| (SlotContent::Run(count), self.leaf_base + u32::from(first)))
        }

        /// The device's box test, in the same arithmetic.
        fn is_entered(&self, slot: usize, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
            let (mut near, mut far) = (0f32, t_max);
            for axis in 0..3 {
                let d = direction[axis];
                let inverse = 1.0 / if d.abs() < 1e-18 { 1e-18f32.copysign(d) } else { d };
                let step = inverse * f32::from_bits(u32::from(self.exponents[axis]) << 23);
                let start = (self.origin[axis] - origin[axis]) * inverse;
                let slack = 1e-6 * (255.0 * step.abs() + start.abs());
                let sides = if d < 0.0 { [1, 0] } else { [0, 1] };
                let [low, high] = sides.map(|side| f32::from(self.planes[axis][side][slot]));
                near = near.max(low * step + (start - slack));
                far = far.min(high * step + (start + slack));
            }
            near <= far
        }
    }

    fn coordinate() -> impl Strategy<Value = f32> {
        (-1f32..1.0, -12i32..12).prop_map(|(x, e)| x * (e as f32).exp2())
    }

    fn corner() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(coordinate()).prop_map(Vec3::from_array)
    }

    fn slots(boxes: &[(Vec3, Vec3)], offset: f32) -> [Option<Slot>; SLOTS] {
        std::array::from_fn(|i| {
            let &(a, b) = boxes.get(i)?;
            Some(Slot { min: a.min(b) + offset, max: a.max(b) + offset, content: SlotContent::Run(1) })
        })
    }

    proptest! {
        /// The decoded box contains the box, at any scale and place, and is less than two units larger.
        #[test]
        fn quantised_boxes_contain_the_boxes(
            boxes in prop::collection::vec((corner(), corner()), 1..=SLOTS),
            offset in prop::sample::select(vec![0f32, 1.0, -3e5, 1e7]),
        ) {
            let slots = slots(&boxes, offset);
            let node = WideNode::new(&slots, 3, Some(7));
            for (i, slot) in slots.iter().enumerate() {
                let Some(slot) = slot else {
                    prop_assert_eq!(node.content(i, false), None);
                    continue;
                };
                let [low, high] = node.decoded(i);
                for axis in 0..3 {
                    let unit = f64::from(f32::from_bits(u32::from(node.exponents[axis]) << 23));
                    let (min, max) = (f64::from(slot.min[axis]), f64::from(slot.max[axis]));
                    prop_assert!(low[axis] <= min && min - low[axis] < unit);
                    prop_assert!(high[axis] >= max && high[axis] - max < unit);
                }
                prop_assert_eq!(node.content(i, false), Some((SlotContent::Run(1), 7 + i as u32)));
            }
        }

        /// A ray to a point of a box enters it, however far away it starts.
        #[test]
        fn rays_enter_the_boxes_that_they_go_to(
            boxes in prop::collection::vec((corner(), corner()), 1..=SLOTS),
            origin in corner(),
            at in prop::array::uniform3(0f64..=1.0),
            flat in 0usize..4,
        ) {
            let slots = slots(&boxes, 0.0);
            let node = WideNode::new(&slots, 0, Some(0));
            for (i, slot) in slots.iter().enumerate() {
                let Some(slot) = slot else { continue };
                // In one coordinate equal to the origin's: the direction has a zero there.
                let mut from = origin;
                let target = [0, 1, 2].map(|axis| f64::from(slot.min[axis]) * (1.0 - at[axis]) + f64::from(slot.max[axis]) * at[axis]);
                if flat < 3 {
                    from[flat] = slot.min[flat];
                }
                let mut d = [0, 1, 2].map(|axis| target[axis] - f64::from(from[axis]));
                if flat < 3 {
                    d[flat] = 0.0;
                }
                let direction = Vec3::from_array(d.map(|x| x as f32));
                // Where the ray goes in truth: the direction was rounded, so only the way of the rounded one counts.
                let passes = |t: f64| (0..3).all(|axis| {
                    let x = f64::from(from[axis]) + t * f64::from(direction[axis]);
                    (f64::from(slot.min[axis])..=f64::from(slot.max[axis])).contains(&x)
                });
                if passes(1.0) {
                    prop_assert!(node.is_entered(i, from, direction, 1.0));
                }
            }
        }
    }

    #[test]
    fn flat_and_single_boxes_are_no_exception() {
        let point = Vec3::new(1.0, -2.0, 1e6);
        let node = WideNode::new(&slots(&[(point, point)], 0.0), 0, Some(0));
        assert_eq!(node.decoded(0), [point.as_dvec3().to_array(); 2]);
        assert!(node.is_entered(0, Vec3::ZERO, point, 1.0));
        assert!(!node.is_entered(0, Vec3::ZERO, point, 0.9));
        assert!(!node.is_entered(0, Vec3::ZERO, -point, f32::MAX));
    }
}
