//! Import of documents made by code.

use crate::{
    ErrorKind, SceneError,
    fixture::{Fixture, SQUARE, SQUARE_FACES, mesh_of},
};
use glam::DVec3;
use kiln_core::{Attribute, BakeSettings, Class, ColorMode, Kernel, Mesh, OutputSettings};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// The faces of a mesh by the bits of their corners.
fn face_set(mesh: &Mesh) -> BTreeSet<[[u32; 3]; 3]> {
    (0..mesh.faces.len()).map(|face| mesh.corners(face).map(|corner| corner.to_array().map(f32::to_bits))).collect()
}

fn square_with(change: impl Fn(&mut Fixture, &mut Value)) -> Fixture {
    let mut fixture = Fixture::square();
    let mut primitive = fixture.json["meshes"][0]["primitives"][0].take();
    change(&mut fixture, &mut primitive);
    fixture.json["meshes"][0]["primitives"][0] = primitive;
    fixture
}

#[test]
fn topologies_and_index_types_give_the_same_faces() {
    let expected = face_set(&mesh_of(&Fixture::square().import().unwrap(), 0));
    assert_eq!(expected.len(), 2);
    let fan_order = [SQUARE[1], SQUARE[3], SQUARE[2], SQUARE[0]];
    let cases: [fn(&mut Fixture, &mut Value); 4] = [
        |_, primitive| {
            primitive["mode"] = json!(5);
            primitive.as_object_mut().unwrap().remove("indices");
        },
        |fixture, primitive| {
            let bytes = SQUARE_FACES.map(|index| index as u8);
            let accessor = json!({ "count": 6, "componentType": 5121, "type": "SCALAR" });
            primitive["indices"] = json!(fixture.accessor(&bytes, accessor));
        },
        |fixture, primitive| {
            let bytes: Vec<u8> = SQUARE_FACES.iter().flat_map(|&index| (index as u16).to_le_bytes()).collect();
            let accessor = json!({ "count": 6, "componentType": 5123, "type": "SCALAR" });
            primitive["indices"] = json!(fixture.accessor(&bytes, accessor));
        },
        |fixture, primitive| {
            let corners = SQUARE_FACES.map(|index| SQUARE[index as usize]);
            *primitive = json!({ "attributes": { "POSITION": fixture.floats(&corners) } });
        },
    ];
    for (i, case) in cases.into_iter().enumerate() {
        assert_eq!(face_set(&mesh_of(&square_with(case).import().unwrap(), 0)), expected, "case {i}");
    }
    let fan = square_with(|fixture, primitive| {
        *primitive = json!({ "attributes": { "POSITION": fixture.floats(&fan_order) }, "mode": 6 });
    });
    assert_eq!(face_set(&mesh_of(&fan.import().unwrap(), 0)), expected);
}

#[test]
fn the_front_of_every_triangle_of_a_strip_is_up() {
    let strip = square_with(|_, primitive| {
        primitive["mode"] = json!(5);
        primitive.as_object_mut().unwrap().remove("indices");
    });
    let mesh = mesh_of(&strip.import().unwrap(), 0);
    for face in 0..2 {
        let [a, b, c] = mesh.corners(face);
        assert!((b - a).cross(c - a).y > 0.0);
    }
}

#[test]
fn transforms_multiply_from_root_to_leaf() {
    let mut fixture = Fixture::square();
    let leaf = fixture.push("nodes", json!({ "name": "leaf", "mesh": 0, "scale": [-1, 2, 1] }));
    let matrix = json!({ "matrix": [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 10, 20, 30, 1], "children": [leaf] });
    let middle = fixture.push("nodes", matrix);
    fixture.root_node(json!({ "translation": [1, 0, 0], "children": [middle] }));
    let import = fixture.import().unwrap();
    let instance = &import.level.instances[1];
    assert_eq!(instance.name, "leaf");
    assert!(instance.is_mirrored() && !import.level.instances[0].is_mirrored());
    let at = instance.world_from_object.transform_point3(DVec3::new(1.0, 1.0, 0.0)) + import.level.origin_m;
    assert!((at - DVec3::new(11.0, 22.0, 31.0)).length() < 1e-12, "{at}");
}

