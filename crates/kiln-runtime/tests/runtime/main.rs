//! The pack and its evaluation: laws, the layout of docs/pack-format.md, and what damage does.

#![expect(clippy::unwrap_used, reason = "these are tests")]

mod allocations;
mod corpus;
mod damage;
#[path = "../../fuzz/exercise.rs"]
mod exercise;
mod layout;
mod lookup;
mod moving;
mod round_trip;
mod sample;
mod versions;
