//! Masks from documents: good ones, those that have no say, and damaged ones.

use crate::{
    fixture::{Files, Fixture, SQUARE, mesh_of},
    import,
};
use kiln_core::{BakeSettings, Class, FoliageMode, Mask, Mesh, Wrap};
use proptest::prelude::*;
use serde_json::{Value, json};

/// The texture coordinates of the fixture's square: u along x, v along z.
const UV: [[f32; 2]; 4] = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]];

/// A PNG of grey and alpha.
pub(crate) fn png(size: [u32; 2], alpha: impl Fn([u32; 2]) -> u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    encoder.set_depth(png::BitDepth::Eight);
    let pixels: Vec<u8> =
        (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| [x, y])).flat_map(|at| [9, alpha(at)]).collect();
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
    bytes
}

fn checkers([x, y]: [u32; 2]) -> u8 {
    if (x + y) % 2 == 0 { 255 } else { 0 }
}

/// A square whose material looks at an image, nearest texel.
fn masked(image: &[u8]) -> Fixture {
    let mut fixture = Fixture::square();
    let coordinates = fixture.floats(&UV);
    // An accessor's view is as good as any other.
    fixture.accessor(image, json!({ "count": 1, "componentType": 5121, "type": "SCALAR" }));
    let view = fixture.json["bufferViews"].as_array().unwrap().len() - 1;
    let primitive = &mut fixture.json["meshes"][0]["primitives"][0];
    primitive["attributes"]["TEXCOORD_0"] = json!(coordinates);
    primitive["material"] = json!(0);
    fixture.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png", "name": "leaf" }]);
    fixture.json["samplers"] = json!([{ "magFilter": 9728 }]);
    fixture.json["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    fixture.json["materials"] = json!([{
        "name": "leaves", "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } },
    }]);
    fixture
}

fn material(fixture: &mut Fixture) -> &mut Value {
    &mut fixture.json["materials"][0]
}

/// The mesh, and the warnings' codes with their subjects and messages.
fn imported(fixture: &Fixture, sidecar: &str) -> (Mesh, Vec<String>) {
    let import = fixture.import_with(&BakeSettings::default(), sidecar).unwrap();
    let warning = |w: &kiln_core::Warning| format!("{}: {}: {}", w.code, w.subject, w.message);
    (mesh_of(&import, 0), import.level.warnings.iter().map(warning).collect())
}

/// Whether the square is there at a place of its own.
fn is_there(mesh: &Mesh, [x, z]: [f64; 2]) -> bool {
    let in_face = |face: usize| {
        let [a, b, c] = mesh.corners(face).map(|corner| [f64::from(corner.x), f64::from(corner.z)]);
        let part = |p: [f64; 2], q: [f64; 2]| (p[0] - x) * (q[1] - z) - (p[1] - z) * (q[0] - x);
        let parts = [part(b, c), part(c, a), part(a, b)];
        let sum: f64 = parts.iter().sum();
        let parts = parts.map(|part| part / sum);
        parts.iter().all(|part| *part >= 0.0).then_some(parts)
    };
    let cutout = |face: usize| mesh.cutout_faces().find(|cutout| cutout.face == face);
    (0..mesh.faces.len()).filter_map(|face| Some((face, in_face(face)?))).any(|(face, parts)| {
        let Some(cutout) = cutout(face) else { return mesh.group(face).occludes };
        let uv = [0, 1].map(|axis| (0..3).map(|i| parts[i] * f64::from(cutout.corners[i][axis])).sum());
        mesh.cutouts.masks[usize::from(cutout.mask)].is_opaque(uv)
    })
}

/// Where a pattern of 8 × 8 places on the square is there.
fn places(mesh: &Mesh) -> Vec<bool> {
    let at = |i: u32| (f64::from(i) + 0.5) / 8.0 + 1e-3;
    (0..64).map(|i| is_there(mesh, [at(i % 8), at(i / 8)])).collect()
}

fn expected(is_opaque: impl Fn(f64, f64) -> bool) -> Vec<bool> {
    let at = |i: u32| (f64::from(i) + 0.5) / 8.0 + 1e-3;
    (0..64).map(|i| is_opaque(at(i % 8), at(i / 8))).collect()
}

/// Checkers of so many cells each way.
fn checker(u: f64, v: f64, cells: f64) -> bool {
    ((u * cells).floor() + (v * cells).floor()).rem_euclid(2.0) == 0.0
}

