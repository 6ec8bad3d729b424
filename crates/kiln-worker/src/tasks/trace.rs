//! Trace: a piece of an instance to per-face moments.

use super::{Backend, LoadedLevel, SceneTracer, counted::Counted, out_of_range};
use crate::{TaskError, TaskOutput};
use kiln_bake::{Piece, trace_piece};
use kiln_core::{Bounds, TraceWork};
use kiln_trace::{Scene, Tracer};
use std::{ops::Range, sync::Arc};

/// `lane` is the tracer's.
pub(super) fn run(
    task: &TraceWork,
    level: &LoadedLevel,
    (scene, tracer): &SceneTracer,
    lane: String,
) -> Result<TaskOutput, TaskError> {
    let (instance, mesh) = level.instance(task.instance)?;
    let faces = faces(task, mesh.faces.len())?;
    let reach = level.reach();
    let piece = Piece {
        mesh,
        world_from_object: &instance.world_from_object,
        faces,
        density_per_m2: task.density_per_m2,
        sampling: &level.level.sampling,
        occluders_m: reach.group(task.instance as usize).map_or(Bounds::EMPTY, |group| reach.bounds_m(group)),
    };
    trace(&piece, (scene, tracer), lane)
}

/// Traces a piece of a model by itself.
pub(super) fn run_alone(task: &TraceWork, level: &LoadedLevel, backend: &Backend) -> Result<TaskOutput, TaskError> {
    let (instance, mesh) = level.instance(task.instance)?;
    let model = level.trees()?.model_of(instance.mesh)?;
    let (scene, tracer) = level.alone(model, backend)?;
    let piece = Piece {
        mesh,
        world_from_object: &model.place(),
        faces: faces(task, mesh.faces.len())?,
        density_per_m2: task.density_per_m2,
        sampling: &level.level.sampling,
        occluders_m: Bounds::EMPTY,
    };
    trace(&piece, (&scene, &tracer), backend.lane_of(&scene))
}

fn trace(
    piece: &Piece<'_>,
    (scene, tracer): (&Arc<Scene>, &Arc<dyn Tracer>),
    lane: String,
) -> Result<TaskOutput, TaskError> {
    let moments = trace_piece(&Counted(&**tracer), scene, piece);
    let mut moments = moments.map_err(|error| TaskError::from(&error))?;
    moments.lanes.insert(lane);
    Ok(TaskOutput { rays: moments.summary.rays, result: moments.to_bytes(), attachments: Vec::new() })
}

/// The faces of a piece, of a mesh with so many.
fn faces(task: &TraceWork, count: usize) -> Result<Range<usize>, TaskError> {
    let first = task.first_face as usize;
    let faces = first..first.saturating_add(task.face_count as usize);
    if faces.end > count {
        return Err(out_of_range("face", task.first_face.saturating_add(task.face_count)));
    }
    Ok(faces)
}
