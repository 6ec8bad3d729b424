//! Volume: some bricks around trees to what can be seen from their voxels.

use super::{LoadedLevel, SceneTracer, counted::Counted, out_of_range, trees};
use crate::{TaskError, TaskOutput};
use kiln_bake::volume::{VolumeError, gather_batch};
use kiln_core::{VolumeWork, codec};

pub(super) fn run(work: &VolumeWork, level: &LoadedLevel, (_, tracer): &SceneTracer) -> Result<TaskOutput, TaskError> {
    let layout = &level.trees()?.layout;
    let first = work.first_brick as usize;
    let bricks = first..first.saturating_add(work.brick_count as usize);
    if bricks.end > layout.bricks().len() {
        return Err(out_of_range("brick", work.first_brick.saturating_add(work.brick_count)));
    }
    let settings = trees::gather_settings(&level.level);
    let batch = gather_batch(&Counted(&**tracer), layout, bricks, &settings).map_err(|error| match &error {
        VolumeError::Trace(trace) => TaskError::from(trace),
        other => TaskError::Failed { reason: other.to_string() },
    })?;
    Ok(TaskOutput { rays: batch.ray_count(), result: codec::encode(&batch), attachments: Vec::new() })
}
