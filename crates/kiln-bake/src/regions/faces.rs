//! Which neighbouring cells see each other.

use super::{
    grid::Grid,
    touch::CellBits,
    voxels::{FLOOR, OPEN, Voxels},
};
use glam::{DVec3, Vec3};
use kiln_trace::{Hit, Ray, TraceError, Tracer};
use rayon::prelude::*;

/// Rays between two cells: one between the centres, and four beside it.
const RAYS: usize = 5;

/// Of those beside it, as many must be open: fewer are so through a crack.
const LEAST_OPEN: usize = 2;

/// How far beside the centres the others are, cells.
const BESIDE: f64 = 0.25;

/// Cells whose faces are looked for at once, and faces whose rays are traced at once.
const CELLS_PER_PASS: usize = 1 << 20;
const FACES_PER_CALL: usize = 1 << 17;

/// A face between a cell and the next along an axis.
#[derive(Clone, Copy)]
struct Face {
    cell: u32,
    axis: u8,
}

/// What rays through a face find.
#[derive(Clone, Copy)]
enum Passage {
    Open,
    /// Closed, and from the farther cell the front of what is there is seen.
    Front,
    Back,
}

/// Finds which neighbours see each other. Where no surface comes into either, they do; elsewhere rays tell.
pub(super) fn connect(grid: Grid, touched: &CellBits, tracer: &dyn Tracer) -> Result<Voxels, TraceError> {
    let mut cells = vec![0u8; grid.len()];
    for (pass, cells) in cells.chunks_mut(CELLS_PER_PASS).enumerate() {
        let first = pass * CELLS_PER_PASS;
        let faces: Vec<Face> =
            (0..cells.len()).into_par_iter().flat_map_iter(|i| doubtful(&grid, touched, first + i)).collect();
        cells.par_iter_mut().enumerate().for_each(|(i, bits)| *bits |= plain(&grid, touched, first + i));
        for faces in faces.chunks(FACES_PER_CALL) {
            for (face, passage) in faces.iter().zip(passages(&grid, faces, tracer)?) {
                let (cell, axis) = (face.cell as usize - first, usize::from(face.axis));
                match passage {
                    Passage::Open => cells[cell] |= OPEN[axis],
                    // Of the cell above, which may be of the next pass; see below.
                    Passage::Front if axis == 1 => cells[cell] |= FLOOR,
                    Passage::Front | Passage::Back => {}
                }
            }
        }
    }
    raise_floors(&grid, &mut cells);
    Ok(Voxels::new(grid, cells))
}

/// Moves the bit of a floor from the cell under it to the cell over it.
fn raise_floors(grid: &Grid, cells: &mut [u8]) {
    let row = grid.size[0];
    cells.par_chunks_mut(grid.stride(2)).for_each(|slab| {
        for index in (0..slab.len()).rev() {
            let below = if index < row { 0 } else { slab[index - row] & FLOOR };
            slab[index] = slab[index] & !FLOOR | below;
        }
    });
}

/// Faces of a cell to the next along each axis, if there is one, and whether a surface is near.
fn faces_of(grid: &Grid, touched: &CellBits, cell: usize) -> impl Iterator<Item = (usize, bool)> {
    let place = grid.coordinates(cell);
    let (size, is_touched) = (grid.size, touched.contains(cell));
    (0..3)
        .filter(move |axis| place[*axis] + 1 < size[*axis])
        .map(move |axis| (axis, is_touched || touched.contains(cell + grid.stride(axis))))
}

/// Faces that rays must decide.
fn doubtful(grid: &Grid, touched: &CellBits, cell: usize) -> impl Iterator<Item = Face> {
    let near = faces_of(grid, touched, cell).filter(|(_, is_near)| *is_near);
    near.map(move |(axis, _)| Face { cell: cell as u32, axis: axis as u8 })
}

/// The bits of faces that are open since nothing is near.
fn plain(grid: &Grid, touched: &CellBits, cell: usize) -> u8 {
    faces_of(grid, touched, cell).filter(|(_, is_near)| !is_near).fold(0, |bits, (axis, _)| bits | OPEN[axis])
}

/// Traces rays through faces, against the axis: along y they fall to the floor.
fn passages(grid: &Grid, faces: &[Face], tracer: &dyn Tracer) -> Result<Vec<Passage>, TraceError> {
    let rays: Vec<Ray> = faces.par_iter().flat_map_iter(|face| rays(grid, *face)).collect();
    let mut hits = vec![Hit::MISS; rays.len()];
    tracer.trace(&rays, &mut hits)?;
    Ok(hits.par_chunks(RAYS).map(passage).collect())
}

fn rays(grid: &Grid, face: Face) -> [Ray; RAYS] {
    let axis = usize::from(face.axis);
    let mut farther = grid.coordinates(face.cell as usize);
    farther[axis] += 1;
    let center = grid.center(farther);
    let unit = |axis: usize| DVec3::AXES[axis] * grid.cell_m;
    let (u, v) = (BESIDE * unit((axis + 1) % 3), BESIDE * unit((axis + 2) % 3));
    let direction: Vec3 = (-unit(axis)).as_vec3();
    [DVec3::ZERO, u + v, u - v, v - u, -u - v].map(|beside| Ray {
        origin: (center + beside).as_vec3(),
        direction,
        t_max: 1.0,
    })
}

fn passage(hits: &[Hit]) -> Passage {
    let open = hits[1..].iter().filter(|hit| !hit.is_hit()).count();
    if !hits[0].is_hit() && open >= LEAST_OPEN {
        return Passage::Open;
    }
    let backs = hits.iter().filter(|hit| hit.is_hit() && hit.back_face).count();
    let fronts = hits.iter().filter(|hit| hit.is_hit() && !hit.back_face).count();
    if fronts > backs { Passage::Front } else { Passage::Back }
}
