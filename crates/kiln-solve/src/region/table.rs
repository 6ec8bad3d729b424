//! How well the rules do, and what is left of jumps on boundaries.

use super::{
    fit::{CenterRule, RegionFit, fit_region},
    harmonics::SPHERE,
    points::RegionPoints,
};
use kiln_core::{REGION_HARMONICS, RegionEdge, RegionErrors};
use rayon::prelude::*;

/// For each channel the root mean square of the jump between neighbours' models at the centres of their boundaries,
/// weighted by area, of AO averaged over all normals; 0 without edges. Edges are between indices of `fits`, of as many
/// channels each.
pub fn jumps(fits: &[RegionFit], edges: &[RegionEdge]) -> Vec<f64> {
    let channels = fits.first().map_or(0, |fit| fit.squared_errors().len());
    let (mut sums, mut area) = (vec![0.0; channels], 0.0);
    for edge in edges {
        let [a, b] = edge.regions.map(|region| &fits[region as usize]);
        let squares: Vec<f64> = a.at(edge.center).zip(b.at(edge.center)).map(|(a, b)| (a - b).powi(2)).collect();
        for (sum, squares) in sums.iter_mut().zip(squares.chunks(REGION_HARMONICS)) {
            *sum += edge.area_m2 * squares.iter().sum::<f64>() / SPHERE;
        }
        area += edge.area_m2;
    }
    sums.into_iter().map(|sum| if area > 0.0 { (sum / area).sqrt() } else { 0.0 }).collect()
}

/// Squared errors of one region by rule, for one channel: mean, gradient, about the points, about the box, the better.
type ByRule = [f64; 5];

/// The errors for each channel, over all points, of models before (`fits`) and after smoothing, and of the other rules.
/// All are as they would be stored but for their rounding to f32: slopes shrunk where they overshot.
pub fn region_errors(
    points: &[RegionPoints],
    fits: &[RegionFit],
    smoothed: &[RegionFit],
    edges: &[RegionEdge],
) -> Vec<RegionErrors> {
    let channels = points.first().map_or(0, RegionPoints::channels);
    let by_rule: Vec<Vec<ByRule>> = points.par_iter().map(by_rule).collect();
    let count = points.iter().map(RegionPoints::len).sum::<usize>().max(1) as f64;
    let root = |sum: f64| (sum / count).sqrt();
    let [before, after] = [jumps(fits, edges), jumps(smoothed, edges)];
    let of_channel = |channel: usize| {
        let rule = |rule: usize| root(by_rule.iter().map(|region| region[channel][rule]).sum());
        let of_fits = |fits: &[RegionFit]| root(fits.iter().map(|fit| fit.squared_errors()[channel]).sum());
        RegionErrors {
            mean: rule(0),
            gradient: rule(1),
            point_center: rule(2),
            box_center: rule(3),
            best_center: rule(4),
            refined: of_fits(fits),
            smoothed: of_fits(smoothed),
            jump_fitted: before[channel],
            jump_smoothed: after[channel],
        }
    };
    (0..channels).map(of_channel).collect()
}

fn by_rule(points: &RegionPoints) -> Vec<ByRule> {
    use CenterRule::{Best, Box, Gradient, Mean, Points};
    let fits = [Mean, Gradient, Points, Box, Best].map(|rule| fit_region(points, rule));
    (0..points.channels()).map(|channel| std::array::from_fn(|rule| fits[rule].squared_errors()[channel])).collect()
}
