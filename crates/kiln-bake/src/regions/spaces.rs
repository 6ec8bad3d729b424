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
    is_over_shell: bool,
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
        } else {
            let views = (0..VIEWS_OF_SPACE).map(|i| cells[i * cells.len() / VIEWS_OF_SPACE] as usize);
            let mut views: Vec<usize> = views.collect();
            views.dedup();
            spaces.push(Space { first, views, is_over_shell: is_over_shell(voxels, &cells) });
        }
    }
    out.iter().for_each(|cell| voxels.cells[*cell as usize] &= !FREE);
    let views: Vec<&[usize]> = spaces.iter().map(|space| space.views.as_slice()).collect();
    let seen = seen_from(voxels, tracer, &views)?;
    voxels.cells.iter_mut().for_each(|bits| *bits &= !SEEN);
    for (space, seen) in spaces.iter().zip(seen) {
        let is_back_facing = seen.backs > settings.back_face_limit;
        if is_back_facing {
            counts.back_facing += 1;
        } else if space.is_over_shell && seen.nothing > 0.5 {
            counts.shells += 1;
        } else {
            counts.kept += 1;
            continue;
        }
        flood(voxels, space.first, &mut cells);
        cells.iter().for_each(|cell| voxels.cells[*cell as usize] &= !FREE);
    }
    if counts.kept == 0 {
        return Err(MakeError::NoSpace { back_facing: counts.back_facing, small: counts.small, shells: counts.shells });
    }
    Ok(counts)
}

/// A shell holds at least this part of the volume of what is outside of it: more than a hollow floor does.
const LEAST_INSIDE: f64 = 0.2;

/// Whether a space is mostly open air over sheets that are the ceilings of others, which are no mere hollows. If it sees little
/// besides, it is the outside of a shell with two sides, such as a cave's.
fn is_over_shell(voxels: &Voxels, cells: &[u32]) -> bool {
    let row = voxels.grid.stride(1);
    let bits = |cell: &u32| voxels.cells[*cell as usize];
    let floors = cells.iter().filter(|cell| bits(cell) & FLOOR != 0);
    let (mut floor_count, mut sheets, mut inside) = (0, 0, 0);
    for floor in floors {
        let below = column_below(voxels, *floor as usize, row);
        floor_count += 1;
        sheets += usize::from(below > 0);
        inside += below;
    }
    let sky = cells.iter().filter(|cell| bits(cell) & SKY != 0).count();
    2 * sky > cells.len() && 2 * sheets > floor_count && inside as f64 > LEAST_INSIDE * cells.len() as f64
}

/// Free cells that see each other in a column under a floor.
fn column_below(voxels: &Voxels, floor: usize, row: usize) -> usize {
    let mut cell = floor;
    let mut count = 0;
    while cell >= row && voxels.is_free(cell - row) && (count == 0 || voxels.joins(cell - row, 1)) {
        cell -= row;
        count += 1;
    }
    count
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
    let seen = seen_from(voxels, tracer, &views)?;
    let before = boxes.len();
    let mut is_good = seen.iter().map(|seen| seen.backs <= settings.back_face_limit);
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

/// What is seen from some cells, as parts of all directions over the sphere.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// The back of a face.
    backs: f64,
    /// Nothing at all.
    nothing: f64,
}

/// What is seen first from each group of cells.
fn seen_from(voxels: &Voxels, tracer: &dyn Tracer, groups: &[&[usize]]) -> Result<Vec<Seen>, TraceError> {
    let mut directions: Vec<Vec3> = Vec::new();
    sphere_directions(SobolScramble([0x9e37_79b9, 0x7f4a_7c15]), DIRECTIONS, &mut directions);
    let views: Vec<usize> = groups.concat();
    // Backs and nothing, of each view.
    let mut counts: Vec<[usize; 2]> = Vec::with_capacity(views.len());
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
        let count = |hits: &[Hit], of: fn(&&Hit) -> bool| hits.iter().filter(of).count();
        let counted = |hits| [count(hits, |hit| hit.is_hit() && hit.back_face), count(hits, |hit| !hit.is_hit())];
        counts.extend(hits.chunks(DIRECTIONS as usize).map(counted));
    }
    let mut next = 0;
    let part = |group: &&[usize]| {
        let all = group.len().max(1) as f64 * f64::from(DIRECTIONS);
        let counts = &counts[next..next + group.len()];
        next += group.len();
        let sum = |which: usize| counts.iter().map(|counts| counts[which]).sum::<usize>() as f64 / all;
        Seen { backs: sum(0), nothing: sum(1) }
    };
    Ok(groups.iter().map(part).collect())
}
