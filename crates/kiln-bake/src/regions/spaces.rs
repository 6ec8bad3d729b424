//! Connected spaces: which of them count.

use super::{
    MakeError, MakeSettings,
    profile::Span,
    voxels::{FLOOR, FREE, SEEN, SKY, Voxels},
};
use glam::Vec3;
use kiln_trace::{Hit, Ray, SobolScramble, TraceError, Tracer, sphere_directions};

/// Cells of a space, or of a box, from which its surroundings are looked at.
const VIEWS_OF_SPACE: usize = 64;
const VIEWS_OF_BOX: usize = 16;

/// Directions of each look.
const DIRECTIONS: u32 = 64;

/// Rays that are traced at once.
const RAYS_PER_CALL: usize = 1 << 20;

/// Spaces that were kept, and why others were not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Spaces {
    pub(super) kept: u64,
    pub(super) back_facing: u64,
    pub(super) small: u64,
    pub(super) shells: u64,
}

/// A space, by one of its cells, and where it is looked at from.
struct Space {
    first: usize,
    views: Vec<usize>,
}

/// Leaves those cells free that are in spaces with a seed, or, without seeds, in those that are not small and do not see
/// too many back faces.
pub(super) fn keep(
    voxels: &mut Voxels,
    tracer: &dyn Tracer,
    settings: &MakeSettings,
    least: usize,
) -> Result<Spaces, MakeError> {
    if !settings.seeds.is_empty() {
        return keep_seeded(voxels, settings);
    }
    let (mut spaces, mut counts) = (Vec::new(), Spaces::default());
    let (mut cells, mut out) = (Vec::new(), Vec::new());
    for first in 0..voxels.cells.len() {
        if voxels.cells[first] & (FREE | SEEN) != FREE {
            continue;
        }
        flood(voxels, first, &mut cells);
        if cells.len() < least {
            counts.small += 1;
            out.extend_from_slice(&cells);
        } else if is_outside_of_shell(voxels, &cells) {
            counts.shells += 1;
            out.extend_from_slice(&cells);
        } else {
            let views = (0..VIEWS_OF_SPACE).map(|i| cells[i * cells.len() / VIEWS_OF_SPACE] as usize);
            let mut views: Vec<usize> = views.collect();
            views.dedup();
            spaces.push(Space { first, views });
        }
    }
    out.iter().for_each(|cell| voxels.cells[*cell as usize] &= !FREE);
    let views: Vec<&[usize]> = spaces.iter().map(|space| space.views.as_slice()).collect();
    let backs = back_fractions(voxels, tracer, &views)?;
    voxels.cells.iter_mut().for_each(|bits| *bits &= !SEEN);
    for (space, _) in spaces.iter().zip(backs).filter(|(_, backs)| *backs > settings.back_face_limit) {
        flood(voxels, space.first, &mut cells);
        cells.iter().for_each(|cell| voxels.cells[*cell as usize] &= !FREE);
        counts.back_facing += 1;
    }
    counts.kept = spaces.len() as u64 - counts.back_facing;
    if counts.kept == 0 {
        return Err(MakeError::NoSpace { back_facing: counts.back_facing, small: counts.small, shells: counts.shells });
    }
    Ok(counts)
}

/// Whether a space is mostly open air over sheets that are the ceilings of others: the outside of a cave's shell that is seen from
/// both sides.
fn is_outside_of_shell(voxels: &Voxels, cells: &[u32]) -> bool {
    let row = voxels.grid.stride(1);
    let bits = |cell: &u32| voxels.cells[*cell as usize];
    let floors = || cells.iter().filter(|cell| bits(cell) & FLOOR != 0);
    let sheets = floors().filter(|cell| **cell as usize >= row && voxels.is_free(**cell as usize - row));
    let sky = cells.iter().filter(|cell| bits(cell) & SKY != 0).count();
    2 * sky > cells.len() && 2 * sheets.count() > floors().count()
}

