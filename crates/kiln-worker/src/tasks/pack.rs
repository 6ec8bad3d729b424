//! The pack that an engine loads: everything that a bake makes, by `kiln-runtime`.

use super::{LoadedLevel, outputs::FoliageOutputs};
use crate::TaskError;
use glam::DVec3;
use kiln_core::{
    Digest, InstanceNumbers, Kernel, Level, MeshEntry, PackFile, RegionModels, Remap, ValueFormat, VertexBlock, Warning,
};
use kiln_runtime::{
    Pack,
    write::{
        EdgeData, MetaData, ModelData, ModelForms, PackData, RegionData, RegionsData, RemapData, ScalarData,
        TreeBlockData, TreeInstanceData, TreeModelData, ValueData, VertexSetData, WriteError, write,
    },
};
use kiln_scene::{BakedInstance, BakedModel, NumberedInstance};
use std::{borrow::Cow, collections::HashMap};

/// Writes a pack, if one is asked for or the level has regions.
pub(super) fn pack(
    level: &LoadedLevel,
    values: &[BakedInstance<'_>],
    foliage: &FoliageOutputs,
    regions: Option<&RegionModels>,
) -> Result<Option<Packed>, TaskError> {
    let of_level = &level.level;
    if !of_level.output.pack && regions.is_none() {
        return Ok(None);
    }
    let (models, numbers) = (foliage.models(), foliage.numbers(level));
    let model_of: HashMap<u32, u32> = models.iter().zip(0..).map(|(model, index)| (model.mesh as u32, index)).collect();
    let data = PackData {
        meta: meta(of_level, level.digest),
        vertex_sets: values.iter().flat_map(|values| vertex_sets(of_level, values)).collect(),
        tree_models: models.iter().map(|model| tree_model(of_level, model)).collect(),
        tree_instances: numbers.iter().filter_map(|numbered| tree_instance(of_level, numbered, &model_of)).collect(),
        scalars: numbers.iter().filter_map(|numbered| scalar(of_level, numbered)).collect(),
        regions: regions.map_or_else(no_regions, |models| regions_data(of_level, models)),
    };
    let failed = |reason: String| TaskError::Failed { reason: format!("the pack: {reason}") };
    let (bytes, warning) = write_in_forms(data).map_err(|error| failed(error.to_string()))?;
    let written = Pack::new(&bytes).map_err(|error| failed(error.to_string()))?;
    let sizes = written
        .sizes()
        .map(|size| {
            (size.kind.map_or_else(|| format!("section {}", size.number), |kind| kind.name().to_owned()), size.bytes)
        })
        .collect();
    let file = PackFile { digest: Digest::of(&bytes), bytes: bytes.len() as u64, sizes };
    Ok(Some(Packed { file, bytes, warning }))
}

/// A pack that was written.
pub(super) struct Packed {
    pub(super) file: PackFile,
    pub(super) bytes: Vec<u8>,
    pub(super) warning: Option<Warning>,
}

/// Models in both forms, or in the full one alone where slopes are beyond half floats: those of levels far smaller than a
/// metre.
fn write_in_forms(mut data: PackData<'_>) -> Result<(Vec<u8>, Option<Warning>), WriteError> {
    match write(&data) {
        Err(WriteError::Half { model }) => {
            data.regions.forms.engine = false;
            let region = &data.regions.models[model].region;
            let subject = data.regions.regions.get(*region as usize).map_or_else(String::new, |r| r.id.clone());
            let message = format!(
                "the model of the region {subject:?} changes so much in a metre that half floats cannot hold it: the pack has no models in \
                 the engine's form; bake the level in metres"
            );
            let warning = Warning { code: "engine_models".into(), subject, message, count: 1 };
            Ok((write(&data)?, Some(warning)))
        }
        written => Ok((written?, None)),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "f32 is what an engine takes")]
fn meta(level: &Level, digest: Digest) -> MetaData {
    let (kernel, distances) = match &level.sampling.kernel {
        Kernel::Obscurance { half_distances_m } => (kiln_runtime::Kernel::Obscurance, half_distances_m.clone()),
        Kernel::Occlusion { ray_distance_m } => (kiln_runtime::Kernel::Occlusion, vec![*ray_distance_m]),
    };
    let blend = level.output.blend.clone().filter(|blend| blend.len() == distances.len());
    MetaData {
        level_digest: digest.0,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        origin: level.origin_m.to_array(),
        kernel,
        blend: blend.unwrap_or_else(|| vec![1.0; distances.len()]).into_iter().map(|weight| weight as f32).collect(),
        half_distances: distances.into_iter().map(|distance| distance as f32).collect(),
        remap: match &level.output.remap {
            None => RemapData::None,
            Some(Remap::Gamma(gamma)) => RemapData::Gamma(*gamma as f32),
            Some(Remap::Curve(points)) => {
                RemapData::Curve(points.iter().map(|point| point.map(|x| x as f32)).collect())
            }
        },
    }
}

/// Values of a block's vertices, in the form that the level asks for.
fn of_block<'a>(level: &Level, values: &'a [f32], block: &VertexBlock) -> ValueData<'a> {
    let channels = level.sampling.kernel.channel_count();
    let (first, count) = (block.first_vertex as usize * channels, block.vertex_count as usize * channels);
    let values = values.get(first..).and_then(|rest| rest.get(..count)).unwrap_or_default();
    match level.output.format {
        ValueFormat::F32 => ValueData::F32(Cow::Borrowed(values)),
        ValueFormat::U16 => ValueData::normalised(values),
    }
}

