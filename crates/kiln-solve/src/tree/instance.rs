//! The fits of one instance: by channel, of the blended signal, and without local AO.

use super::{
    error::{TreeError, check_channels, check_length},
    fit::{TreeFit, fit, known},
    samples::{ModelSamples, SampledLocal},
};

/// How far the weights of a blend may be from adding up to 1.
const BLEND_SLACK: f64 = 1e-6;

/// Fits the global function of an instance for each channel: `min_y Σ w (f − G_y L)²`. `values` has f for each
/// sample of the model, `samples × channels`, the channels of a sample together. What is not finite is not valid and
/// has no weight; what is beyond [0, 1] counts as its end.
///
/// # Errors
/// If the number of values is another.
pub fn fit_instance(samples: &ModelSamples, local: &SampledLocal, values: &[f32]) -> Result<Vec<TreeFit>, TreeError> {
    let channels = local.channels;
    check(samples, local, values)?;
    let of_channel = |channel: usize| {
        let index = move |sample: usize| sample * channels + channel;
        fit(samples, |sample| Some((local.values[index(sample)], known(values[index(sample)])?)))
    };
    Ok((0..channels).map(of_channel).collect())
}

/// Fits four numbers to the signal that an engine blends from all channels: `f = Σ b_c f_c` and `L = Σ b_c L_c`, as the
/// paper ships. A sample is valid where all channels with a weight are.
///
/// # Errors
/// If the number of values or of weights is another, a weight is negative, or they do not add up to 1.
pub fn fit_blended(
    samples: &ModelSamples,
    local: &SampledLocal,
    values: &[f32],
    blend: &[f64],
) -> Result<TreeFit, TreeError> {
    let channels = local.channels;
    check(samples, local, values)?;
    check_length("weights of the blend", blend.len(), channels)?;
    let sum: f64 = blend.iter().sum();
    if !(blend.iter().all(|b| *b >= 0.0) && (sum - 1.0).abs() <= BLEND_SLACK) {
        return Err(TreeError::Blend { sum });
    }
    Ok(fit(samples, |sample| {
        let (mut blended_local, mut blended) = (0.0, 0.0);
        for (channel, weight) in blend.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            blended_local += weight * local.values[sample * channels + channel];
            blended += weight * known(values[sample * channels + channel])?;
        }
        Some((blended_local.min(1.0), blended.min(1.0)))
    }))
}

/// Fits the global function alone, without local AO (L = 1), for each channel: what the composition is compared with.
///
/// # Errors
/// If the number of channels or of values is another.
pub fn fit_global(samples: &ModelSamples, channels: usize, values: &[f32]) -> Result<Vec<TreeFit>, TreeError> {
    check_channels(channels)?;
    check_length("values of the signal", values.len(), samples.len() * channels)?;
    let of_channel = |channel: usize| fit(samples, |sample| Some((1.0, known(values[sample * channels + channel])?)));
    Ok((0..channels).map(of_channel).collect())
}

fn check(samples: &ModelSamples, local: &SampledLocal, values: &[f32]) -> Result<(), TreeError> {
    check_length("sampled values of local AO", local.values.len(), samples.len() * local.channels)?;
    check_length("values of the signal", values.len(), samples.len() * local.channels)
}
