//! A lattice as a texture on whole plates, and the same as geometry: rays must find no difference.

use super::builder::{Builder, Elements, Placement};
use super::case::with_floor;
use super::surface::{Surface, lines};
use glam::{DQuat, DVec3, dvec3};
use serde_json::{Value, json};

/// Texels of the lattice along each side.
const TEXELS: u32 = 16;

/// The side of a plate, metres.
const SIDE: f64 = 2.0;

/// Bars around panes, of which every third is closed.
fn is_opaque(x: u32, y: u32) -> bool {
    x.is_multiple_of(4) || y.is_multiple_of(4) || (x / 4 + y / 4) % 3 == 1
}

/// A PNG whose alpha is the lattice.
fn lattice_png() -> Vec<u8> {
    let texels = (0..TEXELS).flat_map(|y| (0..TEXELS).map(move |x| (x, y)));
    let pixels: Vec<u8> = texels.flat_map(|(x, y)| [90, 120, 60, if is_opaque(x, y) { 255 } else { 0 }]).collect();
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, TEXELS, TEXELS);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&pixels))
        .expect("pixels of the stated number are written to memory");
    png
}

/// Corner and axes of a plate that looks up, its middle at the origin.
fn plate(us: &[f64], vs: &[f64], keep: impl Fn(f64, f64) -> bool) -> Surface {
    let point = |u: f64, v: f64| (dvec3(SIDE * (v - 0.5), 0.0, SIDE * (u - 0.5)), DVec3::Y);
    Surface::patch_where(us, vs, point, keep)
}

/// A roof of one plate over a floor of 4 × 4 m, and a fence of four more around it.
fn places() -> Vec<Placement> {
    let side = |quarter: u32| {
        let turn = DQuat::from_rotation_y(f64::from(quarter) * std::f64::consts::FRAC_PI_2);
        let upright = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        Placement::at(turn * dvec3(1.5, 1.001, 0.25)).rotated(upright).rotated(turn)
    };
    let roof = Placement::at(dvec3(0.0, 0.75, 0.0)).turned(20.0);
    std::iter::once(roof).chain((0..4).map(side)).collect()
}

/// Places a mesh at all [`places`] by EXT_mesh_gpu_instancing.
fn place_all(builder: &mut Builder, mesh: super::builder::Mesh) {
    builder.require_extension("EXT_mesh_gpu_instancing");
    let places = places();
    let translations: Vec<[f32; 3]> = places.iter().map(|place| place.translation().as_vec3().to_array()).collect();
    let rotations: Vec<[f32; 4]> = places.iter().map(|place| place.rotation().as_quat().to_array()).collect();
    let translation = builder.accessor(Elements { target: None, ..Elements::floats(&translations, "VEC3") });
    let rotation = builder.accessor(Elements { target: None, ..Elements::floats(&rotations, "VEC4") });
    let attributes = json!({"TRANSLATION": translation, "ROTATION": rotation});
    let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    builder.node_with("plates", mesh, Placement::ORIGIN, Some(extension));
}

/// Five plates of two triangles each whose texture says where the lattice is, around a floor.
pub(super) fn cutout() -> Vec<u8> {
    let mut builder = with_floor(2.0);
    let material = builder.masked_material("lattice", &lattice_png());
    let (ends, mut coordinates) = ([0.0, 1.0], Vec::new());
    let surface = plate(&ends, &ends, |_, _| true);
    for position in &surface.positions {
        coordinates.push([position.z, position.x].map(|at| (at / SIDE + 0.5) as f32));
    }
    let texture = builder.accessor(Elements::floats(&coordinates, "VEC2"));
    let mut primitive = builder.surface_primitive(&surface, material);
    primitive["attributes"]["TEXCOORD_0"] = Value::from(texture);
    let mesh = builder.raw_mesh("plate", &[primitive]);
    place_all(&mut builder, mesh);
    builder.finish("cutout")
}

/// The same, each texel that is opaque being a square of its own.
pub(super) fn cutout_geometry() -> Vec<u8> {
    let mut builder = with_floor(2.0);
    let material = builder.double_sided_material("lattice", [0.35, 0.47, 0.24]);
    let edges = lines(0.0, 1.0, 1.0 / f64::from(TEXELS));
    let texel = |at: f64| (at * f64::from(TEXELS)) as u32;
    let surface = plate(&edges, &edges, |u, v| is_opaque(texel(u), texel(v)));
    let mesh = builder.mesh("plate", &[(&surface, material)]);
    place_all(&mut builder, mesh);
    builder.finish("cutout_geometry")
}
