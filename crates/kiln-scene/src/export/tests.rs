//! Export of documents made by code, read back by Kiln's own reader and by an independent one.

use crate::{
    ErrorKind, ExportRequest, Exported, Import, SceneError, export,
    export::BakedInstance,
    fixture::{Files, Fixture, SQUARE, export_all, some_values},
    glb::Glb,
    import, read_baked,
};
use kiln_core::{Attribute, BakeSettings, ColorMode, Digest, OutputSettings, ValueFormat, codec};
use serde_json::{Value, json};

/// Imports and exports with values for all; the parsed output.
struct Baked {
    import: Import,
    values: Vec<Vec<f32>>,
    exported: Exported,
    json: Value,
    bin: Vec<u8>,
}

fn bake(fixture: &Fixture, settings: &BakeSettings) -> Baked {
    bake_files("level.glb", &fixture.files(), settings)
}

fn bake_files(name: &str, files: &Files, settings: &BakeSettings) -> Baked {
    let import = import(name, files, None, settings).unwrap();
    let values = some_values(&import);
    let exported = export_all(name, files, &import, &values).unwrap();
    let glb = Glb::parse(&exported.glb).unwrap();
    let json = serde_json::from_slice(glb.json).unwrap();
    let bin = glb.bin.unwrap_or_default().to_vec();
    Baked { import, values, exported, json, bin }
}

fn default() -> BakeSettings {
    BakeSettings::default()
}

fn settings(attribute: Attribute, color: Option<ColorMode>) -> BakeSettings {
    BakeSettings { output: OutputSettings { attribute, color, ..OutputSettings::default() }, ..default() }
}

/// A primitive's values of an attribute, by an independent reader that validates what it reads.
fn foreign_values(glb: &[u8], mesh: usize, primitive: usize, attribute: &gltf::Semantic) -> Vec<f32> {
    let gltf = gltf::Gltf::from_slice(glb).unwrap();
    let primitive = gltf.meshes().nth(mesh).unwrap().primitives().nth(primitive).unwrap();
    let accessor = primitive.get(attribute).unwrap();
    let view = accessor.view().unwrap();
    let blob = gltf.blob.as_ref().unwrap();
    let (width, kind) = (accessor.dimensions().multiplicity(), accessor.data_type());
    assert_eq!(accessor.normalized(), kind == gltf::accessor::DataType::U16);
    let component = |at: usize, c: usize| match kind {
        gltf::accessor::DataType::F32 => f32::from_le_bytes(blob[at + 4 * c..at + 4 * c + 4].try_into().unwrap()),
        gltf::accessor::DataType::U16 => {
            f32::from(u16::from_le_bytes([blob[at + 2 * c], blob[at + 2 * c + 1]])) / 65_535.0
        }
        other => panic!("{other:?}"),
    };
    let element = |i: usize| {
        let at = view.offset() + accessor.offset() + i * view.stride().unwrap_or(accessor.size());
        (0..width).map(|c| component(at, c)).collect::<Vec<f32>>()
    };
    (0..accessor.count()).flat_map(element).collect()
}

fn ao() -> gltf::Semantic {
    gltf::Semantic::Extras("AO".to_owned())
}

#[test]
fn values_come_back_in_every_format() {
    for channels in 1..=4 {
        for (format, tolerance) in [(ValueFormat::F32, 0.0), (ValueFormat::U16, 0.5 / 65_535.0 + 1e-7)] {
            let output = OutputSettings { format, ..OutputSettings::default() };
            let half_distances_m = Some((1..=channels).map(|d| d as f64).collect());
            let baked = bake(&Fixture::square(), &BakeSettings { output, half_distances_m, ..default() });
            let files: Files = [("b.glb".to_owned(), baked.exported.glb.clone())].into();
            let scene = read_baked("b.glb", &files).unwrap();
            let part = &scene.parts[0];
            assert_eq!((part.channels, part.faces.len(), part.node.as_str()), (channels, 2, "square"));
            assert_eq!(scene.half_distances_m.len(), channels);
            let close = |values: &[f32]| values.iter().zip(&baked.values[0]).all(|(a, b)| (a - b).abs() <= tolerance);
            assert!(part.ao.len() == 4 * channels && close(&part.ao), "{format:?} {channels}");
            assert!(close(&foreign_values(&baked.exported.glb, 0, 0, &ao())), "{format:?} {channels}");
        }
    }
}

