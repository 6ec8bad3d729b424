//! Averages for unknowns that no sample reaches: from the hole's rim inwards, ring by ring.

use crate::surface::Surface;

/// An unknown that no sample reaches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HoleUnknown {
    pub(crate) unknown: u32,
    /// A third of the area of its faces.
    pub(crate) area: f64,
    /// Its distance from the rim in edges; 0 where no path leads to a rim.
    pub(crate) ring: u32,
}

/// Sets the averages of unknowns that have no weight but a path to one that has: each ring gets the mean of its
/// neighbours in the rings before, one for each face that joins them. Returns the unknowns without weight;
/// averages of those without such a path stay 0.
pub(crate) fn fill_averages(
    surface: &Surface,
    weight: &[f64],
    average: &mut [f64],
    channels: usize,
) -> Vec<HoleUnknown> {
    let hole = Hole::new(surface, weight);
    let mut ring_of: Vec<u32> =
        hole.unknowns.iter().map(|u| if weight[*u as usize] > 0.0 { 0 } else { u32::MAX }).collect();
    let mut last: Vec<u32> = (0..ring_of.len() as u32).filter(|local| ring_of[*local as usize] == 0).collect();
    for ring in 1.. {
        let mut next: Vec<u32> = last.iter().flat_map(|local| hole.neighbours(*local)).copied().collect();
        next.sort_unstable();
        next.dedup();
        next.retain(|local| ring_of[*local as usize] == u32::MAX);
        if next.is_empty() {
            break;
        }
        for &local in &next {
            let before = hole.neighbours(local).iter().filter(|other| ring_of[**other as usize] < ring);
            let sources: Vec<usize> = before.map(|other| hole.unknowns[*other as usize] as usize).collect();
            let target = hole.unknowns[local as usize] as usize;
            for c in 0..channels {
                let sum: f64 = sources.iter().map(|source| average[source * channels + c]).sum();
                average[target * channels + c] = sum / sources.len() as f64;
            }
        }
        next.iter().for_each(|local| ring_of[*local as usize] = ring);
        last = next;
    }
    hole.report(weight, &ring_of)
}

/// The faces that touch an unknown without weight, in local numbers.
struct Hole {
    /// The unknowns of these faces, rising: the holes' and their rims'.
    unknowns: Vec<u32>,
    /// A third of the area of these faces around each unknown.
    area: Vec<f64>,
    start: Vec<u32>,
    neighbour: Vec<u32>,
}

impl Hole {
    fn new(surface: &Surface, weight: &[f64]) -> Self {
        let touches = |corners: &&[u32; 3]| corners.iter().any(|u| weight[*u as usize] == 0.0);
        let mut unknowns: Vec<u32> = surface.corners.iter().filter(touches).flatten().copied().collect();
        unknowns.sort_unstable();
        unknowns.dedup();
        let mut hole = Self { area: vec![0.0; unknowns.len()], start: vec![0], neighbour: Vec::new(), unknowns };
        let mut pairs = Vec::new();
        for (corners, area) in surface.corners.iter().zip(&surface.areas).filter(|(corners, _)| touches(corners)) {
            let [a, b, c] = corners.map(|u| hole.local(u));
            [a, b, c].iter().for_each(|local| hole.area[*local as usize] += area / 3.0);
            pairs.extend([(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)]);
        }
        pairs.sort_unstable();
        hole.neighbour = pairs.iter().map(|pair| pair.1).collect();
        let ends = (0..hole.unknowns.len() as u32).map(|local| pairs.partition_point(|pair| pair.0 <= local) as u32);
        hole.start.extend(ends);
        hole
    }

    fn local(&self, unknown: u32) -> u32 {
        self.unknowns.partition_point(|u| *u < unknown) as u32
    }

    fn neighbours(&self, local: u32) -> &[u32] {
        &self.neighbour[self.start[local as usize] as usize..self.start[local as usize + 1] as usize]
    }

    fn report(&self, weight: &[f64], ring_of: &[u32]) -> Vec<HoleUnknown> {
        let all = self.unknowns.iter().zip(&self.area).zip(ring_of);
        let all = all.map(|((&unknown, &area), &ring)| HoleUnknown {
            unknown,
            area,
            ring: if ring == u32::MAX { 0 } else { ring },
        });
        all.filter(|hole| weight[hole.unknown as usize] == 0.0).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// A strip of `n` quads along x, two triangles each; unknowns 2i and 2i + 1 at x = i.
    fn strip(n: u32) -> Surface {
        let points = (0..2 * n + 2).map(|u| DVec3::new(f64::from(u / 2), f64::from(u % 2), 0.0)).collect();
        let corners: Vec<_> =
            (0..n).flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 1, 2 * i + 2, 2 * i + 3]]).collect();
        Surface { points, areas: vec![0.5; corners.len()], mesh_face: (0..2 * n).collect(), corners }
    }

    #[test]
    fn rings_take_the_mean_of_what_is_before_them() {
        let mut weight = vec![0.0; 8];
        weight[0] = 1.0;
        weight[1] = 1.0;
        let mut average = vec![0.0; 8];
        average[0] = 0.2;
        average[1] = 0.5;
        let holes = fill_averages(&strip(3), &weight, &mut average, 1);
        // 2 touches 0 once and 1 twice, 3 touches 1 only.
        let [ring_2, ring_3] = [(0.2 + 2.0 * 0.5) / 3.0, 0.5];
        assert!((average[2] - ring_2).abs() < 1e-15 && (average[3] - ring_3).abs() < 1e-15, "{average:?}");
        assert!((average[4] - (ring_2 + 2.0 * ring_3) / 3.0).abs() < 1e-15, "{average:?}");
        assert!(average[6..].iter().all(|x| (0.4..=0.5).contains(x)), "{average:?}");
        assert_eq!(holes.iter().map(|h| h.ring).collect::<Vec<_>>(), [1, 1, 2, 2, 3, 3]);
        assert!((holes.iter().map(|h| h.area).sum::<f64>() - (3.0 - 0.5 / 3.0 * 3.0)).abs() < 1e-15);
    }

    #[test]
    fn without_a_rim_nothing_is_filled() {
        let mut average = vec![0.0; 8];
        let holes = fill_averages(&strip(3), &[0.0; 8], &mut average, 1);
        assert_eq!(average, [0.0; 8]);
        assert_eq!(holes.iter().map(|h| h.ring).collect::<Vec<_>>(), [0; 8]);
    }
}
