//! The volume of visibility around trees (Sloan et al. 2013, section 2.2).
//!
//! Trees have poor normals, surfaces that pass through each other, and faces that are drawn from behind: what they see is not
//! sampled on them but around them. [`Layout`] says which voxels of a lattice any point of the trees' boxes needs;
//! [`gather_batch`] traces those of a run of bricks, over the whole sphere, into quadratic spherical harmonics for each
//! channel; [`Volume::assemble`] puts batches together and fills voxels that lie inside of something; [`Volume::ao_at`]
//! is then the AO of a point and a normal. Only the bake uses it.
//!
//! The lattice is fixed in the level, a voxel's directions are keyed by where it is, and an artefact says which bricks it
//! holds: an edit elsewhere changes none of them.

mod assemble;
mod error;
mod fill;
mod gather;
mod lattice;
mod layout;
#[cfg(test)]
mod layout_tests;
mod reconstruct;

pub use assemble::{Volume, VolumeCounts};
pub use error::{ArtefactError, VolumeError};
pub use gather::{GatherSettings, VolumeBatch, gather_batch};
pub use lattice::{LATTICE_OFFSET, MAX_COORDINATE};
pub use layout::{BRICK_SIZE, BRICK_VOXELS, Brick, Layout, LayoutSettings};
pub(crate) use reconstruct::COSINE_BANDS;
pub use reconstruct::cosine_ao;
