//! Ray tracing for Kiln: the [`Tracer`] contract, ray generation, BVHs and the CPU tracer.
//!
//! A [`Scene`] holds instances in two levels: one four-wide BVH per distinct mesh ([`MeshBvh`]) and one over the
//! instances. Its arrays are plain data that every backend reads as they are. The main operation of a tracer is
//! [`Tracer::gather_cosine`]: rays are made and consumed where they are traced, and only integer sums come back,
//! so that the result does not depend on the order of rays, samples or threads.

mod bvh;
mod cpu;
mod directions;
mod kernel;
mod mesh_bvh;
mod open_sky;
mod scene;
mod sobol;
mod tracer;
mod traverse;
mod triangle;

pub use bvh::{BvhChild, BvhLink, BvhNode, LEAF_BIT, MAX_STACK, NO_CHILD};
pub use cpu::CpuTracer;
pub use directions::{cosine_direction, orthonormal_basis};
pub use kernel::{KernelRates, MAX_RAYS_PER_SAMPLE, ONE, REACH_EPSILON};
pub use mesh_bvh::MeshBvh;
pub use open_sky::{is_open_above, open_sums};
pub use scene::{PositionError, Scene, SceneInstance, SceneObject};
pub use sobol::{SobolScramble, owen_scramble, sobol_digits, sobol_point};
pub use tracer::{CosineSums, Hit, Ray, SurfaceSample, TraceError, Tracer};
pub use triangle::{NO_PRIMITIVE, TWO_SIDED_BIT, TriangleBlock};
