//! `kiln bench`: measurements.

use crate::{
    args::{BenchArgs, Common},
    failure::Failure,
};
use kiln_bench::BenchError;

pub(crate) fn run(args: &BenchArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    args.bench.run().map_err(|error| match error {
        BenchError::Import { .. } | BenchError::File { .. } => Failure::refused(error.to_string()),
        BenchError::Usage(_) => Failure::new(crate::failure::USAGE, error.to_string()),
        BenchError::Failed { .. } => Failure::new(crate::failure::FAILED, error.to_string()),
    })
}