#[test]
fn a_texture_says_where_faces_are() {
    let fixture = masked(&png([4, 4], checkers));
    let (mesh, warnings) = imported(&fixture, "");
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!((mesh.cutouts.masks.len(), mesh.cutouts.corners.len()), (1, 2));
    assert!(mesh.group(0).occludes && !mesh.group(0).is_solid() && mesh.group(0).stops_where_opaque());
    assert_eq!(places(&mesh), expected(|u, v| checker(u, v, 4.0)));
}

#[test]
fn images_of_other_kinds() {
    let whole = |bytes: &[u8]| {
        let (mesh, warnings) = imported(&masked(bytes), "");
        assert!(warnings.is_empty(), "{warnings:?}");
        mesh.group(0).is_solid() && mesh.cutouts.masks.is_empty()
    };
    assert!(whole(b"\xff\xd8\xff\xe0 a JPEG has no alpha"));
    let encoded = |color, depth, palette: Option<(&[u8], &[u8])>, data: &[u8]| {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 2);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if let Some((palette, alpha)) = palette {
            encoder.set_palette(palette.to_vec());
            encoder.set_trns(alpha.to_vec());
        }
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    };
    use png::{BitDepth, ColorType};
    assert!(whole(&encoded(ColorType::Rgb, BitDepth::Eight, None, &[7; 12])));
    let diagonal = expected(|u, v| checker(u, v, 2.0));
    let sixteen: Vec<u8> = [255, 0, 0, 255].iter().flat_map(|alpha| [1, 1, 2, 2, 3, 3, *alpha, 77]).collect();
    for bytes in [
        encoded(ColorType::Rgba, BitDepth::Eight, None, &[1, 2, 3, 128, 1, 2, 3, 127, 1, 2, 3, 0, 1, 2, 3, 255]),
        encoded(ColorType::Rgba, BitDepth::Sixteen, None, &sixteen),
        encoded(ColorType::Indexed, BitDepth::One, Some((&[1, 2, 3, 4, 5, 6], &[255, 0])), &[0b0100_0000, 0b1000_0000]),
    ] {
        assert_eq!(places(&imported(&masked(&bytes), "").0), diagonal);
    }
}

