//! Export: all solutions to the baked file and its summary.

use super::{
    LoadedLevel,
    import::{LoadedFiles, manifest},
};
use crate::{Artefacts, TaskError, TaskOutput};
use kiln_core::{
    BakeSummary, Baked, Digest, ErrorEstimate, ExportSpec, MeshSummary, Solution, TraceSummary, Warning, codec,
};
use kiln_scene::{BakedInstance, ExportRequest};
use kiln_solve::{LevelInstance, fill_unsampled};

pub(super) fn run(spec: &ExportSpec, level: &LoadedLevel, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let (manifest, level_name) = manifest(spec.source, artefacts)?;
    let files = LoadedFiles::load(&manifest.files, artefacts)?;
    let (indices, mut solutions) = load_solutions(spec.solutions, artefacts)?;
    let filled = fill(level, &indices, &mut solutions)?;

    let values: Vec<BakedInstance<'_>> = indices
        .iter()
        .zip(&solutions)
        .map(|(&instance, solution)| BakedInstance { instance: instance as usize, values: &solution.values })
        .collect();
    let request = ExportRequest {
        level_name: &level_name,
        files: &files,
        level: &level.level,
        level_digest: level.digest,
        version: env!("CARGO_PKG_VERSION"),
        values: &values,
    };
    let exported = kiln_scene::export(&request).map_err(|error| TaskError::Refused { reason: error.to_string() })?;
    let warnings = [level.level.warnings.clone(), filled, exported.warnings].concat();
    let baked = Baked {
        file: Digest::of(&exported.glb),
        bytes: exported.glb.len() as u64,
        summary: summary(level, &indices, &solutions, warnings),
    };
    Ok(TaskOutput { result: codec::encode(&baked), attachments: vec![exported.glb], rays: 0 })
}

fn load_solutions(list: Digest, artefacts: &dyn Artefacts) -> Result<(Vec<u32>, Vec<Solution>), TaskError> {
    let list: Vec<(u32, Digest)> = codec::decode("a list of solutions", &artefacts.get(list)?)?;
    let (indices, digests): (Vec<u32>, Vec<Digest>) = list.into_iter().unzip();
    let mut solutions = Vec::with_capacity(digests.len());
    for bytes in artefacts.get_many(&digests)? {
        solutions.push(codec::decode("a solution", &bytes)?);
    }
    Ok((indices, solutions))
}

/// Gives instances without a valid sample the values of the nearest surface that has some.
fn fill(level: &LoadedLevel, indices: &[u32], solutions: &mut [Solution]) -> Result<Vec<Warning>, TaskError> {
    let mut warnings = Vec::new();
    for (&index, solution) in indices.iter().zip(&*solutions) {
        if solution.unsampled && !solution.values.is_empty() {
            let name = &level.instance(index)?.0.name;
            warnings.push(name.clone());
        }
    }
    if warnings.is_empty() {
        return Ok(Vec::new());
    }
    let mut instances = Vec::with_capacity(indices.len());
    for (&index, solution) in indices.iter().zip(solutions) {
        let (instance, mesh) = level.instance(index)?;
        instances.push(LevelInstance { mesh, world_from_object: instance.world_from_object, solution });
    }
    fill_unsampled(&mut instances);
    let count = warnings.len() as u64;
    let more = if count > 3 { ", …" } else { "" };
    let names = warnings.into_iter().take(3).collect::<Vec<_>>().join(", ");
    Ok(vec![Warning {
        code: "buried_instances".into(),
        subject: names.clone(),
        message: format!(
            "{count} instances have no valid sample ({names}{more}): they are buried in other geometry, or see \
             back faces only; they have the values of the nearest other surface"
        ),
        count,
    }])
}

fn summary(level: &LoadedLevel, indices: &[u32], solutions: &[Solution], warnings: Vec<Warning>) -> BakeSummary {
    let mut trace = TraceSummary::default();
    solutions.iter().for_each(|solution| trace.merge(&solution.summary.trace));
    let mesh = |(&index, solution): (&u32, &Solution)| {
        let instance = &level.level.instances[index as usize];
        let mesh = level.level.meshes[instance.mesh as usize].name.clone();
        MeshSummary { node: instance.name.clone(), mesh, solve: solution.summary.clone() }
    };
    BakeSummary {
        level: level.digest,
        counts: level.level.counts.clone(),
        sampling: level.level.sampling.clone(),
        trace,
        error: level_error(solutions, level.level.sampling.kernel.channel_count()),
        meshes: indices.iter().zip(solutions).map(mesh).collect(),
        warnings,
    }
}

/// Error over the level for each channel.
fn level_error(solutions: &[Solution], channels: usize) -> Vec<ErrorEstimate> {
    let of = |channel: usize| {
        let summaries = solutions.iter().map(|solution| &solution.summary);
        ErrorEstimate::of_level(summaries.filter_map(|s| Some((s.visible_area_m2, s.error.get(channel)?))))
    };
    (0..channels).map(of).collect()
}
