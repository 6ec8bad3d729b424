//! The models of all regions of a level.

use super::{
    absorb::{Absorbed, absorb},
    error::{RegionError, check_channels, check_length},
    fit::{CenterRule, RegionFit, fit_region},
    grid::Grid,
    points::{RegionPoints, check_box},
    smooth::{SmoothParams, Smoothed, smooth},
    table::region_errors,
};
use kiln_core::{REGION_HARMONICS, Region, RegionErrors, RegionModels, RegionSamples, RegionSummary, Regions};
use rayon::prelude::*;

/// Models of all regions, from samples of all of them in order; the points of a region are its valid candidates.
///
/// Small regions become part of a neighbour; what is left is fitted with [`CenterRule::Refined`] and smoothed. The
/// errors of the summary are over all points, of regions as they are after that.
///
/// # Errors
/// If the samples are not those of the regions, or a box, an edge or a setting is not usable.
pub fn model_regions(regions: &Regions, samples: &RegionSamples) -> Result<RegionModels, RegionError> {
    let channels = samples.channels as usize;
    check_channels(channels)?;
    let traced = Traced { rays: samples.rays, dropped: dropped(samples), channels: samples.channels };
    model_points(regions, region_points(&regions.regions, samples)?, traced)
}

/// What of samples does not go into points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traced {
    /// Rays of all points.
    pub rays: u64,
    /// Points that were left out.
    pub dropped: u64,
    /// Channels of all points.
    pub channels: u32,
}

impl Traced {
    /// Adds those of a further run of regions.
    pub fn add(&mut self, samples: &RegionSamples) {
        self.rays += samples.rays;
        self.dropped += dropped(samples);
    }
}

/// As [`model_regions`], from the points of each region ([`region_points`]), which are a tenth of the samples: those of
/// many regions need not be in memory together.
///
/// # Errors
/// As [`model_regions`].
pub fn model_points(regions: &Regions, points: Vec<RegionPoints>, traced: Traced) -> Result<RegionModels, RegionError> {
    let settings = &regions.settings;
    check_length("regions with points", points.len(), regions.regions.len())?;
    let empty = points.iter().filter(|points| points.is_empty()).count() as u64;
    let absorbed = absorb(points, &regions.edges, settings.min_points, settings.min_volume_m3)?;
    let refined = |points: &RegionPoints| fit_region(points, CenterRule::Refined);
    let fits: Vec<RegionFit> = absorbed.points.par_iter().map(refined).collect();
    let params = SmoothParams { smoothing: settings.smoothing, sweeps: settings.sweeps, ..SmoothParams::default() };
    let mut smoothed = fits.clone();
    let how = smooth(&absorbed.points, &mut smoothed, &absorbed.edges, &params)?;
    let mut summary = RegionSummary {
        empty,
        rays: traced.rays,
        dropped: traced.dropped,
        ..summary(&absorbed, &fits, &smoothed, how)
    };
    // A level without regions has channels all the same.
    summary.errors.resize_with(traced.channels as usize, RegionErrors::default);
    Ok(RegionModels {
        channels: traced.channels,
        models: smoothed.iter().map(RegionFit::model).collect(),
        model_of: absorbed.model_of,
        region_of: absorbed.region_of,
        edges: absorbed.edges,
        summary,
    })
}

fn summary(absorbed: &Absorbed, fits: &[RegionFit], smoothed: &[RegionFit], how: Smoothed) -> RegionSummary {
    let count = |is: fn(&RegionFit) -> bool| fits.iter().filter(|fit| is(fit)).count() as u64;
    RegionSummary {
        regions: absorbed.model_of.len() as u64,
        absorbed: (absorbed.model_of.len() - absorbed.region_of.len()) as u64,
        points: absorbed.points.iter().map(|points| points.len() as u64).sum(),
        shrunk: count(RegionFit::is_shrunk),
        refined: count(RegionFit::is_refined),
        held: how.held,
        sweeps: how.sweeps(),
        energy: how.energy,
        errors: region_errors(&absorbed.points, fits, smoothed, &absorbed.edges),
        ..RegionSummary::default()
    }
}

fn dropped(samples: &RegionSamples) -> u64 {
    samples.dropped.iter().map(|count| u64::from(*count)).sum()
}

/// The points of each of some regions, from their samples.
///
/// # Errors
/// If the samples are not those of the regions, or a box is not usable.
pub fn region_points(regions: &[Region], samples: &RegionSamples) -> Result<Vec<RegionPoints>, RegionError> {
    let channels = samples.channels as usize;
    check_channels(channels)?;
    samples.check(regions.len(), channels)?;
    regions.iter().enumerate().try_for_each(|(index, region)| check_box(&region.bounds, index))?;
    let mut rest = &samples.values[..];
    let runs: Vec<&[f32]> =
        samples.valid.iter().map(|valid| take(&mut rest, valid.count() * channels * REGION_HARMONICS)).collect();
    let each = regions.par_iter().zip(&samples.valid).zip(runs);
    Ok(each
        .map(|((region, valid), values)| RegionPoints::of_grid(Grid::new(region, valid, values, channels)))
        .collect())
}

/// The first values, which are there.
fn take<'a>(rest: &mut &'a [f32], count: usize) -> &'a [f32] {
    let (first, after) = rest.split_at(count);
    *rest = after;
    first
}
