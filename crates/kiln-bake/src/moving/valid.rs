//! Which candidates of a region are in its free space.
//!
//! A region is a box that a visibility system made: it holds what is behind a slanted wall, and the inside of walls, too.
//! Neighbours that see each other are together, on the same side of all surfaces. Of these groups the one with the most
//! points that see few back faces is the region's free space: some points of each say how many do. A point that is apart
//! from it is let in if some point of it sees it. Single points that see too many back faces all the same are found out when
//! they are traced.

use super::RegionGather;
use crate::scramble::point_scramble;
use glam::{DVec3, Vec3};
use kiln_core::{CANDIDATES, CANDIDATES_PER_AXIS, CandidateBits, Region};
use kiln_trace::{Ray, SpherePoint, SphereSums, TraceError, Tracer};

/// Points of a group that say whether it lies in something solid.
const PROBES: usize = 16;

/// Rays of each: as many as are traced together.
const PROBE_RAYS: u32 = 64;

/// Points of the free space, the nearest ones, that are asked whether they see one that is apart from it.
const WITNESSES: usize = 16;

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
    let groups = groups(&components(tracer, &points)?);
    let Some(main) = freest(tracer, &points, groups, settings)? else { return Ok(CandidateBits::default()) };
    let mut bits = CandidateBits::default();
    main.into_iter().for_each(|index| bits.insert(index));
    let apart: Vec<usize> = (0..CANDIDATES).filter(|index| !bits.contains(*index)).collect();
    for index in seen_from(tracer, &points, &bits, &apart)? {
        bits.insert(index);
    }
    Ok(bits)
}

/// A point's sphere: its directions depend on where it is and on the seed.
pub(super) fn sphere(point: DVec3, seed: u64) -> SpherePoint {
    SpherePoint { origin: point.as_vec3(), scramble: point_scramble(point, seed) }
}

/// The lowest index in each point's component, in which neighbours (by faces, edges and corners) see each other.
fn components(tracer: &dyn Tracer, points: &[DVec3]) -> Result<Vec<u16>, TraceError> {
    let pairs: Vec<[usize; 2]> = (0..CANDIDATES).flat_map(neighbours_after).collect();
    let blocked = blocked(tracer, pairs.iter().map(|[a, b]| [points[*a], points[*b]]))?;
    let mut component: Vec<u16> = (0..CANDIDATES as u16).collect();
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

/// The points of each component, ascending; the largest first, of equals the one with the lowest index.
fn groups(component: &[u16]) -> Vec<Vec<usize>> {
    let mut groups = vec![Vec::new(); component.len()];
    component.iter().enumerate().for_each(|(index, of)| groups[usize::from(*of)].push(index));
    groups.retain(|group| !group.is_empty());
    groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
    groups
}

/// The group with the most points that see few back faces, as far as some of its points tell; none if none of them does.
fn freest(
    tracer: &dyn Tracer,
    points: &[DVec3],
    mut groups: Vec<Vec<usize>>,
    settings: &RegionGather,
) -> Result<Option<Vec<usize>>, TraceError> {
    let (mut best, mut most, mut first) = (None, 0.0, 0);
    // The largest by itself, since as a rule no other has more; then all that still may, together.
    while first < groups.len() {
        let end = if first == 0 { 1 } else { groups.partition_point(|group| group.len() as f64 > most) };
        let Some(asked) = groups.get(first..end).filter(|asked| !asked.is_empty()) else { break };
        for (index, good) in (first..).zip(good_points(tracer, points, asked, settings)?) {
            if good > most {
                (best, most) = (Some(index), good);
            }
        }
        first = end;
    }
    Ok(best.map(|index| groups.swap_remove(index)))
}

/// How many points of each group see few back faces, as far as some of them tell.
fn good_points(
    tracer: &dyn Tracer,
    points: &[DVec3],
    groups: &[Vec<usize>],
    settings: &RegionGather,
) -> Result<Vec<f64>, TraceError> {
    let asked = |group: &Vec<usize>| {
        let step = group.len().div_ceil(PROBES);
        group.iter().copied().skip(step / 2).step_by(step).collect::<Vec<usize>>()
    };
    let asked: Vec<Vec<usize>> = groups.iter().map(asked).collect();
    let spheres: Vec<SpherePoint> = asked.iter().flatten().map(|index| sphere(points[*index], settings.seed)).collect();
    let mut sums = vec![SphereSums::default(); spheres.len()];
    tracer.gather_sphere(&spheres, &settings.kernel, PROBE_RAYS, &mut sums)?;
    let mut sums = sums.iter();
    let good = |(group, asked): (&Vec<usize>, &Vec<usize>)| {
        let of_group = sums.by_ref().take(asked.len());
        let good = of_group.filter(|sum| sum.back_face_fraction() <= settings.settings.back_face_limit).count();
        (group.len() * good) as f64 / asked.len() as f64
    };
    Ok(groups.iter().zip(&asked).map(good).collect())
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
    fn groups_are_components_by_size() {
        let mut component: Vec<u16> = vec![5, 1, 1, 5, 5, 5];
        component.extend([6, 7]);
        assert_eq!(groups(&component), [vec![0, 3, 4, 5], vec![1, 2], vec![6], vec![7]]);
    }
}
