//! The wgpu compute tracer: the contract of [`kiln_trace::Tracer`] on a GPU, over the same data as the CPU's.
//!
//! [`GpuDevice::open`] opens an adapter, [`GpuTracer::new`] sends a [`kiln_trace::Scene`] to it. Each kernel is one
//! `.wgsl` beside one `.rs` that explains it; kernels are joined from modules:
//!
//! | module | what it does |
//! |---|---|
//! | `sampling` | directions, and the cones of 32 that they are dealt to |
//! | `kernel` | the value of a hit |
//! | `scene`, `triangle` | a ray's way into an instance, and triangles |
//! | `node`, `stack`, `traverse` | boxes, and the way of a ray through both levels |
//! | `ray_query` | the same way by a card's ray queries |
//! | `value`, `no_foliage`, `foliage`, `attenuate`, `expected` | the value of a ray, and what it goes through before its hit |
//! | `gather`, `values`, `trace`, `any_hit` | the operations of a tracer |
//! | `visits` | what rays cost, for [`model`] |
//! | `probe` | parts of them, for tests |
//!
//! Results are the same bit for bit on one adapter with one driver (a lane), whatever the threads and dispatches, and
//! near the CPU's: sums are integers, and the arithmetic before them is the CPU's to some ULP.

mod acceleration;
mod adapter;
mod any_hit;
mod boxes;
mod budget;
mod device;
mod error;
mod experimental;
mod flight;
mod foliage;
mod gather;
mod kernel;
mod layout;
pub mod model;
mod node;
mod options;
mod probe;
mod ray_query;
mod rays;
mod sampling;
mod shader;
mod trace;
mod tracer;
mod traverse;
mod triangle;
mod upload;
mod values;
mod visits;
mod widen;

pub use adapter::{ADAPTER_VARIABLE, AdapterChoice, AdapterKind, AdapterSummary, adapters};
pub use device::GpuDevice;
pub use error::GpuError;
pub use options::DeviceOptions;
pub use probe::ProbedRay;
pub use tracer::GpuTracer;
pub use visits::Visits;
