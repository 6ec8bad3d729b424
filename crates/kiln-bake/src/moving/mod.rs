//! What can be seen in visibility regions (Sloan et al. 2013, section 2.3).
//!
//! Each region has 8 × 8 × 8 candidate points. [`gather_regions`] finds out which of them lie in the region's free space,
//! where the level's author does not say so (`valid`), traces the sphere about each, leaves out those that see too many
//! back faces, and gives AO as a function of the normal: what is seen as quadratic spherical harmonics, convolved with the
//! clamped cosine.

mod gather;
mod valid;

pub use gather::{RegionGather, gather_points, gather_regions};
