//! Where something may move: over ground, and indoors or not far above it.

use super::voxels::{FLOOR, FREE, OPEN, SKY, Voxels};
use rayon::prelude::*;

/// Marks the cells where something may be as free: those from which one falls to the front of a face, and, if the sky is
/// open above (which is marked, too), at most `height` cells from it. Without `need_ground`, all under a cover.
///
/// So the space under a terrain is left out, the inside of solids, and what lies beside a level: nothing to stand on
/// is seen from there. A room's ceiling may be of any height.
pub(super) fn find_places(voxels: &mut Voxels, height: usize, need_ground: bool) {
    let [row, levels, _] = voxels.grid.size;
    voxels.cells.par_chunks_mut(row * levels).for_each(|slab| {
        for x in 0..row {
            let sky = sky_from(slab, x, row);
            let mut above_ground = None;
            for (level, index) in (x..slab.len()).step_by(row).enumerate() {
                above_ground = if slab[index] & FLOOR != 0 {
                    Some(0)
                } else if level > 0 && slab[index - row] & OPEN[1] != 0 {
                    above_ground.map(|cells: usize| cells + 1)
                } else {
                    None
                };
                let is_covered = level < sky;
                if !is_covered {
                    slab[index] |= SKY;
                }
                let is_place = above_ground.map_or(is_covered && !need_ground, |cells| is_covered || cells < height);
                if is_place {
                    slab[index] |= FREE;
                }
            }
        }
    });
}

/// The lowest level of a column that the sky is open above.
fn sky_from(slab: &[u8], x: usize, row: usize) -> usize {
    let levels = slab.len() / row;
    let is_open = |level: &usize| slab[x + row * level] & OPEN[1] != 0;
    (0..levels - 1).rev().find(|level| !is_open(level)).map_or(0, |level| level + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regions::grid::Grid;
    use glam::DVec3;

    /// A column from its lowest cell: `_` has a floor, `b` the back of a face, and others see the one below.
    fn free(column: &str, height: usize, need_ground: bool) -> String {
        let marks: Vec<char> = column.chars().collect();
        let cell = |(index, mark): (usize, &char)| {
            let is_open = marks.get(index + 1).is_some_and(|next| !"_b".contains(*next));
            (if *mark == '_' { FLOOR } else { 0 }) | (if is_open { OPEN[1] } else { 0 })
        };
        let cells = marks.iter().enumerate().map(cell).collect();
        let grid = Grid { origin: DVec3::ZERO, cell_m: 1.0, size: [1, marks.len(), 1] };
        let mut voxels = Voxels::new(grid, cells);
        find_places(&mut voxels, height, need_ground);
        (0..marks.len()).map(|index| if voxels.is_free(index) { 'f' } else { '.' }).collect()
    }

    #[test]
    fn places_have_ground_and_are_not_high() {
        assert_eq!(free("..._.....", 3, true), "...fff...");
        // A room of five, and the roof over it.
        assert_eq!(free(".._....b_....", 3, true), "..fffff.fff..");
        // Under the back of a terrain.
        assert_eq!(free("...b......", 3, true), "..........");
        assert_eq!(free("...b......", 3, false), "fff.......");
    }
}
