//! What an engine links: the pack that a bake leaves (`.kiln`, docs/pack-format.md), and the evaluation of what is in it.
//!
//! [`Pack::new`] checks the bytes of a pack once, which may be a memory-mapped file; after that nothing can fail, and
//! nothing on the query path allocates. Without features the crate needs neither the standard library nor an allocator.
//!
//! | for | see |
//! |---|---|
//! | moving objects | [`MovingObject`], or [`Pack::region_at`], [`Pack::engine_at`], [`Pack::full_at`] and [`TemporalBlend`] |
//! | static geometry | [`Pack::vertex_set`] |
//! | trees and instanced objects | [`Pack::tree_instance`], [`TreeModel::place`], [`tree_ao`] |
//! | shrubs and grass | [`Pack::scalar`] |
//! | what is stored in five bits | [`quantise`], [`dither`] |
//! | shaders | [`shaders`] |
//!
//! Values of AO are from 0 to 1; 1 is open. Lengths are metres. Points are relative to the level's origin
//! ([`Meta::origin`], [`Meta::local`]).
#![no_std]

#[cfg(any(feature = "write", test))]
extern crate alloc;
#[cfg(any(feature = "c-api", feature = "cost", test))]
extern crate std;

mod bytes;
#[cfg(feature = "c-api")]
pub mod c_api;
#[cfg(feature = "cost")]
pub mod cost;
mod error;
pub mod format;
pub mod half;
mod harmonics;
mod lookup;
mod model;
mod moving;
mod pack;
mod quantise;
mod remap;
pub mod shaders;
mod temporal;
#[cfg(feature = "write")]
pub mod write;

pub use error::PackError;
pub use format::SectionKind;
pub use harmonics::{ao_linear, ao_quadratic, linear_harmonics, quadratic_harmonics};
pub use lookup::RegionHit;
pub use model::{EngineModel, FullModel, LinearModel};
pub use moving::MovingObject;
pub use pack::{
    Kernel, Meta, Pack, Region, RegionEdge, Scalar, SectionSize, TreeBlock, TreeInstance, TreeModel, Values, VertexSet,
    blend_channels, tree_ao,
};
pub use quantise::{DITHER_LEVELS, dequantise, dither, quantise, quantise_nearest};
pub use remap::{Curve, Remap, remap_curve, remap_gamma};
pub use temporal::{HALF_TIME_SECS, TemporalBlend};
