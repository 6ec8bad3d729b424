//! Stress of the whole way from a file to a file: import, plan, trace, solve and export, by the worker's own executor
//! over artefacts in memory. Every case is compared with the answer for clean geometry, or with a closed form.
//!
//! docs/stress.md says what the suite contains, and what "the same" means in each part. The solver alone is stressed
//! in `kiln-bench` (`kiln bench solve --stress`).

mod bake;
mod command;
mod compare;
mod defects;
mod extremes;
mod geometry;
mod instances;
mod invariances;
mod level;
mod scales;
