//! Writes a glTF file: surfaces become accessors, one buffer view each, and nodes place meshes.
//!
//! Surfaces are made in f64 and rounded to f32 once, here; `min` and `max` are of the rounded values, as the
//! format demands. Indices are 16-bit where they fit.

use super::surface::Surface;
use crate::glb::Glb;
use glam::{DAffine3, DQuat, DVec3};
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Index of a material in the file.
#[derive(Clone, Copy)]
pub(super) struct Material(usize);

/// Index of a mesh in the file.
#[derive(Clone, Copy)]
pub(super) struct Mesh(usize);

/// Translation, rotation and scale of a node.
#[derive(Clone, Copy)]
pub(super) struct Placement {
    translation: DVec3,
    rotation: DQuat,
    scale: DVec3,
}

impl Placement {
    pub(super) const ORIGIN: Self = Self::at(DVec3::ZERO);

    pub(super) const fn at(translation: DVec3) -> Self {
        Self { translation, rotation: DQuat::IDENTITY, scale: DVec3::ONE }
    }

    /// Turned about the vertical axis, degrees counter-clockwise from above.
    pub(super) fn turned(self, degrees: f64) -> Self {
        self.rotated(DQuat::from_rotation_y(degrees.to_radians()))
    }

    pub(super) fn rotated(self, rotation: DQuat) -> Self {
        Self { rotation: rotation * self.rotation, ..self }
    }

    pub(super) fn scaled(self, scale: DVec3) -> Self {
        Self { scale: self.scale * scale, ..self }
    }

    pub(super) const fn translation(&self) -> DVec3 {
        self.translation
    }

    pub(super) const fn rotation(&self) -> DQuat {
        self.rotation
    }

    pub(super) const fn scale(&self) -> DVec3 {
        self.scale
    }
}

/// A file in the making.
pub(super) struct Builder {
    bin: Vec<u8>,
    accessors: Vec<Value>,
    views: Vec<Value>,
    materials: Vec<Value>,
    images: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    extensions: Vec<&'static str>,
    /// Nodes outside of the scene.
    levels: BTreeSet<usize>,
}

/// Elements of an accessor, as they go into the file.
pub(super) struct Elements {
    /// Little-endian, each element padded to a multiple of four bytes.
    pub(super) bytes: Vec<u8>,
    /// Number of elements.
    pub(super) count: usize,
    /// `componentType` of glTF.
    pub(super) component_type: u32,
    /// `type` of glTF.
    pub(super) kind: &'static str,
    /// Integers that stand for fractions.
    pub(super) normalized: bool,
    /// Least and greatest components, as stored.
    pub(super) min_max: Option<[Value; 2]>,
    /// Bytes from element to element, where they are not packed.
    pub(super) stride_bytes: Option<usize>,
    /// `target` of the buffer view, if the elements are vertices or indices.
    pub(super) target: Option<u32>,
}

impl Elements {
    /// Vectors of floats for vertices.
    pub(super) fn floats<const N: usize>(vectors: &[[f32; N]], kind: &'static str) -> Self {
        let bytes = vectors.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let target = Some(ARRAY_BUFFER);
        let (min_max, stride_bytes) = (None, None);
        Self {
            bytes,
            count: vectors.len(),
            component_type: FLOAT,
            kind,
            normalized: false,
            min_max,
            stride_bytes,
            target,
        }
    }

    fn positions(positions: &[[f32; 3]]) -> Self {
        let fold = |f: fn(f32, f32) -> f32, start: f32| {
            let folded = positions.iter().fold([start; 3], |m, p| std::array::from_fn(|i| f(m[i], p[i])));
            json!(folded)
        };
        let min_max = Some([fold(f32::min, f32::INFINITY), fold(f32::max, f32::NEG_INFINITY)]);
        Self { min_max, ..Self::floats(positions, "VEC3") }
    }

    /// Indices of triangles; 65,535 would restart a primitive and is left out of 16 bits.
    fn indices(faces: &[[u32; 3]]) -> Self {
        let indices = || faces.iter().flatten().copied();
        let short = indices().all(|i| i < u32::from(u16::MAX));
        let bytes = if short {
            indices().flat_map(|i| (i as u16).to_le_bytes()).collect()
        } else {
            indices().flat_map(u32::to_le_bytes).collect()
        };
        Self {
            bytes,
            count: 3 * faces.len(),
            component_type: if short { UNSIGNED_SHORT } else { UNSIGNED_INT },
            kind: "SCALAR",
            normalized: false,
            min_max: None,
            stride_bytes: None,
            target: Some(ELEMENT_ARRAY_BUFFER),
        }
    }
}

