//! Which candidates of a region are in its free space.
//!
//! A region is a box that a visibility system made: it holds what is behind a slanted wall, and the inside of walls, too.
//! A candidate is valid if it lies in nothing solid and in the free space that holds most of the region: neighbours that
//! see each other are together, and a point that is apart is let in if some point of that space sees it. A few rays say
//! what is solid; what they let pass is found out when the point is traced.

use super::RegionGather;
use crate::scramble::point_scramble;
use glam::{DVec3, Vec3};
use kiln_core::{CANDIDATES, CANDIDATES_PER_AXIS, CandidateBits, Region};
use kiln_trace::{Ray, SpherePoint, SphereSums, TraceError, Tracer};

/// Rays that say whether a point lies in something solid.
const PROBE_RAYS: u32 = 32;

/// Part of these that must see back faces for it: in the open even a quarter is too much, and 32 rays are 0.08 off.
const SOLID: f64 = 0.5;

/// Points of the free space, the nearest ones, that are asked whether they see one that is apart from it.
const WITNESSES: usize = 16;

/// No component.
const NONE: u16 = u16::MAX;

/// Finds the candidates that are in a region's free space: all of [`Region::valid`], where that is given.
pub(super) fn valid(
    tracer: &dyn Tracer,
    region: &Region,
    settings: &RegionGather,
) -> Result<CandidateBits, TraceError> {
    if let Some(valid) = region.valid {
        return Ok(valid);
    }
    let points: Vec<DVec3> = (0..CANDIDATES).map(|index| region.candidate(index)).collect();
    let solid = back_fractions(tracer, &points, settings)?;
    let is_free: Vec<bool> = solid.iter().map(|fraction| *fraction < SOLID).collect();
    let component = components(tracer, &points, &is_free)?;
    let Some(main) = largest(&component, &solid, settings.settings.back_face_limit) else {
        return Ok(CandidateBits::default());
    };
    let mut bits = CandidateBits::default();
    (0..CANDIDATES).filter(|index| component[*index] == main).for_each(|index| bits.insert(index));
    let apart: Vec<usize> = (0..CANDIDATES).filter(|index| is_free[*index] && component[*index] != main).collect();
    for index in seen_from(tracer, &points, &bits, &apart)? {
        bits.insert(index);
    }
    Ok(bits)
}

fn back_fractions(tracer: &dyn Tracer, points: &[DVec3], settings: &RegionGather) -> Result<Vec<f64>, TraceError> {
    let spheres: Vec<SpherePoint> = points.iter().map(|point| sphere(*point, settings.seed)).collect();
    let mut sums = vec![SphereSums::default(); spheres.len()];
    tracer.gather_sphere(&spheres, &settings.kernel, PROBE_RAYS, &mut sums)?;
    Ok(sums.iter().map(SphereSums::back_face_fraction).collect())
}

/// A point's sphere: its directions depend on where it is and on the seed.
pub(super) fn sphere(point: DVec3, seed: u64) -> SpherePoint {
    SpherePoint { origin: point.as_vec3(), scramble: point_scramble(point, seed) }
}

/// The lowest index in each free point's component, in which neighbours (by faces, edges and corners) see each other.
fn components(tracer: &dyn Tracer, points: &[DVec3], is_free: &[bool]) -> Result<Vec<u16>, TraceError> {
    let pairs: Vec<[usize; 2]> =
        (0..CANDIDATES).flat_map(neighbours_after).filter(|pair| pair.iter().all(|index| is_free[*index])).collect();
    let blocked = blocked(tracer, pairs.iter().map(|[a, b]| [points[*a], points[*b]]))?;
    let mut component: Vec<u16> =
        is_free.iter().zip(0..).map(|(free, index)| if *free { index } else { NONE }).collect();
    // The lowest index spreads; each pass goes both ways, so that few are needed.
    loop {
        let mut changed = false;
        let open = || pairs.iter().zip(&blocked).filter(|(_, blocked)| !**blocked).map(|(pair, _)| *pair);
        let mut join = |[a, b]: [usize; 2]| {
            let lowest = component[a].min(component[b]);
            changed |= component[a] != lowest || component[b] != lowest;
            component[a] = lowest;
            component[b] = lowest;
        };
        open().for_each(&mut join);
        open().rev().for_each(&mut join);
        if !changed {
            return Ok(component);
        }
    }
}

