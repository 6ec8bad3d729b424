//! Points: what can be seen from points on some instances of a model.

use super::{LoadedLevel, SceneTracer, counted::Counted, out_of_range};
use crate::{TaskError, TaskOutput};
use kiln_bake::{model_points, values_traced};
use kiln_core::{PointValues, PointsWork, codec};

pub(super) fn run(work: &PointsWork, level: &LoadedLevel, (_, tracer): &SceneTracer) -> Result<TaskOutput, TaskError> {
    let model = level.trees()?.model_of(work.mesh)?;
    let end = work.first.saturating_add(work.count);
    let instances = model.instances.get(work.first as usize..end as usize);
    let instances = instances.ok_or_else(|| out_of_range("instance of its model", end))?;
    let (mesh, sampling) = (&level.meshes[work.mesh as usize], &level.level.sampling);
    let points = model_points(mesh, sampling.seed);
    if points.len() != work.point_count as usize {
        return Err(out_of_range("point", work.point_count));
    }
    let (mut values, mut sides) = (Vec::new(), 0);
    for index in instances {
        let place = &level.level.instances[*index as usize].world_from_object;
        let found = values_traced(&Counted(&**tracer), mesh, &points, place, (sampling, work.rays));
        values.extend(found.map_err(|error| TaskError::from(&error))?);
        sides += points.iter().map(|point| 1 + u64::from(point.two_sided)).sum::<u64>();
    }
    let rays = sides * u64::from(work.rays);
    Ok(TaskOutput { rays, result: codec::encode(&PointValues { values, rays }), attachments: Vec::new() })
}