#[test]
fn a_rotation_is_made_unit() {
    let mut fixture = Fixture::square();
    fixture.json["nodes"][0]["rotation"] = json!([0, 2, 0, 2]);
    let world = fixture.import().unwrap().level.instances[0].world_from_object;
    assert!((world.transform_vector3(DVec3::Z) - DVec3::X).length() < 1e-12);
    fixture.json["nodes"][0]["rotation"] = json!([0, 0, 0, 0]);
    assert!(fixture.refusal().contains("nodes[0].rotation: it is no rotation"));
}

#[test]
fn regions_are_relative_to_the_origin() {
    let mut fixture = Fixture::square();
    fixture.json["nodes"][0]["translation"] = json!([4e6, 0, 0]);
    let sidecar = "[[region]]\nid = 'a'\nmin_m = [4e6, 0, 0]\nmax_m = [4000002.0, 3, 2]\n\
                   [[region]]\nid = 'b'\nmin_m = [4000002.0, 0, 0]\nmax_m = [4000003.0, 2, 2]\n";
    let level = fixture.import_with(&BakeSettings::default(), sidecar).unwrap().level;
    assert!(level.origin_m.x > 3.9e6);
    let place = |point: DVec3| point + level.origin_m;
    assert_eq!(place(level.regions.regions[1].bounds.max), DVec3::new(4_000_003.0, 2.0, 2.0));
    assert_eq!(place(level.regions.edges[0].center), DVec3::new(4_000_002.0, 1.0, 1.0));
    assert_eq!(level.regions.edges[0].area_m2, 4.0);
}

#[test]
fn far_levels_are_moved_to_the_middle() {
    let mut fixture = Fixture::square();
    fixture.json["nodes"][0]["translation"] = json!([4_000_000.25, 1000.0, -3_000_000.0]);
    let level = fixture.import().unwrap().level;
    assert_eq!(level.origin_m % 1024.0, DVec3::ZERO);
    assert_eq!(level.instances[0].world_from_object.translation + level.origin_m, DVec3::new(4e6 + 0.25, 1e3, -3e6));
    assert!(level.bounds.min.abs().max_element() < 1024.0 && (level.bounds.diagonal() - 2f64.sqrt()).abs() < 1e-9);
}

#[test]
fn deep_hierarchies_do_not_overflow() {
    let mut fixture = Fixture::square();
    let mut child = fixture.push("nodes", json!({ "mesh": 0, "translation": [0, 1, 0] }));
    for _ in 0..30_000 {
        child = fixture.push("nodes", json!({ "children": [child], "translation": [0, 0.5, 0] }));
    }
    fixture.root_node(json!({ "children": [child] }));
    let level = fixture.import().unwrap().level;
    assert_eq!(level.instances[1].world_from_object.translation.y + level.origin_m.y, 15_001.0);
}

#[test]
fn broken_hierarchies_are_refused() {
    let refusal = |nodes: Value, roots: Value| {
        let mut fixture = Fixture::square();
        (fixture.json["nodes"], fixture.json["scenes"][0]["nodes"]) = (nodes, roots);
        fixture.refusal()
    };
    let two_parents = refusal(json!([{ "children": [2] }, { "children": [2] }, { "mesh": 0 }]), json!([0, 1]));
    assert!(two_parents.contains("nodes[1].children[0]: node 2 is a child of nodes[0] already"), "{two_parents}");
    let cycle = refusal(json!([{}, { "children": [2] }, { "children": [1] }]), json!([0]));
    assert!(cycle.contains("among its own descendants"), "{cycle}");
    assert!(refusal(json!([{ "children": [0] }]), json!([0])).contains("descendants"));
    assert!(refusal(json!([{ "children": [1] }, {}]), json!([0, 1])).contains("no root"));
    assert!(refusal(json!([{}]), json!([0, 0])).contains("twice"));
    assert!(refusal(json!([{ "children": [9] }]), json!([0])).contains("only 1"));
    assert!(refusal(json!([{ "mesh": 7 }]), json!([0])).contains("nodes[0].mesh: it refers to meshes[7]"));
}

