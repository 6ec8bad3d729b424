//! Documents for tests, made by code.

use crate::{BakedInstance, ExportRequest, Exported, Import, SceneError, SidecarText, export, glb::Glb, import};
use kiln_core::{BakeSettings, Digest, Mesh, codec};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Files by name.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// A document under construction, with one buffer.
#[derive(Clone)]
pub(crate) struct Fixture {
    pub(crate) json: Value,
    pub(crate) bin: Vec<u8>,
}

/// Corners of a unit square in the xz plane that faces up, as two triangles' worth of vertices.
pub(crate) const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]];
/// Its triangles.
pub(crate) const SQUARE_FACES: [u32; 6] = [0, 1, 2, 2, 1, 3];

impl Fixture {
    pub(crate) fn new() -> Self {
        let json = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [] }], "nodes": [], "meshes": [],
            "accessors": [], "bufferViews": [], "buffers": [{ "byteLength": 0 }],
        });
        Self { json, bin: Vec::new() }
    }

    /// A square at a node named `square`.
    pub(crate) fn square() -> Self {
        let mut fixture = Self::new();
        let primitive = fixture.square_primitive();
        let mesh = fixture.mesh("square", &json!([primitive]));
        fixture.root_node(json!({ "name": "square", "mesh": mesh }));
        fixture
    }

    pub(crate) fn square_primitive(&mut self) -> Value {
        let (position, indices) = (self.floats(&SQUARE), self.indices(&SQUARE_FACES));
        json!({ "attributes": { "POSITION": position }, "indices": indices })
    }

    pub(crate) fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    /// An accessor over bytes of its own.
    pub(crate) fn accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() });
        self.bin.extend_from_slice(bytes);
        self.json["buffers"][0]["byteLength"] = json!(self.bin.len());
        accessor["bufferView"] = json!(self.push("bufferViews", view));
        self.push("accessors", accessor)
    }

    pub(crate) fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let mut accessor = json!({ "count": values.len(), "componentType": 5126, "type": kind });
        if N == 3 && values.iter().flatten().all(|value| value.is_finite()) {
            let bound = |pick: fn(f32, f32) -> f32, i: usize| values.iter().map(|v| v[i]).reduce(pick).unwrap();
            accessor["min"] = json!([bound(f32::min, 0), bound(f32::min, 1), bound(f32::min, 2)]);
            accessor["max"] = json!([bound(f32::max, 0), bound(f32::max, 1), bound(f32::max, 2)]);
        }
        self.accessor(&bytes, accessor)
    }

    pub(crate) fn indices(&mut self, values: &[u32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(&bytes, json!({ "count": values.len(), "componentType": 5125, "type": "SCALAR" }))
    }

    pub(crate) fn mesh(&mut self, name: &str, primitives: &Value) -> usize {
        self.push("meshes", json!({ "name": name, "primitives": primitives }))
    }

    pub(crate) fn root_node(&mut self, node: Value) -> usize {
        let node = self.push("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(node));
        node
    }

    pub(crate) fn glb(&self) -> Vec<u8> {
        let json = self.json.to_string();
        Glb { json: json.as_bytes(), bin: Some(&self.bin), ..Glb::default() }.write().unwrap()
    }

    pub(crate) fn files(&self) -> Files {
        [("level.glb".to_owned(), self.glb())].into()
    }

    pub(crate) fn import(&self) -> Result<Import, SceneError> {
        self.import_with(&BakeSettings::default(), "")
    }

    pub(crate) fn import_with(&self, settings: &BakeSettings, sidecar: &str) -> Result<Import, SceneError> {
        let sidecar = SidecarText { name: "level.kiln.toml", text: sidecar };
        import("level.glb", &self.files(), Some(sidecar), settings)
    }

    /// The message with which the document is refused.
    pub(crate) fn refusal(&self) -> String {
        self.import().unwrap_err().to_string()
    }
}

/// The mesh of an instance.
pub(crate) fn mesh_of(import: &Import, instance: usize) -> Mesh {
    let entry = &import.level.meshes[import.level.instances[instance].mesh as usize];
    let blob = import.meshes.iter().find(|blob| blob.digest == entry.digest).unwrap();
    assert_eq!(Digest::of(&blob.bytes), blob.digest);
    codec::decode("a mesh", &blob.bytes).unwrap()
}

/// Different values for each instance, vertex and channel.
pub(crate) fn some_values(import: &Import) -> Vec<Vec<f32>> {
    let channels = import.level.sampling.kernel.channel_count();
    let value = |instance: usize, i: usize| ((instance * 31 + i * 7) % 101) as f32 / 100.0;
    let count = |mesh: u32| import.level.meshes[mesh as usize].vertex_count as usize * channels;
    let instances = import.level.instances.iter().enumerate();
    instances.map(|(k, instance)| (0..count(instance.mesh)).map(|i| value(k, i)).collect()).collect()
}

/// Exports with values for every instance that receives.
pub(crate) fn export_all(
    name: &str,
    files: &Files,
    import: &Import,
    values: &[Vec<f32>],
) -> Result<Exported, SceneError> {
    let residuals: Vec<Vec<f32>> = values.iter().map(|values| values.iter().rev().copied().collect()).collect();
    let receiving = (0..values.len()).filter(|&instance| import.level.instances[instance].receives);
    let values: Vec<_> = receiving
        .map(|instance| {
            // Residuals of their own: the values the other way round.
            BakedInstance { instance, values: &values[instance], residuals: &residuals[instance] }
        })
        .collect();
    let level_digest = Digest::of(&codec::encode(&import.level));
    export(&ExportRequest {
        level_name: name,
        files,
        level: &import.level,
        level_digest,
        version: "1.2.3",
        values: &values,
        models: &[],
        numbers: &[],
    })
}
