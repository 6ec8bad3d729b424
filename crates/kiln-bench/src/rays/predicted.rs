//! What the model of graphics devices says that a device can reach, beside what was measured.

use super::{
    case::Case,
    contest::{KILN, Standings},
    lap::{Course, Lap, Mode},
};
use crate::{BenchError, spread::Spread};
use kiln_gpu::{GpuDevice, GpuTracer, model::Roofs};
use kiln_trace::{Scene, Tracer};
use kiln_worker::tasks::Backend;
use serde::Serialize;
use std::sync::Arc;

/// Rays that visits are counted of, at most.
pub(super) const COUNTED: usize = 1 << 16;

/// A scene on a backend.
pub(super) enum Traced {
    Cpu(Arc<dyn Tracer>),
    Gpu(Arc<GpuDevice>, GpuTracer),
}

impl Traced {
    /// Sends a scene to a backend.
    pub(super) fn new(backend: &Backend, scene: &Arc<Scene>) -> Result<Self, BenchError> {
        let failed = |error: kiln_gpu::GpuError| BenchError::Failed {
            step: "sending the scene to the device",
            reason: error.to_string(),
        };
        match backend {
            Backend::Cpu => backend.tracer(scene).map(Self::Cpu).map_err(failed),
            Backend::Gpu(device) => GpuTracer::new(Arc::clone(device), scene)
                .map(|tracer| Self::Gpu(Arc::clone(device), tracer))
                .map_err(failed),
        }
    }

    /// What traces.
    pub(super) fn tracer(&self) -> &dyn Tracer {
        match self {
            Self::Cpu(tracer) => &**tracer,
            Self::Gpu(_, tracer) => tracer,
        }
    }
}

/// The model's rate of one mode, and the measured one.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Predicted {
    mode: String,
    /// Millions of rays per second that the model allows.
    model_mrays_per_s: f64,
    /// The roof that it meets.
    limit: String,
    instructions_per_ray: f64,
    bytes_per_ray: f64,
    /// Median of what was measured on the wall.
    measured_mrays_per_s: f64,
}

impl Predicted {
    /// One line for the table.
    pub(super) fn line(&self) -> String {
        let Self { mode, model_mrays_per_s, limit, instructions_per_ray, bytes_per_ray, measured_mrays_per_s } = self;
        format!(
            "- {mode}: {measured_mrays_per_s:.2} Mrays per wall second, {:.2} of the model's {model_mrays_per_s:.2} \
             (limit: {limit}; {instructions_per_ray:.0} instructions and {bytes_per_ray:.0} bytes per ray)",
            measured_mrays_per_s / model_mrays_per_s
        )
    }
}

/// The modes that the model knows, on a graphics device; nothing on the CPU. Its roofs are typical of the kind of device.
pub(super) fn compare(traced: &Traced, case: &Case, standings: &Standings) -> Result<Vec<Predicted>, BenchError> {
    let Traced::Gpu(device, tracer) = traced else { return Ok(Vec::new()) };
    // The model is of the software traversal.
    if tracer.has_ray_queries() {
        return Ok(Vec::new());
    }
    let course = Course::new(tracer, case, 1, false);
    let roofs = Roofs::of_kind(device.adapter().kind);
    let mut all = Vec::new();
    for mode in [Mode::Closest, Mode::Any] {
        let rays = course.rays(mode);
        let step = rays.len().div_ceil(COUNTED).max(1);
        let some: Vec<_> = rays.iter().copied().step_by(step).collect();
        let visits = tracer.visits(&some);
        let visits =
            visits.map_err(|error| BenchError::Failed { step: "counting visits", reason: error.to_string() })?;
        let prediction = roofs.predict(&visits, tracer.memory_bytes());
        let laps = standings.rows.iter().filter(|row| row.tracer == KILN && row.mode == mode.name());
        let rates = laps.flat_map(|row| row.laps.iter().map(|lap: &Lap| lap.mrays_per_wall_second));
        let Some(measured) = Spread::of(rates) else { continue };
        all.push(Predicted {
            mode: mode.name(),
            model_mrays_per_s: prediction.rays_per_s / 1e6,
            limit: format!("{:?}", prediction.limit).to_lowercase(),
            instructions_per_ray: prediction.instructions_per_ray,
            bytes_per_ray: prediction.bytes_per_ray,
            measured_mrays_per_s: measured.median,
        });
    }
    Ok(all)
}
