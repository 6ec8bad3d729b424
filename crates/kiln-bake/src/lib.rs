//! Surface samples and per-face moments: pure functions over a [`kiln_trace::Tracer`].
//!
//! [`trace_piece`] is the whole of a trace task: it makes the samples of a run of faces (`samples`), leaves out
//! those that need no ray, gathers the rest and sums what comes back into moments. [`density`] and [`sample_count`]
//! say how many samples a face gets, for the plan. [`probe`] gathers at given points.
//! [`read_decorators`] and [`resample_lod`] read a finished bake again (`resample`). [`volume`] is what is visible from
//! points around trees, on a sparse lattice. [`regions`] makes boxes of free space, and [`gather_regions`] is what is visible
//! in them.

mod density;
mod foliage;
mod model;
mod moving;
mod noise;
mod piece;
mod probe;
pub mod regions;
mod resample;
mod rounds;
mod samples;
mod scramble;
mod seen;
pub mod volume;

pub use density::{FaceAreas, density, sample_count};
pub use foliage::{ModelDensity, ModelFog, OrientedBox, model_fog, place_fog, thinned};
pub use model::{ModelPoint, model_points, values_in_volume, values_traced};
pub use moving::{RegionGather, gather_points, gather_regions};
pub use piece::{Piece, trace_piece};
pub use probe::{ProbePoint, ProbeResult, probe};
pub use resample::{
    BakedError, BakedInstance, BakedPoint, BakedSurface, Decorator, DecoratorScalar, DecoratorSettings, VertexReadings,
    lod_sampling, read_at_vertices, read_decorators, resample_lod,
};
pub use seen::seen_bounds;
