//! Surface samples and per-face moments: pure functions over a [`kiln_trace::Tracer`].
//!
//! [`trace_piece`] is the whole of a trace task: it makes the samples of a run of faces (`samples`), leaves out
//! those that need no ray, gathers the rest and sums what comes back into moments. [`density`] and [`sample_count`]
//! say how many samples a face gets, for the plan. [`probe`] gathers at given points.

mod density;
mod noise;
mod piece;
mod probe;
mod rounds;
mod samples;
mod scramble;
mod seen;

pub use density::{FaceAreas, density, sample_count};
pub use piece::{Piece, trace_piece};
pub use probe::{ProbePoint, ProbeResult, probe};
pub use seen::seen_bounds;
