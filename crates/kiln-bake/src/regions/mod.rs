//! Visibility regions for a level that has none: boxes of free space, and where they meet.
//!
//! Space is cut into cubic cells, each of which stands for its centre (`grid`). Two neighbours are connected if one sees the
//! other past all that stops rays (`faces`), so that a wall without thickness separates rooms as well as a thick one. What has
//! ground below it, and is indoors or not far above that ground, is where something may move (`columns`); what is connected of it
//! makes spaces, of which those are left out that see too many back faces, for they are inside something solid (`spaces`). What is
//! wide in a space, up to what is narrow, is a room (`rooms`). Free cells are parted into boxes from the top down (`split`), where
//! the least open area is cut and the least volume wasted, so that doors become boundaries; boxes that are one room are put together
//! again (`merge`). Everything is counted in integers or in a fixed order: the result depends neither on threads nor on
//! the order of faces.
//!
//! The boxes are those of Sloan et al. 2013, section 2.3, where a visibility system gives them; how they are made here is our
//! own.

mod columns;
mod cut;
mod faces;
mod grid;
mod links;
mod merge;
mod mixture;
mod profile;
mod rooms;
mod spaces;
mod split;
#[cfg(test)]
mod tests;
mod touch;
mod voxels;

use glam::{DAffine3, DVec3, Vec3};
use grid::{Grid, MOST_CELLS};
use kiln_core::{Bounds, Mesh, Region, RegionEdge};
use kiln_trace::{TraceError, Tracer};
use profile::Span;

/// A mesh in its place, of which the faces that stop rays are looked at.
#[derive(Clone, Copy, Debug)]
pub struct SolidObject<'m> {
    /// The mesh.
    pub mesh: &'m Mesh,
    /// From object space to metres relative to the level's origin.
    pub world_from_object: DAffine3,
}

impl SolidObject<'_> {
    /// Faces that nothing passes; some may have holes.
    fn solid_faces(&self) -> impl Iterator<Item = usize> {
        (0..self.mesh.faces.len()).filter(|face| {
            let group = self.mesh.group(*face);
            group.occludes && group.foliage.is_none()
        })
    }

    fn corners(&self, face: usize) -> [DVec3; 3] {
        self.mesh.corners(face).map(Vec3::as_dvec3).map(|corner| self.world_from_object.transform_point3(corner))
    }
}

/// How regions are made.
#[derive(Clone, Debug, PartialEq)]
pub struct MakeSettings {
    /// Edge of a cell, metres, positive; chosen by the level's size if absent.
    pub cell_m: Option<f64>,
    /// Points in the spaces to be taken, metres relative to the level's origin; if there is none, all spaces with ground that
    /// see few back faces are.
    pub seeds: Vec<DVec3>,
    /// How far above the ground regions reach under the open sky, metres; chosen by the level's size if absent.
    pub height_m: Option<f64>,
    /// Longest edge of a box, metres; chosen by the level's size if absent.
    pub max_edge_m: Option<f64>,
    /// Spaces with less volume are left out, cubic metres; 27 cells if absent.
    pub min_volume_m3: Option<f64>,
    /// The most regions, at least 1.
    pub max_regions: usize,
    /// What sees the backs of faces in more than this part of all directions is inside something.
    pub back_face_limit: f64,
}

impl Default for MakeSettings {
    fn default() -> Self {
        Self {
            cell_m: None,
            seeds: Vec::new(),
            height_m: None,
            max_edge_m: None,
            min_volume_m3: None,
            max_regions: 2000,
            back_face_limit: 0.25,
        }
    }
}

/// Height above the ground and edge of boxes that suit people, metres; what is smaller than a level for people has less.
const USUAL_HEIGHT_M: f64 = 10.0;
const USUAL_EDGE_M: f64 = 16.0;

/// Longest edge of boxes where nothing is said, at least so many cells: a city of large cells has large boxes.
const LEAST_EDGE: f64 = 32.0;

/// The smallest space that counts, if nothing is said, cells.
const USUAL_SPACE: usize = 27;

/// Parts of spaces that are looked at for backs of faces, at most.
const PARTS_LOOKED_AT: usize = 4000;

/// Settings in cells.
#[derive(Clone, Copy, Debug)]
struct Scale {
    height: usize,
    edge: usize,
    least_space: usize,
}

impl MakeSettings {
    /// Height of the air over a level whose longest extent is given, metres.
    fn height_over(&self, extent_m: f64) -> f64 {
        self.height_m.unwrap_or_else(|| USUAL_HEIGHT_M.min(extent_m / 5.0))
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "casts saturate")]
    fn scale(&self, extent_m: f64, cell_m: f64) -> Scale {
        let edge_m = self.max_edge_m.unwrap_or_else(|| USUAL_EDGE_M.min(extent_m / 2.0).max(LEAST_EDGE * cell_m));
        let cells = |length: f64| ((length / cell_m).round() as usize).max(1);
        let least_space = self.min_volume_m3.map_or(USUAL_SPACE, |volume| (volume / cell_m.powi(3)).ceil() as usize);
        Scale { height: cells(self.height_over(extent_m)), edge: cells(edge_m), least_space }
    }
}

/// Regions that were made, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct MadeRegions {
    /// Boxes that do not overlap, metres relative to the level's origin. Validity is left to the bake.
    pub regions: Vec<Region>,
    /// Where free cells of two boxes meet: area and centre of all faces that they share and see each other through. Each pair
    /// once, in the order of its indices.
    pub edges: Vec<RegionEdge>,
    /// What was counted.
    pub summary: MakeSummary,
}

