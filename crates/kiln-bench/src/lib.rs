//! What `kiln bench` measures: one module for each measurement.

pub mod accuracy;
pub mod bake;
mod baked;
mod clock;
mod error;
pub mod foliage;
mod imported;
pub mod lods;
mod memory;
mod provenance;
pub mod rays;
pub mod regions;
mod scratch;
pub mod solve;
mod spread;
pub mod trees;

pub use error::BenchError;
pub use provenance::Provenance;

use clap::Subcommand;
use kiln_worker::tasks::Backend;

/// A measurement.
#[derive(Subcommand, Debug)]
pub enum Bench {
    /// Error against time and rays of several ways to bake, on given scenes
    Accuracy(Box<accuracy::Args>),
    /// Whole bakes: where their time goes, threads, a farm, error, cost against size
    Bake(Box<bake::Args>),
    /// Terrain under trees and shrubs by each way to treat them, against their real geometry, and what each costs
    Foliage(foliage::Args),
    /// Levels of detail by least squares beside reading the full detail at their vertices
    Lods(lods::Args),
    /// Rays per second, time and memory of building BVHs, beside another tracer and ray by ray
    Rays(rays::Args),
    /// Models of visibility regions against direct trace, jumps between them, and what a query costs
    Regions(regions::Args),
    /// The linear solver beside CHOLMOD and Eigen, and its stress suite
    Solve(solve::Args),
    /// Trees by four numbers and their model's own AO, in several surroundings, against direct trace
    Trees(trees::Args),
}

impl Bench {
    /// Runs the measurement and prints its table. `backend` is where `bake` and `rays` trace; the others use the CPU.
    pub fn run(&self, backend: &Backend) -> Result<(), BenchError> {
        match self {
            Self::Accuracy(args) => accuracy::run(args),
            Self::Bake(args) => bake::run(args, backend),
            Self::Rays(args) => rays::run(args, backend),
            Self::Foliage(args) => foliage::run(args),
            Self::Lods(args) => lods::run(args),
            Self::Regions(args) => regions::run(args),
            Self::Solve(args) => solve::run(args),
            Self::Trees(args) => trees::run(args),
        }
    }
}
