//! Plan: a level to its task graph.

use super::LoadedLevel;
use crate::{TaskError, TaskOutput};
use kiln_bake::FaceAreas;
use kiln_core::{Instance, PlanSpec, codec};
use kiln_plan::{InstanceSampling, pieces};
use rayon::prelude::*;

pub(super) fn run(spec: &PlanSpec, level: &LoadedLevel) -> Result<TaskOutput, TaskError> {
    let sampling: Vec<InstanceSampling> = level.level.instances.par_iter().map(|i| sampling(level, i)).collect();
    let graph = kiln_plan::plan(spec.level, &level.level, &spec.lane, &sampling, level.reach())
        .map_err(|error| TaskError::Refused { reason: error.to_string() })?;
    Ok(TaskOutput { result: codec::encode(&graph), attachments: Vec::new(), rays: 0 })
}

fn sampling(level: &LoadedLevel, instance: &Instance) -> InstanceSampling {
    if !instance.receives {
        return InstanceSampling { density_per_m2: 0.0, piece_samples: Vec::new() };
    }
    let (mesh, settings) = (&level.meshes[instance.mesh as usize], &level.level.sampling);
    let areas = FaceAreas::new(mesh, &instance.world_from_object);
    let density_per_m2 = kiln_bake::density(&areas, settings);
    let sides = |face: usize| if mesh.group(face).double_sided { 2 } else { 1 };
    let samples = |face: usize| u64::from(areas.samples(face, density_per_m2, settings)) * sides(face);
    let piece = |range: std::ops::Range<u32>| range.map(|face| samples(face as usize)).sum();
    InstanceSampling { density_per_m2, piece_samples: pieces(mesh.faces.len() as u32).map(piece).collect() }
}
