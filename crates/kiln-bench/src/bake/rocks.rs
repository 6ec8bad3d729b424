//! Levels of many instances, made by code: the rocks of `kiln bench rays --scaling`, as a .glb file.

use crate::{
    BenchError,
    rays::{case::RayCounts, scaling::shapes},
};
use kiln_core::Mesh;
use kiln_scene::glb::Glb;
use serde_json::{Value, json};

/// So many instances of one rock, on uneven ground.
pub(super) fn level(rocks: u32) -> Result<Vec<u8>, BenchError> {
    let case = shapes::by_instances(rocks, RayCounts { points: 1, per_point: 1 });
    let mut file = File::default();
    for mesh in &case.meshes {
        file.mesh(mesh);
    }
    let node = |(index, object): (usize, &kiln_trace::SceneObject)| {
        let matrix = glam::DMat4::from(object.world_from_object).to_cols_array();
        json!({ "name": format!("object_{index}"), "mesh": object.mesh, "matrix": matrix })
    };
    let nodes: Vec<Value> = case.objects.iter().enumerate().map(node).collect();
    let json = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes, "meshes": file.meshes, "accessors": file.accessors, "bufferViews": file.views,
        "buffers": [{ "byteLength": file.bin.len() }],
    });
    let json = json.to_string();
    let glb = Glb { json: json.as_bytes(), bin: Some(&file.bin), other: Vec::new(), bytes_after_end: 0 };
    glb.write().map_err(|error| BenchError::Failed { step: "scene made by code", reason: error.to_string() })
}

/// A file in the making.
#[derive(Default)]
struct File {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
}

impl File {
    fn mesh(&mut self, mesh: &Mesh) {
        let fold = |f: fn(f32, f32) -> f32, start: f32| {
            let folded =
                mesh.positions.iter().fold([start; 3], |m, p| -> [f32; 3] { std::array::from_fn(|i| f(m[i], p[i])) });
            json!(folded)
        };
        let bounds = json!({
            "componentType": 5126, "count": mesh.positions.len(), "type": "VEC3",
            "min": fold(f32::min, f32::INFINITY), "max": fold(f32::max, f32::NEG_INFINITY),
        });
        let positions = self.accessor(bytemuck::cast_slice(&mesh.positions), bounds);
        let count = json!({ "componentType": 5125, "count": 3 * mesh.faces.len(), "type": "SCALAR" });
        let indices = self.accessor(bytemuck::cast_slice(&mesh.faces), count);
        let primitive = json!({ "attributes": { "POSITION": positions }, "indices": indices });
        self.meshes.push(json!({ "primitives": [primitive] }));
    }

    /// An accessor over bytes of its own, which are whole words.
    fn accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        accessor["bufferView"] = json!(self.views.len());
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() }));
        self.bin.extend_from_slice(bytes);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}
