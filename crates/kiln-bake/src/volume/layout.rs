//! Which voxels there are: bricks of a sparse grid, and in each those that some point of a box is interpolated from.

use super::{ArtefactError, MAX_COORDINATE, VolumeError, lattice::Lattice};
use kiln_core::Bounds;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, ops::Range};

/// Voxels along an edge of a brick.
pub const BRICK_SIZE: i32 = 8;

/// Voxels of a brick.
pub const BRICK_VOXELS: usize = 512;

const BITS: i32 = BRICK_SIZE.ilog2() as i32;

/// How a volume is laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayoutSettings {
    /// Distance of neighbouring voxels, metres.
    pub spacing_m: f64,
    /// The most bricks.
    pub max_bricks: usize,
}

impl Default for LayoutSettings {
    /// A voxel each metre, in 65,536 bricks.
    fn default() -> Self {
        Self { spacing_m: 1.0, max_bricks: 1 << 16 }
    }
}

/// Eight by eight by eight voxels, of which some are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Brick {
    /// Coordinates of its first voxel in the lattice, divided by [`BRICK_SIZE`].
    pub coordinates: [i32; 3],
    /// A bit for each voxel: a word for each z, a byte of it for each y, a bit of that for each x.
    pub needed: [u64; 8],
}

impl Brick {
    /// Needed voxels.
    pub fn voxel_count(&self) -> usize {
        self.needed.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Coordinates of the needed voxels, in the order of their bits.
    pub fn voxels(&self) -> impl Iterator<Item = [i32; 3]> {
        let Self { coordinates, needed } = *self;
        (0..BRICK_SIZE.pow(3)).filter(move |i| needed[(i >> 6) as usize] >> (i & 63) & 1 == 1).map(move |i| {
            let local = [i & 7, i >> 3 & 7, i >> 6];
            std::array::from_fn(|axis| coordinates[axis] * BRICK_SIZE + local[axis])
        })
    }

    /// How many needed voxels come before one; `None` for one that is not needed.
    fn rank(&self, [x, y, z]: [i32; 3]) -> Option<usize> {
        let (word, bit) = ((z & 7) as usize, (y & 7) << 3 | x & 7);
        if self.needed[word] >> bit & 1 == 0 {
            return None;
        }
        let before: u32 = self.needed[..word].iter().map(|word| word.count_ones()).sum();
        Some((before + (self.needed[word] & ((1 << bit) - 1)).count_ones()) as usize)
    }

    /// Needs the voxels of a span, as far as they lie in this brick.
    fn need(&mut self, [min, max]: [[i32; 3]; 2]) {
        let run = |axis: usize| {
            let first = self.coordinates[axis] * BRICK_SIZE;
            (min[axis] - first).clamp(0, 8)..(max[axis] + 1 - first).clamp(0, 8)
        };
        let row = run(0).fold(0u64, |row, x| row | 1 << x);
        let slab = run(1).fold(0, |slab, y| slab | row << (8 * y));
        for z in run(2) {
            self.needed[z as usize] |= slab;
        }
    }
}

/// The voxels of a volume: bricks in the order of their coordinates, x first, each with a voxel that is needed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StoredLayout", into = "StoredLayout")]
pub struct Layout {
    lattice: Lattice,
    bricks: Vec<Brick>,
    /// Voxels before each brick, and all of them.
    firsts: Vec<usize>,
}

/// A layout as it is stored.
#[derive(Serialize, Deserialize)]
struct StoredLayout {
    spacing_m: f64,
    bricks: Vec<Brick>,
}

impl Layout {
    /// A layout in which every point of every box, its surface included, has all eight voxels that it is interpolated from.
    /// Boxes are in metres relative to the level's origin; empty ones need nothing.
    pub fn new(boxes: &[Bounds], settings: &LayoutSettings) -> Result<Self, VolumeError> {
        let lattice = Lattice::new(settings.spacing_m)?;
        let too_many = |needed: u64| {
            let LayoutSettings { spacing_m, max_bricks: limit } = *settings;
            if needed > limit as u64 { Err(VolumeError::TooManyBricks { needed, limit, spacing_m }) } else { Ok(()) }
        };
        let mut bricks = BTreeMap::new();
        for bounds in boxes {
            let Some(span) = lattice.span(bounds)? else { continue };
            let runs: [_; 3] = std::array::from_fn(|axis| span[0][axis] >> BITS..=span[1][axis] >> BITS);
            // No more than 2¹⁸ along an axis: the product fits. Known before there is memory or time for it.
            too_many(runs.iter().map(|run| u64::from(run.end().abs_diff(*run.start())) + 1).product())?;
            for coordinates in cells(&runs) {
                bricks.entry(coordinates).or_insert(Brick { coordinates, needed: [0; 8] }).need(span);
            }
            too_many(bricks.len() as u64)?;
        }
        Ok(Self::of(lattice, bricks.into_values().collect()))
    }

