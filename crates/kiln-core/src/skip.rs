//! The rules by which a bake leaves out work that its result does not need. What each does to the result is in
//! docs/skips.md.

use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A hit beyond the reach changes a ray's value by less than this.
pub const REACH_EPSILON: f64 = 1.0 / 1024.0;

/// A rule that leaves out work. Each can be turned off, to show what it changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SkipRule {
    /// Rays end where a hit changes their value by less than [`REACH_EPSILON`], and what lies beyond is not loaded.
    Reach,
    /// A sample has no ray where nothing lies above its surface within reach.
    Empty,
    /// Faces all of whose samples are hidden get no more of them.
    Buried,
    /// A face that repeats another of its mesh is left out.
    Duplicates,
    /// Samples are added until the error is small enough, in place of as many on every face.
    Adaptive,
    /// Tasks whose results are known are not run again.
    Unchanged,
}

impl SkipRule {
    /// Every rule.
    pub const ALL: [Self; 6] =
        [Self::Reach, Self::Empty, Self::Buried, Self::Duplicates, Self::Adaptive, Self::Unchanged];

    /// The rules that change which samples are taken and which of their rays are traced; the others concern the mesh,
    /// the number of samples and the store.
    const SAMPLING: [Self; 3] = [Self::Reach, Self::Empty, Self::Buried];

    /// Of the rules that are turned off, those that sampling must know.
    pub fn of_sampling(off: &BTreeSet<Self>) -> BTreeSet<Self> {
        Self::SAMPLING.into_iter().filter(|rule| off.contains(rule)).collect()
    }
}
