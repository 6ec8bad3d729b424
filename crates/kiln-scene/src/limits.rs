//! How much Kiln takes from one file. Each limit is checked before anything is allocated for it.

/// Bytes of JSON.
pub(crate) const JSON_BYTES: u64 = 128 << 20;
/// Vertices over distinct meshes.
pub(crate) const VERTICES: u64 = 64 << 20;
/// Faces over distinct meshes.
pub(crate) const FACES: u64 = 128 << 20;
/// Elements of an accessor that no bytes stand behind: its zeros cost the file nothing, but memory.
pub(crate) const UNBACKED_ELEMENTS: u64 = 4 << 20;
/// Pixels of an image whose alpha is looked at: 8,192 squared.
pub(crate) const IMAGE_PIXELS: u64 = 64 << 20;
/// Pixels of all such images, those of one that is looked at in several ways counted again.
pub(crate) const LEVEL_PIXELS: u64 = 512 << 20;
/// Instances of meshes.
pub(crate) const INSTANCES: u64 = 1 << 20;
/// Bytes of a .glb file, which states its length in 32 bits.
pub(crate) const GLB_BYTES: u64 = u32::MAX as u64;
/// World coordinates relative to the origin, metres: squares must stay within the range of f32.
pub(crate) const COORDINATE_M: f64 = 1e15;