/// What was counted when regions were made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MakeSummary {
    /// Edge of a cell, metres.
    pub cell_m: f64,
    /// Cells of the lattice along each axis.
    pub size: [usize; 3],
    /// Cells that regions were made of.
    pub free_cells: u64,
    /// Connected spaces that these are.
    pub spaces: u64,
    /// Spaces left out because they see too many back faces, and parts of others likewise.
    pub back_facing: [u64; 2],
    /// Spaces left out because they are small.
    pub small: u64,
    /// Spaces left out because they are the outside of another's shell.
    pub shells: u64,
    /// Boxes that would have been parted, had [`MakeSettings::max_regions`] allowed it.
    pub unfinished: u64,
    /// Cells that are in boxes, free or not.
    pub box_cells: u64,
}

/// Regions could not be made.
#[derive(Debug, thiserror::Error)]
pub enum MakeError {
    /// There is no geometry that bounds space.
    #[error("nothing in the level stops a ray, so its space has no bounds; check the classes in its sidecar")]
    NothingSolid,
    /// The cells are too small for the level.
    #[error("cells of {cell_m} m would be {cells:.0}, more than {MOST_CELLS}; use --cell {least_m} or larger")]
    TooManyCells {
        /// Edge of a cell, metres.
        cell_m: f64,
        /// How many there would be.
        cells: f64,
        /// The smallest that would do.
        least_m: f64,
    },
    /// A seed is not where the level is.
    #[error("seed point {index} (from 0) lies outside the level's bounds; give a point in the space to be filled")]
    SeedOutside {
        /// Which of them.
        index: usize,
    },
    /// A seed is in no space.
    #[error(
        "seed point {index} (from 0) is in a cell of no free space: too high in open air, or with a surface on all sides; \
         move it, or use --height or a smaller --cell"
    )]
    SeedBlocked {
        /// Which of them.
        index: usize,
    },
    /// Nothing is left to make regions of.
    #[error(
        "no free space was found: {back_facing} spaces see the backs of faces, {small} are smaller than --min-volume, {shells} \
         are the outside of others; give a point inside by --seed-point"
    )]
    NoSpace {
        /// Spaces that see too many back faces.
        back_facing: u64,
        /// Spaces that are too small.
        small: u64,
        /// Spaces over the shells of others.
        shells: u64,
    },
    /// Rays could not be traced.
    #[error(transparent)]
    Trace(#[from] TraceError),
}

/// Makes regions for the space among some objects.
///
/// `tracer` traces all that stops rays in the level; `objects` says where that is. Runs on the current rayon pool, and gives
/// the same for any number of threads. The time goes with the number of cells, and with the surface that they touch.
///
/// # Errors
/// [`MakeError`] if there is no space, too many cells, or a seed in none of it.
pub fn make_regions(
    objects: &[SolidObject<'_>],
    tracer: &dyn Tracer,
    settings: &MakeSettings,
) -> Result<MadeRegions, MakeError> {
    let bounds = grid::bounds(objects).ok_or(MakeError::NothingSolid)?;
    let extent_m = (bounds.max - bounds.min).max_element();
    let grid = Grid::over(objects, bounds, settings.height_over(extent_m), settings.cell_m)?;
    let scale = settings.scale(extent_m, grid.cell_m);
    let touched = touch::touched(&grid, objects);
    let mut voxels = faces::connect(grid, &touched, tracer)?;
    columns::find_places(&mut voxels, scale.height, settings.seeds.is_empty());
    let spaces = spaces::keep(&mut voxels, tracer, settings, scale.least_space)?;
    let mut back_facing = 0;
    if settings.seeds.is_empty() {
        // Where a space leaks into something solid, that is in boxes of its own.
        let mut boxes = split::split(&voxels, scale.edge, PARTS_LOOKED_AT).boxes;
        back_facing = spaces::drop_backs(&mut voxels, tracer, settings, &mut boxes)?;
        if boxes.is_empty() {
            let back_facing = spaces.back_facing + spaces.kept;
            return Err(MakeError::NoSpace { back_facing, small: spaces.small, shells: spaces.shells });
        }
    }
    rooms::find_rooms(&mut voxels);
    let parts = split::split(&voxels, scale.edge, settings.max_regions);
    let boxes = merge::merge(&voxels, parts.boxes, scale.edge);
    let summary = MakeSummary {
        cell_m: grid.cell_m,
        size: grid.size,
        free_cells: boxes.iter().map(|part| voxels.count(part)).sum(),
        spaces: spaces.kept,
        back_facing: [spaces.back_facing, back_facing],
        small: spaces.small,
        shells: spaces.shells,
        unfinished: parts.unfinished,
        box_cells: boxes.iter().map(|part| part.volume() as u64).sum(),
    };
    Ok(MadeRegions { regions: regions(&grid, &boxes), edges: links::edges(&voxels, &boxes), summary })
}

/// Boxes with names, which are their numbers.
fn regions(grid: &Grid, boxes: &[Span]) -> Vec<Region> {
    let digits = boxes.len().to_string().len();
    let region = |(index, part): (usize, &Span)| Region {
        id: format!("region_{:0digits$}", index + 1),
        bounds: Bounds { min: grid.corner(part.min), max: grid.corner(part.max) },
        valid: None,
    };
    boxes.iter().enumerate().map(region).collect()
}