#[test]
fn factor_and_cutoff() {
    let half = png([4, 4], |at| if checkers(at) > 0 { 160 } else { 80 });
    let of = |cutoff: Value, factor: f64| {
        let mut fixture = masked(&half);
        material(&mut fixture)["alphaCutoff"] = cutoff;
        material(&mut fixture)["pbrMetallicRoughness"]["baseColorFactor"] = json!([1.0, 1.0, 1.0, factor]);
        let (mesh, warnings) = imported(&fixture, "");
        assert!(warnings.is_empty());
        let group = mesh.group(0);
        (group.is_solid(), group.occludes, mesh.cutouts.corners.len())
    };
    assert_eq!(of(Value::Null, 1.0), (false, true, 2));
    assert_eq!(of(Value::Null, 0.5), (false, false, 0), "all transparent");
    assert_eq!(of(json!(0.25), 1.0), (true, true, 0), "all opaque");
    assert_eq!(of(json!(0.25), 0.5), (false, true, 2));
    assert_eq!(of(json!(1.5), 1.0), (false, false, 0));
    assert_eq!(of(json!(160.0 / 255.0), 1.0), (false, true, 2), "what equals the cutoff is opaque");
    // Without a texture the factor alone counts.
    let mut fixture = Fixture::square();
    fixture.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    for (alpha, occludes) in [(0.5, true), (0.4, false)] {
        let factor = json!([1.0, 1.0, 1.0, alpha]);
        fixture.json["materials"] =
            json!([{ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorFactor": factor } }]);
        assert_eq!(imported(&fixture, "").0.group(0).occludes, occludes);
    }
}

#[test]
fn wraps_transforms_and_sets_of_coordinates() {
    // One texel of a 4 × 4 texture is opaque.
    let dot = png([4, 4], |at| if at == [1, 0] { 255 } else { 0 });
    let is_dot = |u: f64, v: f64| (1.0..2.0).contains(&(u * 4.0)) && (0.0..1.0).contains(&(v * 4.0));
    let mut fixture = masked(&dot);
    let info = json!({ "index": 0, "extensions": { "KHR_texture_transform": { "scale": [2.0, 3.0] } } });
    material(&mut fixture)["pbrMetallicRoughness"]["baseColorTexture"] = info;
    assert_eq!(places(&imported(&fixture, "").0), expected(|u, v| is_dot((2.0 * u).fract(), (3.0 * v).fract())));
    fixture.json["samplers"] = json!([{ "magFilter": 9728, "wrapS": 33648, "wrapT": 33071 }]);
    let mirrored = |u: f64| if u < 1.0 { u } else { 2.0 - u };
    assert_eq!(places(&imported(&fixture, "").0), expected(|u, v| is_dot(mirrored(2.0 * u), (3.0 * v).min(0.99))));
    // Turned by a right angle, counter-clockwise where v points down, then moved: (u, v) becomes (v, −u) + offset.
    let transform = json!({ "rotation": std::f64::consts::FRAC_PI_2, "offset": [0.25, 1.0], "texCoord": 1 });
    let info = json!({ "index": 0, "texCoord": 7, "extensions": { "KHR_texture_transform": transform } });
    material(&mut fixture)["pbrMetallicRoughness"]["baseColorTexture"] = info;
    let second = fixture.floats(&UV.map(|[u, v]| [u * 0.75, v * 0.75]));
    fixture.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = json!(second);
    fixture.json["samplers"] = json!([{ "magFilter": 9728 }]);
    let (mesh, warnings) = imported(&fixture, "");
    assert!(warnings.is_empty());
    assert_eq!(places(&mesh), expected(|u, v| is_dot((0.75 * v + 0.25).fract(), 1.0 - 0.75 * u)));
}

#[test]
fn meshes_share_masks_by_what_they_look_like() {
    let mut fixture = masked(&png([4, 4], checkers));
    let mut other = fixture.json["materials"][0].clone();
    other["name"] = json!("other leaves");
    other["alphaCutoff"] = json!(0.25);
    let mut third = other.clone();
    third["alphaMode"] = json!("OPAQUE");
    fixture.json["materials"].as_array_mut().unwrap().extend([other, third]);
    let primitive = fixture.json["meshes"][0]["primitives"][0].clone();
    let with = |material: usize| {
        let mut primitive = primitive.clone();
        primitive["material"] = json!(material);
        primitive
    };
    fixture.json["meshes"][0]["primitives"] = json!([with(0), with(1), with(2)]);
    let (mesh, warnings) = imported(&fixture, "");
    // Both have the same holes: so they are one mask and one group, and the faces of the second repeat those of the first.
    assert_eq!((mesh.cutouts.masks.len(), mesh.groups.len(), mesh.faces.len()), (1, 2, 4));
    assert_eq!(mesh.cutouts.corners.len(), 2);
    assert!(warnings.len() == 1 && warnings[0].starts_with("duplicate_faces"), "{warnings:?}");
}

#[test]
fn digests_of_meshes_tell_masks_and_coordinates() {
    let digest = |fixture: &Fixture| fixture.import().unwrap().meshes[0].digest;
    let fixture = masked(&png([4, 4], checkers));
    let mut moved = fixture.clone();
    let coordinates = moved.floats(&UV.map(|[u, v]| [u, v + 0.125]));
    moved.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(coordinates);
    let mut whole = fixture.clone();
    material(&mut whole)["alphaMode"] = json!("OPAQUE");
    let mut mirrored = fixture.clone();
    mirrored.json["samplers"] = json!([{ "magFilter": 9728, "wrapS": 33648 }]);
    let other = masked(&png([4, 4], |at| 255 - checkers(at)));
    let all: std::collections::BTreeSet<_> = [&fixture, &moved, &whole, &mirrored, &other].map(digest).into();
    assert_eq!(all.len(), 5);
    // Colours, and alpha on the same side of the cutoff, make no difference.
    assert_eq!(digest(&masked(&png([4, 4], |at| checkers(at).clamp(100, 200)))), digest(&fixture));
}

#[test]
fn coincident_faces_with_other_coordinates_are_kept() {
    let mut fixture = masked(&png([4, 4], checkers));
    let shifted = fixture.floats(&UV.map(|[u, v]| [u + 0.25, v]));
    let mut second = fixture.json["meshes"][0]["primitives"][0].clone();
    second["attributes"]["TEXCOORD_0"] = json!(shifted);
    fixture.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(second);
    let (mesh, warnings) = imported(&fixture, "");
    assert!(warnings.is_empty() && mesh.faces.len() == 4);
    assert!(places(&mesh).iter().all(|there| *there), "what one leaves open the other closes");
}

#[test]
fn classes_with_masks() {
    let fixture = masked(&png([4, 4], checkers));
    let of = |class: &str, more: &str| {
        let (mesh, warnings) = imported(&fixture, &format!("[[class]]\nmatch = 'square'\nclass = '{class}'\n{more}"));
        assert!(warnings.is_empty());
        mesh
    };
    let tree = of("tree", "");
    assert!(tree.group(0).class == Class::Tree && tree.group(0).stops_where_opaque() && !tree.group(0).occludes);
    let thin = of("tree", "transmittance_per_crossing = 0.3");
    assert!(!thin.group(0).stops_where_opaque() && thin.group(0).cutout.is_some());
    assert!(of("shrub", "").group(0).cutout.is_some());
    assert!(of("decorator", "").group(0).cutout.is_none());
    assert!(!of("opaque", "occludes = true").group(0).is_solid());
    assert!(of("opaque", "occludes = false").group(0).cutout.is_none());
    let settings = BakeSettings { foliage: FoliageMode::Geometry, ..BakeSettings::default() };
    let import = fixture.import_with(&settings, "[[class]]\nmatch = 'square'\nclass = 'tree'\n").unwrap();
    assert!(mesh_of(&import, 0).group(0).occludes && mesh_of(&import, 0).group(0).stops_where_opaque());
}

/// Imports, and expects one warning, which names the material, and faces without holes.
fn without_holes(fixture: &Fixture, files: &Files) -> String {
    let import = import("level.glb", files, None, &BakeSettings::default()).unwrap();
    let mesh = mesh_of(&import, 0);
    assert!(mesh.group(0).is_solid() && mesh.cutouts == kiln_core::Cutouts::default());
    let warnings: Vec<_> = import.level.warnings.iter().filter(|w| w.code == "alpha_mask").collect();
    assert_eq!((warnings.len(), warnings[0].count), (1, 2), "{:?} {}", import.level.warnings, fixture.json);
    assert!(warnings[0].subject.starts_with("leaves"));
    format!("{}: {}", warnings[0].subject, warnings[0].message)
}

#[test]
fn what_cannot_be_looked_at_has_no_holes_and_a_warning() {
    let good = png([4, 4], checkers);
    let said = |bytes: &[u8], change: &dyn Fn(&mut Fixture)| {
        let mut fixture = masked(bytes);
        change(&mut fixture);
        without_holes(&fixture, &fixture.files())
    };
    let none = |_: &mut Fixture| {};
    assert!(said(b"RIFF....WEBP", &none).contains("image \"leaf\""));
    assert!(said(b"RIFF....WEBP", &none).contains("save it as PNG"));
    assert!(said(&good[..good.len() - 20], &none).contains("damaged"));
    // A header that promises more than the file can hold, and one that promises more than is read.
    let huge = |width: u32, height: u32| {
        let mut bytes = good.clone();
        bytes[16..20].copy_from_slice(&width.to_be_bytes());
        bytes[20..24].copy_from_slice(&height.to_be_bytes());
        let mut crc = u32::MAX;
        for byte in &bytes[12..29] {
            crc ^= u32::from(*byte);
            (0..8).for_each(|_| crc = if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 });
        }
        bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
        bytes
    };
    assert!(said(&huge(8000, 8000), &none).contains("damaged"));
    assert!(said(&huge(20_000, 20_000), &none).contains("8192 × 8192"));
    assert!(
        said(&good, &|f| f.json["images"][0] = json!({ "uri": "textures/leaf.png" })).contains("textures/leaf.png")
    );
    assert!(said(&good, &|f| f.json["images"][0] = json!({ "uri": "../leaf.png" })).contains("put it there"));
    assert!(said(&good, &|f| f.json["images"][0] = json!({ "uri": "data:image/png;base64,A!" })).contains("damaged"));
    let coordinates = |value: Value| {
        let change = |f: &mut Fixture| f.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = value.clone();
        said(&good, &change)
    };
    for wrong in [Value::Null, json!(99), json!(0), json!("x")] {
        assert!(coordinates(wrong).contains("unwrap the mesh"));
    }
    for (pointer, value) in [
        ("/materials/0/alphaCutoff", json!("x")),
        ("/materials/0/pbrMetallicRoughness/baseColorTexture/index", json!(4)),
        ("/textures/0/source", json!(-1)),
        ("/textures/0/source", Value::Null),
        ("/samplers/0/magFilter", json!({})),
        ("/images/0", json!({})),
        ("/images/0/bufferView", json!(1000)),
    ] {
        let change = |f: &mut Fixture| match f.json.pointer_mut(pointer) {
            Some(place) => *place = value.clone(),
            None => f.json["materials"][0]["alphaCutoff"] = value.clone(),
        };
        assert!(said(&good, &change).contains("export the level again"), "{pointer}");
    }
}

#[test]
fn images_in_files_of_their_own() {
    let mut fixture = masked(&[0]);
    fixture.json["images"][0] = json!({ "uri": "textures/leaf%201.png" });
    let mut files = fixture.files();
    files.insert("textures/leaf 1.png".to_owned(), png([4, 4], checkers));
    let import = import("level.glb", &files, None, &BakeSettings::default()).unwrap();
    assert!(import.level.warnings.is_empty());
    assert_eq!(places(&mesh_of(&import, 0)), expected(|u, v| checker(u, v, 4.0)));
    assert_eq!(super::mask_files("level.glb", &files["level.glb"]).unwrap(), ["textures/leaf 1.png"]);
    material(&mut fixture)["alphaMode"] = json!("BLEND");
    assert!(super::mask_files("level.glb", &fixture.glb()).unwrap().is_empty());
}

#[test]
fn bilinear_edges_are_finer_than_texels() {
    let mut fixture = masked(&png([8, 8], |[x, _]| if x < 4 { 255 } else { 0 }));
    fixture.json["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33071 }]);
    let mask: Mask = Mask::clone(&imported(&fixture, "").0.cutouts.masks[0]);
    assert_eq!((mask.size(), mask.wrap()), ([32, 32], [Wrap::Clamp; 2]));
    assert!(mask.is_opaque([0.49, 0.3]) && !mask.is_opaque([0.51, 0.3]));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Whatever stands in the image, import goes through and faces are whole or have holes.
    #[test]
    fn any_image_is_survived(
        cut in any::<prop::sample::Index>(), changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
        is_cut: bool, keeps_signature: bool,
    ) {
        let mut bytes = png([13, 9], checkers);
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at.max(if keeps_signature { 8 } else { 0 })] = byte;
        }
        if is_cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let (mesh, warnings) = imported(&masked(&bytes), "");
        prop_assert_eq!(mesh.faces.len(), 2);
        prop_assert_eq!(mesh.group(0).cutout.is_some(), mesh.cutouts.corners.len() == 2);
        prop_assert!(warnings.len() <= 1);
    }

    /// Whatever stands in the material, texture, sampler and image, nothing panics.
    #[test]
    fn any_description_is_survived(place in 0usize..9, value in 0usize..8) {
        let mut fixture = masked(&png([4, 4], checkers));
        let info = json!({ "index": 0, "texCoord": 0, "extensions": { "KHR_texture_transform": { "scale": [1.0, 2.0] } } });
        material(&mut fixture)["pbrMetallicRoughness"]["baseColorTexture"] = info;
        let pointer = [
            "/materials/0/pbrMetallicRoughness", "/materials/0/pbrMetallicRoughness/baseColorTexture",
            "/materials/0/pbrMetallicRoughness/baseColorTexture/texCoord", "/textures/0", "/samplers/0/magFilter", "/images/0",
            "/materials/0/pbrMetallicRoughness/baseColorTexture/extensions/KHR_texture_transform",
            "/materials/0/pbrMetallicRoughness/baseColorTexture/extensions/KHR_texture_transform/scale", "/textures/0/sampler",
        ][place];
        let values = [json!(1e308), json!(-1), json!("x"), json!([]), json!({}), Value::Null, json!(18446744073709551615u64), json!([1e300, -1e300])];
        *fixture.json.pointer_mut(pointer).unwrap() = values[value].clone();
        let mesh = mesh_of(&fixture.import().unwrap(), 0);
        prop_assert!(mesh.cutouts.corners.iter().flatten().flatten().all(|x| x.is_finite()));
    }
}

/// So that the fixture's square and the coordinates above agree.
#[test]
fn coordinates_follow_the_square() {
    assert!(SQUARE.iter().zip(UV).all(|(corner, uv)| [corner[0], corner[2]] == uv));
}