#[test]
fn scenes_and_visibility() {
    let mut fixture = Fixture::square();
    let hidden_child = fixture.push("nodes", json!({ "mesh": 0 }));
    let invisible = json!({ "KHR_node_visibility": { "visible": false } });
    fixture.root_node(json!({ "mesh": 0, "extensions": invisible, "children": [hidden_child] }));
    let outside = fixture.push("nodes", json!({ "mesh": 0, "name": "outside" }));
    fixture.push("scenes", json!({ "nodes": [outside] }));
    let names = |fixture: &Fixture| -> Vec<String> {
        fixture.import().unwrap().level.instances.into_iter().map(|instance| instance.name).collect()
    };
    assert_eq!(names(&fixture), ["square"]);
    fixture.json["scene"] = json!(1);
    assert_eq!(names(&fixture), ["outside"]);
    fixture.json["scene"].take();
    assert_eq!(names(&fixture), ["square", "outside"]);
}

#[test]
fn gpu_instances_stand_where_their_attributes_say() {
    let mut fixture = Fixture::square();
    let translation = fixture.floats(&[[1.0, 0.0, 0.0], [0.0, 5.0, 0.0]]);
    let half_turn = [0i16, 0, 0, 32767, 0, 32767, 0, 0];
    let bytes: Vec<u8> = half_turn.iter().flat_map(|value| value.to_le_bytes()).collect();
    let rotation = json!({ "count": 2, "componentType": 5122, "type": "VEC4", "normalized": true });
    let rotation = fixture.accessor(&bytes, rotation);
    let attributes = json!({ "attributes": { "TRANSLATION": translation, "ROTATION": rotation } });
    fixture.json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": attributes });
    fixture.json["nodes"][0]["scale"] = json!([2, 2, 2]);
    let level = fixture.import().unwrap().level;
    let names: Vec<_> = level.instances.iter().map(|i| (i.name.as_str(), i.gpu_instance)).collect();
    assert_eq!(names, [("square[0]", Some(0)), ("square[1]", Some(1))]);
    let corner = |i: usize| level.instances[i].world_from_object.transform_point3(DVec3::X);
    assert!((corner(0) - DVec3::new(4.0, 0.0, 0.0)).length() < 1e-9);
    assert!((corner(1) - DVec3::new(-2.0, 10.0, 0.0)).length() < 1e-9);
    let scale = fixture.floats(&[[1.0; 3]; 3]);
    let node = &mut fixture.json["nodes"][0];
    node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = json!(scale);
    assert!(fixture.refusal().contains("2 elements") || fixture.refusal().contains("3 elements"));
}

#[test]
fn primitives_that_share_positions_share_a_block() {
    let mut fixture = Fixture::new();
    let (one, other) = (fixture.square_primitive(), fixture.square_primitive());
    let same = json!({ "attributes": one["attributes"], "indices": other["indices"], "mode": 4 });
    let points = json!({ "attributes": one["attributes"], "mode": 0 });
    let mesh = fixture.mesh("m", &json!([points, one, other, same]));
    fixture.root_node(json!({ "mesh": mesh }));
    let import = fixture.import().unwrap();
    let blocks: Vec<_> =
        import.level.meshes[0].blocks.iter().map(|b| (b.first_vertex, b.vertex_count, b.primitives.clone())).collect();
    assert_eq!(blocks, [(0, 4, vec![1, 3]), (4, 4, vec![2])]);
    // All three squares are at one place, so that one is left.
    assert_eq!((import.level.meshes[0].vertex_count, import.level.meshes[0].face_count), (8, 2));
    assert_eq!((import.level.warnings[0].code.as_str(), import.level.warnings[0].count), ("duplicate_faces", 4));
}

