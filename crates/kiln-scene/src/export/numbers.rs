//! Numbers of instances: in the extras of a node, or as attributes of its EXT_mesh_gpu_instancing.
//!
//! A tree has `ao_global`, for each half-distance the y0 to y3 of `y0 + y1 u + y2 v + y3 w`, by which the local AO at its
//! mesh's vertices (`_AO`) is multiplied, and `ao_global_blend` for their blend; (u, v, w) is the place within the box that
//! `extras.kiln.ao_box` of the mesh gives in its object space, each from −1 to 1. Shrubs and decorators have `ao`, a number for
//! each half-distance. As attributes of instances these are `_AO_GLOBAL_0`, `_AO_GLOBAL_1`…, `_AO_GLOBAL_BLEND`, and
//! `_AO_SCALAR`.

use super::{
    array_mut,
    buffers::{Attributes, Binary},
};
use crate::{
    SceneError,
    document::Document,
    instancing::{EXTENSION, GpuInstances},
    limits,
};
use kiln_core::{Instance, InstanceNumbers, Level, MeshEntry, ValueFormat};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Names of the attributes and of what is in extras.
pub(crate) const GLOBAL: &str = "_AO_GLOBAL_";
pub(crate) const GLOBAL_BLEND: &str = "_AO_GLOBAL_BLEND";
pub(crate) const SCALAR: &str = "_AO_SCALAR";

/// Numbers of one instance.
#[derive(Clone, Copy, Debug)]
pub struct NumberedInstance<'a> {
    /// Index into [`Level::instances`].
    pub instance: usize,
    /// What it has in place of values at its vertices.
    pub numbers: &'a InstanceNumbers,
}

