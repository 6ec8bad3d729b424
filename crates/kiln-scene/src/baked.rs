//! Reading a baked file back, for comparison and pictures: world-space triangles with their `_AO`.

use crate::{
    SceneError, SourceFiles,
    accessor::Accessor,
    composed::{Columns, Numbers},
    document::{Document, name_of, read_level},
    export::RESIDUAL,
    extensions::check_required,
    findings::Findings,
    json::Item,
    lods::Lods,
    material::{Material, materials},
    mesh::{Primitive, Topology},
    scene::{Placement, placements},
};
use glam::DVec3;
use kiln_core::FaceGroup;

/// A baked file: all triangles of its scene.
#[derive(Clone, Debug, PartialEq)]
pub struct BakedScene {
    /// Half-distances that the file records, metres; empty if it records none.
    pub half_distances_m: Vec<f64>,
    /// One for each primitive with triangles of each visible node, in the order of the hierarchy.
    pub parts: Vec<BakedPart>,
    /// Likewise of the nodes that are drawn in place of others.
    pub lods: Vec<BakedLod>,
    /// Why some primitives without `_AO` are not among the parts: they can't be read. A bake leaves such geometry
    /// alone where it is ignored or flattened.
    pub unreadable: Vec<SceneError>,
}

/// A primitive of a lower level of detail.
#[derive(Clone, Debug, PartialEq)]
pub struct BakedLod {
    /// The primitive.
    pub part: BakedPart,
    /// Indices into [`BakedScene::parts`] of what it is drawn in place of.
    pub lod_of: Vec<usize>,
}

/// A primitive of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct BakedPart {
    /// Name of the node, or `node N`; with `[i]` for an instance of EXT_mesh_gpu_instancing.
    pub node: String,
    /// Name of the mesh, or `mesh N`.
    pub mesh: String,
    /// Index of the primitive in the mesh.
    pub primitive: u32,
    /// World positions, metres; those that no face uses may be anything, even not finite.
    pub positions: Vec<DVec3>,
    /// Vertices of each face, counter-clockwise seen from the front in world space, in the order of the file. All
    /// are in range and finite: faces with others are left out. Degenerate faces are here.
    pub faces: Vec<[u32; 3]>,
    /// Both sides are seen.
    pub double_sided: bool,
    /// Components of `_AO`, or of the number that the instance has; 0 if there is neither.
    pub channels: usize,
    /// `vertices × channels` values: `_AO`, times the function of a tree's instance, or the number of a shrub.
    pub ao: Vec<f32>,
    /// Components of `_AO_RESIDUAL`; 0 if the primitive has none.
    pub residual_channels: usize,
    /// `vertices × residual_channels` values of `_AO_RESIDUAL`.
    pub residual: Vec<f32>,
}

/// Reads a file with `_AO`; primitives without it are there too, with no values. `name` is its path in `files`.
///
/// # Errors
/// As [`crate::import`].
pub fn read_baked(name: &str, files: &dyn SourceFiles) -> Result<BakedScene, SceneError> {
    let bytes = read_level(name, files)?;
    let document = Document::parse(name, &bytes, files)?;
    check_required(&document)?;
    let materials = materials(&document)?;
    let (mut parts, mut unreadable, mut nodes) = (Vec::new(), Vec::new(), Columns::new());
    let lods = Lods::find(&document, &[], &mut Findings::default())?;
    let placed = placements(&document, &lods, &mut Findings::default())?;
    let (mut placed_of, mut lods) = (Vec::new(), Vec::new());
    for placement in placed {
        let Some(mesh) = document.list("meshes")?.get(placement.mesh) else { continue };
        for (index, primitive) in mesh.list("primitives")?.iter().enumerate() {
            match read_part(&document, &placement, &mesh, (index as u32, &primitive), &materials, &mut nodes) {
                Ok(Some(part)) if placement.lod_of.is_some() => lods.push((part, placement.clone())),
                Ok(Some(part)) => {
                    parts.push(part);
                    placed_of.push(placement.clone());
                }
                Ok(None) => {}
                Err(error) if primitive.get("attributes").is_none_or(|a| a.get("_AO").is_none()) => {
                    unreadable.push(error);
                }
                Err(error) => return Err(error),
            }
        }
    }
    let lod = |(part, placement): (BakedPart, Placement)| {
        let full = placement.lod_of;
        let is_full = |of: &Placement| full.is_some_and(|full| of.fulls.contains(&full));
        let lod_of = (0..parts.len()).filter(|index| is_full(&placed_of[*index])).collect();
        BakedLod { part, lod_of }
    };
    let lods = lods.into_iter().map(lod).collect();
    Ok(BakedScene { half_distances_m: recorded_half_distances(&document), parts, lods, unreadable })
}

