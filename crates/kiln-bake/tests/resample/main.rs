//! Laws of reading a finished bake again: for decorators, and for levels of detail.

mod baked;
mod decorators;
mod error;
mod lods;
mod nearest;
mod shapes;
