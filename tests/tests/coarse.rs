//! Meshes that are too coarse for their shadows, and area that nobody sees, as a user meets them.

use kiln_tests::{Workplace, wait_for};
use serde_json::{Value, json};

const BAKE: [&str; 6] = ["bake", "level.glb", "--quality", "low", "--backend", "cpu"];

/// Corners and faces.
type Shape = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// Corners and faces of an axis-parallel box, its faces outward.
fn boxed(low: [f32; 3], high: [f32; 3]) -> Shape {
    let corner = |i: usize| std::array::from_fn(|axis| if i >> axis & 1 == 1 { high[axis] } else { low[axis] });
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    ((0..8).map(corner).collect(), quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect())
}

/// A .glb of named meshes, each at a node of its own at the origin.
fn glb(meshes: &[(&str, Shape)]) -> Vec<u8> {
    let mut bin: Vec<u8> = Vec::new();
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    let mut add = |bytes: Vec<u8>, accessor: Value| {
        views.push(json!({"buffer": 0, "byteOffset": bin.len(), "byteLength": bytes.len()}));
        bin.extend(bytes);
        let mut accessor = accessor;
        accessor["bufferView"] = json!(views.len() - 1);
        accessors.push(accessor);
        accessors.len() - 1
    };
    let mut list = Vec::new();
    for (name, (positions, faces)) in meshes {
        let bound = |pick: fn(f32, f32) -> f32| -> [f32; 3] {
            std::array::from_fn(|axis| positions.iter().map(|p| p[axis]).fold(positions[0][axis], pick))
        };
        let accessor = json!({
            "componentType": 5126, "type": "VEC3", "count": positions.len(), "min": bound(f32::min), "max": bound(f32::max)
        });
        let position = add(positions.iter().flatten().flat_map(|x| x.to_le_bytes()).collect(), accessor);
        let accessor = json!({"componentType": 5125, "type": "SCALAR", "count": 3 * faces.len()});
        let indices = add(faces.iter().flatten().flat_map(|x| x.to_le_bytes()).collect(), accessor);
        list.push(json!({"name": name, "primitives": [{"attributes": {"POSITION": position}, "indices": indices}]}));
    }
    let nodes: Vec<Value> = meshes.iter().enumerate().map(|(i, (name, ..))| json!({"name": name, "mesh": i})).collect();
    let document = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": (0..nodes.len()).collect::<Vec<_>>()}],
        "nodes": nodes, "meshes": list, "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": bin.len()}],
    });
    joined(&document, &bin)
}

fn joined(document: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let chunk = |kind: &[u8; 4], bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes()[..], kind, bytes].concat();
    let body = [chunk(b"JSON", &text), chunk(b"BIN\0", bin)].concat();
    [&b"glTF"[..], &2u32.to_le_bytes(), &(body.len() as u32 + 12).to_le_bytes(), &body].concat()
}

/// The document and the binary chunk of a .glb.
fn split(glb: &[u8]) -> (Value, Vec<u8>) {
    let length = u32::from_le_bytes(glb[12..16].try_into().expect("four bytes")) as usize;
    (serde_json::from_slice(&glb[20..20 + length]).expect("a document"), glb[28 + length..].to_vec())
}

/// An attribute of a mesh; places are in the binary chunk.
struct Attribute {
    component: u64,
    kind: String,
    offset: usize,
    stride: usize,
    count: usize,
}

impl Attribute {
    /// Component type, type, what the offset lacks to alignment, and stride.
    fn layout(&self) -> (u64, &str, usize, usize) {
        (self.component, &self.kind, self.offset % 4, self.stride)
    }
}

fn attribute(document: &Value, mesh: usize, name: &str) -> Option<Attribute> {
    let accessor = document["meshes"][mesh]["primitives"][0]["attributes"][name].as_u64()? as usize;
    let accessor = &document["accessors"][accessor];
    let view = &document["bufferViews"][accessor["bufferView"].as_u64()? as usize];
    let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
    Some(Attribute {
        component: accessor["componentType"].as_u64()?,
        kind: accessor["type"].as_str()?.to_owned(),
        offset: number(&view["byteOffset"]) + number(&accessor["byteOffset"]),
        stride: number(&view["byteStride"]),
        count: number(&accessor["count"]),
    })
}

fn floats(bin: &[u8], attribute: &Attribute) -> Vec<[f32; 2]> {
    let at = |from: usize| f32::from_le_bytes(bin[from..from + 4].try_into().expect("four bytes"));
    let starts = (0..attribute.count).map(|i| attribute.offset + i * attribute.stride);
    starts.map(|from| [at(from), at(from + 4)]).collect()
}

