//! The tasks themselves: each turns artefacts into artefacts, by the crates that own the work.

mod backend;
mod backends;
mod bvhs;
mod counted;
mod export;
mod fit;
mod fit_lod;
mod import;
mod levels;
mod masks;
mod outputs;
mod pack;
mod plan;
mod points;
mod read;
mod regions;
mod resample;
mod solve;
mod trace;
mod trees;
mod volume;

pub use backend::Backend;
pub use backends::Backends;
pub use bvhs::BvhCounts;
pub use levels::{LoadedLevel, SceneTracer, foliage_of, ground_plane};

use crate::{Artefacts, CancelFlag, Executor, Lanes, TaskError, TaskOutput};
use bvhs::BvhKeeper;
use kiln_core::{TaskSpec, TraceWork, Work, WorkSpec, codec::DecodeError};
use kiln_trace::TraceError;
use levels::LevelCache;

/// Runs every kind of task on this machine. Levels that it works on are kept loaded, with their BVHs.
pub struct BakeExecutor {
    levels: LevelCache,
    backends: Backends,
    bvhs: BvhKeeper,
}

impl BakeExecutor {
    /// An executor that traces on the given backends.
    pub fn new(backends: Backends) -> Self {
        Self { levels: LevelCache::default(), backends, bvhs: BvhKeeper::default() }
    }

    /// Where the BVHs of meshes came from so far.
    pub fn bvh_counts(&self) -> BvhCounts {
        self.bvhs.counts()
    }

    /// Waits for what is being written to the local cache. Blocks; to be called before the process ends.
    pub fn finish(&self) {
        self.bvhs.finish();
    }

    /// Does what traces, in the given lane.
    fn trace(&self, spec: &WorkSpec, lane: &str, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
        let level = self.levels.get(spec.level, artefacts)?;
        let cache = artefacts.local_cache();
        self.backends.trace(lane, |backend: &Backend| {
            if let Work::Trace(piece @ TraceWork { alone: true, .. }) = &spec.work {
                return trace::run_alone(piece, &level, backend);
            }
            let tracer = level.tracer_by(backend, &self.bvhs, cache.as_ref())?;
            match &spec.work {
                Work::Trace(piece) => trace::run(piece, &level, tracer, backend.lane_of(&tracer.0)),
                Work::Volume(bricks) => volume::run(bricks, &level, tracer),
                Work::Points(points) => points::run(points, &level, tracer),
                Work::Regions(run) => regions::trace(run, &level, tracer),
                Work::Read(run) => read::run(run, &spec.inputs, &level, tracer, artefacts),
                Work::Solve(_) | Work::Fit(_) | Work::Model(_) | Work::Resample(_) => {
                    Err(TaskError::Failed { reason: "it does not trace".to_owned() })
                }
            }
        })
    }
}

impl Executor for BakeExecutor {
    fn lanes(&self) -> Lanes {
        Lanes { trace: self.backends.lanes(), solve: kiln_solve::lane() }
    }

    fn run(
        &self,
        spec: &TaskSpec,
        lane: &str,
        artefacts: &dyn Artefacts,
        cancel: &CancelFlag,
        progress: &dyn Fn(u64),
    ) -> Result<TaskOutput, TaskError> {
        if cancel.is_cancelled() {
            return Err(TaskError::Cancelled);
        }
        match spec {
            TaskSpec::Import { source } => import::run(*source, artefacts),
            TaskSpec::Plan(spec) => plan::run(spec, &*self.levels.get(spec.level, artefacts)?),
            TaskSpec::Work(WorkSpec { level, work: Work::Resample(piece), inputs }) => {
                let (level, cache) = (self.levels.get(*level, artefacts)?, artefacts.local_cache());
                let output = resample::run(piece, inputs, &level, (&self.bvhs, cache.as_ref()), artefacts)?;
                progress(output.rays);
                Ok(output)
            }
            TaskSpec::Work(
                spec @ WorkSpec {
                    work: Work::Trace(_) | Work::Volume(_) | Work::Points(_) | Work::Regions(_) | Work::Read(_),
                    ..
                },
            ) => {
                let output = self.trace(spec, lane, artefacts)?;
                progress(output.rays);
                Ok(output)
            }
            TaskSpec::Work(WorkSpec { level, work: Work::Solve(instance), inputs }) => {
                solve::run(instance, inputs, &*self.levels.get(*level, artefacts)?, artefacts)
            }
            TaskSpec::Work(WorkSpec { level, work: Work::Fit(model), inputs }) => {
                fit::run(model, inputs, &*self.levels.get(*level, artefacts)?, artefacts)
            }
            TaskSpec::Work(WorkSpec { level, work: Work::Model(work), inputs }) => {
                regions::model(work, inputs, &*self.levels.get(*level, artefacts)?, artefacts)
            }
            TaskSpec::Export(spec) => export::run(spec, &*self.levels.get(spec.level, artefacts)?, artefacts),
        }
    }
}

impl From<DecodeError> for TaskError {
    fn from(error: DecodeError) -> Self {
        Self::Failed { reason: error.to_string() }
    }
}

impl From<&TraceError> for TaskError {
    fn from(error: &TraceError) -> Self {
        let reason = error.to_string();
        if matches!(error, TraceError::DeviceLost { .. }) {
            Self::DeviceLost { reason }
        } else {
            Self::Failed { reason }
        }
    }
}

/// An index of a task is not in its level: coordinator and worker disagree.
fn out_of_range(what: &str, index: u32) -> TaskError {
    TaskError::Failed { reason: format!("the level has no {what} {index}; the task is of another version of Kiln") }
}
