//! Least squares on meshes: vertex values from the per-face moments of a sampled signal.
//!
//! # How it works
//! [`solve`] minimises `E(x) = ∫ (f − g_x)² dA + α ∫ R_edge² dA`: x are values at vertices, g_x their linear
//! interpolation, f the sampled signal (Kavan, Bargteil, Sloan 2011, Comput. Graph. Forum 30(4)). In order:
//!
//! 1. [`frame`] moves the mesh to lengths near 1 about its own centre; α has no unit, so nothing is lost.
//! 2. [`weld`] makes vertices at one position with similar normals one unknown.
//! 3. [`surface`] keeps the faces that receive and have area, by unknowns.
//! 4. [`edges`] finds the interior edges and their regulariser rows.
//! 5. [`assemble`] makes `A = M + α R + μ W` and the residual of the local averages x0: what is solved for is
//!    the correction `δ = x − x0`, so that what the averages get right (a constant) has no rounding to suffer.
//! 6. [`components`] splits the unknowns, [`parallel`] hands them out; [`chain`] solves each by dense Cholesky or
//!    conjugate gradients, else by sparse Cholesky, and [`certificate`] checks every answer before it is used.
//! 7. [`fill`] gives values to what no sample reaches, [`estimate`] the error from the two halves, and [`residual`] says
//!    where no linear function can hold the signal.
//!
//! [`tree`] fits instances of one model to the model's local AO times a linear function of each instance; [`region`]
//! models what moving objects see in visibility regions.
//!
//! All of it is f64 but for the recurrence of conjugate gradients, whose f32 is refined in f64 ([`pcg`]), with a
//! fixed order of every sum: the result depends neither on the number of threads nor on
//! the order in which components are solved. The instruction set matters only inside faer; [`lane`] names it.

pub mod assemble;
pub mod certificate;
pub mod chain;
mod columns;
pub mod components;
pub mod dense;
pub mod edges;
pub mod estimate;
pub mod fill;
pub mod frame;
mod hole;
mod instance;
mod iterate;
mod lane;
pub mod level;
pub mod matrix;
pub mod nearest;
pub mod parallel;
pub mod pcg;
pub mod region;
pub mod residual;
pub mod samples;
mod scaled;
mod schwarz;
pub mod sparse;
pub mod surface;
pub mod system;
pub mod tree;
pub mod weld;

pub use chain::{SolverParams, solve_component};
pub use instance::{SolveError, SolveInput, solve, solve_with};
pub use lane::lane;
pub use level::{LevelInstance, fill_unsampled};
pub use region::{RegionError, model_regions};
pub use system::{ComponentAnswer, ComponentSystem};
pub use tree::{
    AlternateParams, Alternated, ErrorTables, GLOBAL_BOUND, HalfStep, ModelSample, ModelSamples, SampledLocal,
    TreeError, TreeFit, TreeInstance, TreeModel, alternate, error_table, error_tables, fit_blended, fit_global,
    fit_instance, unit_position,
};
