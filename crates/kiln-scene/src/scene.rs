//! The node hierarchy: which meshes stand where, in f64, in the order of the hierarchy.
//!
//! The default scene is baked; a file with one scene needs no default; in one with several and no default, all
//! root nodes are. The hierarchy must be a forest, as glTF demands, and it is walked without recursion.

use crate::{
    SceneError,
    document::{Document, name_of},
    findings::{Finding, Findings},
    instancing::{GpuInstances, unit},
    json::{Item, List},
    limits,
    lods::Lods,
};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::collections::BTreeSet;

/// A mesh at a place.
#[derive(Clone, Debug)]
pub(crate) struct Placement {
    /// Index of the node.
    pub(crate) node: usize,
    /// Index within the node's EXT_mesh_gpu_instancing.
    pub(crate) gpu_instance: Option<u32>,
    /// Index of the mesh.
    pub(crate) mesh: usize,
    /// From object space to the file's world, metres.
    pub(crate) world_from_object: DAffine3,
    /// The full-detail node of which this is part of a lower level.
    pub(crate) lod_of: Option<usize>,
    /// The nodes at or above it that have lower levels.
    pub(crate) fulls: Vec<usize>,
}

/// A node that is to be visited.
struct Visit {
    node: usize,
    world_from_parent: DAffine3,
    lod_of: Option<usize>,
    fulls: Vec<usize>,
}

/// Every visible mesh of the scene, in the order of the hierarchy (parents first, children in their order), and those of lower
/// levels of detail where they stand.
pub(crate) fn placements(
    document: &Document<'_>,
    lods: &Lods,
    findings: &mut Findings,
) -> Result<Vec<Placement>, SceneError> {
    let nodes = document.list("nodes")?;
    let parents = parents(&nodes)?;
    check_forest(&nodes, &parents)?;
    let roots = roots(document, &nodes, &parents, lods, findings)?;
    let is_root: BTreeSet<usize> = roots.iter().copied().collect();
    let with_levels: BTreeSet<usize> = lods.full_nodes().collect();
    let visit = |node| Visit { node, world_from_parent: DAffine3::IDENTITY, lod_of: None, fulls: Vec::new() };
    let mut stack: Vec<Visit> = roots.into_iter().rev().map(visit).collect();
    let mut placements = Vec::new();
    while let Some(Visit { node: index, world_from_parent, lod_of, mut fulls }) = stack.pop() {
        let Some(node) = nodes.get(index) else { continue };
        if !is_visible(&node)? {
            continue;
        }
        let lod_of = lod_of.or(lods.full_of(index));
        if with_levels.contains(&index) {
            fulls.push(index);
        }
        if lod_of.is_none() {
            let elsewhere =
                lods.levels_of(index).iter().rev().filter(|l| parents[**l].is_none() && !is_root.contains(l));
            stack.extend(elsewhere.map(|&level| Visit {
                node: level,
                world_from_parent,
                lod_of: Some(index),
                fulls: Vec::new(),
            }));
        }
        let world = world_from_parent * local_transform(&node)?;
        for child in node.list("children")?.iter().collect::<Vec<_>>().iter().rev() {
            stack.push(Visit { node: child.index()?, world_from_parent: world, lod_of, fulls: fulls.clone() });
        }
        let place = Placement { node: index, gpu_instance: None, mesh: 0, world_from_object: world, lod_of, fulls };
        place_mesh(document, &node, &place, &mut placements)?;
    }
    if document.root().extension("CESIUM_RTC").is_some() {
        findings.add(Finding::RelativeToCenter, document.root().file(), 1);
    }
    Ok(placements)
}

/// The parent of each node; a node with two is refused.
fn parents(nodes: &List<'_>) -> Result<Vec<Option<usize>>, SceneError> {
    let mut parents = vec![None; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for child in node.list("children")?.iter() {
            let (child_index, _) = nodes.resolve(&child)?;
            if let Some(other) = parents[child_index].replace(index) {
                return Err(child.invalid(format!("node {child_index} is a child of nodes[{other}] already")));
            }
        }
    }
    Ok(parents)
}

/// Refuses cycles. With one parent at most for each node, a node is in or below a cycle exactly if no root leads
/// to it.
fn check_forest(nodes: &List<'_>, parents: &[Option<usize>]) -> Result<(), SceneError> {
    // 0: not looked at, 1: on the way up that is being walked, 2: leads to a root.
    let mut state = vec![0u8; parents.len()];
    for start in 0..parents.len() {
        let mut at = start;
        while state[at] == 0 {
            state[at] = 1;
            match parents[at] {
                Some(parent) => at = parent,
                None => break,
            }
        }
        if state[at] == 1 && parents[at].is_some() {
            let node = nodes.get(at).map(|node| node.invalid("it is among its own descendants"));
            return node.map_or(Ok(()), Err);
        }
        let mut up = Some(start);
        while let Some(node) = up.filter(|&node| state[node] != 2) {
            state[node] = 2;
            up = parents[node];
        }
    }
    Ok(())
}

