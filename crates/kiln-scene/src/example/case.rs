//! Small files, each with one thing that import, tracing or export must get right.

use super::builder::{Builder, Elements, Placement};
use super::masonry::stairs_of;
use super::props::wooden_crate;
use super::surface::{Surface, lines};
use glam::{DQuat, DVec3, dvec3};
use serde_json::json;

const GREY: [f32; 3] = [0.5; 3];
const SHORT: u32 = 5123;
const SIGNED_BYTE: u32 = 5120;
const ARRAY_BUFFER: u32 = 34962;

pub(super) fn with_floor(half: f64) -> Builder {
    let mut builder = Builder::new();
    let material = builder.material("floor", GREY);
    let cells = lines(-half, half, 0.25);
    let mesh = builder.mesh("floor", &[(&Surface::floor(&cells, &cells, 0.0), material)]);
    builder.node("floor", mesh, Placement::ORIGIN);
    builder
}

/// Three steps placed twice over a floor: mirrored in x, and stretched by (2, −0.5, 1.25) and turned. Both
/// transforms turn the winding.
pub fn mirrored() -> Vec<u8> {
    let mut builder = with_floor(3.0);
    let material = builder.material("stone", GREY);
    let steps = builder.mesh("steps", &[(&stairs_of(3, &lines(0.0, 1.0, 0.25)), material)]);
    let mirrored = Placement::at(dvec3(-0.5, 0.0, -0.5)).scaled(dvec3(-1.0, 1.0, 1.0));
    let stretched = Placement::at(dvec3(0.5, 1.0, 0.5)).scaled(dvec3(2.0, -0.5, 1.25)).turned(30.0);
    builder.node("steps_mirrored", steps, mirrored);
    builder.node("steps_stretched", steps, stretched);
    builder.finish("mirrored")
}

/// Over a floor: a sheet of coincident single-sided faces that look up and down, and a crate whose every face is
/// there twice.
pub fn coincident() -> Vec<u8> {
    let mut builder = with_floor(3.0);
    let material = builder.material("single_sided", GREY);
    let up = sheet();
    let mut both = up.clone();
    both.append(&up.flipped());
    let both = builder.mesh("sheet", &[(&both, material)]);
    builder.node("sheet", both, Placement::at(dvec3(-1.0, 1.0, 0.0)));
    let mut twice = wooden_crate();
    twice.faces.extend_from_within(..);
    let twice = builder.mesh("crate", &[(&twice, material)]);
    builder.node("crate", twice, Placement::at(dvec3(1.5, 0.0, 0.0)));
    builder.finish("coincident")
}

/// An open double-sided sheet a metre above a floor; its front looks up.
pub fn double_sided() -> Vec<u8> {
    let mut builder = with_floor(2.0);
    let cloth = builder.double_sided_material("cloth", GREY);
    let mesh = builder.mesh("sheet", &[(&sheet(), cloth)]);
    builder.node("sheet", mesh, Placement::at(DVec3::Y));
    builder.finish("double_sided")
}

/// A square of 2 m about the origin that looks up.
fn sheet() -> Surface {
    let cells = lines(-1.0, 1.0, 0.25);
    Surface::floor(&cells, &cells, 0.0)
}

/// Where the instances of [`gpu_instancing`] are, before the node's own translation.
fn instance_placements() -> Vec<Placement> {
    let place = |i: u32| {
        let along = f64::from(i);
        Placement::at(dvec3(1.4 * along - 2.8, 0.0, 0.3 * along))
            .scaled(DVec3::splat(0.6 + 0.1 * along))
            .rotated(DQuat::from_rotation_y(0.4 * along))
    };
    (0..5).map(place).collect()
}

