//! What `kiln bench` measures: one module for each measurement.

pub mod accuracy;
mod clock;
mod error;
mod provenance;
pub mod solve;

pub use error::BenchError;
pub use provenance::Provenance;

use clap::Subcommand;

/// A measurement.
#[derive(Subcommand, Debug)]
pub enum Bench {
    /// Error against time and rays of several ways to bake, on given scenes
    Accuracy(Box<accuracy::Args>),
    /// The linear solver beside CHOLMOD and Eigen, and its stress suite
    Solve(solve::Args),
}

impl Bench {
    /// Runs the measurement and prints its table.
    pub fn run(&self) -> Result<(), BenchError> {
        match self {
            Self::Accuracy(args) => accuracy::run(args),
            Self::Solve(args) => solve::run(args),
        }
    }
}