#[test]
fn rules_on_nodes_make_variants() {
    let mut fixture = Fixture::square();
    for name in ["far_1", "gone", "near"] {
        fixture.root_node(json!({ "name": name, "mesh": 0 }));
    }
    let twin = fixture.json["meshes"][0].clone();
    let twin = fixture.push("meshes", twin);
    fixture.root_node(json!({ "name": "twin", "mesh": twin }));
    let rules = "[[class]]\nmatch = 'far_*'\nclass = 'distant'\n[[class]]\nmatch = 'gone'\nclass = 'ignored'\n\
                 [[class]]\nmatch = 'nothing'\nclass = 'tree'\n";
    let import = fixture.import_with(&BakeSettings::default(), rules).unwrap();
    let level = &import.level;
    let placed: Vec<_> = level.instances.iter().map(|i| (i.name.as_str(), i.mesh)).collect();
    assert_eq!(placed, [("square", 0), ("far_1", 1), ("near", 0), ("twin", 2)]);
    assert_eq!(mesh_of(&import, 1).groups[0].max_samples_per_face, Some(4));
    assert_eq!(level.meshes.iter().map(|mesh| mesh.source_mesh).collect::<Vec<_>>(), [0, 0, 1]);
    assert_eq!((level.meshes[0].digest, import.meshes.len()), (level.meshes[2].digest, 2));
    let classes: Vec<_> = level.counts.classes.iter().map(|(class, faces)| (*class, *faces)).collect();
    assert_eq!(classes, [(Class::Opaque, 6), (Class::Distant, 2), (Class::Ignored, 2)]);
    assert_eq!((level.counts.meshes, level.counts.instances, level.counts.faces), (2, 4, 8));
    assert!(level.warnings.iter().any(|warning| warning.code == "unused_rule" && warning.subject == "nothing"));
}

#[test]
fn foliage_is_told_from_what_stops_rays() {
    let rules = "[[class]]\nmatch = 'square'\nclass = 'tree'\ntransmittance_per_crossing = 0.5\n";
    let import = Fixture::square().import_with(&BakeSettings::default(), rules).unwrap();
    let group = &mesh_of(&import, 0).groups[0];
    assert!(group.class == Class::Tree && !group.occludes && group.receives);
    assert_eq!(group.foliage, Some(kiln_core::Foliage::Crossing(kiln_core::OpticalDepth(1 << 16))));
    assert_eq!(import.level.warnings, []);
    let settings = BakeSettings { foliage: kiln_core::FoliageMode::Geometry, ..BakeSettings::default() };
    let group = mesh_of(&Fixture::square().import_with(&settings, rules).unwrap(), 0).groups[0].clone();
    assert!(group.class == Class::Tree && group.occludes && group.foliage.is_none());
}

#[test]
fn materials_decide_on_sides_and_light() {
    let material = |material: Value| {
        let mut fixture = Fixture::square();
        fixture.json["materials"] = json!([material]);
        fixture.json["meshes"][0]["primitives"][0]["material"] = json!(0);
        let import = fixture.import().unwrap();
        (mesh_of(&import, 0).groups[0].clone(), import.level.warnings.len())
    };
    let (group, warnings) = material(json!({ "doubleSided": true }));
    assert!(group.double_sided && group.occludes && warnings == 0);
    assert!(!material(json!({ "alphaMode": "BLEND" })).0.occludes);
    let transmission =
        |factor: f64| json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": factor } } });
    assert!(!material(transmission(0.5)).0.occludes);
    assert!(material(transmission(0.0)).0.occludes);
    let (group, warnings) = material(json!({ "alphaMode": "MASK" }));
    assert!(group.is_solid() && warnings == 0, "without a texture the factor's alpha counts, which is 1");
}

