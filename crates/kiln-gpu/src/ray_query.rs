//! Traversal by hardware ray queries; the host side of `ray_query.wgsl`. Off unless [`crate::DeviceOptions::ray_queries`] asks for it.
//!
//! The hardware proposes, our own test decides. Its acceleration structures hold boxes ([`crate::boxes`]), not triangles: one for each run of up to
//! four triangles that a slot of the software tree has ([`crate::widen`]). For each box that it proposes the shader takes the ray into the
//! instance's space and tests the triangles, by the code and the data that the software traversal has
//! (`scene.wgsl`, `triangle.wgsl`). The best hit so far is ours, with the tie rule, and the hardware is told of one only to leave out what lies behind:
//! by a generated intersection, further away by 2⁻¹⁵ of the distance than it is, since distances that tie differ by up to 2⁻¹⁷.
//!
//! So results are those of the software traversal if every box is proposed that holds a triangle which our test says is
//! hit, up to the distance that was reported. That rests on the margin by which boxes are grown; no vendor promises that it is enough.
//! It is checked instead: by tests, by `kiln bench rays --ray-queries`, and whenever a device is opened ([`check`]).
//!
//! Only the first hit is reported. Wherever one has been committed already, wgpu 30 compares the next with a distance that the candidate,
//! a box, does not have (naga 30.0.1, `write_ray_query_generate_intersection`), which Vulkan does not define. Only the culling suffers: what is reported is never
//! the result.

use crate::{GpuDevice, GpuError, GpuTracer};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_core::{FaceGroup, Mesh};
use kiln_trace::{Hit, MeshBvh, Ray, Scene, SceneObject, Tracer};
use std::sync::Arc;

/// Side of the grid of the check's mesh, cells.
const CELLS: u16 = 12;
/// Rays of the check.
const RAYS: u16 = 4096;

/// What an adapter lacks for ray queries, if anything.
pub(crate) fn missing(features: wgpu::Features, limits: &wgpu::Limits) -> Option<String> {
    if !features.contains(wgpu::Features::EXPERIMENTAL_RAY_QUERY) {
        return Some(
            "its driver does not offer them (EXPERIMENTAL_RAY_QUERY in wgpu, VK_KHR_ray_query in Vulkan)".to_owned(),
        );
    }
    let needed = [
        ("max_blas_primitive_count", limits.max_blas_primitive_count),
        ("max_blas_geometry_count", limits.max_blas_geometry_count),
        ("max_tlas_instance_count", limits.max_tlas_instance_count),
        ("max_acceleration_structures_per_shader_stage", limits.max_acceleration_structures_per_shader_stage),
    ];
    let zero = needed.into_iter().find(|(_, limit)| *limit == 0);
    zero.map(|(name, _)| format!("its limit {name} is 0"))
}

/// Traces a small scene both ways and refuses a device on which they differ.
pub(crate) fn check(gpu: &Arc<GpuDevice>) -> Result<(), GpuError> {
    let scene = scene();
    let rays = rays(&scene.1);
    let trace = |tracer: GpuTracer| {
        let mut hits = vec![Hit::MISS; rays.len()];
        tracer.trace(&rays, &mut hits).map(|()| hits)
    };
    let software = trace(GpuTracer::without_ray_queries(Arc::clone(gpu), &scene.0)?)?;
    let hardware = trace(GpuTracer::new(Arc::clone(gpu), &scene.0)?)?;
    let differing = software.iter().zip(&hardware).filter(|(a, b)| a != b).count();
    if differing > 0 || !software.iter().any(Hit::is_hit) {
        let adapter = gpu.adapter().to_string();
        return Err(GpuError::RayQueriesDiffer { adapter, differing, rays: rays.len() });
    }
    Ok(())
}