fn roots(
    document: &Document<'_>,
    nodes: &List<'_>,
    parents: &[Option<usize>],
    lods: &Lods,
    findings: &mut Findings,
) -> Result<Vec<usize>, SceneError> {
    let scenes = document.list("scenes")?;
    let scene = match document.root().get("scene") {
        Some(reference) => Some(scenes.resolve(&reference)?.1),
        None if scenes.len() == 1 => scenes.get(0),
        None => None,
    };
    let Some(scene) = scene else {
        findings.add(Finding::NoDefaultScene, document.root().file(), scenes.len() as u64);
        let is_level = |node: &usize| lods.full_of(*node).is_some();
        return Ok((0..nodes.len()).filter(|node| parents[*node].is_none() && !is_level(node)).collect());
    };
    let mut roots = Vec::new();
    let mut seen = BTreeSet::new();
    for reference in scene.list("nodes")?.iter() {
        let (node, _) = nodes.resolve(&reference)?;
        if let Some(parent) = parents[node] {
            return Err(reference.invalid(format!("node {node} is no root: it is a child of nodes[{parent}]")));
        }
        if !seen.insert(node) {
            return Err(reference.invalid(format!("node {node} is in the scene twice")));
        }
        roots.push(node);
    }
    Ok(roots)
}

fn is_visible(node: &Item<'_>) -> Result<bool, SceneError> {
    node.extension("KHR_node_visibility").and_then(|e| e.get("visible")).map_or(Ok(true), |visible| visible.boolean())
}

/// A node's transform relative to its parent.
fn local_transform(node: &Item<'_>) -> Result<DAffine3, SceneError> {
    let parts = ["translation", "rotation", "scale"].map(|key| node.get(key));
    if let Some(matrix) = node.get("matrix") {
        if parts.iter().any(Option::is_some) {
            return Err(matrix.invalid("the node has a translation, rotation or scale besides"));
        }
        let m: [f64; 16] = matrix.numbers()?;
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            return Err(matrix.invalid("its last row is not 0 0 0 1, so it is no affine transform"));
        }
        let column = |i: usize| DVec3::new(m[i], m[i + 1], m[i + 2]);
        return Ok(DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(4), column(8)), column(12)));
    }
    let [translation, rotation, scale] = parts;
    let vector = |item: Option<Item<'_>>, default| item.map_or(Ok(default), |item| item.numbers().map(DVec3::from));
    let rotation = match rotation {
        None => DQuat::IDENTITY,
        Some(item) => {
            let quaternion = DQuat::from_array(item.numbers()?);
            unit(quaternion).ok_or_else(|| item.invalid("it is no rotation: its length is zero or not finite"))?
        }
    };
    let (scale, translation) = (vector(scale, DVec3::ONE)?, vector(translation, DVec3::ZERO)?);
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
}

/// Adds the placements of a node's mesh, if it has one: like `place`, but for the mesh and what EXT_mesh_gpu_instancing makes
/// of it.
fn place_mesh<'d>(
    document: &'d Document<'_>,
    node: &Item<'d>,
    place: &Placement,
    placements: &mut Vec<Placement>,
) -> Result<(), SceneError> {
    let (index, world) = (place.node, place.world_from_object);
    let Some(reference) = node.get("mesh") else { return Ok(()) };
    let (mesh, _) = document.list("meshes")?.resolve(&reference)?;
    let room = limits::INSTANCES - placements.len() as u64;
    let mut add = |gpu_instance, world_from_object: DAffine3| {
        if !world_from_object.is_finite() {
            let name = name_of(node, "node", index);
            return Err(node.invalid_with(
                format!("the transform of {name:?} from object to world is not finite"),
                "correct the transforms of the node and its parents",
            ));
        }
        placements.push(Placement { gpu_instance, mesh, world_from_object, ..place.clone() });
        Ok(())
    };
    let Some(instances) = GpuInstances::read(document, node, room)? else {
        if room == 0 {
            let limit = limits::INSTANCES;
            return Err(node.too_big("instances of meshes", limit + 1, limit, "split the level"));
        }
        return add(None, world);
    };
    for i in 0..instances.count {
        let local = instances.placing(i).map_or(DAffine3::from_scale(DVec3::NAN), |placing| placing.affine());
        add(Some(i as u32), world * local)?;
    }
    Ok(())
}
