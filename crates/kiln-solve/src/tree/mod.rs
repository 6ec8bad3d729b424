//! Trees and other instanced models: local AO, known once for a model, times a linear global function of each instance.
//!
//! # How it works
//! The value at a point of instance j is `G_y(s) · L(s)`: L is the local AO, the model's AO when it stands alone, and
//! `G_y(s) = y0 + y1 u_x + y2 u_y + y3 u_z` has four numbers for each instance and channel, with u the position in the
//! model's own box, scaled to [−1, 1]³ ([`unit_position`]). (Sloan, Tranchida, Chen, Kavan, "Ambient Obscurance Baking on
//! the GPU", 2013, section 2.2, equation 3.)
//!
//! - [`samples`] has the points of the model that all its instances share, [`fit`] the least squares of four unknowns,
//!   [`instance`] its forms: by channel, of the blended signal, without local AO.
//! - [`mod@alternate`] is that paper's future work: L of the model given all y, y given L, and so on. `local_step` solves
//!   for L with the welding, the regulariser and the solvers of whole instances (`unknowns`); `gauge` settles the scale.
//! - [`table`] compares the three with the given signal.
//!
//! Bounds: values of f and L are in [0, 1]; of every fit `|y0| + |y1| + |y2| + |y3| ≤ `[`GLOBAL_BOUND`], so that G, and
//! G·L too, stay within ±`GLOBAL_BOUND` in all of the model's box: at samples, at vertices, anywhere.

pub mod alternate;
mod channel;
mod eigen;
mod error;
pub mod fit;
mod gauge;
pub mod instance;
mod local_step;
pub mod samples;
pub mod table;
mod unknowns;

pub use alternate::{AlternateParams, Alternated, HalfStep, TreeInstance, TreeModel, alternate};
pub use error::TreeError;
pub use fit::{GLOBAL_BOUND, TreeFit};
pub use instance::{fit_blended, fit_global, fit_instance};
pub use samples::{ModelSample, ModelSamples, SampledLocal, unit_position};
pub use table::{ErrorTables, error_table, error_tables};
