//! Fits of seven parameters to the points of a region, by rules for the centre.

use super::{
    bound::{Limits, Norm, with_constant},
    design::Design,
    grid::Scale,
    moments::{Moments, SIDES, sides},
    points::RegionPoints,
    ridge::{apply, dot, frozen},
    search::search,
};
use glam::DVec3;
use kiln_core::{REGION_HARMONICS, REGION_PARAMETERS, RegionModel};

/// Where a model's centre is, or what simpler model is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CenterRule {
    /// No slopes: the mean of the points' values.
    Mean,
    /// One gradient: three slopes.
    Gradient,
    /// Seven parameters about the mean of the valid points.
    Points,
    /// Seven parameters about the middle of the box.
    Box,
    /// The better of both; about the points if they are equal. The paper's.
    Best,
    /// As [`Self::Best`], then searched; kept where that lowers the squared error by more than 1 %.
    Refined,
}

/// A centre of three more numbers is not searched for fewer points: it would follow their noise.
const LEAST_REFINED: usize = 32;

/// What part of the squared error a searched centre may leave.
const WORTH: f64 = 0.99;

/// A root mean square of 10⁻⁵ in AO needs no better centre.
const GOOD_ENOUGH: f64 = 1e-10;

/// A model of a region before it is stored, and how well it does.
#[derive(Clone, Debug, PartialEq)]
pub struct RegionFit {
    pub(crate) scale: Scale,
    /// c, scaled to the box.
    pub(crate) center: [f64; 3],
    /// For each channel and harmonic the value at c and the slopes per half-extent of the box.
    pub(crate) parameters: Vec<[f64; REGION_PARAMETERS]>,
    pub(crate) frozen: [bool; SIDES],
    pub(crate) squared_errors: Vec<f64>,
    pub(crate) is_shrunk: bool,
    pub(crate) is_refined: bool,
}

/// Fits a model by least squares over the points. Slopes have a ridge, 10⁻³ of the number of points in a box scaled to
/// [−1, 1]³; its bias is taken out where the points determine a slope. Slopes that nothing determines are 0; without
/// points the model is open sky. Where AO would overshoot by more than 0.1 the fit is moved until it does not.
///
/// Errors by which rules compare are those after that.
pub fn fit_region(points: &RegionPoints, rule: CenterRule) -> RegionFit {
    match rule {
        CenterRule::Mean => RegionFit::new(points, [0.0; 3], Design::Constant),
        CenterRule::Gradient => RegionFit::new(points, [0.0; 3], Design::Gradient),
        CenterRule::Points => RegionFit::new(points, points.center(), Design::Sides),
        CenterRule::Box => RegionFit::new(points, [0.0; 3], Design::Sides),
        CenterRule::Best => best(points),
        CenterRule::Refined => refined(points),
    }
}

fn best(points: &RegionPoints) -> RegionFit {
    let [of_points, of_box] = [points.center(), [0.0; 3]].map(|center| RegionFit::new(points, center, Design::Sides));
    if of_box.total_error() < of_points.total_error() { of_box } else { of_points }
}

fn refined(points: &RegionPoints) -> RegionFit {
    let best = best(points);
    let enough = GOOD_ENOUGH * points.len() as f64;
    if points.len() < LEAST_REFINED || best.total_error() <= enough {
        return best;
    }
    let found = RegionFit::new(points, search(points, best.center), Design::Sides);
    if found.total_error() < WORTH * best.total_error() { RegionFit { is_refined: true, ..found } } else { best }
}

/// The best parameters, or where these would overshoot others that do not; the means alone do not.
fn bounded(
    points: &RegionPoints,
    center: [f64; 3],
    best: &[[f64; REGION_PARAMETERS]],
    norm: impl Fn() -> Norm,
) -> Vec<[f64; REGION_PARAMETERS]> {
    let limits = Limits::new(points, &points.scale, center);
    let of_channel = |(channel, best): (usize, &[[f64; REGION_PARAMETERS]])| {
        if limits.is_within(channel, best) {
            return best.to_vec();
        }
        let means = &points.mean[channel * REGION_HARMONICS..][..REGION_HARMONICS];
        let constant: Vec<_> = means.iter().map(|mean| with_constant(*mean, [0.0; SIDES])).collect();
        limits.towards(channel, &constant, best, &norm())
    };
    best.chunks(REGION_HARMONICS).enumerate().flat_map(of_channel).collect()
}

impl RegionFit {
    fn new(points: &RegionPoints, center: [f64; 3], design: Design) -> Self {
        let moments = Moments::new(points, &points.scale, center);
        let (inverse, means) = (design.inverse(&moments.covariance()), moments.means());
        let best = |k: usize| {
            let slopes = apply(&inverse, &moments.right(k));
            with_constant(points.mean[k] - dot(&slopes, &means), slopes)
        };
        let best: Vec<_> = (0..points.mean.len()).map(best).collect();
        let parameters = bounded(points, center, &best, || design.norm(moments.mean_squares()));
        Self {
            scale: points.scale,
            center,
            frozen: frozen(&moments.covariance()),
            squared_errors: points.squared_errors_by(&moments, &parameters),
            is_shrunk: parameters != best,
            parameters,
            is_refined: false,
        }
    }

    /// c, metres.
    pub fn center(&self) -> DVec3 {
        self.scale.position(self.center)
    }

    /// For each channel, [`RegionPoints::squared_errors`] over the points that it was fitted to.
    pub fn squared_errors(&self) -> &[f64] {
        &self.squared_errors
    }

    pub(crate) fn total_error(&self) -> f64 {
        self.squared_errors.iter().sum()
    }

    /// Whether it would have overshot, and so is not the least-squares fit.
    pub fn is_shrunk(&self) -> bool {
        self.is_shrunk
    }

    /// Whether its centre was searched.
    pub fn is_refined(&self) -> bool {
        self.is_refined
    }

    /// 1 and the columns of the slopes at a point, metres.
    pub(crate) fn columns(&self, point: DVec3) -> [f64; REGION_PARAMETERS] {
        let offset = [0, 1, 2].map(|axis| self.scale.coordinate(axis, point[axis]) - self.center[axis]);
        with_constant(1.0, sides(offset))
    }

    /// Coefficients at a point, for each channel and harmonic. Metres.
    pub fn at(&self, point: DVec3) -> impl Iterator<Item = f64> + '_ {
        let columns = self.columns(point);
        self.parameters.iter().map(move |parameters| dot(parameters, &columns))
    }

    /// The model as it is stored: slopes per metre, f32.
    #[expect(clippy::cast_possible_truncation, reason = "f32 is what is stored")]
    pub fn model(&self) -> RegionModel {
        let stored = |parameters: &[f64; REGION_PARAMETERS]| {
            std::array::from_fn(|i| match i {
                0 => parameters[0] as f32,
                _ => self.scale.divide((i - 1) / 2, parameters[i]) as f32,
            })
        };
        RegionModel { center: self.center().to_array(), coefficients: self.parameters.iter().map(stored).collect() }
    }
}
