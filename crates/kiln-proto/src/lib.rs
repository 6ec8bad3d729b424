//! Kiln's gRPC types, their conversions to domain types, and a typed client.
//!
//! [`v1`] is generated from `proto/kiln/v1` by the build script. A message becomes a domain type by `TryFrom`,
//! which checks every field and names the one at fault ([`FieldError`]); the other way is `From`. [`status`]
//! makes and reads rich errors, [`limits`] holds what a peer may send, and [`client`] is what the command line
//! and the workers call the farm through.

pub mod client;
mod field;
pub mod limits;
mod result;
mod settings;
mod source;
pub mod status;
mod task;

pub use field::{FieldError, digest, required};
pub use result::Submission;

/// The generated types of package `kiln.v1`.
#[expect(clippy::allow_attributes, clippy::large_enum_variant, unused_qualifications, reason = "generated code")]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/kiln.v1.rs"));
}

/// The encoded descriptor set of `kiln.v1`, for server reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/kiln_descriptor.bin"));

/// Revision of the worker protocol that this build speaks.
pub const PROTOCOL: u32 = 4;

/// Oldest revision of the worker protocol that this build understands.
pub const PROTOCOL_MIN: u32 = 4;