    fn of(lattice: Lattice, bricks: Vec<Brick>) -> Self {
        let counts = bricks.iter().map(Brick::voxel_count);
        let sums = counts.scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        });
        let firsts = std::iter::once(0).chain(sums).collect();
        Self { lattice, bricks, firsts }
    }

    /// Distance of neighbouring voxels, metres.
    pub fn spacing_m(&self) -> f64 {
        self.lattice.spacing_m
    }

    /// The bricks, in the order of their coordinates.
    pub fn bricks(&self) -> &[Brick] {
        &self.bricks
    }

    /// A box around all that a brick's voxels are needed for, metres relative to the level's origin.
    pub fn bounds_m(&self, brick: &Brick) -> Bounds {
        let position = |offset: i32| self.lattice.position(brick.coordinates.map(|x| (x << BITS) + offset));
        Bounds { min: position(-1), max: position(BRICK_SIZE) }
    }

    /// Needed voxels of all bricks: points to be traced.
    pub fn voxel_count(&self) -> usize {
        self.firsts[self.bricks.len()]
    }

    pub(crate) fn lattice(&self) -> Lattice {
        self.lattice
    }

    /// Places of a brick's voxels among all of them.
    pub(crate) fn slots(&self, brick: usize) -> Range<usize> {
        self.firsts[brick]..self.firsts[brick + 1]
    }

    /// Index of the brick with given coordinates.
    pub(crate) fn brick_at(&self, coordinates: [i32; 3]) -> Option<usize> {
        self.bricks.binary_search_by_key(&coordinates, |brick| brick.coordinates).ok()
    }

    /// Place of a needed voxel among all of them.
    pub(crate) fn slot(&self, voxel: [i32; 3]) -> Option<usize> {
        let brick = self.brick_at(voxel.map(|x| x >> BITS))?;
        Some(self.firsts[brick] + self.bricks[brick].rank(voxel)?)
    }

    /// Runs of whole bricks with at most so many voxels, or one brick, that hold all bricks in their order. With 0 each
    /// brick is alone, and what is traced for it is the same whatever else there is.
    pub fn batches(&self, voxels_per_batch: usize) -> Vec<Range<usize>> {
        let mut batches = Vec::new();
        let mut start = 0;
        for end in 1..=self.bricks.len() {
            let is_full = end == self.bricks.len() || self.firsts[end + 1] - self.firsts[start] > voxels_per_batch;
            if is_full {
                batches.push(start..end);
                start = end;
            }
        }
        batches
    }
}

/// Coordinates in a box of bricks, in their order.
fn cells(runs: &[std::ops::RangeInclusive<i32>; 3]) -> impl Iterator<Item = [i32; 3]> {
    let [xs, ys, zs] = runs.clone();
    xs.flat_map(move |x| {
        let zs = zs.clone();
        ys.clone().flat_map(move |y| zs.clone().map(move |z| [x, y, z]))
    })
}

/// Checks bricks that were read: in their order, each once, in the lattice's range, none without a voxel.
pub(crate) fn check_bricks(bricks: &[Brick]) -> Result<(), &'static str> {
    let limit = MAX_COORDINATE >> BITS;
    if !bricks.is_sorted_by(|a, b| a.coordinates < b.coordinates) {
        return Err("its bricks are not in their order");
    }
    if bricks.iter().flat_map(|brick| brick.coordinates).any(|x| !(-limit..=limit).contains(&x)) {
        return Err("a brick lies beyond the lattice");
    }
    if bricks.iter().any(|brick| brick.needed == [0; 8]) {
        return Err("a brick has no voxel");
    }
    Ok(())
}

impl TryFrom<StoredLayout> for Layout {
    type Error = ArtefactError;

    fn try_from(stored: StoredLayout) -> Result<Self, ArtefactError> {
        let error = |reason| ArtefactError { what: "layout of a volume", reason };
        let lattice = Lattice::new(stored.spacing_m).map_err(|_| error("its spacing is no length"))?;
        check_bricks(&stored.bricks).map_err(error)?;
        Ok(Self::of(lattice, stored.bricks))
    }
}

impl From<Layout> for StoredLayout {
    fn from(layout: Layout) -> Self {
        Self { spacing_m: layout.lattice.spacing_m, bricks: layout.bricks }
    }
}
