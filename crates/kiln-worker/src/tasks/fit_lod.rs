//! Fit of a lower level of detail of trees: it has what the full model has. Its local AO is read from the full model's, as
//! that of other levels of detail is from finished values; the numbers of its instances are those of the instances that they
//! stand for, as functions of a place in its own box.

use super::{LoadedLevel, counted::Counted, trees::Full};
use crate::{Artefacts, TaskError, TaskOutput};
use glam::{DAffine3, DVec3};
use kiln_bake::{BakedInstance, BakedSurface, FaceAreas, Piece, lod_sampling, resample_lod};
use kiln_core::{Bounds, Digest, FitWork, InstanceNumbers, Mesh, Solution, TraceSummary, TreeErrors, TreeFits, codec};
use kiln_solve::SolveInput;
use kiln_trace::{CpuTracer, MeshBvh, Scene, SceneObject};
use std::{collections::BTreeSet, sync::Arc};

/// `inputs` are the fits of the full model.
pub(super) fn run(
    work: &FitWork,
    full: &Full,
    inputs: &[Digest],
    level: &LoadedLevel,
    artefacts: &dyn Artefacts,
) -> Result<TaskOutput, TaskError> {
    let failed = |reason: String| TaskError::Failed { reason: format!("the level of detail {}: {reason}", work.mesh) };
    let [input] = inputs else { return Err(failed("it has no full model".to_owned())) };
    let fits: TreeFits = codec::decode("fits of trees", &artefacts.get(*input)?)?;
    let [of_lod, of_full] = [work.mesh, full.mesh].map(|mesh| level.level.meshes[mesh as usize].bounds);
    let numbers = full.instances.iter().map(|index| {
        let numbers = fits.numbers.get(*index)?;
        let InstanceNumbers::Global { channels, blend } = numbers else { return None };
        let of = |y: &[f32; 4]| in_box(*y, &of_full, &of_lod, &full.full_from_lod);
        Some(InstanceNumbers::Global { channels: channels.iter().map(of).collect(), blend: of(blend) })
    });
    let numbers: Option<Vec<InstanceNumbers>> = numbers.collect();
    let numbers = numbers.ok_or_else(|| failed("the full model has other instances".to_owned()))?;
    let solution = local(level, work.mesh, full, &fits)?;
    let no_errors =
        vec![TreeErrors { global_only: 0.0, local_global: 0.0, alternated: 0.0, weight: 0.0 }; fits.errors.len()];
    let fits = TreeFits {
        channels: fits.channels,
        local: solution.values,
        instance_errors: vec![no_errors.clone(); numbers.len()],
        numbers,
        errors: no_errors,
        trace: TraceSummary::default(),
        trace_lanes: BTreeSet::new(),
        voxels: 0,
        point_rays: 0,
        is_lod: true,
    };
    Ok(TaskOutput { result: codec::encode(&fits), attachments: Vec::new(), rays: 0 })
}

/// The local AO of the lower level, in the full model's object space.
fn local(level: &LoadedLevel, mesh: u32, full: &Full, fits: &TreeFits) -> Result<Solution, TaskError> {
    let failed = |reason: String| TaskError::Failed { reason: format!("the level of detail {mesh}: {reason}") };
    let [lod_mesh, full_mesh] = [mesh, full.mesh].map(|mesh| &level.meshes[mesh as usize]);
    let whole = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
    // All faces, those that rays go through too.
    let tree = Arc::new(MeshBvh::build_whole(full_mesh));
    let tracer = CpuTracer::new(Arc::new(Scene::build(vec![tree], &[whole])));
    let baked = BakedInstance { mesh: full_mesh, world_from_object: DAffine3::IDENTITY, values: &fits.local };
    let surface =
        BakedSurface::new(fits.channels as usize, &[Some(baked)]).map_err(|error| failed(error.to_string()))?;
    let sampling = lod_sampling(&level.level.sampling, lod_mesh.faces.len());
    let piece = Piece {
        mesh: lod_mesh,
        world_from_object: &full.full_from_lod,
        faces: 0..lod_mesh.faces.len(),
        density_per_m2: kiln_bake::density(&FaceAreas::new(lod_mesh, &full.full_from_lod), &sampling),
        sampling: &sampling,
        occluders_m: Bounds::EMPTY,
    };
    let moments = resample_lod(&Counted(&tracer), &surface, &piece).map_err(|error| TaskError::from(&error))?;
    let mut settings = level.level.solve.clone();
    settings.rays_per_sample = sampling.rays_per_sample;
    let input =
        SolveInput { mesh: lod_mesh, world_from_object: full.full_from_lod, moments: &moments, settings: &settings };
    let mut solution = kiln_solve::solve(&input).map_err(|error| failed(error.to_string()))?;
    if solution.unsampled {
        solution.values = mean(full_mesh, &fits.local, lod_mesh.positions.len());
    }
    Ok(solution)
}

