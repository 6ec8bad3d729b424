//! Pictures of baked files, by Kiln's own CPU tracer.

mod camera;
mod png_file;
mod ramp;
mod render;

pub(crate) use camera::Camera;
pub(crate) use png_file::{Image, write_png};
pub(crate) use ramp::{TICK, TOP};
pub(crate) use render::{Ball, Shading, Surface, render};
