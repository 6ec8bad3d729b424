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

    /// The lane that traces a scene: the processor's where rays go through what the device does not know.
    pub fn lane_of(&self, scene: &Scene) -> String {
        if self.falls_back(scene) { Self::Cpu.lane() } else { self.lane() }
    }

    /// A tracer over a scene. Where rays go through what the device does not know it is the processor's.
    pub fn tracer(&self, scene: &Arc<Scene>) -> Result<Arc<dyn Tracer>, GpuError> {
        Ok(match self {
            Self::Gpu(device) if self.falls_back(scene) => {
                let card = device.describe();
                tracing::warn!(%card, "rays are traced on the processor: the card's tracer does not know all that they go through");
                Arc::new(CpuTracer::new(Arc::clone(scene)))
            }
            Self::Gpu(device) => Arc::new(GpuTracer::new(Arc::clone(device), scene)?),
            Self::Cpu => Arc::new(CpuTracer::new(Arc::clone(scene))),
        })
    }

    /// Whether the processor traces a scene in the device's place.
    fn falls_back(&self, scene: &Scene) -> bool {
        matches!(self, Self::Gpu(_)) && !GpuTracer::knows(scene)
    }
}
