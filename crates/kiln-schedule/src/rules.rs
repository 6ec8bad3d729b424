//! The rules of scheduling, one test for each.
