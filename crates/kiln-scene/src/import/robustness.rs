//! Import and export of damaged documents, and golden results.

use crate::{
    fixture::{Files, Fixture, SQUARE, export_all, some_values},
    glb::Glb,
    import, read_baked,
};
use kiln_core::{BakeSettings, Digest, Mesh, codec};
use proptest::prelude::*;
use serde_json::json;

/// A document with most of what import reads: for golden and mutation tests.
fn rich() -> Fixture {
    let mut fixture = Fixture::new();
    let mut square = fixture.square_primitive();
    square["attributes"]["NORMAL"] = json!(fixture.floats(&[[0.0, 1.0, 0.0]; 4]));
    let strip =
        json!({ "attributes": { "POSITION": fixture.floats(&SQUARE.map(|[x, _, z]| [x, z, 1.0])) }, "mode": 5 });
    let bytes: Vec<u8> = [0i16, 0, 0, 0, 9, 0, 0, 0, 0, 9, 0, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let quantised = fixture.accessor(&bytes, json!({ "count": 3, "componentType": 5122, "type": "VEC3" }));
    let (values, indices) = (fixture.accessor(&[1, 0, 2, 0, 3, 0], json!({})), fixture.accessor(&[1], json!({})));
    let view = |accessor: usize| fixture.json["accessors"][accessor]["bufferView"].clone();
    let sparse = json!({
        "count": 1, "indices": { "bufferView": view(indices), "componentType": 5121 },
        "values": { "bufferView": view(values) },
    });
    fixture.json["accessors"][quantised]["sparse"] = sparse;
    fixture.json["bufferViews"][quantised]["byteStride"] = json!(8);
    let sparse = json!({ "attributes": { "POSITION": quantised } });
    fixture.json["materials"] = json!([{ "name": "glass", "alphaMode": "BLEND" }, { "doubleSided": true }]);
    square["material"] = json!(0);
    let mesh = fixture.mesh("mixed", &json!([square, strip, sparse]));
    let instances = fixture.floats(&[[0.0f32, 1.0, 0.0], [3.0, 1.0, 0.0]]);
    let instancing = json!({ "attributes": { "TRANSLATION": instances } });
    let child =
        json!({ "mesh": mesh, "rotation": [0, 0.6, 0, 0.8], "extensions": { "EXT_mesh_gpu_instancing": instancing } });
    let child = fixture.push("nodes", child);
    fixture.root_node(json!({ "name": "parent", "mesh": mesh, "scale": [1, 2, -1], "children": [child] }));
    fixture
}

/// If this fails, import gives another result than before for the same input: raise the revision of
/// `TaskKind::Import` in kiln-core, so that no store answers with what it kept, and put the new digest here.
#[test]
fn golden_import() {
    let import = rich().import().unwrap();
    let digest = Digest::of(&codec::encode(&import.level));
    assert_eq!(import.level.instances.len(), 3);
    assert_eq!(digest.to_string(), "8b8fa08b974081a34c7a71c5ded5b0a4d97fb28f8d706a004edd1970461c088a");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_order_of_faces_does_not_matter(
        positions in proptest::collection::vec(prop::array::uniform3(-3i8..4), 3..30),
        corners in proptest::collection::vec(any::<[u8; 3]>(), 1..60),
        seed in any::<u32>(),
    ) {
        let positions: Vec<[f32; 3]> = positions.iter().map(|p| p.map(f32::from)).collect();
        let faces: Vec<[u32; 3]> =
            corners.iter().map(|c| c.map(|index| u32::from(index) % positions.len() as u32)).collect();
        let import = |faces: &[[u32; 3]]| {
            let mut fixture = Fixture::new();
            let position = fixture.floats(&positions);
            let indices = fixture.indices(faces.as_flattened());
            let mesh = fixture.mesh("m", &json!([{ "attributes": { "POSITION": position }, "indices": indices }]));
            fixture.root_node(json!({ "mesh": mesh }));
            fixture.import().unwrap()
        };
        let mut order: Vec<usize> = (0..faces.len()).collect();
        order.sort_by_key(|&face| (face as u32 ^ seed).wrapping_mul(2_654_435_761));
        let turned = |face: usize| { let [a, b, c] = faces[face]; if face.is_multiple_of(2) { [b, c, a] } else { [a, b, c] } };
        let shuffled: Vec<[u32; 3]> = order.into_iter().map(turned).collect();
        prop_assert_eq!(import(&faces), import(&shuffled));
    }

    #[test]
    fn damaged_bytes_are_refused_or_imported(
        changes in proptest::collection::vec((any::<u32>(), any::<u8>()), 1..8),
        end in proptest::option::weighted(0.2, any::<u32>()),
    ) {
        let mut bytes = rich().glb();
        for (at, value) in changes {
            let at = at as usize % bytes.len();
            bytes[at] = value;
        }
        if let Some(end) = end {
            bytes.truncate(end as usize % (bytes.len() + 1));
        }
        import_and_export(bytes)?;
    }

    /// Numbers of the JSON take other values, so that offsets, counts and indices go wrong in every way.
    #[test]
    fn damaged_numbers_are_refused_or_imported(
        changes in proptest::collection::vec((any::<u32>(), 0usize..12), 1..4),
    ) {
        const VALUES: [&str; 12] = [
            "0", "1", "-1", "0.5", "2", "7", "255", "65536", "4294967296", "18446744073709551615", "1e300", "null",
        ];
        let fixture = rich();
        let text = fixture.json.to_string();
        let starts: Vec<usize> = text.match_indices(|c: char| c.is_ascii_digit()).map(|(at, _)| at).collect();
        let mut pieces: Vec<String> = text.chars().map(String::from).collect();
        for (which, value) in changes {
            pieces[starts[which as usize % starts.len()]] = VALUES[value].to_owned();
        }
        let json = pieces.concat();
        let glb = Glb { json: json.as_bytes(), bin: Some(&fixture.bin), ..Default::default() };
        import_and_export(glb.write().unwrap())?;
    }
}

/// Imports bytes, and exports what comes of it; neither may panic.
fn import_and_export(bytes: Vec<u8>) -> Result<(), TestCaseError> {
    let files: Files = [("level.glb".to_owned(), bytes)].into();
    if let Ok(import) = import("level.glb", &files, None, &BakeSettings::default()) {
        for blob in &import.meshes {
            let mesh: Mesh = codec::decode("a mesh", &blob.bytes).unwrap();
            prop_assert!(mesh.faces.iter().flatten().all(|&vertex| (vertex as usize) < mesh.positions.len()));
            prop_assert!(mesh.positions.iter().flatten().all(|coordinate| coordinate.is_finite()));
        }
        let values = some_values(&import);
        let exported = export_all("level.glb", &files, &import, &values);
        if let Ok(exported) = exported {
            let baked: Files = [("baked.glb".to_owned(), exported.glb)].into();
            read_baked("baked.glb", &baked).map_err(|error| TestCaseError::fail(error.to_string()))?;
        }
    }
    Ok(())
}
