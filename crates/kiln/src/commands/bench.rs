//! `kiln bench`: measurements.

use crate::{
    args::{BackendChoice, BenchArgs, Common},
    failure::Failure,
};
use kiln_bench::BenchError;

pub(crate) fn run(args: &BenchArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    // Measurements are of the CPU unless a graphics card is asked for: `auto` would make them differ by machine.
    let backend = match common.backend {
        BackendChoice::Gpu => super::choose_backend(common)?,
        BackendChoice::Auto | BackendChoice::Cpu => super::on_processor(common)?,
        BackendChoice::Mixed => {
            let message = "one backend is measured at a time; use --backend cpu or --backend gpu";
            return Err(Failure::new(crate::failure::USAGE, message));
        }
    };
    args.bench.run(&backend).map_err(|error| match error {
        BenchError::Import { .. } | BenchError::File { .. } => Failure::refused(error.to_string()),
        BenchError::Usage(_) => Failure::new(crate::failure::USAGE, error.to_string()),
        BenchError::Failed { .. } => Failure::new(crate::failure::FAILED, error.to_string()),
    })
}
