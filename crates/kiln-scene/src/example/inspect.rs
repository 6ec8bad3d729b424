//! Reads examples back for tests, straight from the bytes and with no code that writes or imports them.

use crate::glb::Glb;
use glam::{DAffine3, DQuat, DVec3};
use serde_json::Value;

/// A parsed file.
pub(super) struct File {
    pub(super) json: Value,
    bin: Vec<u8>,
}

/// A primitive in object space.
pub(super) struct Primitive {
    pub(super) positions: Vec<DVec3>,
    pub(super) normals: Vec<DVec3>,
    pub(super) faces: Vec<[usize; 3]>,
}

impl File {
    pub(super) fn of(example: &str) -> Self {
        Self::parse(&super::build(example).expect("the example exists"))
    }

    pub(super) fn parse(bytes: &[u8]) -> Self {
        let glb = Glb::parse(bytes).unwrap();
        Self { json: serde_json::from_slice(glb.json).unwrap(), bin: glb.bin.unwrap_or_default().to_vec() }
    }

    pub(super) fn list(&self, key: &str) -> &[Value] {
        self.json[key].as_array().map_or(&[], Vec::as_slice)
    }

    /// Components of an accessor's elements, as stored.
    pub(super) fn stored(&self, accessor: usize) -> Vec<Vec<f64>> {
        let accessor = &self.list("accessors")[accessor];
        let view = &self.list("bufferViews")[count(&accessor["bufferView"])];
        let (start, length) = (count(&view["byteOffset"]), count(&view["byteLength"]));
        let bytes = &self.bin[start..start + length];
        let components = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => panic!("{other}"),
        };
        let (size, read): (usize, fn(&[u8]) -> f64) = match count(&accessor["componentType"]) {
            5120 => (1, |b| f64::from(b[0] as i8)),
            5123 => (2, |b| f64::from(u16::from_le_bytes(b.try_into().unwrap()))),
            5125 => (4, |b| f64::from(u32::from_le_bytes(b.try_into().unwrap()))),
            5126 => (4, |b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))),
            other => panic!("{other}"),
        };
        assert_eq!(start % 4, 0);
        let stride = view.get("byteStride").map_or(size * components, count);
        assert_eq!(bytes.len(), stride * count(&accessor["count"]));
        bytes.chunks(stride).map(|element| element.chunks(size).take(components).map(read).collect()).collect()
    }

    fn vectors(&self, accessor: usize) -> Vec<DVec3> {
        let stored = &self.list("accessors")[accessor];
        let unit = match (stored.get("normalized"), count(&stored["componentType"])) {
            (Some(_), 5120) => 127.0,
            (Some(_), 5123) => 65535.0,
            _ => 1.0,
        };
        self.stored(accessor).iter().map(|v| DVec3::from_slice(v) / unit).collect()
    }

    pub(super) fn primitives(&self, mesh: usize) -> Vec<Primitive> {
        let primitives = self.list("meshes")[mesh]["primitives"].as_array().unwrap();
        primitives
            .iter()
            .map(|primitive| {
                let indices = self.stored(count(&primitive["indices"]));
                let indices: Vec<usize> = indices.iter().map(|i| i[0] as usize).collect();
                Primitive {
                    positions: self.vectors(count(&primitive["attributes"]["POSITION"])),
                    normals: self.vectors(count(&primitive["attributes"]["NORMAL"])),
                    faces: indices.chunks(3).map(|f| f.try_into().unwrap()).collect(),
                }
            })
            .collect()
    }

    /// Triangles in world space of the nodes that `wanted` names. No example nests nodes.
    pub(super) fn world_triangles(&self, wanted: impl Fn(&str) -> bool) -> Vec<[DVec3; 3]> {
        let mut triangles = Vec::new();
        for node in self.list("nodes").iter().filter(|node| wanted(node["name"].as_str().unwrap())) {
            let world_from_object = transform(node);
            for primitive in self.primitives(count(&node["mesh"])) {
                let corners = |f: &[usize; 3]| f.map(|v| world_from_object.transform_point3(primitive.positions[v]));
                triangles.extend(primitive.faces.iter().map(corners));
            }
        }
        triangles
    }

    /// Triangles over all nodes and their instances.
    pub(super) fn triangle_count(&self) -> usize {
        let of = |node: &Value| {
            let faces: usize = self.primitives(count(&node["mesh"])).iter().map(|p| p.faces.len()).sum();
            let instances = node.pointer("/extensions/EXT_mesh_gpu_instancing/attributes/TRANSLATION");
            faces * instances.map_or(1, |accessor| count(&self.list("accessors")[count(accessor)]["count"]))
        };
        self.list("nodes").iter().map(of).sum()
    }
}

pub(super) fn count(value: &Value) -> usize {
    value.as_u64().unwrap() as usize
}

/// A node's transform.
pub(super) fn transform(node: &Value) -> DAffine3 {
    let numbers = |key: &str, default: &[f64]| -> Vec<f64> {
        node.get(key).map_or(default.to_vec(), |v| v.as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).collect())
    };
    DAffine3::from_scale_rotation_translation(
        DVec3::from_slice(&numbers("scale", &[1.0; 3])),
        DQuat::from_slice(&numbers("rotation", &[0.0, 0.0, 0.0, 1.0])),
        DVec3::from_slice(&numbers("translation", &[0.0; 3])),
    )
}
