//! Figure 2 of Sloan et al. 2013 as numbers: the linear function alone, local AO times it, and both optimised.

use super::{
    alternate::{Alternated, TreeInstance, TreeModel, content_order},
    error::{TreeError, check_length},
    fit::{TreeFit, rmse},
    instance::{fit_global, fit_instance},
};
use kiln_core::TreeErrors;
use rayon::prelude::*;
use std::ops::Range;

/// Compares the three models with the instances' signals, for each channel. `alternated` is that of the same model and
/// instances. Sums are in the order of the instances' keys.
///
/// # Errors
/// If the parts do not fit together.
pub fn error_table(
    model: &TreeModel<'_>,
    instances: &[TreeInstance<'_>],
    alternated: &Alternated,
) -> Result<Vec<TreeErrors>, TreeError> {
    Ok(error_tables(model, instances, alternated)?.total)
}

/// What [`error_table`] gives, over all instances and for each.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorTables {
    /// For each channel.
    pub total: Vec<TreeErrors>,
    /// For each instance, in the order that they were given in, and channel.
    pub instances: Vec<Vec<TreeErrors>>,
}

/// As [`error_table`], for each instance too.
///
/// # Errors
/// If the parts do not fit together.
pub fn error_tables(
    model: &TreeModel<'_>,
    instances: &[TreeInstance<'_>],
    alternated: &Alternated,
) -> Result<ErrorTables, TreeError> {
    model.check(instances)?;
    let (samples, channels) = (model.samples, model.channels);
    check_length("alternated fits", alternated.fits.len(), instances.len() * channels)?;
    let local = samples.local(model.local, channels)?;
    let order = content_order(instances);
    let signals: Vec<_> = order.iter().map(|j| instances[*j].values).collect();
    let global_only = each(&signals, |values| fit_global(samples, channels, values))?;
    let local_global = each(&signals, |values| fit_instance(samples, &local, values))?;
    let ordered: Vec<_> = order.iter().map(|j| alternated.fits[j * channels..][..channels].to_vec()).collect();
    let errors = |which: Range<usize>| -> Vec<TreeErrors> {
        let of_channel = |channel: usize| TreeErrors {
            global_only: total_rmse(&global_only[which.clone()], channel),
            local_global: total_rmse(&local_global[which.clone()], channel),
            alternated: total_rmse(&ordered[which.clone()], channel),
            weight: ordered[which.clone()].iter().map(|fits| fits[channel].weight).sum(),
        };
        (0..channels).map(of_channel).collect()
    };
    let mut of_instances = vec![Vec::new(); instances.len()];
    for (at, j) in order.iter().enumerate() {
        of_instances[*j] = errors(at..at + 1);
    }
    Ok(ErrorTables { total: errors(0..instances.len()), instances: of_instances })
}

/// The fits of all signals.
fn each(
    signals: &[&[f32]],
    fit: impl Fn(&[f32]) -> Result<Vec<TreeFit>, TreeError> + Sync,
) -> Result<Vec<Vec<TreeFit>>, TreeError> {
    signals.par_iter().map(|values| fit(values)).collect()
}

fn total_rmse(fits: &[Vec<TreeFit>], channel: usize) -> f64 {
    let sum = |part: fn(&TreeFit) -> f64| fits.iter().map(|fits| part(&fits[channel])).sum::<f64>();
    rmse(sum(|fit| fit.squared_error), sum(|fit| fit.weight))
}
