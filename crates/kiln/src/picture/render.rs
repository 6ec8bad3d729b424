//! One ray through each of four points of a pixel; the AO of what it hits, interpolated.
//!
//! Back faces of single-sided geometry are looked through, so that a closed room shows its inside.

use super::{Camera, Image};
use glam::{DAffine3, DVec3, Vec3};
use kiln_core::{Class, FaceGroup, Mesh};
use kiln_scene::BakedScene;
use kiln_trace::{CpuTracer, MeshBvh, Ray, Scene, SceneObject};
use rayon::prelude::*;
use std::sync::Arc;

/// Back faces looked through before a ray is given up.
const MAX_LAYERS: usize = 64;

/// What of the AO is shown.
pub(crate) struct Shading {
    /// Weight of each half-distance.
    pub(crate) weights: Vec<f64>,
}

impl Shading {
    /// One half-distance, or the usual blend: 3 % of the shortest and 97 % of the longest.
    pub(crate) fn new(channel: Option<usize>, channels: usize) -> Result<Self, String> {
        let mut weights = vec![0.0; channels];
        match channel {
            Some(c) if c < channels => weights[c] = 1.0,
            Some(c) => return Err(format!("there is no half-distance number {c}; the file has {channels}, from 0")),
            None if channels == 2 => weights = vec![0.03, 0.97],
            None => weights.fill(1.0 / channels.max(1) as f64),
        }
        Ok(Self { weights })
    }
}

struct Surface {
    tracer: CpuTracer,
    mesh: Mesh,
    /// Shown value of each corner of each face; NaN where there is none.
    values: Vec<[f32; 3]>,
    origin: DVec3,
}

/// Renders a baked file.
pub(crate) fn render(scene: &BakedScene, camera: &Camera, shading: &Shading, width: u32, height: u32) -> Image {
    let surface = Surface::new(scene, shading, camera);
    let aspect = f64::from(width) / f64::from(height);
    let eye = (camera.eye - surface.origin).as_vec3();
    let pixel = |index: u32| {
        let (x, y) = (index % width, index / width);
        let mut sum = Vec3::ZERO;
        // A rotated grid of four points.
        for (dx, dy) in [(0.125, 0.625), (0.375, 0.125), (0.625, 0.875), (0.875, 0.375)] {
            let u = 2.0 * (f64::from(x) + dx) / f64::from(width) - 1.0;
            let v = 1.0 - 2.0 * (f64::from(y) + dy) / f64::from(height);
            sum += surface.color(eye, camera.direction(u, v, aspect));
        }
        (sum * 0.25).to_array().map(to_srgb)
    };
    let rgb = (0..width * height).into_par_iter().flat_map_iter(pixel).collect();
    Image { width, height, rgb }
}

impl Surface {
    fn new(scene: &BakedScene, shading: &Shading, camera: &Camera) -> Self {
        // Relative to what is looked at, so that f32 holds far-away levels.
        let origin = camera.target;
        let group = FaceGroup {
            class: Class::Opaque,
            double_sided: false,
            occludes: true,
            receives: true,
            max_samples_per_face: None,
        };
        let mut mesh =
            Mesh { groups: vec![group.clone(), FaceGroup { double_sided: true, ..group }], ..Mesh::default() };
        let mut values = Vec::new();
        for part in &scene.parts {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(part.positions.iter().map(|&p| (p - origin).as_vec3().to_array()));
            mesh.faces.extend(part.faces.iter().map(|face| face.map(|v| v + first)));
            mesh.face_group.resize(mesh.faces.len(), u16::from(part.double_sided));
            let value = |v: u32| {
                let all = part.ao.get(v as usize * part.channels..).unwrap_or_default();
                let blend: f64 = all.iter().zip(&shading.weights).map(|(&ao, w)| f64::from(ao) * w).sum();
                if part.channels == 0 { f32::NAN } else { blend as f32 }
            };
            values.extend(part.faces.iter().map(|face| face.map(value)));
        }
        mesh.normals = vec![[0.0; 3]; mesh.positions.len()];
        let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
        let tracer = CpuTracer::new(Arc::new(Scene::build(vec![Arc::new(MeshBvh::build(&mesh))], &[object])));
        Self { tracer, mesh, values, origin }
    }

    fn color(&self, eye: Vec3, direction: Vec3) -> Vec3 {
        let mut origin = eye;
        for _ in 0..MAX_LAYERS {
            let hit = self.tracer.closest_hit(&Ray { origin, direction, t_max: f32::MAX });
            if !hit.is_hit() {
                break;
            }
            let point = origin + direction * hit.t;
            if !hit.back_face {
                return self.shade(hit.primitive as usize, point);
            }
            origin = point + direction * (1e-6 * point.abs().max_element().max(hit.t) + f32::MIN_POSITIVE);
        }
        // A plain ground for what is empty.
        Vec3::new(0.36, 0.45, 0.58).lerp(Vec3::new(0.62, 0.70, 0.80), 0.5 + 0.5 * direction.y)
    }

    fn shade(&self, face: usize, point: Vec3) -> Vec3 {
        let [a, b, c] = self.mesh.corners(face);
        let normal = (b - a).cross(c - a);
        let area = normal.length_squared();
        let u = (c - b).cross(point - b).dot(normal) / area;
        let v = (a - c).cross(point - c).dot(normal) / area;
        let [x, y, z] = self.values[face];
        let value = x * u + y * v + z * (1.0 - u - v);
        // Geometry without values stands out.
        if value.is_finite() { Vec3::splat(value.clamp(0.0, 1.0)) } else { Vec3::new(0.35, 0.16, 0.30) }
    }
}

/// AO is shown as reflected light, so it is encoded as such.
fn to_srgb(linear: f32) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0 + 0.5) as u8
}
