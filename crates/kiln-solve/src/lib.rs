//! Least squares on meshes.
