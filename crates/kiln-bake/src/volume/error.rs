//! What can be wrong with a volume.

use glam::DVec3;
use kiln_trace::TraceError;

/// A volume could not be laid out, traced or put together.
#[derive(Debug, thiserror::Error)]
pub enum VolumeError {
    /// The lattice's spacing is no length.
    #[error("voxels cannot be {spacing_m} m apart; give a number of metres above 0, such as 1")]
    Spacing {
        /// What was given.
        spacing_m: f64,
    },
    /// A box of a tree lies where rays are too coarse for its voxels.
    #[error(
        "a tree's box from {min_m} to {max_m} m has voxels beyond {limit_m} m from the level's origin, where rays are too \
         coarse for voxels {spacing_m} m apart; move the tree, or give a larger spacing"
    )]
    OutOfRange {
        /// Least corner of the box.
        min_m: DVec3,
        /// Its greatest corner.
        max_m: DVec3,
        /// What was given.
        spacing_m: f64,
        /// How far voxels may be, along each axis.
        limit_m: f64,
    },
    /// The boxes need more bricks than are permitted.
    #[error(
        "trees need a volume of {needed} bricks or more, {limit} are permitted; give voxels a larger spacing than \
         {spacing_m} m, or class what is no tree as something else"
    )]
    TooManyBricks {
        /// Bricks counted until then.
        needed: u64,
        /// The limit.
        limit: usize,
        /// What was given.
        spacing_m: f64,
    },
    /// The rays of a voxel cannot be gathered.
    #[error("{rays} rays for each voxel are no power of two from 1 to {limit}; 1024 is usual")]
    Rays {
        /// What was given.
        rays: u32,
        /// The most.
        limit: u32,
    },
    /// A batch names bricks that there are not.
    #[error("a batch of bricks {start} to {end} was asked for, the volume has {count}; lay it out anew")]
    NoSuchBricks {
        /// First brick.
        start: usize,
        /// One after the last.
        end: usize,
        /// Bricks of the layout.
        count: usize,
    },
    /// No batch has a brick of the layout.
    #[error("no batch holds brick {coordinates:?} of the volume; trace its batch again")]
    MissingBrick {
        /// Which brick.
        coordinates: [i32; 3],
    },
    /// A batch has a brick that the layout does not have so, or that another batch has too.
    #[error(
        "a batch holds brick {coordinates:?}, which is not in the volume, has other voxels there, or comes twice; trace the batches of one layout"
    )]
    StrayBrick {
        /// Which brick.
        coordinates: [i32; 3],
    },
    /// A batch is of another lattice or kernel.
    #[error(
        "a batch has {channels} channels {spacing_m} m apart, the volume has {expected_channels} at {expected_spacing_m} m; trace it with the volume's settings"
    )]
    OtherSettings {
        /// The batch's channels.
        channels: usize,
        /// The batch's spacing.
        spacing_m: f64,
        /// The volume's channels.
        expected_channels: usize,
        /// The volume's spacing.
        expected_spacing_m: f64,
    },
    /// The backend could not trace.
    #[error(transparent)]
    Trace(#[from] TraceError),
}

/// An artefact that was read is not what its kind demands.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("this is no {what}: {reason}; the artefact is damaged or of another version")]
pub struct ArtefactError {
    /// The kind of artefact.
    pub what: &'static str,
    /// What is wrong.
    pub reason: &'static str,
}