/// A box on a wide floor of two triangles that cannot hold its shadow, and a field under the open sky that has none.
fn box_on_floor() -> Workplace {
    let place = Workplace::new();
    let quad = |x: f32| {
        let positions = vec![[x - 9.0, 0.0, -9.0], [x - 9.0, 0.0, 9.0], [x + 9.0, 0.0, 9.0], [x + 9.0, 0.0, -9.0]];
        (positions, vec![[0, 1, 2], [0, 2, 3]])
    };
    let occluder = boxed([-4.0, 0.01, -4.0], [4.0, 6.0, 4.0]);
    let level = glb(&[("floor", quad(0.0)), ("field", quad(100.0)), ("box", occluder)]);
    std::fs::write(place.path("level.glb"), level).expect("the folder is there");
    place
}

/// The floor and the field get values, the box only occludes.
const RECEIVERS: [&str; 4] = ["--only", "f*", "--half-distance", "2,4"];

#[test]
fn a_coarse_mesh_is_reported_and_shown() {
    let place = box_on_floor();
    let said = place.succeed(&[&BAKE[..], &RECEIVERS, &["-o", "plain.glb", "--report", "r.json"]].concat());
    assert!(said.contains("too coarse for its shadows: 2 faces") && said.contains("--residual"), "{said}");
    let report = place.json("r.json");
    let coarse = &report["too_coarse"];
    assert_eq!((&coarse["faces"], &coarse["least_deviation"]), (&json!(2), &json!(0.1)));
    // The shadow is a step from nearly 0 to nearly 1 over a fifth of the floor: its deviation is √(.2 · .8), nearly.
    let worst = coarse["worst"].as_array().expect("a list");
    for face in worst {
        let (deviation, center) = (face["deviation"].as_f64().unwrap_or(0.0), &face["center_m"]);
        assert!(face["node"] == "floor" && (0.25..0.45).contains(&deviation), "{face}");
        assert!(center[1] == 0.0 && center[0].as_f64().is_some_and(|x| (x.abs() - 3.0).abs() < 1e-9), "{face}");
    }
    let of = |mesh: usize| report["meshes"][mesh]["too_coarse"]["faces"].as_u64();
    assert_eq!((of(0), of(1), worst.len()), (Some(2), Some(0), 2));
    let share = report["meshes"][0]["too_coarse"]["share"].as_f64();
    assert!(share.is_some_and(|share| (share - 1.0).abs() < 1e-9), "{share:?}");

    let refusal = place.fail(3, &["view", "plain.glb", "-o", "p.png", "--overlay", "residual"]);
    assert!(
        refusal.contains("plain.glb has no `_AO_RESIDUAL`") && refusal.contains("kiln bake --residual"),
        "{refusal}"
    );
    assert!(!place.path("p.png").exists());
    let more = ["-o", "shown.glb", "--report", "r2.json", "--residual"];
    place.succeed(&[&BAKE[..], &RECEIVERS, &more].concat());
    // Only the writing is new.
    let stages = &place.json("r2.json")["cache"]["by_stage"];
    assert_eq!((&stages["trace"]["misses"], &stages["solve"]["misses"]), (&json!(0), &json!(0)));
    let view = ["view", "shown.glb", "-o", "p.png", "--overlay", "residual", "--size", "160x100", "--json"];
    let said: Value = serde_json::from_str(&place.succeed(&view)).expect("JSON");
    assert_eq!((&said["scale"]["high"], &said["scale"]["coarse"]), (&json!(0.3), &json!(0.1)));
    assert!(place.read("p.png").starts_with(b"\x89PNG"));
    assert!(place.fail(2, &[&view[..], &["--channel", "2"]].concat()).contains("half-distance number 2"));
}

