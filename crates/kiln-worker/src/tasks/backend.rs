//! Which tracer runs trace tasks.

use kiln_gpu::{GpuDevice, GpuError, GpuTracer};
use kiln_trace::{CpuTracer, Scene, Tracer};
use std::sync::Arc;

/// Where rays are traced.
pub enum Backend {
    /// On the threads of this process.
    Cpu,
    /// On a graphics device.
    Gpu(Arc<GpuDevice>),
}

impl Backend {
    /// The lane of its trace tasks.
    pub fn lane(&self) -> String {
        match self {
            Self::Cpu => "cpu".to_owned(),
            Self::Gpu(device) => device.lane(),
        }
    }

    /// What it is, for people.
    pub fn describe(&self) -> String {
        match self {
            Self::Cpu => "the CPU".to_owned(),
            Self::Gpu(device) => device.describe(),
        }
    }

    /// The lane that traces a scene: the processor's where rays go through foliage or faces have holes.
    pub fn lane_of(&self, scene: &Scene) -> String {
        if only_processor(scene).is_some() { Self::Cpu.lane() } else { self.lane() }
    }

    /// A tracer over a scene. Where rays go through foliage or faces have holes it is the processor's, whatever the backend.
    pub fn tracer(&self, scene: &Arc<Scene>) -> Result<Arc<dyn Tracer>, GpuError> {
        Ok(match (self, only_processor(scene)) {
            (Self::Cpu, _) => Arc::new(CpuTracer::new(Arc::clone(scene))),
            (Self::Gpu(device), Some(what)) => {
                let card = device.describe();
                tracing::warn!(%card, "rays are traced on the processor: the card's tracer has no {what} yet");
                Arc::new(CpuTracer::new(Arc::clone(scene)))
            }
            (Self::Gpu(device), None) => Arc::new(GpuTracer::new(Arc::clone(device), scene)?),
        })
    }
}

/// What of a scene only the processor can trace, if there is anything.
fn only_processor(scene: &Scene) -> Option<&'static str> {
    let cutouts = scene.has_cutouts().then_some("faces with holes");
    cutouts.or(scene.foliage().map(|_| "foliage"))
}
