//! Fit: the local AO of a model, and what its instances should have, to four numbers for each.

use super::{LoadedLevel, fit_lod, trees};
use crate::{Artefacts, TaskError, TaskOutput};
use kiln_bake::{
    ModelPoint, model_points, values_in_volume,
    volume::{Volume, VolumeBatch},
};
use kiln_core::{Digest, FitWork, InstanceNumbers, Mesh, PointValues, Solution, TreeFits, codec};
use kiln_solve::{
    AlternateParams, Alternated, ModelSample, ModelSamples, TreeError, TreeInstance, TreeModel, alternate,
    error_tables, fit_blended,
};
use rayon::prelude::*;

/// `inputs` are the model's local AO, then all batches of the volume, or the values at the points of all instances.
pub(super) fn run(
    work: &FitWork,
    inputs: &[Digest],
    level: &LoadedLevel,
    artefacts: &dyn Artefacts,
) -> Result<TaskOutput, TaskError> {
    let model = level.trees()?.model_of(work.mesh)?;
    if let Some(full) = &model.full {
        return fit_lod::run(work, full, inputs, level, artefacts);
    }
    let failed = |reason: String| TaskError::Failed { reason: format!("the model {}: {reason}", work.mesh) };
    let [local, rest @ ..] = inputs else { return Err(failed("it has no local AO".to_owned())) };
    let mesh = &level.meshes[work.mesh as usize];
    let local: Solution = codec::decode("a solution", &artefacts.get(*local)?)?;
    let points = model_points(mesh, level.level.sampling.seed);
    let (mut voxels, mut point_rays) = (0, 0);
    let values: Vec<Vec<f32>> = if model.is_traced {
        let decode = |bytes: &bytes::Bytes| codec::decode::<PointValues>("values at points", bytes);
        let runs: Vec<PointValues> = artefacts.get_many(rest)?.iter().map(decode).collect::<Result<_, _>>()?;
        point_rays = runs.iter().map(|run| run.rays).sum();
        let of_instance = (points.len() * level.level.sampling.kernel.channel_count()).max(1);
        runs.iter().flat_map(|run| run.values.chunks(of_instance)).map(<[f32]>::to_vec).collect()
    } else {
        let volume = level.volume(rest, artefacts)?;
        voxels = volume.layout().voxel_count() as u64;
        let place = |index: &u32| &level.level.instances[*index as usize].world_from_object;
        model.instances.par_iter().map(|index| values_in_volume(&volume, &points, place(index))).collect()
    };
    if values.len() != model.instances.len() {
        return Err(failed(format!("{} instances have values, of {}", values.len(), model.instances.len())));
    }
    let keys = model.instances.iter().map(|index| trees::key(&level.level.instances[*index as usize]));
    let instances: Vec<TreeInstance<'_>> =
        keys.zip(&values).map(|(key, values)| TreeInstance { key, values }).collect();
    let fit = Fitting { mesh, points: &points, local: &local, level, instances: &instances };
    let fits = fit.run().map_err(|error| failed(error.to_string()))?;
    let fits = TreeFits { voxels, point_rays, ..fits };
    Ok(TaskOutput { result: codec::encode(&fits), attachments: Vec::new(), rays: 0 })
}

struct Fitting<'a> {
    mesh: &'a Mesh,
    points: &'a [ModelPoint],
    local: &'a Solution,
    level: &'a LoadedLevel,
    instances: &'a [TreeInstance<'a>],
}

impl Fitting<'_> {
    fn run(&self) -> Result<TreeFits, TreeError> {
        let settings = &self.level.level.solve;
        let channels = self.local.channels as usize;
        let samples = self.samples()?;
        // A model none of whose samples is valid has nothing of its own.
        let own = if self.local.unsampled { vec![1.0; self.local.values.len()] } else { self.local.values.clone() };
        let model = TreeModel { mesh: self.mesh, samples: &samples, local: &own, channels };
        let params = AlternateParams {
            regularization: settings.regularization,
            anchor: settings.anchor,
            weld_degrees: settings.weld_degrees,
            ..AlternateParams::default()
        };
        let found = alternate(&model, self.instances, &params)?;
        let errors = error_tables(&model, self.instances, &found)?;
        let blend = self.blend(channels);
        let local = samples.local(&found.local, channels)?;
        let numbers = (0..self.instances.len()).into_par_iter().map(|index| {
            let blended = fit_blended(&samples, &local, self.instances[index].values, &blend)?.y;
            Ok(InstanceNumbers::Global { channels: of_instance(&found, index), blend: blended })
        });
        let numbers = numbers.collect::<Result<_, TreeError>>()?;
        Ok(TreeFits {
            channels: channels as u32,
            local: found.local,
            numbers,
            errors: errors.total,
            instance_errors: errors.instances,
            trace: self.local.summary.trace,
            trace_lanes: self.local.summary.trace_lanes.clone(),
            voxels: 0,
            point_rays: 0,
            is_lod: false,
        })
    }

    fn samples(&self) -> Result<ModelSamples, TreeError> {
        let sample = |point: &ModelPoint| ModelSample {
            face: point.face,
            phi: point.phi,
            position: point.position,
            weight: point.area_m2,
        };
        ModelSamples::new(self.mesh, &self.points.iter().map(sample).collect::<Vec<_>>())
    }

    /// Weight of each channel, 1 in all.
    fn blend(&self, channels: usize) -> Vec<f64> {
        let given = self.level.level.output.blend.as_ref().filter(|blend| blend.len() == channels);
        let weights = given.cloned().unwrap_or_else(|| vec![1.0; channels]);
        let sum: f64 = weights.iter().sum();
        weights.iter().map(|weight| weight / sum).collect()
    }
}

fn of_instance(found: &Alternated, index: usize) -> Vec<[f32; 4]> {
    found.fits[index * found.channels..][..found.channels].iter().map(|fit| fit.y).collect()
}

/// Batches as the volume that they are of.
pub(super) fn assemble(
    level: &LoadedLevel,
    batches: &[Digest],
    artefacts: &dyn Artefacts,
) -> Result<Volume, TaskError> {
    let decode = |bytes: &bytes::Bytes| Ok(codec::decode::<VolumeBatch>("a batch of the volume", bytes)?);
    let batches: Vec<VolumeBatch> =
        artefacts.get_many(batches)?.par_iter().map(decode).collect::<Result<_, TaskError>>()?;
    let channels = level.level.sampling.kernel.channel_count();
    Volume::assemble(level.trees()?.layout.clone(), channels, &batches)
        .map_err(|error| TaskError::Failed { reason: format!("the volume around trees: {error}") })
}
