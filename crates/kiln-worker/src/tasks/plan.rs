//! Plan: a level to its task graph.

use super::{LoadedLevel, trees::is_read};
use crate::{TaskError, TaskOutput};
use glam::DAffine3;
use kiln_bake::FaceAreas;
use kiln_core::{Gets, Instance, PlanSpec, Sampling, codec};
use kiln_plan::{InstanceSampling, pieces};
use rayon::prelude::*;

pub(super) fn run(spec: &PlanSpec, level: &LoadedLevel) -> Result<TaskOutput, TaskError> {
    let settings = &level.level.sampling;
    let of_instance = |instance: &Instance| {
        let of = |settings: &Sampling| sampling(level, instance.mesh, &instance.world_from_object, settings);
        match instance {
            _ if is_read(instance) => of(settings),
            Instance { receives: true, gets: Gets::Vertices, .. } => {
                let faces = level.meshes[instance.mesh as usize].faces.len();
                of(&kiln_bake::lod_sampling(settings, faces))
            }
            _ => NONE,
        }
    };
    let instances: Vec<InstanceSampling> = level.level.instances.par_iter().map(of_instance).collect();
    let foliage = level.trees()?.plan(level, |mesh, place| sampling(level, mesh, place, settings));
    let graph = kiln_plan::plan(spec.level, &level.level, &spec.lane, &instances, &foliage, level.reach())
        .map_err(|error| TaskError::Refused { reason: error.to_string() })?;
    Ok(TaskOutput { result: codec::encode(&graph), attachments: Vec::new(), rays: 0 })
}

/// Of instances without values of their own.
const NONE: InstanceSampling = InstanceSampling { density_per_m2: 0.0, piece_samples: Vec::new() };

fn sampling(level: &LoadedLevel, mesh: u32, place: &DAffine3, settings: &Sampling) -> InstanceSampling {
    let mesh = &level.meshes[mesh as usize];
    let areas = FaceAreas::new(mesh, place);
    let density_per_m2 = kiln_bake::density(&areas, settings);
    let sides = |face: usize| if mesh.group(face).double_sided { 2 } else { 1 };
    let samples = |face: usize| u64::from(areas.samples(face, density_per_m2, settings)) * sides(face);
    let piece = |range: std::ops::Range<u32>| range.map(|face| samples(face as usize)).sum();
    InstanceSampling { density_per_m2, piece_samples: pieces(mesh.faces.len() as u32).map(piece).collect() }
}
