//! Values for the unknowns of an instance that no sample reaches: those of the nearest unknown that has values.
//!
//! These are components without a valid sample, vertices of faces that do not receive or have no area, and
//! vertices that no face uses. Distance is between points; an unknown at the very position comes first.

use crate::nearest::KdTree;
use glam::DVec3;
use rayon::prelude::*;

/// Gives every unknown without values those of the nearest with values; `false` if none has values.
pub fn fill_unknowns(points: &[DVec3], valid: &[bool], values: &mut [f64], channels: usize) -> bool {
    if !valid.contains(&false) {
        return true;
    }
    let sources: Vec<_> = (0u32..).zip(points).filter(|(u, _)| valid[*u as usize]).map(|(u, p)| (*p, u)).collect();
    let tree = KdTree::new(sources);
    let wanted: Vec<u32> = (0..points.len() as u32).filter(|u| !valid[*u as usize]).collect();
    let found: Vec<_> = wanted.par_iter().map(|u| tree.nearest(points[*u as usize])).collect();
    for (unknown, source) in wanted.iter().zip(found) {
        let Some(source) = source else { return false };
        let from = source.index as usize * channels;
        values.copy_within(from..from + channels, *unknown as usize * channels);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_the_nearest_and_never_another_filled_one() {
        let points: Vec<_> = [0.0, 1.0, 1.9, 5.0].map(|x| DVec3::X * x).to_vec();
        let mut values = vec![0.1, 0.2, 9.0, 9.0, 9.0, 9.0, 0.3, 0.4];
        assert!(fill_unknowns(&points, &[true, false, false, true], &mut values, 2));
        assert_eq!(values, [0.1, 0.2, 0.1, 0.2, 0.1, 0.2, 0.3, 0.4]);
    }

    #[test]
    fn without_a_source_it_says_so() {
        assert!(!fill_unknowns(&[DVec3::ZERO], &[false], &mut [0.0], 1));
        assert!(fill_unknowns(&[], &[], &mut [], 1));
    }
}
