//! Import of glTF levels and sidecars, cleaning, classes, and export of baked glTF.
