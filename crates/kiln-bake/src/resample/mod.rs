//! Reading a finished bake again: for small decorators, and for levels of detail (LODs).
//!
//! # How it works
//! Rays from the boundary of a small sphere towards its centre meet the surfaces near the centre; the values that were
//! baked there are averaged, weighted by the distance to the boundary (Sloan et al. 2013, section 2.2.1). Nothing is
//! gathered: a ray reads one value.
//!
//! - `baked`: values at the vertices of instances, read where a ray hits ([`BakedSurface`]).
//! - `sphere`: the rays of spheres and the weighted means of what they read.
//! - `decorator`: one scalar for each decorator ([`read_decorators`]).
//! - `lod`: moments of the faces of a LOD ([`resample_lod`]), of which the ordinary solve makes vertex values.
//! - `vertices`: what least squares is compared with, the same reading at the vertices alone ([`read_at_vertices`]).
//! - `near`: spheres around points of a LOD, for both.
//! - `distance`: how far a point of a LOD is from the surface that it stands for, and so how large its sphere is.

mod baked;
mod decorator;
mod distance;
mod lod;
mod near;
mod sphere;
mod vertices;

pub use baked::{BakedError, BakedInstance, BakedPoint, BakedSurface};
pub use decorator::{Decorator, DecoratorScalar, DecoratorSettings, read_decorators};
pub use lod::{lod_sampling, resample_lod};
pub use vertices::{VertexReadings, read_at_vertices};
