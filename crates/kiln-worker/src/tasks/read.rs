//! Read: finished values around shrubs and decorators to one number for each.

use super::{LoadedLevel, SceneTracer, counted::Counted, out_of_range, trees};
use crate::{Artefacts, TaskError, TaskOutput};
use kiln_bake::{BakedInstance, BakedSurface, DecoratorScalar, DecoratorSettings, read_decorators};
use kiln_core::{Digest, InstanceNumbers, ReadWork, Solution, codec};

/// `inputs` are the values of the instances around, in their order.
pub(super) fn run(
    work: &ReadWork,
    inputs: &[Digest],
    level: &LoadedLevel,
    (_, tracer): &SceneTracer,
    artefacts: &dyn Artefacts,
) -> Result<TaskOutput, TaskError> {
    let failed = |reason: String| TaskError::Failed { reason };
    let scalars = &level.trees()?.scalars;
    let end = work.first.saturating_add(work.count);
    let run = scalars.get(work.first as usize..end as usize).ok_or_else(|| out_of_range("shrub or decorator", end))?;
    let near = level.near(work.first)?;
    if near.len() != inputs.len() {
        return Err(failed(format!("{} instances are near, but {} have values", near.len(), inputs.len())));
    }
    let solutions: Vec<Solution> =
        artefacts.get_many(inputs)?.iter().map(|bytes| codec::decode("a solution", bytes)).collect::<Result<_, _>>()?;
    let mut baked: Vec<Option<BakedInstance<'_>>> = vec![None; level.level.instances.len()];
    for (index, solution) in near.iter().zip(&solutions).filter(|(_, solution)| !solution.unsampled) {
        let (instance, mesh) = level.instance(*index)?;
        let world_from_object = instance.world_from_object;
        baked[*index as usize] = Some(BakedInstance { mesh, world_from_object, values: &solution.values });
    }
    let channels = level.level.sampling.kernel.channel_count();
    let surface = BakedSurface::new(channels, &baked).map_err(|error| failed(error.to_string()))?;
    let decorators: Vec<_> = run.iter().map(|index| trees::decorator(&level.level, *index)).collect();
    let settings = DecoratorSettings { seed: level.level.sampling.seed, ..DecoratorSettings::default() };
    let read = read_decorators(&Counted(&**tracer), &surface, &decorators, &settings);
    let read = read.map_err(|error| TaskError::from(&error))?;
    let numbers: Vec<InstanceNumbers> = read.iter().map(|scalar| number(scalar, channels)).collect();
    let rays = decorators.len() as u64 * u64::from(settings.directions);
    Ok(TaskOutput { rays, result: codec::encode(&numbers), attachments: Vec::new() })
}

#[expect(clippy::cast_possible_truncation, reason = "values are f32")]
fn number(scalar: &DecoratorScalar, channels: usize) -> InstanceNumbers {
    let ao = scalar.ao[..channels].iter().map(|ao| *ao as f32).collect();
    InstanceNumbers::Scalar { ao, is_open: scalar.is_open }
}
