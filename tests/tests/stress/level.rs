//! Files made by code: surfaces become meshes of a .glb, without normals, and nodes place them.

use crate::geometry::Surface;
use glam::DVec3;
use kiln_scene::glb::Glb;
use serde_json::{Value, json};

/// A file in the making.
pub(crate) struct Level {
    root: Value,
    bin: Vec<u8>,
}

impl Level {
    pub(crate) fn new() -> Self {
        let root = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [],
            "materials": [{"name": "single"}, {"name": "double", "doubleSided": true}],
            "accessors": [], "bufferViews": [], "buffers": [{"byteLength": 0}],
        });
        Self { root, bin: Vec::new() }
    }

    /// One mesh at the origin.
    pub(crate) fn of(surface: &Surface) -> Self {
        Self::placed(surface, json!({}))
    }

    /// One mesh at a node with these properties.
    pub(crate) fn placed(surface: &Surface, node: Value) -> Self {
        let mut level = Self::new();
        let mesh = level.mesh(surface, false);
        level.node(mesh, node);
        level
    }

    /// One mesh at the origin, of a material that is seen from both sides.
    pub(crate) fn double_sided(surface: &Surface) -> Self {
        let mut level = Self::new();
        let mesh = level.mesh(surface, true);
        level.node(mesh, json!({}));
        level
    }

    /// Adds a mesh; its index is returned.
    pub(crate) fn mesh(&mut self, surface: &Surface, is_double_sided: bool) -> usize {
        let positions: Vec<[f32; 3]> = surface.positions.iter().map(|p| p.as_vec3().to_array()).collect();
        let bytes: Vec<u8> = positions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        let mut accessor = json!({"count": positions.len(), "componentType": 5126, "type": "VEC3"});
        if surface.positions.iter().all(|p| p.is_finite()) {
            let bound = |pick: fn(f32, f32) -> f32| {
                positions.iter().copied().reduce(|a, b| std::array::from_fn(|i| pick(a[i], b[i])))
            };
            (accessor["min"], accessor["max"]) = (json!(bound(f32::min)), json!(bound(f32::max)));
        }
        let position = self.accessor(&bytes, accessor);
        let indices: Vec<u8> = surface.faces.iter().flatten().flat_map(|index| index.to_le_bytes()).collect();
        let count = 3 * surface.faces.len();
        let indices = self.accessor(&indices, json!({"count": count, "componentType": 5125, "type": "SCALAR"}));
        let primitive = json!({
            "attributes": {"POSITION": position}, "indices": indices, "material": usize::from(is_double_sided),
        });
        let name = format!("mesh_{}", self.count("meshes"));
        self.push("meshes", json!({"name": name, "primitives": [primitive]}))
    }

    /// Adds a node at the root that places a mesh, with properties such as `translation`.
    pub(crate) fn node(&mut self, mesh: usize, mut properties: Value) {
        properties["mesh"] = json!(mesh);
        if properties.get("name").is_none() {
            properties["name"] = json!(format!("node_{}", self.count("nodes")));
        }
        let node = self.push("nodes", properties);
        if let Some(roots) = self.root["scenes"][0]["nodes"].as_array_mut() {
            roots.push(json!(node));
        }
    }

    fn count(&self, list: &str) -> usize {
        self.root[list].as_array().map_or(0, Vec::len)
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.root[list].as_array_mut().expect("the lists are there from the start");
        list.push(value);
        list.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        let view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        self.bin.extend_from_slice(bytes);
        self.root["buffers"][0]["byteLength"] = json!(self.bin.len());
        accessor["bufferView"] = json!(self.push("bufferViews", view));
        self.push("accessors", accessor)
    }

    /// The file's bytes.
    pub(crate) fn glb(&self) -> Vec<u8> {
        let json = self.root.to_string();
        let glb = Glb { json: json.as_bytes(), bin: Some(&self.bin), ..Glb::default() };
        glb.write().expect("a test's level is far smaller than 4 GiB")
    }
}

/// A node's `translation`.
pub(crate) fn at(place: DVec3) -> Value {
    json!({"translation": place.to_array()})
}

/// A node's `scale`.
pub(crate) fn scaled(scale: DVec3) -> Value {
    json!({"scale": scale.to_array()})
}