/// Whether all of `before` is in `after` as it was; arrays may have grown at their end.
fn survives(before: &Value, after: &Value, path: &str) {
    match (before, after) {
        (Value::Object(before), Value::Object(after)) => {
            for (key, value) in before {
                let path = format!("{path}/{key}");
                survives(value, after.get(key).unwrap_or_else(|| panic!("{path} is gone")), &path);
            }
        }
        (Value::Array(before), Value::Array(after)) => {
            assert!(after.len() >= before.len(), "{path}");
            let pairs = before.iter().zip(after).enumerate();
            pairs.for_each(|(i, (before, after))| survives(before, after, &format!("{path}/{i}")));
        }
        _ if path.ends_with("/byteLength") && path.starts_with("/buffers/") => {}
        _ => assert_eq!(before, after, "{path}"),
    }
}

#[test]
fn all_that_is_unknown_survives() {
    let mut fixture = Fixture::square();
    fixture.json["asset"]["extras"] = json!({ "by": "someone" });
    fixture.json["animations"] = json!([{ "channels": [], "samplers": [], "name": "a", "extras": 0.1 }]);
    fixture.json["extensionsUsed"] = json!(["ACME_thing"]);
    fixture.json["extensions"] = json!({ "ACME_thing": { "list": [1, 2.5, 1e-7, null, "ü\u{1}", { "x": -0.0 }] } });
    fixture.json["images"] = json!([{ "uri": "a%20b.png" }, { "uri": "data:image/png;base64,AA==" }]);
    fixture.json["nodes"][0]["extras"] = json!([true, { "deep": [[[]]] }]);
    fixture.json["meshes"][0]["primitives"][0]["attributes"]["_OTHER"] = json!(0);
    fixture.bin.extend([1, 2, 3, 4, 5]);
    fixture.json["buffers"][0]["byteLength"] = json!(fixture.bin.len());
    let baked = bake(&fixture, &default());
    survives(&fixture.json, &baked.json, "");
    assert!(baked.bin.starts_with(&fixture.bin));
    let kiln = &baked.json["asset"]["extras"]["kiln"];
    let level = Digest::of(&codec::encode(&baked.import.level)).to_string();
    assert_eq!((kiln["version"].as_str(), kiln["level"].as_str()), (Some("1.2.3"), Some(level.as_str())));
    assert_eq!((&kiln["attribute"], &kiln["half_distances_m"]), (&json!("ao"), &json!([0.08, 12.0])));
    assert_eq!(baked.exported.warnings[0].code, "external_images");
    assert_eq!(baked.exported.warnings[0].count, 1);
}

#[test]
fn instances_of_a_mesh_share_all_but_their_values() {
    let mut fixture = Fixture::square();
    fixture.root_node(json!({ "name": "other", "mesh": 0 }));
    let baked = bake(&fixture, &default());
    assert_eq!((&baked.json["nodes"][0]["mesh"], &baked.json["nodes"][1]["mesh"]), (&json!(0), &json!(1)));
    let primitive = |mesh: usize| &baked.json["meshes"][mesh]["primitives"][0];
    assert_eq!(primitive(0)["attributes"]["POSITION"], primitive(1)["attributes"]["POSITION"]);
    assert_eq!(primitive(0)["indices"], primitive(1)["indices"]);
    for instance in 0..2 {
        assert_eq!(foreign_values(&baked.exported.glb, instance, 0, &ao()), baked.values[instance]);
    }
}

