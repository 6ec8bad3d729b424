//! All triangles of a baked file as one mesh that can be traced.

use glam::{DAffine3, DVec3};
use kiln_core::{FaceGroup, Mesh};
use kiln_scene::{BakedPart, BakedScene};
use kiln_trace::{MeshBvh, Scene, SceneObject};
use std::sync::Arc;

/// Faces of all parts in order, relative to an origin near what matters, so that f32 holds far-away levels. Every face
/// occludes; those of parts for which `receives` says so receive.
pub(crate) fn one_mesh(scene: &BakedScene, origin: DVec3, receives: impl Fn(&BakedPart) -> bool) -> Mesh {
    let group = |double_sided, receives| FaceGroup { double_sided, receives, ..FaceGroup::PLAIN };
    let groups = vec![group(false, false), group(true, false), group(false, true), group(true, true)];
    let mut mesh = Mesh { groups, ..Mesh::default() };
    for part in &scene.parts {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(part.positions.iter().map(|&p| (p - origin).as_vec3().to_array()));
        mesh.faces.extend(part.faces.iter().map(|face| face.map(|v| v + first)));
        let group = u16::from(part.double_sided) + 2 * u16::from(receives(part));
        mesh.face_group.resize(mesh.faces.len(), group);
    }
    mesh.normals = vec![[0.0; 3]; mesh.positions.len()];
    mesh
}

/// The mesh as a scene of its own.
pub(crate) fn scene_of(mesh: &Mesh) -> Arc<Scene> {
    let object = SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY };
    Arc::new(Scene::build(vec![Arc::new(MeshBvh::build(mesh))], &[object]))
}
