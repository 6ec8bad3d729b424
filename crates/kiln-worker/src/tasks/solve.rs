//! Solve: the moments of an instance's pieces to vertex values.

use super::{LoadedLevel, trees::Model};
use crate::{Artefacts, TaskError, TaskOutput};
use kiln_core::{Digest, FaceMoments, SolveWork, codec};
use kiln_solve::SolveInput;

pub(super) fn run(
    work: &SolveWork,
    moments: &[Digest],
    level: &LoadedLevel,
    artefacts: &dyn Artefacts,
) -> Result<TaskOutput, TaskError> {
    let (placed, mesh) = level.instance(work.instance)?;
    let failed = |reason: String| TaskError::Failed { reason: format!("{}: {reason}", placed.name) };
    let channels = level.level.sampling.kernel.channel_count();
    let mut whole = FaceMoments::new(channels);
    for bytes in artefacts.get_once(moments)? {
        let piece = FaceMoments::from_bytes(&bytes).map_err(|error| failed(error.to_string()))?;
        if piece.channel_count() != channels {
            return Err(failed(format!("{} channels in its moments, {channels} in the level", piece.channel_count())));
        }
        whole.append(&piece);
    }
    let model = if work.alone { Some(level.trees()?.model_of(placed.mesh)?) } else { None };
    let world_from_object = model.map_or(placed.world_from_object, Model::place);
    let mut settings = level.level.solve.clone();
    if placed.is_lod() && !work.alone {
        settings.rays_per_sample = kiln_bake::lod_sampling(&level.level.sampling, mesh.faces.len()).rays_per_sample;
    }
    let input = SolveInput { mesh, world_from_object, moments: &whole, settings: &settings };
    let solution = kiln_solve::solve(&input).map_err(|error| failed(error.to_string()))?;
    Ok(TaskOutput { result: codec::encode(&solution), attachments: Vec::new(), rays: 0 })
}