#[test]
fn residuals_are_an_attribute_that_costs_only_who_wants_it() {
    let place = box_on_floor();
    for (name, more) in
        [("plain.glb", &[][..]), ("shown.glb", &["--residual"]), ("u16.glb", &["--residual", "--format", "u16"])]
    {
        place.succeed(&[&BAKE[..], &RECEIVERS, &["-o", name], more].concat());
    }
    let (plain, plain_bin) = split(&place.read("plain.glb"));
    let (shown, shown_bin) = split(&place.read("shown.glb"));
    assert!(attribute(&plain, 0, "_AO_RESIDUAL").is_none() && plain_bin.len() + 8 * 8 == shown_bin.len());
    for mesh in 0..2 {
        let ao = attribute(&shown, mesh, "_AO").expect("values");
        assert_eq!(floats(&shown_bin, &ao), floats(&plain_bin, &attribute(&plain, mesh, "_AO").expect("values")));
        let residual = attribute(&shown, mesh, "_AO_RESIDUAL").expect("residuals");
        assert_eq!(residual.layout(), (5126, "VEC2", 0, 8));
        let values = floats(&shown_bin, &residual);
        // Rays are rounded to 2⁻¹⁶, so what is constant strays by about as much.
        let range = if mesh == 0 { 0.2..0.5 } else { 0.0..1e-3 };
        assert!(values.iter().all(|[near, _]| range.contains(near)), "{values:?}");
        let (small, _) = split(&place.read("u16.glb"));
        let residual = attribute(&small, mesh, "_AO_RESIDUAL").expect("residuals");
        assert_eq!(residual.layout(), (5123, "VEC2", 0, 4));
    }
}

#[test]
fn a_farm_writes_residuals_too() {
    let place = box_on_floor();
    let _server = place.start(&["serve", "--listen", "127.0.0.1:0", "--data-dir", "farm", "--address-file", "address"]);
    let read = || std::fs::read_to_string(place.path("address")).ok().filter(|text| text.ends_with('\n'));
    let address = wait_for("the coordinator's start", read);
    let farm = ["--coordinator", address.trim()];
    let worker = ["worker", "--name", "w", "--data-dir", "worker", "--threads", "1", "--backend", "cpu"];
    let _worker = place.start(&[&worker[..], &farm].concat());
    let settings = ["--quality", "low", "--backend", "cpu", "--residual"];
    let bake = place.succeed(&[&["submit", "level.glb"][..], &farm, &settings].concat());
    place.succeed(&[&["watch", bake.trim()][..], &farm].concat());
    place.succeed(&[&["fetch", bake.trim(), "-o", "farm.glb"][..], &farm].concat());
    place.succeed(&[&BAKE[..], &["-o", "alone.glb", "--residual"]].concat());
    assert_eq!(place.read("farm.glb"), place.read("alone.glb"));
    assert!(attribute(&split(&place.read("farm.glb")).0, 0, "_AO_RESIDUAL").is_some());
}

#[test]
fn what_is_buried_does_not_count_in_a_comparison() {
    let place = Workplace::new();
    let level = glb(&[("outer", boxed([-1.0; 3], [1.0; 3])), ("inner", boxed([-0.5; 3], [0.5; 3]))]);
    std::fs::write(place.path("level.glb"), level).expect("the folder is there");
    place.succeed(&[&BAKE[..], &["-o", "a.glb"]].concat());
    let changed = |mesh: usize, name: &str| {
        let (document, mut bin) = split(&place.read("a.glb"));
        let Attribute { offset, stride, count, .. } = attribute(&document, mesh, "_AO").expect("values");
        bin[offset..offset + stride * count].fill(0);
        std::fs::write(place.path(name), joined(&document, &bin)).expect("the folder is there");
    };
    changed(1, "buried.glb");
    changed(0, "seen.glb");
    let said = place.succeed(&["compare", "a.glb", "buried.glb", "--fail-above", "0"]);
    assert!(said.contains("over the 80.0 % of the area that can be seen"), "{said}");
    let said = place.fail(4, &["compare", "a.glb", "buried.glb", "--fail-above", "0.1", "--all-area"]);
    assert!(said.contains("over all area"), "{said}");
    let said = place.fail(4, &["compare", "a.glb", "seen.glb", "--fail-above", "0.1"]);
    assert!(said.contains("over what can be seen"), "{said}");
    let json: Value =
        serde_json::from_str(&place.succeed(&["compare", "a.glb", "buried.glb", "--json"])).expect("JSON");
    assert_eq!((&json["visible"]["total"][0]["rmse"], &json["visible_area_m2"]), (&json!(0.0), &json!(24.0)));
    // What was there before means what it did: all area, a fifth of which is changed from nearly 1 to 0.
    let rmse = json["total"][0]["rmse"].as_f64().unwrap_or(0.0);
    assert!((rmse - 0.2f64.sqrt()).abs() < 0.05, "{rmse}");
    assert_eq!((&json["meshes"][1]["area_m2"], &json["meshes"][1]["visible_area_m2"]), (&json!(6.0), &json!(0.0)));
}