/// Checks that numbers fit the level.
pub(super) fn check(level: &Level, numbers: &[NumberedInstance<'_>]) -> Result<(), SceneError> {
    let channels = level.sampling.kernel.channel_count();
    for numbered in numbers {
        let mismatch = |problem: String| SceneError::Mismatch { instance: numbered.instance, problem };
        if numbered.instance >= level.instances.len() {
            return Err(mismatch("there is no such one".to_owned()));
        }
        let (count, is_finite) = match numbered.numbers {
            InstanceNumbers::Global { channels, blend } => {
                (channels.len(), channels.iter().chain([blend]).flatten().all(|y| y.is_finite()))
            }
            InstanceNumbers::Scalar { ao, .. } => (ao.len(), ao.iter().all(|ao| ao.is_finite())),
        };
        if count != channels {
            return Err(mismatch(format!("it has numbers for {count} channels of {channels}")));
        }
        if !is_finite {
            return Err(mismatch("a number is not finite".to_owned()));
        }
    }
    Ok(())
}

/// Writes the numbers of all instances.
pub(super) fn write(
    document: &Document<'_>,
    level: &Level,
    numbers: &[NumberedInstance<'_>],
    root: &mut Value,
    binary: &mut Binary,
) -> Result<(), SceneError> {
    let mut by_node: BTreeMap<u32, Vec<(&Instance, &InstanceNumbers)>> = BTreeMap::new();
    for numbered in numbers {
        let instance = &level.instances[numbered.instance];
        by_node.entry(instance.node).or_default().push((instance, numbered.numbers));
    }
    for (node, instances) in by_node {
        if instances[0].0.gpu_instance.is_some() {
            write_attributes(document, node as usize, &instances, root, binary)?;
        } else if let Some((_, numbers)) = instances.last() {
            write_extras(&mut root["nodes"][node as usize], numbers);
        }
    }
    Ok(())
}

fn write_extras(node: &mut Value, numbers: &InstanceNumbers) {
    let Some(kiln) = kiln_of(node) else { return };
    match numbers {
        InstanceNumbers::Global { channels, blend } => {
            kiln["ao_global"] = json!(channels);
            kiln["ao_global_blend"] = json!(blend);
        }
        InstanceNumbers::Scalar { ao, .. } => kiln["ao"] = json!(ao),
    }
}

/// `extras.kiln` of an object, made if it isn't there; `None` where the extras are no object.
pub(super) fn kiln_of(object: &mut Value) -> Option<&mut Value> {
    let extras = &mut object["extras"];
    if extras.is_null() {
        *extras = json!({});
    }
    let kiln = extras.as_object_mut()?.entry("kiln").or_insert_with(|| json!({}));
    kiln.is_object().then_some(kiln)
}

/// One value for each instance of a node. Those that got no numbers have those of an open place.
fn write_attributes(
    document: &Document<'_>,
    node: usize,
    instances: &[(&Instance, &InstanceNumbers)],
    root: &mut Value,
    binary: &mut Binary,
) -> Result<(), SceneError> {
    let nodes = document.list("nodes")?;
    let Some(item) = nodes.get(node) else { return Ok(()) };
    let count = GpuInstances::read(document, &item, limits::INSTANCES)?.map_or(0, |instances| instances.count);
    for (name, width, default, of) in columns(instances[0].1) {
        let mut values = default.repeat(count);
        for (instance, numbers) in instances {
            let at = instance.gpu_instance.unwrap_or(0) as usize * width;
            if let (Some(slot), Some(numbers)) = (values.get_mut(at..at + width), of(numbers)) {
                slot.copy_from_slice(&numbers);
            }
        }
        let mut attributes = Attributes::new(ValueFormat::F32, width);
        attributes.add_run(&values);
        let error = || document.root().invalid("accessors or bufferViews is no array");
        let accessor = binary.add_attributes(root, &attributes).ok_or_else(error)?[0];
        root["nodes"][node]["extensions"][EXTENSION]["attributes"][name] = json!(accessor);
    }
    Ok(())
}

/// Name, width, value of an open place, and how to read an instance's, of each attribute.
type Column = (String, usize, Vec<f32>, Box<dyn Fn(&InstanceNumbers) -> Option<Vec<f32>>>);

fn columns(numbers: &InstanceNumbers) -> Vec<Column> {
    match numbers {
        InstanceNumbers::Global { channels, .. } => {
            let open = vec![1.0, 0.0, 0.0, 0.0];
            let channel = |c: usize| -> Column {
                let of = move |numbers: &InstanceNumbers| match numbers {
                    InstanceNumbers::Global { channels, .. } => channels.get(c).map(|y| y.to_vec()),
                    InstanceNumbers::Scalar { .. } => None,
                };
                (format!("{GLOBAL}{c}"), 4, open.clone(), Box::new(of))
            };
            let blend = |numbers: &InstanceNumbers| match numbers {
                InstanceNumbers::Global { blend, .. } => Some(blend.to_vec()),
                InstanceNumbers::Scalar { .. } => None,
            };
            let last: Column = (GLOBAL_BLEND.to_owned(), 4, open.clone(), Box::new(blend));
            (0..channels.len()).map(channel).chain([last]).collect()
        }
        InstanceNumbers::Scalar { ao, .. } => {
            let of = |numbers: &InstanceNumbers| match numbers {
                InstanceNumbers::Scalar { ao, .. } => Some(ao.clone()),
                InstanceNumbers::Global { .. } => None,
            };
            vec![(SCALAR.to_owned(), ao.len(), vec![1.0; ao.len()], Box::new(of))]
        }
    }
}

/// Records in a mesh's extras in which box the numbers of its instances are functions.
pub(super) fn write_box(root: &mut Value, mesh: usize, entry: &MeshEntry) {
    let Some(mesh) = array_mut(root, "meshes").and_then(|meshes| meshes.get_mut(mesh)) else { return };
    let Some(kiln) = kiln_of(mesh) else { return };
    let corner = |corner: glam::DVec3| json!((corner + entry.center).to_array());
    kiln["ao_box"] = json!({ "min": corner(entry.bounds.min), "max": corner(entry.bounds.max) });
}