fn vertex_sets<'a>(level: &'a Level, baked: &BakedInstance<'a>) -> impl Iterator<Item = VertexSetData<'a>> + use<'a> {
    let (instance, values) = (&level.instances[baked.instance], baked.values);
    level.meshes[instance.mesh as usize].blocks.iter().map(move |block| VertexSetData {
        node: instance.node,
        gpu_instance: instance.gpu_instance,
        primitives: block.primitives.clone(),
        values: of_block(level, values, block),
    })
}

fn tree_model<'a>(level: &Level, model: &BakedModel<'a>) -> TreeModelData<'a> {
    let mesh: &MeshEntry = &level.meshes[model.mesh];
    let (center, half) = (mesh.bounds.center() + mesh.center, (mesh.bounds.max - mesh.bounds.min) * 0.5);
    TreeModelData {
        mesh: mesh.source_mesh,
        center: center.as_vec3().to_array(),
        half_extent: half.as_vec3().to_array(),
        blocks: mesh
            .blocks
            .iter()
            .map(|block| TreeBlockData {
                primitives: block.primitives.clone(),
                values: of_block(level, model.values, block),
            })
            .collect(),
    }
}

fn tree_instance(
    level: &Level,
    numbered: &NumberedInstance<'_>,
    model_of: &HashMap<u32, u32>,
) -> Option<TreeInstanceData> {
    let instance = &level.instances[numbered.instance];
    let InstanceNumbers::Global { channels, blend } = numbered.numbers else { return None };
    Some(TreeInstanceData {
        node: instance.node,
        gpu_instance: instance.gpu_instance,
        model: *model_of.get(&instance.mesh)?,
        numbers: channels.clone(),
        blend: *blend,
    })
}

fn scalar(level: &Level, numbered: &NumberedInstance<'_>) -> Option<ScalarData> {
    let instance = &level.instances[numbered.instance];
    let InstanceNumbers::Scalar { ao, .. } = numbered.numbers else { return None };
    Some(ScalarData { node: instance.node, gpu_instance: instance.gpu_instance, values: ao.clone() })
}

const FORMS: ModelForms = ModelForms { full: true, engine: true };

fn no_regions() -> RegionsData {
    RegionsData { regions: Vec::new(), edges: Vec::new(), models: Vec::new(), forms: FORMS }
}

fn regions_data(level: &Level, models: &RegionModels) -> RegionsData {
    let point = |p: DVec3| p.as_vec3().to_array();
    let region = |(region, model): (&kiln_core::Region, &u32)| RegionData {
        id: region.id.clone(),
        min: point(region.bounds.min),
        max: point(region.bounds.max),
        model: *model,
    };
    let model = |(model, region): (&kiln_core::RegionModel, &u32)| ModelData {
        region: *region,
        center: point(DVec3::from_array(model.center)),
        coefficients: model.coefficients.clone(),
    };
    #[expect(clippy::cast_possible_truncation, reason = "f32 is what an engine takes")]
    let edge = |edge: &kiln_core::RegionEdge| EdgeData {
        regions: edge.regions,
        area_m2: edge.area_m2 as f32,
        center: point(edge.center),
    };
    RegionsData {
        regions: level.regions.regions.iter().zip(&models.model_of).map(region).collect(),
        edges: level.regions.edges.iter().map(edge).collect(),
        models: models.models.iter().zip(&models.region_of).map(model).collect(),
        forms: FORMS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn data(slope: f32) -> PackData<'static> {
        let meta = MetaData {
            level_digest: [0; 32],
            version: String::new(),
            origin: [0.0; 3],
            kernel: kiln_runtime::Kernel::Obscurance,
            half_distances: vec![2.0],
            blend: vec![1.0],
            remap: RemapData::None,
        };
        let region = RegionData { id: "hall".into(), min: [0.0; 3], max: [1e-6; 3], model: 0 };
        let coefficients = vec![[1.0, slope, 0.0, 0.0, 0.0, 0.0, 0.0]; 9];
        let model = ModelData { region: 0, center: [0.0; 3], coefficients };
        let regions = RegionsData { regions: vec![region], edges: Vec::new(), models: vec![model], forms: FORMS };
        PackData { regions, ..PackData::new(meta) }
    }

    #[test]
    fn models_that_half_floats_cannot_hold_have_the_full_form() {
        let (bytes, warning) = write_in_forms(data(5.0)).unwrap();
        assert!(warning.is_none() && Pack::new(&bytes).unwrap().engine_model(0).is_some());
        let (bytes, warning) = write_in_forms(data(1e6)).unwrap();
        let pack = Pack::new(&bytes).unwrap();
        assert!(pack.engine_model(0).is_none() && pack.full_model(0).is_some());
        assert!(warning.unwrap().message.contains("hall"));
        assert!(write_in_forms(data(f32::NAN)).is_err());
    }
}
