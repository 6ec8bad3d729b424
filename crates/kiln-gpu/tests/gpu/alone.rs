//! The closest hit in a scene is that of each of its triangles alone, whatever the tree: slivers and rays that graze are
//! no exception.

use crate::scenes::{Numbers, TestScene};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_gpu::GpuTracer;
use kiln_trace::{Hit, Ray, SceneObject, Tracer};

const TRIANGLES: usize = 160;
const RAYS: usize = 20_000;

type Triangle = [Vec3; 3];

/// Small ones, large ones, slivers, ones in a plane of the axes, and fans in one plane.
fn triangles(numbers: &mut Numbers) -> Vec<Triangle> {
    let hub = numbers.point();
    (0..TRIANGLES)
        .map(|i| {
            let a = numbers.point();
            let [u, v] = [numbers.point(), numbers.point()];
            match i % 5 {
                0 => [a, a + u * 0.2, a + v * 0.2],
                1 => [a + u * 30.0, a - u * 20.0, a + v * 25.0],
                // As thin as 1e-6 of their length.
                2 => [a, a + u, a + u * numbers.unit() + v * 10f32.powi(-((numbers.bits() % 7) as i32))],
                3 => [a, a + Vec3::X * u.x, a + Vec3::Y * u.y],
                _ => [hub, hub + Vec3::new(u.x, u.y, 0.3 * u.x), hub + Vec3::new(v.x, v.y, 0.3 * v.x)],
            }
        })
        .collect()
}

/// Rays to and from points of the triangles: across them, and along them at angles down to 1e-6.
fn rays(triangles: &[Triangle], transform: &DAffine3, numbers: &mut Numbers) -> Vec<Ray> {
    let mut on = |triangle: &Triangle| {
        let (mut s, mut r) = (numbers.unit(), numbers.unit());
        if s + r > 1.0 {
            (s, r) = (1.0 - s, 1.0 - r);
        }
        // Some on an edge.
        r *= f32::from(!numbers.bits().is_multiple_of(4));
        let [a, b, c] = *triangle;
        let place = a + (b - a) * s + (c - a) * r;
        let along = ((b - a) * (numbers.unit() - 0.5) + (c - a) * (numbers.unit() - 0.5)).normalize_or(Vec3::X);
        let normal = (b - a).cross(c - a).normalize_or(Vec3::Z);
        let lean =
            10f32.powi(-((numbers.bits() % 7) as i32)) * if numbers.bits().is_multiple_of(2) { 1.0 } else { -1.0 };
        let far = 10f32.powi((numbers.bits() % 5) as i32 - 3);
        (place, along + normal * lean, far)
    };
    (0..RAYS)
        .map(|i| {
            let (place, direction, far) = on(&triangles[i % triangles.len()]);
            let origin = match i % 3 {
                0 => place - direction * far,
                1 => place,
                _ => on(&triangles[(7 * i + i / 11) % triangles.len()]).0,
            };
            let direction = if i % 3 == 2 { place - origin } else { direction };
            let t_max = if i % 7 == 0 { 1.0 } else { f32::INFINITY };
            Ray {
                origin: transform.transform_point3(origin.as_dvec3()).as_vec3(),
                direction: transform.transform_vector3(direction.as_dvec3()).as_vec3(),
                t_max,
            }
        })
        .collect()
}

fn trace(scene: &TestScene, rays: &[Ray]) -> Vec<Hit> {
    let tracer = GpuTracer::new(crate::device(), &scene.build()).expect("the scene fits");
    let mut hits = vec![Hit::MISS; rays.len()];
    tracer.trace(rays, &mut hits).expect("it traces");
    hits
}

fn check(name: &'static str, seed: u64, transform: DAffine3) {
    let mut numbers = Numbers(seed);
    let triangles = triangles(&mut numbers);
    let rays = rays(&triangles, &transform, &mut numbers);
    let object = || vec![SceneObject { mesh: 0, world_from_object: transform }];
    let whole = trace(&TestScene::new(name, &triangles, object()), &rays);
    let mut closest = vec![Hit::MISS; rays.len()];
    for (face, triangle) in triangles.iter().enumerate() {
        let alone = trace(&TestScene::new(name, &[*triangle], object()), &rays);
        for (best, hit) in closest.iter_mut().zip(alone).filter(|(_, hit)| hit.is_hit()) {
            let hit = Hit { primitive: face as u32, ..hit };
            let order = |hit: &Hit| (hit.back_face, hit.primitive);
            if hit.t < best.t || (hit.t == best.t && order(&hit) < order(best)) {
                *best = hit;
            }
        }
    }
    let differ: Vec<usize> = (0..rays.len()).filter(|&i| whole[i] != closest[i]).collect();
    let hits = whole.iter().filter(|hit| hit.is_hit()).count();
    assert!(hits > rays.len() / 2 && hits < rays.len(), "{name}: {hits} hits");
    let first = differ.first().map(|&i| (rays[i], whole[i], closest[i]));
    assert!(first.is_none(), "{name}: {} of {} hits are not the closest: {first:?}", differ.len(), rays.len());
}

/// Instances of one triangle in one place, its corners in each order: the first front wins, bit for bit.
#[test]
fn permuted_corners_tie() {
    let mut numbers = Numbers(17);
    let turn = DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(2.0);
    let transform =
        DAffine3::from_scale_rotation_translation(DVec3::new(1.1, 0.7, 1.9), turn, DVec3::new(-40.0, 9.0, 3.0));
    for triangle in triangles(&mut numbers).into_iter().take(30) {
        let [a, b, c] = triangle;
        // Every other one is wound the other way.
        let orders = [[a, c, b], [a, b, c], [c, b, a], [b, c, a], [b, a, c], [c, a, b]];
        let mut scene = TestScene::new("permuted", &orders[..1], Vec::new());
        for (mesh, order) in orders.iter().enumerate() {
            if mesh > 0 {
                scene.meshes.extend(TestScene::new("permuted", &[*order], Vec::new()).meshes);
            }
            scene.objects.push(SceneObject { mesh, world_from_object: transform });
        }
        let all_rays = rays(&[triangle], &transform, &mut numbers);
        let hits = trace(&scene, &all_rays[..500]);
        assert!(hits.iter().any(Hit::is_hit));
        for hit in hits.iter().filter(|hit| hit.is_hit()) {
            assert!(hit.instance < 2 && !hit.back_face, "{hit:?}");
        }
    }
}

#[test]
fn the_closest_hit_is_that_of_each_triangle_alone() {
    for seed in 0..4 {
        check("where they are", seed, DAffine3::IDENTITY);
    }
}

#[test]
fn so_it_is_under_a_transform() {
    let turn = DQuat::from_rotation_x(0.4) * DQuat::from_rotation_z(-1.1);
    let transform =
        DAffine3::from_scale_rotation_translation(DVec3::new(0.5, -2.0, 1.3), turn, DVec3::new(300.0, -200.0, 10.0));
    check("placed", 9, transform);
}
