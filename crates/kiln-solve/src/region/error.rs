//! Regions, samples and settings that do not fit together.

use kiln_core::{MAX_CHANNELS, ResultError};

/// What is wrong with the input of models of regions.
#[derive(Debug, thiserror::Error)]
pub enum RegionError {
    /// The samples are not those of the regions.
    #[error("the samples are not those of these regions: {0}; sample these regions again")]
    Samples(#[from] ResultError),
    /// The number of channels is out of range.
    #[error("a model has 1 to {MAX_CHANNELS} channels, not {channels}; bake fewer half-distances")]
    Channels {
        /// The number given.
        channels: usize,
    },
    /// A region's box is not finite, or its least corner is beyond its greatest.
    #[error("the box of region {region} is not finite or its corners are swapped; correct it in the level")]
    Box {
        /// The index of the region.
        region: usize,
    },
    /// An edge names a region that is not there, or one region twice, or its area or centre is not usable.
    #[error("edge {edge} between regions has {what}; correct it in the level")]
    Edge {
        /// The index of the edge.
        edge: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// An array has another length than it must have.
    #[error("there are {found} {what}, not {expected}; make them for these regions and channels")]
    Length {
        /// The array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that goes with the rest.
        expected: usize,
    },
    /// A value at a point is not finite.
    #[error("value {index} at a region's points is not finite; sample the region again")]
    Value {
        /// Its index.
        index: usize,
    },
    /// A setting is out of range.
    #[error("{what} is {value}, but must be finite and at least 0; correct the setting")]
    Setting {
        /// The setting.
        what: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Whether a number of channels is in range.
pub(crate) fn check_channels(channels: usize) -> Result<(), RegionError> {
    if (1..=MAX_CHANNELS).contains(&channels) { Ok(()) } else { Err(RegionError::Channels { channels }) }
}

/// Whether an array has the length that it must have.
pub(crate) fn check_length(what: &'static str, found: usize, expected: usize) -> Result<(), RegionError> {
    if found == expected { Ok(()) } else { Err(RegionError::Length { what, found, expected }) }
}

/// Whether a setting is finite and not negative.
pub(crate) fn check_setting(what: &'static str, value: f64) -> Result<(), RegionError> {
    if value.is_finite() && value >= 0.0 { Ok(()) } else { Err(RegionError::Setting { what, value }) }
}
