//! Export: the source with the baked values added, as one .glb.
//!
//! The document's JSON is edited as it stands and never goes through types, so that whatever Kiln doesn't know
//! survives; the source's binary data is the unchanged start of the output's, and new data follow it. Each instance
//! needs a mesh of its own that shares all accessors but its values: where every node that uses a mesh is baked, the
//! first keeps the mesh and the others get copies; where some are not, the mesh stays as it is and all baked nodes
//! get copies.

mod assign;
mod buffers;
mod numbers;
#[cfg(test)]
mod tests;
mod values;

use crate::{
    SceneError, SourceFiles,
    document::{Document, read_level},
    findings::{Finding, Findings},
    glb::{Glb, GlbError},
    limits,
    lods::Lods,
    scene::placements,
};
pub(crate) use assign::RESIDUAL;
use assign::assign;
use buffers::Binary;
use kiln_core::{Digest, Instance, Kernel, Level, MeshEntry, Warning};
pub use numbers::NumberedInstance;
pub(crate) use numbers::{GLOBAL, SCALAR};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// Values of one instance.
#[derive(Clone, Copy, Debug)]
pub struct BakedInstance<'a> {
    /// Index into [`Level::instances`].
    pub instance: usize,
    /// `vertices × channels` values from 0 to 1, in the order of the mesh's vertices.
    pub values: &'a [f32],
    /// Deviations in the same form, for `_AO_RESIDUAL`; not read where the level's output doesn't ask for them.
    pub residuals: &'a [f32],
}

/// Local AO of a model, which all its instances share.
#[derive(Clone, Copy, Debug)]
pub struct BakedModel<'a> {
    /// Index into [`Level::meshes`]; its instances have [`kiln_core::InstanceNumbers::Global`].
    pub mesh: usize,
    /// `vertices × channels` values from 0 to 1, in the order of the mesh's vertices.
    pub values: &'a [f32],
}

/// What to export.
#[derive(Clone, Copy)]
pub struct ExportRequest<'a> {
    /// The level's path in `files`.
    pub level_name: &'a str,
    /// The source that the level was imported from.
    pub files: &'a dyn SourceFiles,
    /// The level as imported.
    pub level: &'a Level,
    /// Its digest, which is recorded in the output.
    pub level_digest: Digest,
    /// Kiln's version, likewise.
    pub version: &'a str,
    /// Values, in any order. Instances without any keep what they had.
    pub values: &'a [BakedInstance<'a>],
    /// Values of models whose instances have numbers of their own, in any order.
    pub models: &'a [BakedModel<'a>],
    /// Numbers of instances that have no values, in any order.
    pub numbers: &'a [NumberedInstance<'a>],
}

/// The baked file.
#[derive(Clone, Debug)]
pub struct Exported {
    /// Bytes of the .glb.
    pub glb: Vec<u8>,
    /// What the export found worth saying.
    pub warnings: Vec<Warning>,
}

/// An instance that gets values.
#[derive(Clone, Copy)]
struct Target<'a> {
    instance: &'a Instance,
    entry: &'a MeshEntry,
    /// `vertices × channels`.
    values: &'a [f32],
    /// Likewise, if they are wanted.
    residuals: Option<&'a [f32]>,
}

/// A model that gets values, once for all its instances.
struct Model<'a> {
    target: Target<'a>,
    /// Node of each instance, and index within its EXT_mesh_gpu_instancing.
    nodes: Vec<(u32, Option<u32>)>,
}

/// Writes the source with the values added.
///
/// # Errors
/// As import; and [`SceneError::Mismatch`] where level and values don't belong to the source.
pub fn export(request: &ExportRequest<'_>) -> Result<Exported, SceneError> {
    let level_bytes = read_level(request.level_name, request.files)?;
    let document = Document::parse(request.level_name, &level_bytes, request.files)?;
    let targets = targets(request, &document)?;
    let models = models(request, &document)?;
    numbers::check(request.level, request.numbers)?;
    let mut findings = Findings::default();
    let mut root = document.root.clone();
    let mut binary = Binary::merge(&document, &mut root)?;
    assign(&document, request.level, &targets, &models, &mut root, &mut binary, &mut findings)?;
    numbers::write(&document, request.level, request.numbers, &mut root, &mut binary)?;
    write_links(&document, request.level, &mut root)?;
    record(request, &mut root, &mut findings);
    findings.add(Finding::ExternalImages, request.level_name, external_image_count(&document));
    let bytes = binary.finish(&mut root);
    let json = serde_json::to_vec(&root).map_err(|error| document.root().invalid(format!("as JSON: {error}")))?;
    let glb = Glb { json: &json, bin: bytes.as_deref(), other: document.other_chunks.clone(), bytes_after_end: 0 };
    let glb = glb.write().map_err(|error| too_long(&document, &error))?;
    Ok(Exported { glb, warnings: findings.into_warnings() })
}