/// Waves on a grid of cells of 1 m, in instances that are turned, mirrored, scaled unevenly and far away, and twice in one place.
fn scene() -> (Scene, Vec<DAffine3>) {
    let side = u32::from(CELLS) + 1;
    let height = |x: f32, y: f32| (1.3 * x).sin() * (0.9 * y).cos();
    let at = |i: u32| ((i % side) as f32 - 6.0, (i / side) as f32 - 6.0);
    let positions: Vec<[f32; 3]> = (0..side * side).map(at).map(|(x, y)| [x, y, height(x, y)]).collect();
    let cells = (0..side * (side - 1)).filter(|i| i % side + 1 < side);
    let faces: Vec<[u32; 3]> = cells.flat_map(|i| [[i, i + 1, i + side], [i + 1, i + side + 1, i + side]]).collect();
    let group = FaceGroup::PLAIN;
    let mesh = Mesh {
        normals: vec![[0.0; 3]; positions.len()],
        positions,
        face_group: vec![0; faces.len()],
        faces,
        groups: vec![group],
        ..Mesh::default()
    };
    let turn = DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(2.1);
    let far = DVec3::new(900.0, -700.0, 40.0);
    let transforms = vec![
        DAffine3::from_scale_rotation_translation(DVec3::new(1.0, 1.0, 1.0), DQuat::IDENTITY, far),
        DAffine3::from_scale_rotation_translation(DVec3::new(-0.4, 1.7, 0.9), turn, far + DVec3::Z),
        DAffine3::from_scale_rotation_translation(
            DVec3::new(0.05, 0.06, -0.3),
            turn.inverse(),
            far + DVec3::new(1.0, 2.0, 2.0),
        ),
        DAffine3::from_scale_rotation_translation(DVec3::new(1.0, 1.0, 1.0), DQuat::IDENTITY, far),
    ];
    let object = |transform: &DAffine3| SceneObject { mesh: 0, world_from_object: *transform };
    let objects: Vec<SceneObject> = transforms.iter().map(object).collect();
    (Scene::build(vec![Arc::new(MeshBvh::build(&mesh))], &objects), transforms)
}

/// Rays to points of the grid, among them its corners and edges, from around it.
fn rays(transforms: &[DAffine3]) -> Vec<Ray> {
    let ray = |i: u16| {
        let transform = &transforms[usize::from(i) % transforms.len()];
        let (x, y) = (f64::from(i % 97) / 8.0 - 6.0, f64::from(i % 89) / 8.0 - 6.0);
        let angle = f64::from(i) * 2.399_963;
        let target = transform.transform_point3(DVec3::new(x, y, (1.3 * x).sin() * (0.9 * y).cos()));
        let from = DVec3::new(angle.cos(), angle.sin(), f64::from(i % 13) - 6.0) * f64::from(1 + i % 7);
        let origin = (target + from).as_vec3();
        let direction: Vec3 = target.as_vec3() - origin;
        Ray { origin, direction, t_max: if i.is_multiple_of(5) { 1.0 } else { f32::INFINITY } }
    };
    (0..RAYS).map(ray).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_adapter_lacks_is_named() {
        let with = wgpu::Features::EXPERIMENTAL_RAY_QUERY;
        let limits = wgpu::Limits::default();
        let said = missing(wgpu::Features::SUBGROUP, &limits).expect("the feature is missing");
        assert!(said.contains("EXPERIMENTAL_RAY_QUERY") && said.contains("VK_KHR_ray_query"), "{said}");
        let said = missing(with, &limits).expect("limits are 0 by default");
        assert!(said.contains("max_blas_primitive_count"), "{said}");
        assert_eq!(missing(with, &limits.using_minimum_supported_acceleration_structure_values()), None);
    }

    /// The check's rays meet what they are for: hits of every instance but the last, which lies where the first does.
    #[test]
    fn the_check_sees_its_instances() {
        let (scene, transforms) = scene();
        let rays = rays(&transforms);
        let mut hits = vec![Hit::MISS; rays.len()];
        kiln_trace::CpuTracer::new(Arc::new(scene)).trace(&rays, &mut hits).expect("it traces");
        let of = |instance: u32| hits.iter().filter(|hit| hit.instance == instance).count();
        assert!((0..3).all(|instance| of(instance) > 50), "{:?}", [0, 1, 2, 3].map(of));
        assert!(hits.iter().filter(|hit| !hit.is_hit()).count() > 100);
    }
}
