//! Resample: finished values of a full-detail mesh to moments of the faces of a lower level of detail.

use super::{LoadedLevel, bvhs::BvhKeeper, counted::Counted, out_of_range};
use crate::{Artefacts, LocalCache, TaskError, TaskOutput};
use kiln_bake::{BakedInstance, BakedSurface, Piece, lod_sampling, resample_lod};
use kiln_core::{Bounds, Digest, ResampleWork, Solution, codec};
use kiln_trace::{CpuTracer, CutoutMesh, Scene, SceneObject};
use std::sync::Arc;

/// `inputs` are the values of the instances that the level of detail stands for, in their order.
pub(super) fn run(
    work: &ResampleWork,
    inputs: &[Digest],
    level: &LoadedLevel,
    (bvhs, cache): (&BvhKeeper, Option<&LocalCache>),
    artefacts: &dyn Artefacts,
) -> Result<TaskOutput, TaskError> {
    let (instance, mesh) = level.instance(work.instance)?;
    let failed = |reason: String| TaskError::Failed { reason: format!("{}: {reason}", instance.name) };
    let first = work.first_face as usize;
    let faces = first..first.saturating_add(work.face_count as usize);
    if faces.end > mesh.faces.len() {
        return Err(out_of_range("face", work.first_face.saturating_add(work.face_count)));
    }
    if instance.lod_of.len() != inputs.len() {
        let (fulls, values) = (instance.lod_of.len(), inputs.len());
        return Err(failed(format!("it stands for {fulls} instances, but {values} have values")));
    }
    let decode = |bytes: &bytes::Bytes| codec::decode("a solution", bytes);
    let solutions: Vec<Solution> = artefacts.get_many(inputs)?.iter().map(decode).collect::<Result<_, _>>()?;
    let (mut trees, mut cutouts, mut objects, mut baked) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (index, solution) in instance.lod_of.iter().zip(&solutions) {
        let (full, mesh) = level.instance(*index)?;
        let world_from_object = full.world_from_object;
        objects.push(SceneObject { mesh: trees.len(), world_from_object });
        trees.push(level.bvh(full.mesh, bvhs, cache));
        cutouts.push(CutoutMesh::build(mesh).map(Arc::new));
        let has_values = !solution.unsampled;
        baked.push(has_values.then_some(BakedInstance { mesh, world_from_object, values: &solution.values }));
    }
    let tracer = CpuTracer::new(Arc::new(Scene::build(trees, &objects).with_cutouts(cutouts, &objects)));
    let channels = level.level.sampling.kernel.channel_count();
    let surface = BakedSurface::new(channels, &baked).map_err(|error| failed(error.to_string()))?;
    let sampling = lod_sampling(&level.level.sampling, mesh.faces.len());
    let piece = Piece {
        mesh,
        world_from_object: &instance.world_from_object,
        faces,
        density_per_m2: work.density_per_m2,
        sampling: &sampling,
        occluders_m: Bounds::EMPTY,
    };
    let moments = resample_lod(&Counted(&tracer), &surface, &piece).map_err(|error| TaskError::from(&error))?;
    Ok(TaskOutput { rays: moments.summary.rays, result: moments.to_bytes(), attachments: Vec::new() })
}
