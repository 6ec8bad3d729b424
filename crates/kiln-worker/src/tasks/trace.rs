//! Trace: a piece of an instance to per-face moments.

use super::{LoadedLevel, SceneTracer, counted::Counted, out_of_range};
use crate::{TaskError, TaskOutput};
use kiln_bake::{Piece, trace_piece};
use kiln_core::{Bounds, TraceTask};

/// `lane` is the tracer's.
pub(super) fn run(
    task: &TraceTask,
    level: &LoadedLevel,
    (scene, tracer): &SceneTracer,
    lane: String,
) -> Result<TaskOutput, TaskError> {
    let (instance, mesh) = level.instance(task.instance)?;
    let first = task.first_face as usize;
    let faces = first..first.saturating_add(task.face_count as usize);
    if faces.end > mesh.faces.len() {
        return Err(out_of_range("face", task.first_face.saturating_add(task.face_count)));
    }
    let reach = level.reach();
    let piece = Piece {
        mesh,
        world_from_object: &instance.world_from_object,
        faces,
        density_per_m2: task.density_per_m2,
        sampling: &level.level.sampling,
        occluders_m: reach.group(task.instance as usize).map_or(Bounds::EMPTY, |group| reach.bounds_m(group)),
    };
    let moments = trace_piece(&Counted(&**tracer), scene, &piece);
    let mut moments = moments.map_err(|error| TaskError::from(&error))?;
    moments.lanes.insert(lane);
    Ok(TaskOutput { rays: moments.summary.rays, result: moments.to_bytes(), attachments: Vec::new() })
}
