//! What `kiln bake --report` says, as far as it is used here (docs/report.md).

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A report of a bake.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Report {
    pub(super) level: Counts,
    pub(super) samples: Samples,
    pub(super) rays: Rays,
    pub(super) stages: Vec<Stage>,
    /// Wall time of the command.
    pub(super) seconds: f64,
    /// Processor time of the process that wrote the report.
    pub(super) cpu_seconds: f64,
    pub(super) peak_memory_bytes: Option<u64>,
    pub(super) error_estimate: Errors,
    #[serde(default)]
    pub(super) foliage: Foliage,
    #[serde(default)]
    pub(super) lods: Lods,
    #[serde(default)]
    pub(super) regions: Option<Regions>,
    pub(super) solve: Vec<Solve>,
    pub(super) meshes: Vec<Instance>,
}

/// Sizes of the level.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Counts {
    pub(super) instances: u64,
    pub(super) vertices: u64,
    pub(super) faces: u64,
}

/// Samples that were gathered.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Samples {
    pub(super) total: u64,
}

/// Rays that were traced.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Rays {
    pub(super) traced: u64,
}

/// One kind of task.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Stage {
    pub(super) name: String,
    pub(super) seconds: f64,
    pub(super) cpu_seconds: f64,
    pub(super) parts: BTreeMap<String, PartTime>,
}

/// A part of the work of a kind.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
pub(super) struct PartTime {
    pub(super) seconds: f64,
    pub(super) cpu_seconds: f64,
}

/// Estimated errors, one for each half-distance.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Errors {
    pub(super) rmse: Vec<f64>,
}

/// What became of foliage.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub(super) struct Foliage {
    /// Points that were traced around trees.
    pub(super) voxels: u64,
    pub(super) models: Vec<Model>,
    /// Shrubs and decorators.
    pub(super) scalars: u64,
    /// What a game loads for them, and what values at all their vertices would be.
    #[serde(default)]
    pub(super) bytes: u64,
    #[serde(default)]
    pub(super) bytes_at_vertices: u64,
}

/// What became of lower levels of detail.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub(super) struct Lods {
    pub(super) vertices: u64,
    pub(super) faces: u64,
    /// Points at which the full detail was read.
    pub(super) samples: u64,
}

/// What became of visibility regions.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub(super) struct Regions {
    pub(super) regions: u64,
    /// Valid points.
    pub(super) points: u64,
}

/// A model of trees.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Model {
    pub(super) instances: u64,
}

/// One instance's linear system.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Solve {
    pub(super) unknowns: u64,
}

/// One instance that has values.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Instance {
    pub(super) visible_area_m2: f64,
}

impl Report {
    /// A kind of task; nothing took any time if there was none.
    pub(super) fn stage(&self, name: &str) -> Option<&Stage> {
        self.stages.iter().find(|stage| stage.name == name)
    }

    /// A part of the work, over all kinds.
    pub(super) fn part(&self, name: &str) -> PartTime {
        self.stages.iter().filter_map(|stage| stage.parts.get(name)).fold(PartTime::default(), |sum, part| PartTime {
            seconds: sum.seconds + part.seconds,
            cpu_seconds: sum.cpu_seconds + part.cpu_seconds,
        })
    }

    /// Area that can be seen of all that has values.
    pub(super) fn visible_area_m2(&self) -> f64 {
        self.meshes.iter().map(|mesh| mesh.visible_area_m2).sum()
    }
}

impl Stage {
    /// A part of the work.
    pub(super) fn part(&self, name: &str) -> PartTime {
        self.parts.get(name).copied().unwrap_or_default()
    }

    /// Processor time of what is not told apart.
    pub(super) fn own_cpu_seconds(&self) -> f64 {
        let parts: f64 = self.parts.values().map(|part| part.cpu_seconds).sum();
        (self.cpu_seconds - parts).max(0.0)
    }
}
