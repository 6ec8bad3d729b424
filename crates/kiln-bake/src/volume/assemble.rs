//! A volume from its batches.

use super::{ArtefactError, Layout, VolumeBatch, VolumeError, fill::fill, gather::check_coefficients};
use kiln_trace::HARMONICS;
use serde::{Deserialize, Serialize};

/// What voxels have their values from, for the report. The counts sum to the number of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct VolumeCounts {
    /// Traced, and valid.
    pub valid: usize,
    /// The weighted mean of neighbours.
    pub filled: usize,
    /// Too far from any valid one: the mean of all that are valid.
    pub averaged: usize,
    /// None is valid: an open sky.
    pub opened: usize,
}

/// What can be seen from every voxel of a layout, as quadratic spherical harmonics for each channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StoredVolume", into = "StoredVolume")]
pub struct Volume {
    layout: Layout,
    channels: usize,
    /// [`HARMONICS`] for each channel of each voxel.
    coefficients: Vec<f32>,
    counts: VolumeCounts,
}

/// A volume as it is stored.
#[derive(Serialize, Deserialize)]
struct StoredVolume {
    layout: Layout,
    channels: u8,
    coefficients: Vec<f32>,
    counts: VolumeCounts,
}

impl Volume {
    /// Puts the batches of a layout together, in whatever order they come, and gives voxels that are not valid the values of
    /// those around them. Each brick must be in one batch; all must have the given number of channels.
    pub fn assemble(layout: Layout, channels: usize, batches: &[VolumeBatch]) -> Result<Self, VolumeError> {
        let (stride, voxels) = (channels * HARMONICS, layout.voxel_count());
        let mut is_valid = vec![false; voxels];
        let mut coefficients = vec![0.0; voxels * stride];
        let mut has_brick = vec![false; layout.bricks().len()];
        for batch in batches {
            check_settings(batch, &layout, channels)?;
            let mut first = 0;
            for brick in batch.bricks() {
                let stray = VolumeError::StrayBrick { coordinates: brick.coordinates };
                let index =
                    layout.brick_at(brick.coordinates).filter(|i| layout.bricks()[*i] == *brick && !has_brick[*i]);
                let index = index.ok_or(stray)?;
                let (from, to) = (first..first + brick.voxel_count(), layout.slots(index));
                first = from.end;
                let scaled = |run: &std::ops::Range<usize>| run.start * stride..run.end * stride;
                coefficients[scaled(&to)].copy_from_slice(&batch.coefficients()[scaled(&from)]);
                is_valid[to].copy_from_slice(&batch.validity()[from]);
                has_brick[index] = true;
            }
        }
        if let Some(missing) = has_brick.iter().position(|has| !has) {
            return Err(VolumeError::MissingBrick { coordinates: layout.bricks()[missing].coordinates });
        }
        let counts = fill(&layout, stride, &is_valid, &mut coefficients);
        Ok(Self { layout, channels, coefficients, counts })
    }

    /// Where its voxels are.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Channels of each voxel.
    pub fn channel_count(&self) -> usize {
        self.channels
    }

    /// What voxels have their values from.
    pub fn counts(&self) -> VolumeCounts {
        self.counts
    }

    /// The coefficients of a voxel, [`HARMONICS`] for each channel.
    pub(crate) fn voxel(&self, coordinates: [i32; 3]) -> Option<&[f32]> {
        let (slot, stride) = (self.layout.slot(coordinates)?, self.channels * HARMONICS);
        Some(&self.coefficients[slot * stride..][..stride])
    }
}

fn check_settings(batch: &VolumeBatch, layout: &Layout, channels: usize) -> Result<(), VolumeError> {
    if batch.channel_count() == channels && batch.spacing_m().to_bits() == layout.spacing_m().to_bits() {
        return Ok(());
    }
    Err(VolumeError::OtherSettings {
        channels: batch.channel_count(),
        spacing_m: batch.spacing_m(),
        expected_channels: channels,
        expected_spacing_m: layout.spacing_m(),
    })
}

impl TryFrom<StoredVolume> for Volume {
    type Error = ArtefactError;

    fn try_from(stored: StoredVolume) -> Result<Self, ArtefactError> {
        let error = |reason| ArtefactError { what: "volume", reason };
        let StoredVolume { layout, channels, coefficients, counts } = stored;
        let channels = usize::from(channels);
        let voxels = layout.voxel_count();
        check_coefficients(&coefficients, channels, voxels).map_err(error)?;
        let parts = [counts.valid, counts.filled, counts.averaged, counts.opened];
        if parts.iter().try_fold(0usize, |sum, part| sum.checked_add(*part)) != Some(voxels) {
            return Err(error("its counts are of other voxels"));
        }
        Ok(Self { layout, channels, coefficients, counts })
    }
}

impl From<Volume> for StoredVolume {
    fn from(volume: Volume) -> Self {
        let Volume { layout, channels, coefficients, counts } = volume;
        Self { layout, channels: channels as u8, coefficients, counts }
    }
}