fn keep_seeded(voxels: &mut Voxels, settings: &MakeSettings) -> Result<Spaces, MakeError> {
    let mut counts = Spaces::default();
    let mut cells = Vec::new();
    for (index, seed) in settings.seeds.iter().enumerate() {
        let place = voxels.grid.cell_of(*seed).ok_or(MakeError::SeedOutside { index })?;
        let cell = voxels.grid.index(place);
        // A point on a floor may be in a cell whose centre is under it.
        let above = (place[1] + 1 < voxels.grid.size[1]).then(|| cell + voxels.grid.stride(1));
        let free = [Some(cell), above].into_iter().flatten().find(|cell| voxels.is_free(*cell));
        let first = free.ok_or(MakeError::SeedBlocked { index })?;
        if voxels.cells[first] & SEEN == 0 {
            flood(voxels, first, &mut cells);
            counts.kept += 1;
        }
    }
    let outside = voxels.cells.iter_mut().filter(|bits| **bits & SEEN == 0);
    outside.for_each(|bits| *bits &= !FREE);
    Ok(counts)
}

/// Marks all cells of the space that a free cell is in as seen, and lists them.
fn flood(voxels: &mut Voxels, first: usize, cells: &mut Vec<u32>) {
    cells.clear();
    cells.push(first as u32);
    voxels.cells[first] |= SEEN;
    let mut next = 0;
    while let Some(&cell) = cells.get(next) {
        next += 1;
        let mut found = [0; 6];
        let mut count = 0;
        voxels.for_neighbours(cell as usize, |neighbour| {
            found[count] = neighbour;
            count += 1;
        });
        for neighbour in &found[..count] {
            if voxels.cells[*neighbour] & SEEN == 0 {
                voxels.cells[*neighbour] |= SEEN;
                cells.push(*neighbour as u32);
            }
        }
    }
}

/// Takes out the boxes that see too many back faces, and returns how many.
pub(super) fn drop_backs(
    voxels: &mut Voxels,
    tracer: &dyn Tracer,
    settings: &MakeSettings,
    boxes: &mut Vec<Span>,
) -> Result<u64, TraceError> {
    let views = |span: &Span| {
        let cells: Vec<usize> = voxels.free_in(span).collect();
        let mut views: Vec<usize> = (0..VIEWS_OF_BOX).map(|i| cells[i * cells.len() / VIEWS_OF_BOX]).collect();
        views.dedup();
        views
    };
    let views: Vec<Vec<usize>> = boxes.iter().map(views).collect();
    let views: Vec<&[usize]> = views.iter().map(Vec::as_slice).collect();
    let backs = back_fractions(voxels, tracer, &views)?;
    let before = boxes.len();
    let mut is_good = backs.iter().map(|backs| *backs <= settings.back_face_limit);
    boxes.retain(|span| {
        let keep = is_good.next().unwrap_or(true);
        if !keep {
            let cells: Vec<usize> = voxels.free_in(span).collect();
            cells.into_iter().for_each(|cell| voxels.cells[cell] &= !FREE);
        }
        keep
    });
    Ok((before - boxes.len()) as u64)
}

/// Of each group of cells, the part of directions over the sphere in which the back of a face is seen first.
fn back_fractions(voxels: &Voxels, tracer: &dyn Tracer, groups: &[&[usize]]) -> Result<Vec<f64>, TraceError> {
    let mut directions: Vec<Vec3> = Vec::new();
    sphere_directions(SobolScramble([0x9e37_79b9, 0x7f4a_7c15]), DIRECTIONS, &mut directions);
    let views: Vec<usize> = groups.concat();
    let mut backs = Vec::with_capacity(views.len());
    for views in views.chunks(RAYS_PER_CALL / DIRECTIONS as usize) {
        let origin = |cell: &usize| voxels.grid.center(voxels.grid.coordinates(*cell)).as_vec3();
        let rays: Vec<Ray> = views
            .iter()
            .map(origin)
            .flat_map(|origin| directions.iter().map(move |direction| (origin, *direction)))
            .map(|(origin, direction)| Ray { origin, direction, t_max: f32::MAX })
            .collect();
        let mut hits = vec![Hit::MISS; rays.len()];
        tracer.trace(&rays, &mut hits)?;
        let is_back = |hit: &&Hit| hit.is_hit() && hit.back_face;
        backs.extend(hits.chunks(DIRECTIONS as usize).map(|hits| hits.iter().filter(is_back).count()));
    }
    let mut next = 0;
    let fraction = |group: &&[usize]| {
        let sum: usize = backs[next..next + group.len()].iter().sum();
        next += group.len();
        sum as f64 / (group.len().max(1) as f64 * f64::from(DIRECTIONS))
    };
    Ok(groups.iter().map(fraction).collect())
}
