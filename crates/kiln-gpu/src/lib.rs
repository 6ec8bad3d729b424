//! The wgpu compute tracer: the contract of [`kiln_trace::Tracer`] on a GPU, over the same data as the CPU's.
//!
//! [`GpuDevice::open`] opens an adapter, [`GpuTracer::new`] sends a [`kiln_trace::Scene`] to it. Each kernel is one
//! `.wgsl` beside one `.rs` that explains it; kernels are joined from modules:
//!
//! | module | what it does |
//! |---|---|
//! | `sampling` | directions, and the cones of 32 that they are dealt to |
//! | `kernel` | the value of a hit |
//! | `traverse` | the scene's layout, traversal, triangles |
//! | `gather`, `trace` | the two operations of a tracer |
//! | `probe` | parts of them, for tests |
//!
//! Results are the same bit for bit on one adapter with one driver (a lane), whatever the threads and dispatches, and
//! near the CPU's: sums are integers, and the arithmetic before them is the CPU's to some ULP.

mod adapter;
mod budget;
mod device;
mod error;
mod gather;
mod kernel;
mod probe;
mod sampling;
mod shader;
mod trace;
mod tracer;
mod traverse;

pub use adapter::{ADAPTER_VARIABLE, AdapterChoice, AdapterKind, AdapterSummary, adapters};
pub use device::GpuDevice;
pub use error::GpuError;
pub use probe::ProbedRay;
pub use tracer::GpuTracer;