#[test]
fn meshes_of_nodes_that_are_not_baked_stay_as_they_are() {
    let mut fixture = Fixture::square();
    fixture.push("nodes", json!({ "name": "outside", "mesh": 0 }));
    let baked = bake(&fixture, &default());
    assert_eq!(baked.json["meshes"][0], fixture.json["meshes"][0]);
    assert_eq!((&baked.json["nodes"][0]["mesh"], &baked.json["nodes"][1]["mesh"]), (&json!(1), &json!(0)));
}

#[test]
fn gpu_instances_become_nodes() {
    let mut fixture = Fixture::square();
    let translation = fixture.floats(&[[1.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 7.0]]);
    let id = fixture.floats(&[[5.0], [6.0], [7.0]]);
    let attributes = json!({ "attributes": { "TRANSLATION": translation, "_ID": id } });
    let child = fixture.push("nodes", json!({ "name": "child" }));
    let node = &mut fixture.json["nodes"][0];
    node["extensions"] = json!({ "EXT_mesh_gpu_instancing": attributes, "ACME": 1 });
    node["children"] = json!([child]);
    node["rotation"] = json!([0.0, 0.6, 0.0, 0.8]);
    fixture.json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing", "ACME"]);
    fixture.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let baked = bake(&fixture, &default());
    let node = &baked.json["nodes"][0];
    assert_eq!((&node["children"], &node["extensions"]), (&json!([1, 2, 3, 4]), &json!({ "ACME": 1 })));
    assert!(node.get("mesh").is_none() && baked.json.get("extensionsRequired").is_none());
    assert_eq!(baked.json["extensionsUsed"], json!(["ACME"]));
    assert_eq!(baked.json["nodes"][3]["extras"], json!({ "EXT_mesh_gpu_instancing": { "_ID": 6.0 } }));
    assert_eq!(baked.exported.warnings[0].code, "instancing_expanded");
    let again: Files = [("level.glb".to_owned(), baked.exported.glb.clone())].into();
    let again = import("level.glb", &again, None, &default()).unwrap();
    for (before, after) in baked.import.level.instances.iter().zip(&again.level.instances) {
        assert!(before.world_from_object.abs_diff_eq(after.world_from_object, 1e-12));
    }
    assert_eq!(again.level.instances.len(), 3);
}

#[test]
fn separate_buffers_become_one() {
    let mut fixture = Fixture::square();
    let whole = bake(&fixture, &default());
    let half = fixture.bin.split_off(48);
    fixture.json["bufferViews"][1] = json!({ "buffer": 1, "byteLength": half.len() });
    let uri = "data:application/octet-stream;base64,";
    let base64 = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, &half);
    for (uri, file) in [(format!("{uri}{base64}"), None), ("sub/b%20c.bin".to_owned(), Some("sub/b c.bin"))] {
        fixture.json["buffers"] = json!([
            { "uri": "a.bin", "byteLength": 48, "name": "first" },
            { "uri": uri, "byteLength": half.len(), "extras": "kept" },
        ]);
        let mut files: Files = [("a.bin".to_owned(), fixture.bin.clone())].into();
        files.insert("level.gltf".to_owned(), fixture.json.to_string().into_bytes());
        files.extend(file.map(|name| (name.to_owned(), half.clone())));
        let baked = bake_files("level.gltf", &files, &default());
        assert_eq!(baked.import.meshes, whole.import.meshes);
        assert_eq!(baked.json["buffers"].as_array().unwrap().len(), 1);
        assert!(baked.json["buffers"][0].get("uri").is_none());
        assert_eq!(baked.json["buffers"][0]["name"], "first");
        let merged = &baked.json["buffers"][0]["extras"]["kiln"]["merged_buffers"][0];
        assert_eq!((&merged["extras"], &merged["byteOffset"]), (&json!("kept"), &json!(48)));
        let again: Files = [("level.glb".to_owned(), baked.exported.glb.clone())].into();
        assert_eq!(import("level.glb", &again, None, &default()).unwrap().meshes, whole.import.meshes);
        assert_eq!(foreign_values(&baked.exported.glb, 0, 0, &ao()), baked.values[0]);
    }
}

