//! The wgpu compute tracer.
