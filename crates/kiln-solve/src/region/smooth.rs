//! Models of neighbours agree better on their boundaries (Sloan et al. 2013, section 2.3).
//!
//! `E = Σ_i ‖M_i − M_orig,i‖² + β Σ_i Σ_{j∈N(i)} ŵ_ij (M_i(b_ij) − M_j(b_ij))²`, b the centre of a boundary and `ŵ_ij =
//! w_ij / √(W_i W_j)` of its area w, with W_i the sum over the neighbours of i, so that β means the same in every
//! level. Each boundary is counted from both sides. ‖·‖² is the mean over the region's points of the squared
//! difference, plus the fit's ridge on slopes: along directions in which the points do not spread nothing else would
//! hold a model. Sums are over all harmonics of all channels, by 4π.
//!
//! Block coordinate descent: the best model of one region, given its neighbours, is a system of seven unknowns, the
//! same for all harmonics. Columns that the fit froze stay as they are, and centres too. Where the best model of a
//! channel would overshoot, it gets as near to it as `bound` finds, which is nearer than what it had: E never rises.
//!
//! Regions of one colour do not touch, so that doing them in parallel is doing them in turn.

use super::{
    bound::{Limits, Norm},
    boundaries::Boundaries,
    cholesky::Cholesky,
    error::{RegionError, check_length, check_setting},
    fit::RegionFit,
    harmonics::SPHERE,
    moments::Moments,
    points::RegionPoints,
    ridge::{Square, apply, dot},
};
use kiln_core::{REGION_HARMONICS, REGION_PARAMETERS, RegionEdge};
use rayon::prelude::*;

/// In what norm models stay near to what was fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SmoothNorm {
    /// The mean over the region's points of the squared difference of values.
    #[default]
    Points,
    /// The sum of squares of parameters, slopes per metre: the paper's, as far as it says.
    Coefficients,
}

/// How models are smoothed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothParams {
    /// β, at least 0. With 0 models stay as they are.
    pub smoothing: f64,
    /// Sweeps at most.
    pub sweeps: u32,
    /// A sweep that takes less than this part of E is the last.
    pub tolerance: f64,
    /// Of the difference to what was fitted.
    pub norm: SmoothNorm,
}

impl Default for SmoothParams {
    fn default() -> Self {
        Self { smoothing: 0.1, sweeps: 8, tolerance: 1e-3, norm: SmoothNorm::Points }
    }
}

/// How smoothing went.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Smoothed {
    /// E before and after each sweep, in squares of AO averaged over all normals.
    pub energy: Vec<f64>,
    /// Models that went less far than E would have had them, for they would have overshot.
    pub held: u64,
}

impl Smoothed {
    /// Sweeps done.
    pub fn sweeps(&self) -> u32 {
        self.energy.len().saturating_sub(1) as u32
    }
}

/// Smooths models in place. The points are those that each was fitted to.
///
/// # Errors
/// If β is negative or not finite, an edge is not usable, or numbers of regions or channels differ.
pub fn smooth(
    points: &[RegionPoints],
    fits: &mut [RegionFit],
    edges: &[RegionEdge],
    params: &SmoothParams,
) -> Result<Smoothed, RegionError> {
    let mut smoother = Smoother::new(points, fits, edges, params)?;
    let mut energy = vec![smoother.energy()];
    for _ in 0..if params.smoothing > 0.0 { params.sweeps } else { 0 } {
        let before = energy[energy.len() - 1];
        smoother.sweep();
        energy.push(smoother.energy());
        if before - energy[energy.len() - 1] <= params.tolerance * before {
            break;
        }
    }
    let held = smoother.blocks.iter().filter(|block| block.is_held).count() as u64;
    smoother.finish(points, fits);
    Ok(Smoothed { energy, held })
}

/// The parameters of one harmonic.
type Parameters = [f64; REGION_PARAMETERS];

/// A boundary as seen from one side.
#[derive(Clone, Debug)]
struct Link {
    other: usize,
    /// 2 β ŵ: the boundary is counted from both sides.
    weight: f64,
    /// The columns of both models at the boundary's centre.
    own: Parameters,
    others: Parameters,
}

#[derive(Clone, Debug)]
struct Block {
    original: Vec<Parameters>,
    current: Vec<Parameters>,
    metric: Square<REGION_PARAMETERS>,
    /// Of the block's terms of E, with zeros for what is frozen, which then does not change.
    system: Norm,
    links: Vec<Link>,
    limits: Limits,
    is_held: bool,
}

/// Block coordinate descent, block by block.
#[derive(Clone, Debug)]
pub struct Smoother {
    blocks: Vec<Block>,
    colors: Vec<Vec<usize>>,
}

impl Smoother {
    /// Starts at the models given.
    ///
    /// # Errors
    /// As [`smooth`].
    pub fn new(
        points: &[RegionPoints],
        fits: &[RegionFit],
        edges: &[RegionEdge],
        params: &SmoothParams,
    ) -> Result<Self, RegionError> {
        check_setting("the weight of smoothing", params.smoothing)?;
        check_length("models", fits.len(), points.len())?;
        for fit in fits {
            check_length("harmonics of a model", fit.parameters.len(), points[0].mean.len())?;
        }
        let boundaries = Boundaries::new(points.len(), edges)?;
        let sum = |region| boundaries.neighbors(region).map(|(_, boundary)| boundary.area_m2).sum::<f64>();
        let sums: Vec<f64> = (0..points.len()).map(sum).collect();
        let block = |region: usize| {
            let link = |(other, boundary): (usize, super::boundaries::Boundary)| Link {
                other,
                weight: 2.0 * params.smoothing * boundary.area_m2 / (sums[region] * sums[other]).sqrt(),
                own: fits[region].columns(boundary.center),
                others: fits[other].columns(boundary.center),
            };
            Block::new(&points[region], &fits[region], boundaries.neighbors(region).map(link).collect(), params.norm)
        };
        Ok(Self { blocks: (0..points.len()).into_par_iter().map(block).collect(), colors: boundaries.colors() })
    }

