//! Import of glTF levels and sidecars, cleaning, classes, and export of baked glTF.
//!
//! [`import`] reads a level and its sidecar into a [`kiln_core::Level`] and its meshes; [`export`] writes the source
//! again with the baked values added; [`read_baked`] reads what was written. All three are pure functions of bytes
//! that [`SourceFiles`] hands out: nothing but [`LevelFiles`], which hands out what it read, touches a disk.
//!
//! The document is read straight from its JSON ([`serde_json::Value`]), not through types: every error can then
//! name its place, what Kiln doesn't know is never in the way, and export changes nothing but what it must. The
//! path of the data is [`import`] → `scene` (the node hierarchy) → `gather` (classes, variants, limits) → `mesh`
//! (accessors to triangles) → `clean` → `resolve` (settings), each a module that can be read alone.
//!
//! Limits that are known: skins and morph targets are baked in their node's place and base shape; Draco and meshopt
//! compression are refused by name; the alpha of COLOR_0 has no say in alpha masks; where a mesh is copied for several instances,
//! animation pointers into it go on to move the first only.

mod accessor;
mod baked;
mod classes;
mod clean;
mod composed;
mod cutout;
mod disk;
mod document;
mod error;
pub mod example;
mod export;
mod extensions;
mod files;
mod findings;
#[cfg(test)]
mod fixture;
mod gather;
pub mod glb;
mod import;
mod instancing;
mod json;
mod limits;
mod lods;
mod material;
mod mesh;
mod resolve;
mod scene;
mod sidecar;

pub use baked::{BakedLod, BakedPart, BakedScene, read_baked};
pub use disk::{LevelFiles, ReadError};
pub use document::external_files;
pub use error::{ErrorKind, SceneError};
pub use export::{BakedInstance, BakedModel, ExportRequest, Exported, NumberedInstance, export};
pub use files::SourceFiles;
pub use import::{Import, MeshBlob, import};
pub use sidecar::{ClassRule, Gates, LodRule, Sidecar, SidecarText, region_tables};