/// A candidate with each of its neighbours of greater index.
fn neighbours_after(index: usize) -> impl Iterator<Item = [usize; 2]> {
    let side = CANDIDATES_PER_AXIS as isize;
    let [x, y, z] = [index % 8, index / 8 % 8, index / 64].map(|i| i as isize);
    let offsets = (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
    offsets.filter_map(move |[dx, dy, dz]| {
        let [x, y, z] = [x + dx, y + dy, z + dz];
        let other = (x + side * y + side * side * z) as usize;
        let is_inside = [x, y, z].iter().all(|i| (0..side).contains(i));
        (is_inside && other > index).then_some([index, other])
    })
}

/// The component with the most points that are good for sure; of equals the one with the lowest index.
fn largest(component: &[u16], back_fractions: &[f64], limit: f64) -> Option<u16> {
    let mut count = [0u32; CANDIDATES];
    let good = component.iter().zip(back_fractions).filter(|(of, fraction)| **of != NONE && **fraction <= limit);
    good.for_each(|(of, _)| count[usize::from(*of)] += 1);
    let most = count.iter().copied().max().filter(|most| *most > 0)?;
    (0..).zip(&count).find(|(_, count)| **count == most).map(|(of, _)| of)
}

/// Those of the points apart that some of the nearest members see.
fn seen_from(
    tracer: &dyn Tracer,
    points: &[DVec3],
    members: &CandidateBits,
    apart: &[usize],
) -> Result<Vec<usize>, TraceError> {
    let mut pairs: Vec<[usize; 2]> = Vec::with_capacity(apart.len() * WITNESSES);
    let mut nearest: Vec<usize> = members.iter().collect();
    for &index in apart {
        let distance = |member: &usize| points[*member].distance_squared(points[index]);
        nearest.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
        pairs.extend(nearest.iter().take(WITNESSES).map(|member| [*member, index]));
    }
    let blocked = blocked(tracer, pairs.iter().map(|[a, b]| [points[*a], points[*b]]))?;
    let mut seen: Vec<usize> =
        pairs.iter().zip(blocked).filter(|(_, blocked)| !blocked).map(|([_, index], _)| *index).collect();
    seen.dedup();
    Ok(seen)
}

/// Whether something stands between two points, for each pair.
fn blocked(tracer: &dyn Tracer, pairs: impl Iterator<Item = [DVec3; 2]>) -> Result<Vec<bool>, TraceError> {
    let ray = |[from, to]: [DVec3; 2]| {
        let origin: Vec3 = from.as_vec3();
        Ray { origin, direction: to.as_vec3() - origin, t_max: 1.0 }
    };
    let rays: Vec<Ray> = pairs.map(ray).collect();
    let mut blocked = vec![false; rays.len()];
    tracer.any_hit(&rays, &mut blocked)?;
    Ok(blocked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pair_of_neighbours_is_there_once() {
        let pairs: Vec<[usize; 2]> = (0..CANDIDATES).flat_map(neighbours_after).collect();
        let cell = |index: usize| [index % 8, index / 8 % 8, index / 64].map(|i| i as i32);
        let touch = |a: usize, b: usize| cell(a).iter().zip(cell(b)).all(|(a, b)| (a - b).abs() <= 1);
        let all = (0..CANDIDATES).flat_map(|a| (a + 1..CANDIDATES).map(move |b| [a, b])).filter(|[a, b]| touch(*a, *b));
        assert_eq!(pairs, all.collect::<Vec<_>>());
    }

    #[test]
    fn the_largest_component_is_that_of_good_points() {
        let mut component = vec![NONE; CANDIDATES];
        component[..5].copy_from_slice(&[0, 0, 0, 3, 3]);
        let mut backs = vec![0.0; CANDIDATES];
        assert_eq!(largest(&component, &backs, 0.25), Some(0));
        backs[..2].fill(0.3);
        assert_eq!(largest(&component, &backs, 0.25), Some(3));
        backs.fill(1.0);
        assert_eq!(largest(&component, &backs, 0.25), None);
    }
}
