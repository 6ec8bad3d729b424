//! Models of what moving objects see in visibility regions.
//!
//! # How it works
//! AO at a point p is, for each spherical harmonic of each channel, `v + Σ over the axes (p − c)_i · v_{2i + s_i}`, s_i
//! = 0 where (p − c)_i ≥ 0, else 1: a value at a centre c and six slopes (Sloan, Tranchida, Chen, Kavan, "Ambient
//! Obscurance Baking on the GPU", 2013, section 2.3, equation 4). Given c it is linear, and the design is the same for
//! all harmonics of all channels. In order:
//!
//! 1. [`points`] keeps of a region's points what fits need. They lie on a grid and a column of the design depends on
//!    one coordinate, so that sums over the grid's slabs, and counts over pairs of them, give the normal equations for
//!    any c (`moments`).
//! 2. [`fit`] solves them by rule: about the mean of the points, about the middle of the box, the better of both, or a
//!    centre that is searched (`search`, the future work of the paper). `ridge` makes the inverse, `design` says which
//!    slopes are free, `bound` keeps models from overshooting.
//! 3. [`mod@absorb`] gives small regions to a neighbour, with their points and their boundaries (`boundaries`).
//! 4. [`mod@smooth`] draws models of neighbours together on their boundaries, by block coordinate descent.
//! 5. [`table`] says how well each rule does.
//!
//! [`model_regions`] does all of it. Positions are relative to a region's box, scaled to [−1, 1]³; the result
//! depends neither on the number of threads nor on the order of the edges.

pub mod absorb;
mod bound;
mod boundaries;
mod cholesky;
mod design;
mod error;
pub mod fit;
mod grid;
mod harmonics;
mod level;
mod moments;
pub mod points;
mod ridge;
mod search;
pub mod smooth;
pub mod table;

pub use absorb::{Absorbed, absorb};
pub use error::RegionError;
pub use fit::{CenterRule, RegionFit, fit_region};
pub use harmonics::OPEN_SKY;
pub use level::{Traced, model_points, model_regions, region_points};
pub use points::RegionPoints;
pub use smooth::{SmoothNorm, SmoothParams, Smoothed, Smoother, smooth};
pub use table::{jumps, region_errors};
