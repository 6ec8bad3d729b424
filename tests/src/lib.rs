//! Process-level tests of the `kiln` binary.