    /// Number of blocks: one for each region.
    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Whether there are no regions.
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    /// E, in squares of AO averaged over all normals, summed over regions, boundaries and channels.
    pub fn energy(&self) -> f64 {
        let each: Vec<f64> = self.blocks.par_iter().map(|block| block.energy(&self.blocks)).collect();
        each.iter().sum::<f64>() / SPHERE
    }

    /// The best model of one region, given the others, as far as it may go.
    pub fn step(&mut self, region: usize) {
        if let Some((current, is_held)) = self.blocks[region].next(&self.blocks) {
            self.blocks[region].current = current;
            self.blocks[region].is_held |= is_held;
        }
    }

    /// A step for each region, colour by colour.
    pub fn sweep(&mut self) {
        for color in &self.colors {
            let next: Vec<_> = color.par_iter().map(|region| self.blocks[*region].next(&self.blocks)).collect();
            for (region, next) in color.iter().zip(next) {
                if let Some((current, is_held)) = next {
                    self.blocks[*region].current = current;
                    self.blocks[*region].is_held |= is_held;
                }
            }
        }
    }

    /// Writes the models back, with their errors.
    fn finish(self, points: &[RegionPoints], fits: &mut [RegionFit]) {
        let each = fits.par_iter_mut().zip(self.blocks).zip(points);
        each.filter(|((_, block), _)| block.current != block.original).for_each(|((fit, block), points)| {
            fit.parameters = block.current;
            fit.squared_errors = points.squared_errors(fit);
        });
    }
}

impl Block {
    fn new(points: &RegionPoints, fit: &RegionFit, links: Vec<Link>, norm: SmoothNorm) -> Self {
        let frozen: [bool; REGION_PARAMETERS] = std::array::from_fn(|i| i > 0 && fit.frozen[i - 1]);
        let metric = match norm {
            SmoothNorm::Points => Moments::new(points, &fit.scale, fit.center).mean_squares(),
            SmoothNorm::Coefficients => per_metre(fit),
        };
        let mut system = metric;
        for link in &links {
            for (i, j) in pairs() {
                system[i][j] += link.weight * link.own[i] * link.own[j];
            }
        }
        pairs().filter(|(i, j)| frozen[*i] || frozen[*j]).for_each(|(i, j)| system[i][j] = 0.0);
        Self {
            original: fit.parameters.clone(),
            current: fit.parameters.clone(),
            metric,
            system: Norm { inverse: Cholesky::new(&system).invert(), matrix: system },
            links,
            limits: Limits::new(points, &fit.scale, fit.center),
            is_held: false,
        }
    }

    /// Its terms of E times 4π; of boundaries those counted from its side.
    fn energy(&self, blocks: &[Self]) -> f64 {
        let of_harmonic = |k: usize| {
            let change = difference(&self.current[k], &self.original[k]);
            let jumps = self.links.iter().map(|link| 0.5 * link.weight * self.jump(link, blocks, k).powi(2));
            dot(&change, &apply(&self.metric, &change)) + jumps.sum::<f64>()
        };
        (0..self.current.len()).map(of_harmonic).sum()
    }

    fn jump(&self, link: &Link, blocks: &[Self], k: usize) -> f64 {
        dot(&link.own, &self.current[k]) - dot(&link.others, &blocks[link.other].current[k])
    }

    /// The next model and whether something held it back; nothing where nothing draws.
    fn next(&self, blocks: &[Self]) -> Option<(Vec<Parameters>, bool)> {
        if self.links.iter().all(|link| link.weight == 0.0) {
            return None;
        }
        let wanted: Vec<_> = (0..self.current.len()).map(|k| self.best(blocks, k)).collect();
        let (mut next, mut is_held) = (Vec::with_capacity(wanted.len()), false);
        let channels = self.current.chunks(REGION_HARMONICS).zip(wanted.chunks(REGION_HARMONICS));
        for (channel, (from, to)) in channels.enumerate() {
            // E rises with the distance from its least, so that it falls on the way.
            let allowed = self.limits.towards(channel, from, to, &self.system);
            is_held |= allowed != to;
            next.extend(allowed);
        }
        Some((next, is_held))
    }

    /// The least E of one harmonic, by its gradient at the current model.
    fn best(&self, blocks: &[Self], k: usize) -> Parameters {
        let current = self.current[k];
        let mut right = apply(&self.metric, &difference(&self.original[k], &current));
        for link in &self.links {
            let pull = link.weight * self.jump(link, blocks, k);
            (0..REGION_PARAMETERS).for_each(|i| right[i] -= pull * link.own[i]);
        }
        let step = apply(&self.system.inverse, &right);
        std::array::from_fn(|i| current[i] + step[i])
    }
}

fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..REGION_PARAMETERS).flat_map(|i| (0..REGION_PARAMETERS).map(move |j| (i, j)))
}

fn difference(a: &Parameters, b: &Parameters) -> Parameters {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Squares of the constant and of slopes per metre.
fn per_metre(fit: &RegionFit) -> Square<REGION_PARAMETERS> {
    let weight = |i: usize| if i == 0 { 1.0 } else { fit.scale.divide((i - 1) / 2, 1.0).powi(2) };
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { weight(i) } else { 0.0 }))
}