#[test]
fn bad_faces_are_refused_or_dropped() {
    let drop = BakeSettings { drop_bad_faces: true, ..BakeSettings::default() };
    let infinite = square_with(|fixture, primitive| {
        let mut corners = SQUARE;
        corners[3][1] = f32::INFINITY;
        primitive["attributes"]["POSITION"] = json!(fixture.floats(&corners));
    });
    assert!(infinite.refusal().contains("meshes[0].primitives[0].attributes.POSITION (accessor 2): vertex 3 is at"));
    let out_of_range =
        square_with(|fixture, primitive| primitive["indices"] = json!(fixture.indices(&[0, 1, 2, 2, 1, 4])));
    let message = out_of_range.refusal();
    assert!(message.contains("indices (accessor 2): index 4 is out of range: there are 4 vertices"), "{message}");
    assert!(message.contains("--drop-bad-faces"));
    let restart =
        square_with(|fixture, primitive| primitive["indices"] = json!(fixture.indices(&[0, 1, 2, u32::MAX, 1, 0])));
    assert!(restart.refusal().contains("primitive restart"));
    for (fixture, code) in
        [(infinite, "non_finite_faces"), (out_of_range, "out_of_range_faces"), (restart, "out_of_range_faces")]
    {
        let import = fixture.import_with(&drop, "").unwrap();
        assert_eq!(mesh_of(&import, 0).faces.len(), 1);
        assert!(mesh_of(&import, 0).positions.iter().flatten().all(|coordinate| coordinate.is_finite()));
        assert!(import.level.warnings.iter().any(|warning| warning.code == code && warning.count == 1), "{code}");
    }
}

#[test]
fn normals_are_unit_or_zero() {
    let fixture = square_with(|fixture, primitive| {
        let normals = [[0.0, 2.0, 0.0], [0.0; 3], [f32::NAN, 0.0, 0.0], [0.0, 1e-30, 0.0]];
        primitive["attributes"]["NORMAL"] = json!(fixture.floats(&normals));
    });
    let import = fixture.import().unwrap();
    assert_eq!(mesh_of(&import, 0).normals, [[0.0, 1.0, 0.0], [0.0; 3], [0.0; 3], [0.0, 1.0, 0.0]]);
    assert_eq!((import.level.warnings[0].code.as_str(), import.level.warnings[0].count), ("invalid_normals", 2));
    assert_eq!(mesh_of(&Fixture::square().import().unwrap(), 0).normals, [[0.0; 3]; 4]);
    let short = square_with(|fixture, primitive| {
        primitive["attributes"]["NORMAL"] = json!(fixture.floats(&[[0.0, 1.0, 0.0]; 3]));
    });
    assert!(short.refusal().contains("it has 3 elements, but POSITION has 4"));
}

#[test]
fn levels_without_triangles_are_levels() {
    let mut fixture = Fixture::new();
    assert_eq!(fixture.import().unwrap().level.instances.len(), 0);
    let primitive = fixture.square_primitive();
    let mesh = fixture.mesh("points", &json!([{ "attributes": primitive["attributes"], "mode": 0 }]));
    fixture.root_node(json!({ "mesh": mesh }));
    let import = fixture.import().unwrap();
    assert!(import.level.instances.is_empty() && import.meshes.is_empty() && import.level.bounds.is_empty());
}

#[test]
fn flat_and_endless_transforms() {
    let mut fixture = Fixture::square();
    fixture.json["nodes"][0]["scale"] = json!([1, 0, 1]);
    let import = fixture.import().unwrap();
    assert_eq!((import.level.instances.len(), import.level.warnings[0].code.as_str()), (0, "flat_instances"));
    fixture.json["nodes"][0]["scale"] = json!([1e20, 1e20, 1e20]);
    assert!(matches!(fixture.import(), Err(SceneError::TooBig { .. })));
    let child = fixture.push("nodes", json!({ "mesh": 0, "scale": [1e300, 1, 1] }));
    fixture.json["nodes"][0]["children"] = json!([child]);
    assert!(fixture.refusal().contains("\"node 1\" from object to world is not finite"));
}