fn recorded_half_distances(document: &Document<'_>) -> Vec<f64> {
    let recorded = document.root.pointer("/asset/extras/kiln/half_distances_m").and_then(|value| value.as_array());
    recorded.into_iter().flatten().filter_map(serde_json::Value::as_f64).collect()
}

fn read_part(
    document: &Document<'_>,
    placement: &Placement,
    mesh: &Item<'_>,
    (index, primitive): (u32, &Item<'_>),
    materials: &[Material],
    nodes: &mut Columns,
) -> Result<Option<BakedPart>, SceneError> {
    let Some(topology) = Topology::of(primitive)? else { return Ok(None) };
    let attributes = primitive.require("attributes")?;
    if attributes.get("POSITION").is_none() {
        return Ok(None);
    }
    let material = primitive.get("material").and_then(|reference| materials.get(reference.index().ok()?));
    let opened = Primitive::open(document, primitive, index, topology, plain_group())?;
    let numbers = |attribute: &str| match attributes.get(attribute) {
        None => Ok((0, Vec::new())),
        Some(reference) => read_numbers(document, &reference, opened.position.count),
    };
    let (ao, (residual_channels, residual)) = (numbers("_AO")?, numbers(RESIDUAL)?);
    let world = placement.world_from_object;
    let positions = opened.position.vectors::<3>()?;
    let composed = Numbers::read(document, placement, mesh, nodes)?;
    let (channels, ao) = match &composed {
        Some(numbers) => numbers.compose(&positions, ao),
        None => ao,
    };
    let mut faces = opened.triangles()?;
    faces.retain(|face| face.iter().all(|&vertex| is_good(&opened, &positions, vertex)));
    if world.matrix3.determinant() < 0.0 {
        faces.iter_mut().for_each(|face| face.swap(1, 2));
    }
    let node = document.list("nodes")?.get(placement.node);
    let node = node.map_or_else(String::new, |node| name_of(&node, "node", placement.node));
    Ok(Some(BakedPart {
        node: placement.gpu_instance.map_or_else(|| node.clone(), |i| format!("{node}[{i}]")),
        mesh: name_of(mesh, "mesh", placement.mesh),
        primitive: index,
        positions: positions.iter().map(|p| world.transform_point3(DVec3::from(p.map(f64::from)))).collect(),
        faces,
        double_sided: material.is_some_and(|material| material.double_sided),
        channels,
        ao,
        residual_channels,
        residual,
    }))
}

/// Whether a vertex is there and finite; a file that was baked with `--drop-bad-faces` has faces with others.
fn is_good(primitive: &Primitive<'_>, positions: &[[f32; 3]], vertex: u32) -> bool {
    primitive.has_vertex(vertex) && positions[vertex as usize].iter().all(|coordinate| coordinate.is_finite())
}

/// What a primitive is opened as where classes don't matter.
fn plain_group() -> FaceGroup {
    FaceGroup::PLAIN
}

/// Components and values of an attribute of any width.
fn read_numbers(
    document: &Document<'_>,
    reference: &Item<'_>,
    vertices: usize,
) -> Result<(usize, Vec<f32>), SceneError> {
    let accessor = Accessor::open(document, reference)?;
    accessor.expect_count(vertices, "POSITION")?;
    let values = match accessor.width {
        1 => accessor.vectors::<1>()?.into_flattened(),
        2 => accessor.vectors::<2>()?.into_flattened(),
        3 => accessor.vectors::<3>()?.into_flattened(),
        _ => accessor.vectors::<4>()?.into_flattened(),
    };
    Ok((accessor.width, values))
}