/// Where nothing could be read, the mean of the full model's vertices.
#[expect(clippy::cast_possible_truncation, reason = "values are f32")]
fn mean(full: &Mesh, local: &[f32], vertices: usize) -> Vec<f32> {
    let count = full.positions.len().max(1);
    let channels = local.len() / count;
    let of = |channel: usize| local.iter().skip(channel).step_by(channels).map(|ao| f64::from(*ao)).sum::<f64>();
    let means: Vec<f32> = (0..channels).map(|channel| (of(channel) / count as f64) as f32).collect();
    means.repeat(vertices)
}

/// The same linear function of a place in another box: u of a point is its place in its box, from −1 to 1 on each axis.
#[expect(clippy::cast_possible_truncation, reason = "numbers are f32")]
fn in_box(y: [f32; 4], of_full: &Bounds, of_lod: &Bounds, full_from_lod: &DAffine3) -> [f32; 4] {
    let half = |bounds: &Bounds| 0.5 * (bounds.max - bounds.min);
    let (half_full, half_lod) = (half(of_full), half(of_lod));
    // Where the box is flat the place is 0.
    let slope = DVec3::from_array(std::array::from_fn(|axis| {
        if half_full[axis] > 0.0 { f64::from(y[axis + 1]) / half_full[axis] } else { 0.0 }
    }));
    let center = full_from_lod.transform_point3(of_lod.center()) - of_full.center();
    let along = full_from_lod.matrix3.transpose() * slope * half_lod;
    [f64::from(y[0]) + slope.dot(center), along.x, along.y, along.z].map(|y| y as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_function_is_the_same_in_another_box() {
        let full = Bounds { min: DVec3::new(-1.0, 0.0, -2.0), max: DVec3::new(3.0, 6.0, 2.0) };
        let lod = Bounds { min: DVec3::new(-0.8, 0.5, -1.0), max: DVec3::new(2.0, 5.0, 1.5) };
        let full_from_lod = DAffine3::from_scale_rotation_translation(
            DVec3::splat(1.1),
            glam::DQuat::from_rotation_y(0.3),
            DVec3::new(0.1, 0.2, -0.1),
        );
        let y = [0.5, 0.1, -0.2, 0.3];
        let at = |y: [f32; 4], bounds: &Bounds, point: DVec3| {
            let u = (point - bounds.center()) / (0.5 * (bounds.max - bounds.min));
            f64::from(y[0]) + f64::from(y[1]) * u.x + f64::from(y[2]) * u.y + f64::from(y[3]) * u.z
        };
        let moved = in_box(y, &full, &lod, &full_from_lod);
        for point in [lod.min, lod.max, DVec3::new(0.3, 1.0, 0.2)] {
            let (here, there) = (at(moved, &lod, point), at(y, &full, full_from_lod.transform_point3(point)));
            assert!((here - there).abs() < 1e-6, "{here} {there}");
        }
    }

    #[test]
    fn nothing_read_is_the_mean() {
        let full = Mesh { positions: vec![[0.0; 3]; 2], ..Mesh::default() };
        assert_eq!(mean(&full, &[0.2, 0.4, 0.4, 0.8], 3), [0.3, 0.6, 0.3, 0.6, 0.3, 0.6].map(|x: f32| x));
    }
}
