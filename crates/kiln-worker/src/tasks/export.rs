//! Export: all solutions to the baked file and its summary.

use super::{
    LoadedLevel,
    import::{LoadedFiles, manifest},
    outputs::{FoliageOutputs, Outputs},
};
use crate::{Artefacts, TaskError, TaskOutput};
use bytes::Bytes;
use glam::DVec3;
use kiln_core::{
    BakeSummary, Baked, BeyondReach, CoarseFaces, Digest, ErrorEstimate, ExportSpec, Instance, LodSummary, MeshSummary,
    Solution, TraceSummary, Warning, codec,
};
use kiln_scene::{BakedInstance, ExportRequest};
use kiln_solve::{LevelInstance, fill_unsampled};
use rayon::prelude::*;

pub(super) fn run(spec: &ExportSpec, level: &LoadedLevel, artefacts: &dyn Artefacts) -> Result<TaskOutput, TaskError> {
    let (manifest, level_name) = manifest(spec.source, artefacts)?;
    let files = LoadedFiles::load(&manifest.files, artefacts)?;
    let outputs = Outputs::load(spec.outputs, artefacts)?;
    let (indices, mut solutions) = load_solutions(&outputs, artefacts)?;
    let foliage = FoliageOutputs::load(&outputs, level, artefacts)?;
    let regions = outputs.regions(artefacts)?;
    let filled = fill(level, &indices, &mut solutions)?;

    let values: Vec<BakedInstance<'_>> = indices
        .iter()
        .zip(&solutions)
        .map(|(&instance, Solution { values, residuals, .. })| {
            let instance = instance as usize;
            BakedInstance { instance, values, residuals }
        })
        .collect();
    let request = ExportRequest {
        level_name: &level_name,
        files: &files,
        level: &level.level,
        level_digest: level.digest,
        version: env!("CARGO_PKG_VERSION"),
        values: &values,
        models: &foliage.models(),
        numbers: &foliage.numbers(level),
    };
    let exported = kiln_scene::export(&request).map_err(|error| TaskError::Refused { reason: error.to_string() })?;
    let warnings = [level.level.warnings.clone(), filled, foliage.warnings(level), exported.warnings].concat();
    let pack = super::pack::pack(level, &values, &foliage, regions.as_ref())?;
    let warnings = warnings.into_iter().chain(pack.iter().filter_map(|pack| pack.warning.clone())).collect();
    let mut summary = summary(level, &indices, &solutions, &foliage, warnings);
    summary.trace.rays += regions.as_ref().map_or(0, |models| models.summary.rays);
    summary.regions = regions.map(|models| models.summary);
    let (file, bytes) = (Digest::of(&exported.glb), exported.glb.len() as u64);
    let (pack, packed) = pack.map(|pack| (pack.file, pack.bytes)).unzip();
    let baked = Baked { file, bytes, pack, summary };
    let attachments = std::iter::once(exported.glb).chain(packed).collect();
    Ok(TaskOutput { result: codec::encode(&baked), attachments, rays: 0 })
}

