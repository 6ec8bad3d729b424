//! Gives each baked instance a mesh with its values, and expands nodes of EXT_mesh_gpu_instancing.

use super::{
    Model, Target, array_mut,
    buffers::{Attributes, Binary},
    numbers::write_box,
    values::{block_values, color_exists, color_width, colors, greys, of_block},
};
use crate::{
    SceneError,
    accessor::Accessor,
    document::{Document, name_of},
    findings::{Finding, Findings},
    instancing::{EXTENSION, GpuInstances},
    json::Item,
    limits,
};
use kiln_core::{Attribute, ColorMode, Level, VertexBlock};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// The attribute that says how far the signal strays from the values around a vertex.
pub(crate) const RESIDUAL: &str = "_AO_RESIDUAL";

/// The blocks of a target's vertices that primitives use.
fn blocks<'t>(target: &'t Target<'_>) -> impl Iterator<Item = &'t VertexBlock> {
    target.entry.blocks.iter().filter(|block| !block.primitives.is_empty())
}

/// Adds the values of all targets to `root` and `binary`.
pub(super) fn assign(
    document: &Document<'_>,
    level: &Level,
    targets: &[Target<'_>],
    models: &[Model<'_>],
    root: &mut Value,
    binary: &mut Binary,
    findings: &mut Findings,
) -> Result<(), SceneError> {
    let mut assigner = Assigner { document, level, root, binary, free: BTreeMap::new() };
    let by_node = group_by_node(targets);
    let mut baked: BTreeMap<u32, usize> = by_node.iter().map(|(node, targets)| (*node, targets.len())).collect();
    models.iter().flat_map(|model| &model.nodes).for_each(|(node, _)| *baked.entry(*node).or_default() += 1);
    assigner.find_free_meshes(&baked)?;
    for model in models {
        let mesh = assigner.mesh_for(&model.target)?;
        write_box(assigner.root, mesh, model.target.entry);
        model.nodes.iter().for_each(|(node, _)| assigner.root["nodes"][*node as usize]["mesh"] = json!(mesh));
    }
    let mut meshes = BTreeMap::new();
    for target in targets {
        let mesh = assigner.mesh_for(target)?;
        meshes.insert((target.instance.node, target.instance.gpu_instance), mesh);
    }
    for (&node, targets) in &by_node {
        if targets[0].instance.gpu_instance.is_some() {
            assigner.expand(node, &meshes, findings)?;
        } else if let Some(&mesh) = meshes.get(&(node, None)) {
            assigner.root["nodes"][node as usize]["mesh"] = json!(mesh);
        }
    }
    drop_unused_extension(root);
    Ok(())
}

/// The targets at each node, in the order of nodes.
fn group_by_node<'t, 'a>(targets: &'t [Target<'a>]) -> BTreeMap<u32, Vec<&'t Target<'a>>> {
    let mut by_node: BTreeMap<u32, Vec<&Target<'a>>> = BTreeMap::new();
    for target in targets {
        by_node.entry(target.instance.node).or_default().push(target);
    }
    by_node
}

/// Index of the mesh that each baked instance gets, by node and index within it.
type Meshes = BTreeMap<(u32, Option<u32>), usize>;

struct Assigner<'x, 'd> {
    document: &'x Document<'d>,
    level: &'x Level,
    root: &'x mut Value,
    binary: &'x mut Binary,
    /// Meshes of the source that only baked instances use, and whether one of them has not been given away yet.
    free: BTreeMap<usize, bool>,
}

impl Assigner<'_, '_> {
    /// Finds the meshes that no node uses but for baked ones: the first of these may change the mesh itself.
    fn find_free_meshes(&mut self, by_node: &BTreeMap<u32, usize>) -> Result<(), SceneError> {
        for (index, node) in self.document.list("nodes")?.iter().enumerate() {
            // A node outside the scene may refer to nothing: import didn't look at it, and it stays as it is.
            let Some(mesh) = node.get("mesh").and_then(|mesh| mesh.index().ok()) else { continue };
            let baked = by_node.get(&(index as u32)).copied().unwrap_or(0);
            let wanted = if node.extension(EXTENSION).is_some() && baked > 0 {
                GpuInstances::read(self.document, &node, limits::INSTANCES)?.map_or(1, |instances| instances.count)
            } else {
                1
            };
            let all_baked = self.free.entry(mesh).or_insert(true);
            *all_baked &= baked == wanted;
        }
        Ok(())
    }

    /// The mesh with a target's values: the source's own or a copy.
    fn mesh_for(&mut self, target: &Target<'_>) -> Result<usize, SceneError> {
        let source = target.entry.source_mesh as usize;
        let list = self.document.list("meshes")?;
        let item =
            list.get(source).ok_or_else(|| self.document.root().invalid(format!("there is no mesh {source}")))?;
        let mut mesh = item.value().clone();
        self.drop_residuals(target, &mut mesh);
        for (primitive, attribute, accessor) in self.accessors(target, &item)? {
            mesh["primitives"][primitive]["attributes"][attribute] = json!(accessor);
        }
        let free = self.free.get_mut(&source).is_some_and(std::mem::take);
        let meshes =
            array_mut(self.root, "meshes").ok_or_else(|| self.document.root().invalid("meshes is no array"))?;
        if free {
            meshes[source] = mesh;
            return Ok(source);
        }
        meshes.push(mesh);
        Ok(meshes.len() - 1)
    }

    /// Adds the values of a target; (primitive, attribute, accessor) for each primitive that gets some.
    fn accessors(
        &mut self,
        target: &Target<'_>,
        mesh: &Item<'_>,
    ) -> Result<Vec<(usize, &'static str, usize)>, SceneError> {
        let attribute = self.level.output.attribute;
        let mut assigned = Vec::new();
        if attribute != Attribute::Color {
            self.add_numbers(target, "_AO", target.values, &mut assigned)?;
        }
        if attribute != Attribute::Ao {
            for block in blocks(target) {
                self.add_colors(target, block, mesh, &mut assigned)?;
            }
        }
        if let Some(residuals) = target.residuals {
            self.add_numbers(target, RESIDUAL, residuals, &mut assigned)?;
        }
        Ok(assigned)
    }

    /// Adds `vertices × channels` numbers as an attribute, one component for each half-distance.
    fn add_numbers(
        &mut self,
        target: &Target<'_>,
        attribute: &'static str,
        numbers: &[f32],
        assigned: &mut Vec<(usize, &'static str, usize)>,
    ) -> Result<(), SceneError> {
        let channels = self.level.sampling.kernel.channel_count();
        let mut attributes = Attributes::new(self.level.output.format, channels);
        blocks(target).for_each(|block| attributes.add_run(of_block(numbers, block, channels)));
        for (block, accessor) in blocks(target).zip(self.add(&attributes)?) {
            assigned.extend(block.primitives.iter().map(|&primitive| (primitive as usize, attribute, accessor)));
        }
        Ok(())
    }

    /// Takes residuals of an earlier bake off the primitives that get values: they are not those of the new ones.
    fn drop_residuals(&self, target: &Target<'_>, mesh: &mut Value) {
        if self.level.output.attribute == Attribute::Color || target.residuals.is_some() {
            return;
        }
        for &primitive in blocks(target).flat_map(|block| &block.primitives) {
            let attributes = mesh["primitives"][primitive as usize]["attributes"].as_object_mut();
            attributes.and_then(|attributes| attributes.shift_remove(RESIDUAL));
        }
    }

    /// Adds the colours of a block's primitives; those without a colour, or with the same, share an accessor.
    fn add_colors(
        &mut self,
        target: &Target<'_>,
        block: &VertexBlock,
        mesh: &Item<'_>,
        assigned: &mut Vec<(usize, &'static str, usize)>,
    ) -> Result<(), SceneError> {
        let output = &self.level.output;
        let channels = self.level.sampling.kernel.channel_count();
        let greys = greys(block_values(target, block, channels), channels, output);
        let primitives = mesh.list("primitives")?;
        let mut added: BTreeMap<Option<usize>, usize> = BTreeMap::new();
        for &primitive in &block.primitives {
            let item = primitives.get(primitive as usize);
            let reference = item.and_then(|item| item.get("attributes")?.get("COLOR_0"));
            let existing = reference.as_ref().map(|item| Accessor::open(self.document, item)).transpose()?;
            let key = existing.as_ref().map(|accessor| accessor.index);
            let accessor = match added.get(&key) {
                Some(&accessor) => accessor,
                None => {
                    let mode = match (output.color, &reference) {
                        (None, Some(reference)) => return Err(color_exists(reference, &target.entry.name)),
                        (mode, _) => mode.unwrap_or(ColorMode::Replace),
                    };
                    let mut attributes = Attributes::new(output.format, color_width(existing.as_ref()));
                    attributes.add_run(&colors(&greys, existing.as_ref(), mode)?);
                    let accessor = self.add(&attributes)?[0];
                    added.insert(key, accessor);
                    accessor
                }
            };
            assigned.push((primitive as usize, "COLOR_0", accessor));
        }
        Ok(())
    }

    fn add(&mut self, attributes: &Attributes) -> Result<Vec<usize>, SceneError> {
        let error = || self.document.root().invalid("accessors or bufferViews is no array");
        self.binary.add_attributes(self.root, attributes).ok_or_else(error)
    }

    /// Puts a child node for each of its instances in the place of a node's mesh.
    fn expand(&mut self, index: u32, meshes: &Meshes, findings: &mut Findings) -> Result<(), SceneError> {
        let nodes = self.document.list("nodes")?;
        let Some(node) = nodes.get(index as usize) else { return Ok(()) };
        let Some(instances) = GpuInstances::read(self.document, &node, limits::INSTANCES)? else { return Ok(()) };
        let name = name_of(&node, "node", index as usize);
        let others = other_attributes(self.document, &node)?;
        let mut children = Vec::with_capacity(instances.count);
        for i in 0..instances.count {
            let Some(placing) = instances.placing(i) else { continue };
            let mut child = json!({
                "name": format!("{name}[{i}]"),
                "mesh": meshes.get(&(index, Some(i as u32))).map_or(node.value()["mesh"].clone(), |mesh| json!(mesh)),
                "translation": placing.translation.to_array(),
                "rotation": placing.rotation.to_array(),
                "scale": placing.scale.to_array(),
            });
            for key in ["skin", "weights"] {
                if let Some(value) = node.get(key) {
                    child[key] = value.value().clone();
                }
            }
            if !others.is_empty() {
                let values: Map<String, Value> =
                    others.iter().map(|(key, values)| (key.clone(), values[i].clone())).collect();
                child["extras"] = json!({ EXTENSION: values });
            }
            children.push(child);
        }
        findings.add(Finding::InstancingExpanded, &name, 1);
        self.replace_mesh(index as usize, children)
    }

    /// Removes a node's mesh and instancing, and adds children to it.
    fn replace_mesh(&mut self, index: usize, children: Vec<Value>) -> Result<(), SceneError> {
        let no_array = || self.document.root().invalid("nodes or children is no array");
        let nodes = array_mut(self.root, "nodes").ok_or_else(no_array)?;
        let first = nodes.len();
        let added = children.len();
        nodes.extend(children);
        let Some(node) = nodes[index].as_object_mut() else { return Err(no_array()) };
        for key in ["mesh", "skin", "weights"] {
            node.shift_remove(key);
        }
        if let Some(extensions) = node.get_mut("extensions").and_then(Value::as_object_mut) {
            extensions.shift_remove(EXTENSION);
            if extensions.is_empty() {
                node.shift_remove("extensions");
            }
        }
        let list = array_mut(&mut nodes[index], "children").ok_or_else(no_array)?;
        list.extend((first..first + added).map(|child| json!(child)));
        Ok(())
    }
}

/// Attributes of a node's instances besides their places, one value for each instance.
fn other_attributes(document: &Document<'_>, node: &Item<'_>) -> Result<Vec<(String, Vec<Value>)>, SceneError> {
    let Some(attributes) = node.extension(EXTENSION).and_then(|extension| extension.get("attributes")) else {
        return Ok(Vec::new());
    };
    let mut others = Vec::new();
    for key in attributes.object()?.keys() {
        if ["TRANSLATION", "ROTATION", "SCALE"].contains(&key.as_str()) {
            continue;
        }
        let Some(reference) = attributes.get(key) else { continue };
        let values = Accessor::open(document, &reference)?.numbers()?;
        let value = |element: Vec<f64>| if let [single] = element[..] { json!(single) } else { json!(element) };
        others.push((key.clone(), values.into_iter().map(value).collect()));
    }
    Ok(others)
}

/// Takes EXT_mesh_gpu_instancing off the lists of extensions if no node has it any more.
fn drop_unused_extension(root: &mut Value) {
    let has_it = |node: &Value| node.pointer("/extensions/EXT_mesh_gpu_instancing").is_some();
    if root.get("nodes").and_then(Value::as_array).is_some_and(|nodes| nodes.iter().any(has_it)) {
        return;
    }
    for key in ["extensionsUsed", "extensionsRequired"] {
        let Some(list) = root.get_mut(key).and_then(Value::as_array_mut) else { continue };
        list.retain(|name| name != EXTENSION);
        if list.is_empty()
            && let Some(root) = root.as_object_mut()
        {
            root.shift_remove(key);
        }
    }
}