#[test]
fn only_chooses_receivers() {
    let mut fixture = Fixture::square();
    fixture.root_node(json!({ "name": "other", "mesh": 0 }));
    let only = |glob: &str| BakeSettings { only: Some(glob.to_owned()), ..BakeSettings::default() };
    let receives = |glob: &str| -> Vec<bool> {
        fixture.import_with(&only(glob), "").unwrap().level.instances.iter().map(|i| i.receives).collect()
    };
    assert_eq!(receives("oth*"), [false, true]);
    assert_eq!(receives("square"), [true, true]);
    let error = fixture.import_with(&only("nobody"), "").unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Usage);
    assert_eq!(fixture.import_with(&only("["), "").unwrap_err().kind(), ErrorKind::Usage);
}

#[test]
fn a_color_that_exists_needs_a_decision_before_the_bake() {
    let fixture = square_with(|fixture, primitive| {
        primitive["attributes"]["COLOR_0"] = json!(fixture.floats(&[[1.0f32; 3]; 4]));
    });
    let settings = |color| {
        let output = OutputSettings { attribute: Attribute::Both, color, ..OutputSettings::default() };
        BakeSettings { output, ..BakeSettings::default() }
    };
    let error = fixture.import_with(&settings(None), "").unwrap_err();
    assert!(matches!(&error, SceneError::ColorExists { mesh, .. } if mesh == "square"), "{error}");
    assert!(fixture.import_with(&settings(Some(ColorMode::Multiply)), "").is_ok());
    assert!(Fixture::square().import_with(&settings(None), "").is_ok());
}

#[test]
fn small_files_cannot_ask_for_much_memory() {
    let mut fixture = Fixture::new();
    let zeros = json!({ "count": 4_000_000, "componentType": 5126, "type": "VEC3" });
    let primitives: Vec<Value> =
        (0..2_000).map(|_| json!({ "attributes": { "POSITION": fixture.push("accessors", zeros.clone()) } })).collect();
    let mesh = fixture.mesh("bomb", &json!(primitives));
    fixture.root_node(json!({ "mesh": mesh }));
    assert!(matches!(fixture.import(), Err(SceneError::TooBig { what: "vertices up to here", .. })));
}

#[test]
fn draco_is_refused_even_where_it_has_a_fallback() {
    let fixture = square_with(|_, primitive| {
        primitive["extensions"] = json!({ "KHR_draco_mesh_compression": { "bufferView": 0 } });
    });
    assert!(matches!(fixture.import(), Err(SceneError::Extension { .. })));
}

#[test]
fn automatic_half_distances_follow_the_size() {
    let mut fixture = Fixture::square();
    fixture.json["nodes"][0]["scale"] = json!([10, 10, 10]);
    let kernel = fixture.import().unwrap().level.sampling.kernel;
    assert_eq!(kernel, Kernel::Obscurance { half_distances_m: vec![0.04 * 16.0, 96.0] });
}

#[test]
fn models_are_written_once() {
    let mut fixture = Fixture::square();
    for i in 0..5 {
        fixture.root_node(
            json!({ "name": format!("tree_{i}"), "mesh": 0, "translation": [2.0 * f64::from(i), 0.0, 0.0] }),
        );
    }
    let vertices =
        |rules: &str| super::output_vertices(&fixture.import_with(&BakeSettings::default(), rules).unwrap().level);
    assert_eq!(vertices(""), 24);
    assert_eq!(vertices("[[class]]\nmatch = 'tree*'\nclass = 'tree'\n"), 8);
    assert_eq!(vertices("[[class]]\nmatch = 'tree*'\nclass = 'shrub'\n"), 4);
}