/// Records at lower levels of detail that nothing in the document links what they stand for, so that readers of the output
/// know without the sidecar.
fn write_links(document: &Document<'_>, level: &Level, root: &mut Value) -> Result<(), SceneError> {
    let lods = Lods::find(document, &[], &mut Findings::default())?;
    let linked: BTreeSet<usize> = placements(document, &lods, &mut Findings::default())?
        .into_iter()
        .filter(|placement| placement.lod_of.is_some())
        .map(|placement| placement.node)
        .collect();
    for instance in level.instances.iter().filter(|instance| !linked.contains(&(instance.node as usize))) {
        let Some(full) = instance.lod_of.first().and_then(|full| level.instances.get(*full as usize)) else { continue };
        if let Some(kiln) = numbers::kiln_of(&mut root["nodes"][instance.node as usize]) {
            kiln["lod_of"] = json!(full.node);
        }
    }
    Ok(())
}

fn too_long(document: &Document<'_>, error: &GlbError) -> SceneError {
    let advice = "use --format u16, fewer half-distances, or split the level";
    match error {
        GlbError::TooLong(bytes) => document.root().too_big("bytes of output", *bytes, limits::GLB_BYTES, advice),
        other => document.root().invalid(other.to_string()),
    }
}

/// Images in files of their own, which the output goes on to refer to.
fn external_image_count(document: &Document<'_>) -> u64 {
    let images = document.root.get("images").and_then(Value::as_array).into_iter().flatten();
    let uris = images.filter_map(|image| image.get("uri")?.as_str());
    uris.filter(|uri| !uri.starts_with("data:")).count() as u64
}

/// Checks that the values fit the level, and the level the source; in the order of the level's instances.
fn targets<'a>(request: &ExportRequest<'a>, document: &Document<'_>) -> Result<Vec<Target<'a>>, SceneError> {
    let channels = request.level.sampling.kernel.channel_count();
    let mut sorted: Vec<&BakedInstance<'a>> = request.values.iter().collect();
    sorted.sort_by_key(|baked| baked.instance);
    let mut seen = BTreeSet::new();
    let mut targets = Vec::with_capacity(sorted.len());
    for baked in sorted {
        let mismatch = |problem: &str| SceneError::Mismatch { instance: baked.instance, problem: problem.to_owned() };
        let instance = request.level.instances.get(baked.instance).ok_or_else(|| mismatch("there is no such one"))?;
        let entry = request.level.meshes.get(instance.mesh as usize).ok_or_else(|| mismatch("it has no mesh"))?;
        if !seen.insert(baked.instance) {
            return Err(mismatch("it has values twice"));
        }
        let residuals = request.level.output.residual.then_some(baked.residuals);
        for (what, numbers) in [("value", Some(baked.values)), ("residual", residuals)] {
            let Some(numbers) = numbers else { continue };
            check_numbers(what, numbers, entry.vertex_count as usize, channels).map_err(|p| mismatch(&p))?;
        }
        let node = document.list("nodes")?.get(instance.node as usize);
        let mesh = node.and_then(|node| node.get("mesh")).and_then(|mesh| mesh.index().ok());
        if mesh != Some(entry.source_mesh as usize) {
            return Err(mismatch("the source has another mesh at its node"));
        }
        if !blocks_fit(document, entry)? {
            return Err(mismatch("the source has other primitives in its mesh"));
        }
        targets.push(Target { instance, entry, values: baked.values, residuals });
    }
    Ok(targets)
}