/// Five crates of one node by EXT_mesh_gpu_instancing with translation, rotation and scale, over a floor; the node
/// itself is moved half a metre along z.
pub fn gpu_instancing() -> Vec<u8> {
    let mut builder = with_floor(4.0);
    builder.require_extension("EXT_mesh_gpu_instancing");
    let material = builder.material("wood", GREY);
    let mesh = builder.mesh("crate", &[(&wooden_crate(), material)]);
    let places = instance_placements();
    let vectors = |of: fn(&Placement) -> DVec3| -> Vec<[f32; 3]> {
        places.iter().map(|place| of(place).as_vec3().to_array()).collect()
    };
    let rotations: Vec<[f32; 4]> = places.iter().map(|place| place.rotation().as_quat().to_array()).collect();
    // Instance attributes are no vertex attributes: their buffer views have no target.
    let per_instance = |elements: Elements| Elements { target: None, ..elements };
    let translation = builder.accessor(per_instance(Elements::floats(&vectors(Placement::translation), "VEC3")));
    let rotation = builder.accessor(per_instance(Elements::floats(&rotations, "VEC4")));
    let scale = builder.accessor(per_instance(Elements::floats(&vectors(Placement::scale), "VEC3")));
    let attributes = json!({"TRANSLATION": translation, "ROTATION": rotation, "SCALE": scale});
    let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    builder.node_with("crates", mesh, Placement::at(DVec3::Z * 0.5), Some(extension));
    builder.finish("gpu_instancing")
}

/// A crate with 16-bit positions and 8-bit normals (KHR_mesh_quantization), over a floor. Its node's scale and
/// translation undo the quantisation, to a crate of a metre that stands on the floor.
pub fn quantized() -> Vec<u8> {
    let mut builder = with_floor(2.0);
    builder.require_extension("KHR_mesh_quantization");
    let material = builder.material("wood", GREY);
    let source = wooden_crate();
    // The crate fills −0.5 to 0.5 in x and z and 0 to 1 in y; two bytes of each element are padding.
    let corner = dvec3(-0.5, 0.0, -0.5);
    let steps: Vec<[u16; 3]> = source
        .positions
        .iter()
        .map(|p| (*p - corner).to_array().map(|c| (c * f64::from(u16::MAX)).round() as u16))
        .collect();
    let position = builder.accessor(Elements {
        bytes: steps.iter().flat_map(|&[x, y, z]| [x, y, z, 0]).flat_map(u16::to_le_bytes).collect(),
        count: steps.len(),
        component_type: SHORT,
        kind: "VEC3",
        normalized: true,
        min_max: Some([json!([0, 0, 0]), json!([u16::MAX, u16::MAX, u16::MAX])]),
        stride_bytes: Some(8),
        target: Some(ARRAY_BUFFER),
    });
    let normals = source.normals.iter().map(|n| n.to_array().map(|c| (c * f64::from(i8::MAX)).round() as i8));
    let normal = builder.accessor(Elements {
        bytes: normals.flat_map(|[x, y, z]| [x, y, z, 0]).flat_map(i8::to_le_bytes).collect(),
        count: source.normals.len(),
        component_type: SIGNED_BYTE,
        kind: "VEC3",
        normalized: true,
        min_max: None,
        stride_bytes: Some(4),
        target: Some(ARRAY_BUFFER),
    });
    let primitive = builder.primitive(position, normal, &source.faces, material);
    let mesh = builder.raw_mesh("crate", &[primitive]);
    builder.node("crate", mesh, Placement::at(corner));
    builder.finish("quantized")
}

/// A scene without nodes, meshes or buffers.
pub fn empty() -> Vec<u8> {
    Builder::new().finish("empty")
}

/// One triangle that looks up.
pub fn triangle() -> Vec<u8> {
    let mut builder = Builder::new();
    let material = builder.material("grey", GREY);
    let mut surface = Surface::default();
    let corners = [DVec3::ZERO, DVec3::Z, DVec3::X].map(|p| surface.vertex(p, DVec3::Y));
    surface.faces.push(corners);
    let mesh = builder.mesh("triangle", &[(&surface, material)]);
    builder.node("triangle", mesh, Placement::ORIGIN);
    builder.finish("triangle")
}
