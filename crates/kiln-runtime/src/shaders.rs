//! The same evaluation in shading languages, as text to include.
//!
//! WGSL is the source; `cargo xtask shaders` writes the others from it. Each function is tested against this crate's on a
//! software Vulkan driver (`kiln-gpu`, `tests/runtime_shaders`).

/// WebGPU's language.
pub const WGSL: &str = include_str!("../shaders/kiln_runtime.wgsl");

/// Direct3D's language, from shader model 5.1.
pub const HLSL: &str = include_str!("../shaders/kiln_runtime.hlsl");

/// OpenGL's and Vulkan's language, from 4.20.
pub const GLSL: &str = include_str!("../shaders/kiln_runtime.glsl");

/// Metal's language, from 2.0.
pub const MSL: &str = include_str!("../shaders/kiln_runtime.metal");