fn matrix_node(name: &str, mesh: Mesh, place: &DAffine3) -> Value {
    let mut node = json!({"name": name, "mesh": mesh.0});
    if *place != DAffine3::IDENTITY {
        node["matrix"] = json!(glam::DMat4::from(*place).to_cols_array());
    }
    node
}

/// Rounds to f32; negative zero becomes zero.
pub(super) fn to_f32(v: DVec3) -> [f32; 3] {
    v.as_vec3().to_array().map(|c| c + 0.0)
}

impl Builder {
    pub(super) fn new() -> Self {
        Self {
            bin: Vec::new(),
            accessors: Vec::new(),
            views: Vec::new(),
            materials: Vec::new(),
            images: Vec::new(),
            meshes: Vec::new(),
            nodes: Vec::new(),
            extensions: Vec::new(),
            levels: BTreeSet::new(),
        }
    }

    /// A rough material of one colour (linear, 0 to 1).
    pub(super) fn material(&mut self, name: &str, color: [f32; 3]) -> Material {
        let [r, g, b] = color;
        self.materials.push(json!({
            "name": name,
            "pbrMetallicRoughness": {"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0},
        }));
        Material(self.materials.len() - 1)
    }

    /// The same, seen from both sides.
    pub(super) fn double_sided_material(&mut self, name: &str, color: [f32; 3]) -> Material {
        let material = self.material(name, color);
        self.materials[material.0]["doubleSided"] = json!(true);
        material
    }

    /// A double-sided material whose faces are where the alpha of a PNG says, texel by texel.
    pub(super) fn masked_material(&mut self, name: &str, png: &[u8]) -> Material {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        self.views.push(json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": png.len()}));
        self.bin.extend_from_slice(png);
        self.images.push(json!({"name": name, "bufferView": self.views.len() - 1, "mimeType": "image/png"}));
        self.materials.push(json!({
            "name": name,
            "alphaMode": "MASK",
            "doubleSided": true,
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": self.images.len() - 1}, "metallicFactor": 0.0, "roughnessFactor": 1.0,
            },
        }));
        Material(self.materials.len() - 1)
    }

    /// An extension that the file uses and cannot be read without.
    pub(super) fn require_extension(&mut self, name: &'static str) {
        self.extensions.push(name);
    }

    /// Appends elements and returns the accessor's index.
    pub(super) fn accessor(&mut self, elements: Elements) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": elements.bytes.len()});
        if let Some(stride) = elements.stride_bytes {
            view["byteStride"] = json!(stride);
        }
        if let Some(target) = elements.target {
            view["target"] = json!(target);
        }
        self.bin.extend_from_slice(&elements.bytes);
        let mut accessor = json!({
            "bufferView": self.views.len(),
            "componentType": elements.component_type,
            "count": elements.count,
            "type": elements.kind,
        });
        if elements.normalized {
            accessor["normalized"] = json!(true);
        }
        if let Some([min, max]) = elements.min_max {
            accessor["min"] = min;
            accessor["max"] = max;
        }
        self.views.push(view);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// A mesh of one primitive for each surface.
    pub(super) fn mesh(&mut self, name: &str, surfaces: &[(&Surface, Material)]) -> Mesh {
        let mut primitives = Vec::new();
        for (surface, material) in surfaces {
            primitives.push(self.surface_primitive(surface, *material));
        }
        self.raw_mesh(name, &primitives)
    }

    /// A primitive of a surface.
    pub(super) fn surface_primitive(&mut self, surface: &Surface, material: Material) -> Value {
        let positions: Vec<[f32; 3]> = surface.positions.iter().copied().map(to_f32).collect();
        let normals: Vec<[f32; 3]> = surface.normals.iter().copied().map(to_f32).collect();
        let position = self.accessor(Elements::positions(&positions));
        let normal = self.accessor(Elements::floats(&normals, "VEC3"));
        self.primitive(position, normal, &surface.faces, material)
    }

    /// A primitive of given accessors.
    pub(super) fn primitive(
        &mut self,
        position: usize,
        normal: usize,
        faces: &[[u32; 3]],
        material: Material,
    ) -> Value {
        let indices = self.accessor(Elements::indices(faces));
        json!({
            "attributes": {"POSITION": position, "NORMAL": normal},
            "indices": indices,
            "material": material.0,
        })
    }

    /// A mesh of given primitives.
    pub(super) fn raw_mesh(&mut self, name: &str, primitives: &[Value]) -> Mesh {
        self.meshes.push(json!({"name": name, "primitives": primitives}));
        Mesh(self.meshes.len() - 1)
    }

    /// A node at the root that places a mesh. Names start with the kind of thing, such as `crate_2`.
    pub(super) fn node(&mut self, name: &str, mesh: Mesh, placement: Placement) {
        self.node_with(name, mesh, placement, None);
    }

    /// The same with extras.
    pub(super) fn node_with_extras(&mut self, name: &str, mesh: Mesh, placement: Placement, extras: Value) {
        self.node_with(name, mesh, placement, None);
        if let Some(node) = self.nodes.last_mut() {
            node["extras"] = extras;
        }
    }

    /// The same with extensions.
    pub(super) fn node_with(&mut self, name: &str, mesh: Mesh, placement: Placement, extensions: Option<Value>) {
        let mut node = Map::new();
        node.insert("name".into(), json!(name));
        node.insert("mesh".into(), json!(mesh.0));
        if placement.translation != DVec3::ZERO {
            node.insert("translation".into(), json!(to_f32(placement.translation)));
        }
        if placement.rotation != DQuat::IDENTITY {
            node.insert("rotation".into(), json!(placement.rotation.as_quat().to_array()));
        }
        if placement.scale != DVec3::ONE {
            node.insert("scale".into(), json!(to_f32(placement.scale)));
        }
        if let Some(extensions) = extensions {
            node.insert("extensions".into(), extensions);
        }
        self.nodes.push(Value::Object(node));
    }

    /// A node that is drawn in place of another: it is not in the scene.
    pub(super) fn level_node(&mut self, name: &str, mesh: Mesh, place: &DAffine3) -> usize {
        self.levels.insert(self.nodes.len());
        self.nodes.push(matrix_node(name, mesh, place));
        self.nodes.len() - 1
    }

    /// A node at the root with lower levels of detail.
    pub(super) fn node_with_levels(&mut self, name: &str, mesh: Mesh, place: &DAffine3, levels: &[usize]) {
        let mut node = matrix_node(name, mesh, place);
        if !levels.is_empty() {
            node["extensions"] = json!({"MSFT_lod": {"ids": levels}});
        }
        self.nodes.push(node);
    }

    /// The file's bytes.
    pub(super) fn finish(self, scene_name: &str) -> Vec<u8> {
        let mut root = Map::new();
        root.insert("asset".into(), json!({"version": "2.0", "generator": "kiln example"}));
        if !self.extensions.is_empty() {
            root.insert("extensionsUsed".into(), json!(self.extensions));
            root.insert("extensionsRequired".into(), json!(self.extensions));
        }
        if !self.levels.is_empty() {
            root.insert("extensionsUsed".into(), json!(["MSFT_lod"]));
        }
        root.insert("scene".into(), json!(0));
        let mut scene = json!({"name": scene_name});
        if !self.nodes.is_empty() {
            scene["nodes"] =
                json!((0..self.nodes.len()).filter(|node| !self.levels.contains(node)).collect::<Vec<_>>());
        }
        root.insert("scenes".into(), json!([scene]));
        // Each image is a texture; nearest texel, as at the edge beyond it.
        let textures: Vec<Value> = (0..self.images.len()).map(|image| json!({"source": image, "sampler": 0})).collect();
        let sampler = json!({"magFilter": 9728, "minFilter": 9728, "wrapS": 33071, "wrapT": 33071});
        let lists = [
            ("nodes", self.nodes),
            ("meshes", self.meshes),
            ("materials", self.materials),
            ("samplers", textures.iter().take(1).map(|_| sampler.clone()).collect()),
            ("textures", textures),
            ("images", self.images),
            ("accessors", self.accessors),
            ("bufferViews", self.views),
        ];
        // The format has no empty lists.
        for (key, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            root.insert(key.into(), Value::Array(list));
        }
        if !self.bin.is_empty() {
            root.insert("buffers".into(), json!([{"byteLength": self.bin.len()}]));
        }
        let json = Value::Object(root).to_string();
        let bin = (!self.bin.is_empty()).then_some(&self.bin[..]);
        let glb = Glb { json: json.as_bytes(), bin, ..Glb::default() };
        glb.write().expect("an example is far smaller than the 4 GiB that a .glb file can hold")
    }
}