/// The models, each as a target at its first instance, with the nodes of all of them.
fn models<'a>(request: &ExportRequest<'a>, document: &Document<'_>) -> Result<Vec<Model<'a>>, SceneError> {
    let level = request.level;
    let channels = level.sampling.kernel.channel_count();
    let numbered: BTreeSet<usize> = request.numbers.iter().map(|numbered| numbered.instance).collect();
    let mut models = Vec::with_capacity(request.models.len());
    let mut sorted: Vec<&BakedModel<'a>> = request.models.iter().collect();
    sorted.sort_by_key(|model| model.mesh);
    for model in sorted {
        let has_it = |index: &usize| level.instances.get(*index).is_some_and(|i| i.mesh as usize == model.mesh);
        let instances: Vec<&Instance> = numbered.iter().filter(|i| has_it(i)).map(|i| &level.instances[*i]).collect();
        let (Some(instance), Some(entry)) = (instances.first(), level.meshes.get(model.mesh)) else { continue };
        let mismatch = |problem: String| SceneError::Mismatch {
            instance: numbered.iter().copied().find(has_it).unwrap_or(0),
            problem,
        };
        check_numbers("value", model.values, entry.vertex_count as usize, channels).map_err(mismatch)?;
        if !blocks_fit(document, entry)? {
            return Err(mismatch("the source has other primitives in its mesh".to_owned()));
        }
        let target = Target { instance, entry, values: model.values, residuals: None };
        models.push(Model {
            target,
            nodes: instances.iter().map(|instance| (instance.node, instance.gpu_instance)).collect(),
        });
    }
    Ok(models)
}

/// Checks that there is a finite number for each vertex and channel, or says what is wrong.
fn check_numbers(what: &str, numbers: &[f32], vertices: usize, channels: usize) -> Result<(), String> {
    if numbers.len() != vertices * channels {
        return Err(format!("it has {} {what}s for {vertices} vertices × {channels} channels", numbers.len()));
    }
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(()),
        false => Err(format!("a {what} is not finite")),
    }
}

/// Whether the primitives that get values are in the source, with as many vertices as the level says.
fn blocks_fit(document: &Document<'_>, entry: &MeshEntry) -> Result<bool, SceneError> {
    let accessors = document.list("accessors")?;
    let Some(mesh) = document.list("meshes")?.get(entry.source_mesh as usize) else { return Ok(false) };
    let primitives = mesh.list("primitives")?;
    let count_of = |primitive: u32| {
        let position = primitives.get(primitive as usize)?.get("attributes")?.get("POSITION")?;
        accessors.get(position.index().ok()?)?.get("count")?.index().ok()
    };
    Ok(entry.blocks.iter().all(|block| {
        let end = block.first_vertex.checked_add(block.vertex_count);
        let inside = end.is_some_and(|end| end <= entry.vertex_count);
        inside && block.primitives.iter().all(|&primitive| count_of(primitive) == Some(block.vertex_count as usize))
    }))
}

/// Records in `asset.extras.kiln` how the values came about.
fn record(request: &ExportRequest<'_>, root: &mut Value, findings: &mut Findings) {
    let mut kiln = json!({
        "version": request.version,
        "level": request.level_digest.to_string(),
        "attribute": request.level.output.attribute,
    });
    match &request.level.sampling.kernel {
        Kernel::Obscurance { half_distances_m } => kiln["half_distances_m"] = json!(half_distances_m),
        Kernel::Occlusion { ray_distance_m } if ray_distance_m.is_finite() => {
            kiln["ray_distance_m"] = json!(ray_distance_m);
        }
        Kernel::Occlusion { .. } => kiln["ray_distance_m"] = json!("inf"),
    }
    let extras = &mut root["asset"]["extras"];
    if extras.is_null() {
        *extras = json!({});
    }
    match extras.as_object_mut() {
        Some(extras) => {
            extras.insert("kiln".to_owned(), kiln);
        }
        None => findings.add(Finding::ExtrasNotAnObject, request.level_name, 1),
    }
}

/// The array of that name in an object, made if it isn't there.
fn array_mut<'v>(object: &'v mut Value, key: &str) -> Option<&'v mut Vec<Value>> {
    object.as_object_mut()?.entry(key).or_insert_with(|| json!([])).as_array_mut()
}