fn load_solutions(outputs: &Outputs, artefacts: &dyn Artefacts) -> Result<(Vec<u32>, Vec<Solution>), TaskError> {
    let (indices, digests): (Vec<u32>, Vec<Digest>) = outputs.solutions.iter().copied().unzip();
    let decode = |bytes: &Bytes| Ok(codec::decode("a solution", bytes)?);
    let solutions: Result<_, TaskError> = artefacts.get_once(&digests)?.par_iter().map(decode).collect();
    Ok((indices, solutions?))
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

fn summary(
    level: &LoadedLevel,
    indices: &[u32],
    solutions: &[Solution],
    foliage: &FoliageOutputs,
    warnings: Vec<Warning>,
) -> BakeSummary {
    let lods = lods(level, indices, solutions);
    let is_lod = |index: &u32| level.level.instances[*index as usize].is_lod();
    let (indices, solutions): (Vec<u32>, Vec<&Solution>) =
        indices.iter().zip(solutions).filter(|(index, _)| !is_lod(index)).map(|(i, s)| (*i, s)).unzip();
    let (indices, solutions) = (&indices[..], &solutions[..]);
    let mut trace = TraceSummary::default();
    solutions.iter().for_each(|solution| trace.merge(&solution.summary.trace));
    trace.rays_skipped_duplicate = rays_of_duplicates(level, indices, solutions);
    foliage.add_to(&mut trace);
    let mesh = |(&index, solution): (&u32, &&Solution)| {
        let instance = &level.level.instances[index as usize];
        let mesh = level.level.meshes[instance.mesh as usize].name.clone();
        let solve = solution.summary.clone();
        let coarse_centers_m = centers_m(level, instance, &solve.too_coarse);
        MeshSummary { node: instance.name.clone(), mesh, solve, coarse_centers_m }
    };
    BakeSummary {
        level: level.digest,
        counts: level.level.counts.clone(),
        sampling: level.level.sampling.clone(),
        trace,
        trace_lanes: solutions.iter().flat_map(|solution| &solution.summary.trace_lanes).cloned().collect(),
        beyond_reach: beyond_reach(level, indices, solutions),
        error: level_error(solutions, level.level.sampling.kernel.channel_count()),
        meshes: indices.iter().zip(solutions).map(mesh).collect(),
        foliage: foliage.summary(level),
        lods,
        regions: None,
        warnings,
    }
}

/// Totals of lower levels of detail.
fn lods(level: &LoadedLevel, indices: &[u32], solutions: &[Solution]) -> LodSummary {
    let mut lods = LodSummary::default();
    for (index, solution) in indices.iter().zip(solutions) {
        let instance = &level.level.instances[*index as usize];
        if instance.is_lod() {
            let (mesh, trace) = (&level.level.meshes[instance.mesh as usize], &solution.summary.trace);
            lods.instances += 1;
            lods.vertices += u64::from(mesh.vertex_count);
            lods.faces += u64::from(mesh.face_count);
            lods.samples += trace.samples;
            lods.invalid += trace.invalid;
            lods.rays += trace.rays;
        }
    }
    lods
}

/// World-space centres of the faces that are listed as too coarse; those of a mesh that has no such face are left out.
fn centers_m(level: &LoadedLevel, instance: &Instance, coarse: &CoarseFaces) -> Vec<[f64; 3]> {
    let mesh = &level.meshes[instance.mesh as usize];
    let center = |face: usize| {
        let center = mesh.corners(face).iter().map(|corner| corner.as_dvec3()).sum::<DVec3>() / 3.0;
        (instance.world_from_object.transform_point3(center) + level.level.origin_m).to_array()
    };
    coarse.worst.iter().map(|coarse| coarse.face as usize).filter(|face| *face < mesh.faces.len()).map(center).collect()
}

/// What faces would have cost that repeat others and were left out: as much as those of their instance did on average.
fn rays_of_duplicates(level: &LoadedLevel, indices: &[u32], solutions: &[&Solution]) -> u64 {
    let of = |(&index, solution): (&u32, &&Solution)| {
        let mesh = &level.level.meshes[level.level.instances[index as usize].mesh as usize];
        let rays = u128::from(solution.summary.trace.rays) * u128::from(mesh.duplicate_faces);
        u64::try_from(rays / u128::from(mesh.face_count.max(1))).unwrap_or(u64::MAX)
    };
    indices.iter().zip(solutions).map(of).sum()
}

fn beyond_reach(level: &LoadedLevel, indices: &[u32], solutions: &[&Solution]) -> BeyondReach {
    let instances = level.level.instances.iter().enumerate();
    let left_out: Vec<&Instance> = instances.filter(|(index, _)| !level.is_traced(*index)).map(|(_, i)| i).collect();
    let reach = level.reach();
    let in_scene = level.level.instances.iter().filter(|instance| !instance.is_lod()).count();
    // Beyond the reach of a whole instance lies more than what its samples are told of.
    let cut = |(&index, solution): (&u32, &&Solution)| {
        let occluders = reach.group(index as usize).map(|group| reach.occluders(group).len());
        let is_all = occluders.is_none_or(|count| count == in_scene);
        let trace = &solution.summary.trace;
        if is_all { trace.rays_cut } else { trace.rays }
    };
    BeyondReach {
        instances: left_out.len() as u64,
        faces: left_out.iter().map(|i| u64::from(level.level.meshes[i.mesh as usize].face_count)).sum(),
        rays_cut: indices.iter().zip(solutions).map(cut).sum(),
    }
}

/// Error over the level for each channel.
fn level_error(solutions: &[&Solution], channels: usize) -> Vec<ErrorEstimate> {
    let of = |channel: usize| {
        let summaries = solutions.iter().map(|solution| &solution.summary);
        ErrorEstimate::of_level(summaries.filter_map(|s| Some((s.visible_area_m2, s.error.get(channel)?))))
    };
    (0..channels).map(of).collect()
}
