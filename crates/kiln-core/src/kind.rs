//! The kinds of task, and the lanes that their arithmetic runs in.

use serde::{Deserialize, Serialize};

/// The kinds of task, in the order of the data path: stages are shown in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TaskKind {
    /// Source files to a level.
    Import,
    /// A level to its task graph.
    Plan,
    /// A piece of an instance to per-face moments.
    Trace,
    /// An instance's moments to vertex values.
    Solve,
    /// Voxels around trees to what can be seen from them.
    Volume,
    /// Points on some instances of a model to what can be seen from them.
    Points,
    /// Valid points of some visibility regions to what can be seen from them.
    Regions,
    /// A model's local AO, and what its instances should have, to four numbers for each of them.
    Fit,
    /// What can be seen in all visibility regions to a model for each.
    Model,
    /// Finished values around shrubs and decorators to one number for each of them.
    Read,
    /// Finished values of a full-detail mesh to moments of the faces of a lower level of detail.
    Resample,
    /// The outputs of a task graph to the baked file.
    Export,
}

impl TaskKind {
    /// Every kind, in the order of the data path.
    pub const ALL: [Self; 12] = [
        Self::Import,
        Self::Plan,
        Self::Trace,
        Self::Solve,
        Self::Volume,
        Self::Points,
        Self::Regions,
        Self::Fit,
        Self::Model,
        Self::Read,
        Self::Resample,
        Self::Export,
    ];

    /// Revision of the kind's code: raised whenever its output changes for some input, so that results of
    /// other revisions are never taken for its own. A golden test in the kind's crate fails otherwise.
    pub const fn kernel_rev(self) -> u32 {
        match self {
            Self::Model | Self::Read | Self::Resample => 1,
            Self::Points | Self::Regions => 2,
            Self::Volume | Self::Fit => 3,
            Self::Solve => 4,
            Self::Import | Self::Plan | Self::Export => 7,
            Self::Trace => 9,
        }
    }

    /// The name in messages, reports and keys.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Import => "import",
            Self::Plan => "plan",
            Self::Trace => "trace",
            Self::Solve => "solve",
            Self::Volume => "volume",
            Self::Points => "points",
            Self::Regions => "regions",
            Self::Fit => "fit",
            Self::Model => "model",
            Self::Read => "read",
            Self::Resample => "resample",
            Self::Export => "export",
        }
    }

    /// The part of its bake's [`Lane`] that results of the kind depend on, and that a worker must offer to run it; `None`
    /// if they are the same everywhere.
    pub const fn lane_part(self) -> Option<LanePart> {
        match self {
            Self::Trace | Self::Volume | Self::Points | Self::Regions | Self::Read => Some(LanePart::Trace),
            Self::Solve | Self::Fit | Self::Model => Some(LanePart::Solve),
            // Levels of detail are resampled by the processor, whose hits are the same everywhere.
            Self::Import | Self::Plan | Self::Resample | Self::Export => None,
        }
    }

    /// Whether tasks of the kind shoot rays: then their cost is a number of rays, and what can stop these is in their
    /// keys ([`crate::PlannedTask::surroundings`]).
    pub const fn traces(self) -> bool {
        matches!(self.lane_part(), Some(LanePart::Trace))
    }
}

/// The trace lane of bakes whose pieces are traced in whatever lane there is. Their keys are made for it, so that their
/// results never pass for those of one lane.
pub const MIXED_LANE: &str = "mixed";

/// One of the two parts of a [`Lane`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LanePart {
    /// [`Lane::trace`].
    Trace,
    /// [`Lane::solve`].
    Solve,
}

/// Where a task's arithmetic runs. Results are bit for bit the same within a lane, not across lanes, but for
/// [`MIXED_LANE`], which promises the error bound only.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Lane {
    /// `cpu`, `gpu:ADAPTER:DRIVER`, or [`MIXED_LANE`].
    pub trace: String,
    /// The instruction set of solves, such as `x86_64+avx2`.
    pub solve: String,
}

impl Lane {
    /// Whether pieces are traced in any lane.
    pub fn is_mixed(&self) -> bool {
        self.trace == MIXED_LANE
    }

    /// What a worker must offer to run tasks of a kind; `None` if any worker may.
    pub fn needed_by(&self, kind: TaskKind) -> Option<&str> {
        match kind.lane_part()? {
            LanePart::Trace => (!self.is_mixed()).then_some(&self.trace),
            LanePart::Solve => Some(&self.solve),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_have_names_and_places_of_their_own() {
        // The order of the list is that of the stages, and names keep keys of different kinds apart.
        assert!(TaskKind::ALL.is_sorted_by(|a, b| a < b));
        let names: std::collections::BTreeSet<&str> = TaskKind::ALL.map(TaskKind::name).into();
        assert_eq!(names.len(), TaskKind::ALL.len());
        // Domains of other keys.
        assert!(["bake", "task", "bake failure"].iter().all(|other| !names.contains(other)));
    }

    #[test]
    fn a_mixed_lane_binds_solves_only() {
        let lane = Lane { trace: "cpu".into(), solve: "portable".into() };
        let mixed = Lane { trace: MIXED_LANE.into(), ..lane.clone() };
        let needs = |lane: &Lane| TaskKind::ALL.map(|kind| lane.needed_by(kind).map(str::to_owned));
        let solve = Some("portable".to_owned());
        let cpu = Some("cpu".to_owned());
        let expected =
            [&None, &None, &cpu, &solve, &cpu, &cpu, &cpu, &solve, &solve, &cpu, &None, &None].map(Clone::clone);
        assert_eq!(needs(&lane), expected);
        let expected =
            [&None, &None, &None, &solve, &None, &None, &None, &solve, &solve, &None, &None, &None].map(Clone::clone);
        assert_eq!(needs(&mixed), expected);
    }
}
