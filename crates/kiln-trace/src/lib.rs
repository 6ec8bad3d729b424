//! Ray tracing for Kiln: the [`Tracer`] contract, ray generation, BVHs and the CPU tracer.
//!
//! A [`Scene`] holds instances in two levels: one eight-wide BVH per distinct mesh ([`MeshBvh`]) and one over the
//! instances. The main operation of a tracer is
//! [`Tracer::gather_cosine`]: rays are made and consumed where they are traced, and only integer sums come back,
//! so that the result does not depend on the order of rays, samples or threads. [`Tracer::gather_sphere`] does the same
//! for points in the air, whose sums are projections on spherical harmonics.

mod alone;
#[cfg(target_arch = "x86_64")]
mod avx2;
mod binned;
mod boxed;
mod build;
mod bundle;
mod collapse;
mod cpu;
mod cutout;
mod directions;
mod foliage;
mod harmonics;
mod kernel;
mod lanes;
mod levels;
mod mesh_bvh;
mod node;
mod open_sky;
mod pages;
mod path;
mod ray;
mod rays;
mod scene;
mod sobol;
mod sphere;
mod sphere_gather;
mod stored;
mod stream;
mod tracer;
mod triangle;

pub use cpu::CpuTracer;
pub use cutout::CutoutMesh;
pub use directions::{cosine_direction, orthonormal_basis, sphere_direction};
pub use foliage::{CrossingMesh, FogBox, Foliage, FoliageObject, FoliageView, ShrubGroup, ShrubRecord, fog_bounds};
pub use harmonics::{HARMONICS, quadratic_harmonics};
pub use kernel::{KernelRates, MAX_RAYS_PER_SAMPLE, ONE, REACH_EPSILON};
pub use mesh_bvh::MeshBvh;
pub use node::{BvhChild, BvhLink};
pub use open_sky::{is_open_above, open_sums};
pub use path::Path;
pub use scene::{Place, PositionError, Scene, SceneInstance, SceneObject};
pub use sobol::{SobolScramble, owen_scramble, sobol_digits, sobol_point};
pub use sphere::{
    RayValue, SpherePoint, SphereSums, gather_sphere_by_rays, gather_sphere_by_values, sphere_directions,
};
pub use stored::{BVH_REV, StoredBvhError};
pub use tracer::{CosineSums, Hit, Ray, SurfaceSample, TraceError, Tracer};
pub use triangle::{FLIPPED_BIT, TWO_SIDED_BIT};
