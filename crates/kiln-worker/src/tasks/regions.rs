//! Regions: what can be seen from the valid points of some visibility regions, and the models of all.

use super::{LoadedLevel, SceneTracer, counted::Counted, out_of_range};
use crate::{Artefacts, TaskError, TaskOutput};
use bytes::Bytes;
use kiln_bake::{RegionGather, gather_regions};
use kiln_core::{Digest, ModelWork, RegionSamples, RegionsWork, codec};
use kiln_solve::region::{RegionError, Traced, model_points, region_points};
use rayon::prelude::*;

/// Results of tasks that are read at once.
const RUNS_AT_ONCE: usize = 256;

/// Traces some regions.
pub(super) fn trace(
    work: &RegionsWork,
    level: &LoadedLevel,
    (_, tracer): &SceneTracer,
) -> Result<TaskOutput, TaskError> {
    let end = work.first.saturating_add(work.count);
    let regions = level.level.regions.regions.get(work.first as usize..end as usize);
    let regions = regions.ok_or_else(|| out_of_range("region", end))?;
    let samples = gather_regions(&Counted(&**tracer), regions, &RegionGather::of(&level.level))
        .map_err(|error| TaskError::from(&error))?;
    Ok(TaskOutput { rays: samples.rays, result: codec::encode(&samples), attachments: Vec::new() })
}

/// Finds the models of all regions; `inputs` are their samples, in their order.
pub(super) fn model(
    work: &ModelWork,
    inputs: &[Digest],
    level: &LoadedLevel,
    artefacts: &dyn Artefacts,
) -> Result<TaskOutput, TaskError> {
    let regions = &level.level.regions;
    if regions.regions.len() != work.region_count as usize {
        return Err(out_of_range("region", work.region_count));
    }
    let failed =
        |error: RegionError| TaskError::Failed { reason: format!("the models of visibility regions: {error}") };
    let mut traced = Traced { rays: 0, dropped: 0, channels: level.level.sampling.kernel.channel_count() as u32 };
    let mut points = Vec::with_capacity(regions.regions.len());
    // What points saw is ten times what is made of it.
    for inputs in inputs.chunks(RUNS_AT_ONCE) {
        let decode = |bytes: &Bytes| codec::decode::<RegionSamples>("samples of regions", bytes);
        let runs: Vec<RegionSamples> =
            artefacts.get_many(inputs)?.par_iter().map(decode).collect::<Result<_, codec::DecodeError>>()?;
        for samples in runs {
            let rest = regions.regions.get(points.len()..).and_then(|rest| rest.get(..samples.valid.len()));
            let of_run = rest.ok_or_else(|| out_of_range("region", work.region_count))?;
            points.extend(region_points(of_run, &samples).map_err(failed)?);
            traced.add(&samples);
        }
    }
    let models = model_points(regions, points, traced).map_err(failed)?;
    Ok(TaskOutput { result: codec::encode(&models), attachments: Vec::new(), rays: 0 })
}
