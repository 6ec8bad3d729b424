//! Input of the tree fits that does not fit together.

use crate::instance::SolveError;
use kiln_core::MAX_CHANNELS;

/// What is wrong with the input of a fit of trees.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TreeError {
    /// The model's mesh or a setting is not usable.
    #[error(transparent)]
    Mesh(#[from] SolveError),
    /// A sample is not one of this mesh.
    #[error("sample {sample} of the model has {what}; sample this mesh again")]
    Sample {
        /// The sample.
        sample: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// An array has another length than it must have.
    #[error("there are {found} {what}, not {expected}; make them for this model's samples and channels")]
    Length {
        /// The array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that goes with the rest.
        expected: usize,
    },
    /// The number of channels is out of range.
    #[error("a model has 1 to {MAX_CHANNELS} channels, not {channels}; bake fewer half-distances")]
    Channels {
        /// The number given.
        channels: usize,
    },
    /// A value of local AO is not finite.
    #[error("value {index} of the local AO is not finite; solve the model again")]
    Local {
        /// Its index, vertex by vertex.
        index: usize,
    },
    /// The weights of a blend are not usable.
    #[error("the blend's weights must be at least 0 and add up to 1, but they add up to {sum}; correct the blend")]
    Blend {
        /// Their sum.
        sum: f64,
    },
}

/// Whether a number of channels is in range.
pub(crate) fn check_channels(channels: usize) -> Result<(), TreeError> {
    if (1..=MAX_CHANNELS).contains(&channels) { Ok(()) } else { Err(TreeError::Channels { channels }) }
}

/// Whether an array has the length that it must have.
pub(crate) fn check_length(what: &'static str, found: usize, expected: usize) -> Result<(), TreeError> {
    if found == expected { Ok(()) } else { Err(TreeError::Length { what, found, expected }) }
}