#[test]
fn buffers_without_bytes_keep_their_views() {
    let fixture = Fixture::square();
    let mut json = fixture.json.clone();
    json["buffers"] = json!([{ "byteLength": 8, "extensions": { "ACME": 1 } }, { "uri": "a.bin", "byteLength": 72 }]);
    json["bufferViews"][0]["buffer"] = json!(1);
    json["bufferViews"][1]["buffer"] = json!(1);
    json["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 0, "byteLength": 8 }));
    let files: Files =
        [("a.bin".to_owned(), fixture.bin.clone()), ("level.gltf".to_owned(), json.to_string().into_bytes())].into();
    let baked = bake_files("level.gltf", &files, &default());
    let buffers: Vec<_> = (0..3).map(|view| baked.json["bufferViews"][view]["buffer"].as_u64()).collect();
    assert_eq!(buffers, [Some(0), Some(0), Some(1)]);
    assert_eq!(baked.json["buffers"][1], json!({ "byteLength": 8, "extensions": { "ACME": 1 } }));
}

#[test]
fn colors_are_the_blend() {
    let baked = bake(&Fixture::square(), &settings(Attribute::Color, None));
    let colors = foreign_values(&baked.exported.glb, 0, 0, &gltf::Semantic::Colors(0));
    let ao = &baked.values[0];
    for vertex in 0..4 {
        let grey = (0.03 * f64::from(ao[2 * vertex]) + 0.97 * f64::from(ao[2 * vertex + 1])) as f32;
        assert_eq!(colors[3 * vertex..3 * vertex + 3], [grey; 3]);
    }
    assert!(baked.json["meshes"][0]["primitives"][0]["attributes"].get("_AO").is_none());
}

#[test]
fn existing_colors_are_multiplied_or_replaced() {
    let mut fixture = Fixture::square();
    let rgba = [[1.0, 0.5, 0.25, 0.75]; 4];
    let color = fixture.floats(&rgba);
    fixture.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(color);
    let plain = bake(&Fixture::square(), &settings(Attribute::Color, None));
    let greys = foreign_values(&plain.exported.glb, 0, 0, &gltf::Semantic::Colors(0));
    let colors = |mode| {
        let baked = bake(&fixture, &settings(Attribute::Both, Some(mode)));
        assert_eq!(foreign_values(&baked.exported.glb, 0, 0, &ao()), baked.values[0]);
        foreign_values(&baked.exported.glb, 0, 0, &gltf::Semantic::Colors(0))
    };
    let (multiplied, replaced) = (colors(ColorMode::Multiply), colors(ColorMode::Replace));
    for vertex in 0..4 {
        let grey = greys[3 * vertex];
        assert_eq!(multiplied[4 * vertex..4 * vertex + 4], [grey, grey * 0.5, grey * 0.25, 0.75]);
        assert_eq!(replaced[4 * vertex..4 * vertex + 4], [grey, grey, grey, 0.75]);
    }
}

#[test]
fn residuals_are_written_where_they_are_wanted() {
    for format in [ValueFormat::F32, ValueFormat::U16] {
        let with = |residual| {
            let output = OutputSettings { format, residual, ..OutputSettings::default() };
            bake(&Fixture::square(), &BakeSettings { output, ..default() })
        };
        let (plain, baked) = (with(false), with(true));
        let attributes = |baked: &Baked| baked.json["meshes"][0]["primitives"][0]["attributes"].clone();
        assert!(attributes(&plain).get("_AO_RESIDUAL").is_none());
        let attribute = gltf::Semantic::Extras("AO_RESIDUAL".to_owned());
        let expected: Vec<f32> = baked.values[0].iter().rev().copied().collect();
        let close = |found: &[f32]| found.iter().zip(&expected).all(|(a, b)| (a - b).abs() <= 1e-5);
        let foreign = foreign_values(&baked.exported.glb, 0, 0, &attribute);
        assert!(foreign.len() == 8 && close(&foreign), "{foreign:?}");
        // What a default bake writes is the start of it; Kiln reads both back.
        assert!(baked.bin.starts_with(&plain.bin[..plain.bin.len()]));
        assert_eq!(attributes(&baked)["_AO"], attributes(&plain)["_AO"]);
        let read = |baked: &Baked| {
            let files: Files = [("b.glb".to_owned(), baked.exported.glb.clone())].into();
            read_baked("b.glb", &files).unwrap().parts.remove(0)
        };
        assert_eq!((read(&plain).residual_channels, read(&plain).residual.len()), (0, 0));
        assert!(read(&baked).residual_channels == 2 && close(&read(&baked).residual));
        // Baked again without, the old ones are gone: they are not those of the new values.
        let files: Files = [("level.glb".to_owned(), baked.exported.glb.clone())].into();
        let again = bake_files("level.glb", &files, &default());
        assert!(attributes(&again).get("_AO_RESIDUAL").is_none() && attributes(&again).get("_AO").is_some());
    }
}

#[test]
fn baking_a_baked_file_replaces_its_values() {
    let once = bake(&Fixture::square(), &default());
    let files: Files = [("level.glb".to_owned(), once.exported.glb.clone())].into();
    let settings = BakeSettings { half_distances_m: Some(vec![1.0]), ..default() };
    let twice = bake_files("level.glb", &files, &settings);
    assert_eq!(twice.import.meshes, once.import.meshes);
    assert_eq!(foreign_values(&twice.exported.glb, 0, 0, &ao()), twice.values[0]);
    assert_eq!(twice.json["asset"]["extras"]["kiln"]["half_distances_m"], json!([1.0]));
}

#[test]
fn without_values_nothing_but_the_record_changes() {
    let fixture = Fixture::square();
    let import = fixture.import().unwrap();
    let exported = export_all("level.glb", &fixture.files(), &import, &[]).unwrap();
    let json: Value = serde_json::from_slice(Glb::parse(&exported.glb).unwrap().json).unwrap();
    let mut expected = fixture.json.clone();
    expected["asset"] = json["asset"].clone();
    assert_eq!(json, expected);
}

#[test]
fn what_does_not_fit_is_refused() {
    let fixture = Fixture::square();
    let files = fixture.files();
    let import = fixture.import().unwrap();
    let export_with = |files: &Files, values: &[BakedInstance<'_>]| {
        let level_digest = Digest::default();
        let (level_name, level, version) = ("level.glb", &import.level, "0");
        export(&ExportRequest { level_name, files, level, level_digest, version, values, models: &[], numbers: &[] })
            .map(|_| ())
    };
    let refused = |values: &[BakedInstance<'_>]| export_with(&files, values).unwrap_err();
    let good = BakedInstance { instance: 0, values: &[0.5; 8], residuals: &[] };
    assert_eq!(export_with(&files, &[good]), Ok(()));
    assert_eq!(refused(&[good, good]).kind(), ErrorKind::Internal);
    assert_eq!(refused(&[BakedInstance { instance: 1, ..good }]).kind(), ErrorKind::Internal);
    assert!(refused(&[BakedInstance { values: &[0.5; 7], ..good }]).to_string().contains("7 values for 4 vertices"));
    assert!(refused(&[BakedInstance { values: &[f32::NAN; 8], ..good }]).to_string().contains("not finite"));
    let mut level = import.level.clone();
    level.output.residual = true;
    let (level_name, level_digest, version) = ("level.glb", Digest::default(), "0");
    let values = &[BakedInstance { residuals: &[0.5; 7], ..good }];
    let request = ExportRequest {
        level_name,
        files: &files,
        level: &level,
        level_digest,
        version,
        values,
        models: &[],
        numbers: &[],
    };
    assert!(export(&request).unwrap_err().to_string().contains("7 residuals for 4 vertices"));
    let mut other = Fixture::new();
    let position = other.floats(&SQUARE[..3]);
    let mesh = other.mesh("m", &json!([{ "attributes": { "POSITION": position } }]));
    other.root_node(json!({ "mesh": mesh }));
    assert!(matches!(export_with(&other.files(), &[good]), Err(SceneError::Mismatch { .. })));
}

/// If this fails, export gives other bytes than before for the same input: raise the revision of
/// `TaskKind::Export` in kiln-core, so that no store answers with what it kept, and put the new digest here.
#[test]
fn golden_export() {
    let mut fixture = Fixture::square();
    fixture.root_node(json!({ "name": "other", "mesh": 0, "translation": [0, 1, 0] }));
    let baked = bake(&fixture, &settings(Attribute::Both, None));
    let mut glb = baked.exported.glb;
    // The level's own digest is import's affair.
    let level = Digest::of(&codec::encode(&baked.import.level)).to_string();
    let at = glb.windows(64).position(|window| window == level.as_bytes()).unwrap();
    glb[at..at + 64].fill(b'0');
    assert_eq!(Digest::of(&glb).to_string(), "8a61fe62b009bdbbfb18ff6ec7a79017bc2d63e3a12c2c2a74b330f8dc7b4b64");
}

#[test]
fn defects_outside_the_scene_do_not_stop_an_export() {
    let mut fixture = Fixture::square();
    fixture.push("nodes", json!({ "mesh": "none" }));
    fixture.json["images"] = json!({});
    let baked = bake(&fixture, &default());
    survives(&fixture.json, &baked.json, "");
}

/// The square twice as a tree, once as a shrub, and once as itself.
fn with_foliage() -> (Fixture, Import) {
    let mut fixture = Fixture::square();
    for (name, x) in [("tree_1", 2.0), ("tree_2", 4.0), ("shrub", 6.0)] {
        fixture.root_node(json!({ "name": name, "mesh": 0, "translation": [x, 0.0, 0.0] }));
    }
    let offsets = fixture.floats(&[[0.0f32, 1.0, 0.0], [3.0, 1.0, 0.0]]);
    let instancing = json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": offsets } } });
    fixture.root_node(json!({ "name": "tree_many", "mesh": 0, "extensions": instancing }));
    let rules = "[[class]]\nmatch = 'tree_*'\nclass = 'tree'\n[[class]]\nmatch = 'shrub'\nclass = 'shrub'\n";
    let import = fixture.import_with(&default(), rules).unwrap();
    (fixture, import)
}

#[test]
fn numbers_of_instances_come_back_composed() {
    use kiln_core::{Gets, InstanceNumbers};
    let (fixture, import) = with_foliage();
    let level = &import.level;
    let gets: Vec<Gets> = level.instances.iter().map(|instance| instance.gets).collect();
    let tree = Gets::GlobalTraced;
    assert_eq!(gets, [Gets::Vertices, tree, tree, Gets::Scalar, tree, tree]);
    let number = |index: usize| match gets[index] {
        Gets::Global | Gets::GlobalTraced => {
            let y = |channel: usize| [0.5 + index as f32 / 16.0, 0.125, -0.25 * channel as f32, 0.0];
            InstanceNumbers::Global { channels: vec![y(0), y(1)], blend: y(1) }
        }
        _ => InstanceNumbers::Scalar { ao: vec![0.25, 0.75], is_open: false },
    };
    let all: Vec<InstanceNumbers> = (0..6).map(number).collect();
    let numbers: Vec<_> =
        (1..6).map(|instance| super::NumberedInstance { instance, numbers: &all[instance] }).collect();
    let own = vec![0.9; level.meshes[0].vertex_count as usize * 2];
    let local: Vec<f32> = (0..level.meshes[1].vertex_count * 2).map(|i| (i % 7) as f32 / 8.0).collect();
    let files = fixture.files();
    let request = ExportRequest {
        level_name: "level.glb",
        files: &files,
        level,
        level_digest: Digest::default(),
        version: "1.2.3",
        values: &[BakedInstance { instance: 0, values: &own, residuals: &[] }],
        models: &[super::BakedModel { mesh: level.instances[1].mesh as usize, values: &local }],
        numbers: &numbers,
    };
    let glb = export(&request).unwrap().glb;
    let files: Files = [("b.glb".to_owned(), glb)].into();
    let scene = read_baked("b.glb", &files).unwrap();
    let names: Vec<&str> = scene.parts.iter().map(|part| part.node.as_str()).collect();
    assert_eq!(names, ["square", "tree_1", "tree_2", "shrub", "tree_many[0]", "tree_many[1]"]);
    assert!(scene.parts[0].ao.iter().all(|ao| *ao == 0.9));
    assert!(scene.parts[3].ao.chunks(2).all(|ao| ao == [0.25, 0.75]));
    let (min, max) = (level.meshes[1].bounds.min, level.meshes[1].bounds.max);
    for index in [1usize, 2, 4, 5] {
        let part = &scene.parts[index];
        let InstanceNumbers::Global { channels, .. } = &all[index] else { panic!("a tree") };
        for (vertex, source) in SQUARE.iter().enumerate() {
            for channel in 0..2 {
                let u = |axis: usize| {
                    let half = 0.5 * (max[axis] - min[axis]) as f32;
                    let middle = 0.5 * (max[axis] + min[axis]) as f32;
                    if half > 0.0 { (source[axis] - middle) / half } else { 0.0 }
                };
                let y = channels[channel];
                let global = y[0] + y[1] * u(0) + y[2] * u(1) + y[3] * u(2);
                let expected = (local[2 * vertex + channel] * global).clamp(0.0, 1.0);
                assert!((part.ao[2 * vertex + channel] - expected).abs() < 1e-6, "{index} {vertex} {channel}");
            }
        }
    }
    // All trees share one mesh, so that it is there once; the others have the source's.
    let json: Value = serde_json::from_slice(Glb::parse(&files["b.glb"]).unwrap().json).unwrap();
    assert_eq!(json["meshes"].as_array().unwrap().len(), 3);
    assert_eq!(json["nodes"][1]["mesh"], json["nodes"][2]["mesh"]);
    assert_eq!(json["nodes"][3]["extras"]["kiln"]["ao"], json!([0.25, 0.75]));
}

#[test]
fn numbers_that_do_not_fit_are_refused() {
    use kiln_core::InstanceNumbers;
    let (fixture, import) = with_foliage();
    let refusal = |instance: usize, numbers: InstanceNumbers| {
        let files = fixture.files();
        let numbers = [super::NumberedInstance { instance, numbers: &numbers }];
        let request = ExportRequest {
            level_name: "level.glb",
            files: &files,
            level: &import.level,
            level_digest: Digest::default(),
            version: "1",
            values: &[],
            models: &[],
            numbers: &numbers,
        };
        export(&request).unwrap_err().to_string()
    };
    let scalar = |ao: Vec<f32>| InstanceNumbers::Scalar { ao, is_open: false };
    assert!(refusal(99, scalar(vec![1.0, 1.0])).contains("there is no such one"));
    assert!(refusal(3, scalar(vec![1.0])).contains("1 channels of 2"));
    assert!(refusal(3, scalar(vec![1.0, f32::NAN])).contains("not finite"));
}
