//! Laws of reading one hit.

use crate::shapes::{Full, plane, turned};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_bake::{BakedError, BakedInstance, BakedPoint, BakedSurface};
use kiln_trace::{Hit, Ray};

fn linear(p: DVec3) -> f64 {
    0.5 + 0.1 * p.x - 0.15 * p.z
}

/// What a ray through a point of object space reads, from above or below the plane there.
fn look(full: &Full, point: DVec3, from: DVec3) -> Option<BakedPoint> {
    let place = full.parts[0].place;
    let origin = place.transform_point3(point + from).as_vec3();
    let ray = Ray { origin, direction: place.transform_vector3(-from).as_vec3(), t_max: 2.0 };
    full.baked().read(&ray, &full.tracer().closest_hit(&ray))
}

#[test]
fn values_are_linear_between_vertices_under_any_transform() {
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.0);
    let place = |scale| DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(30.0, -4.0, 7.0));
    for scale in [DVec3::ONE, DVec3::new(2.0, 0.3, 1.0), DVec3::new(-1.0, 2.0, 0.5)] {
        let full = Full::one(plane(2.0, 0.0), place(scale), linear);
        let up = (turn * DVec3::Y * scale.y).normalize();
        for point in [DVec3::new(0.3, 0.0, 0.9), DVec3::new(-1.7, 0.0, 0.2), DVec3::new(1.1, 0.0, -1.9)] {
            for from in [DVec3::Y, -DVec3::Y, DVec3::new(0.7, 1.0, -0.2)] {
                let found = look(&full, point, from).expect("a plane");
                assert!((found.ao[0] - linear(point)).abs() < 1e-5, "{scale}: {} {}", found.ao[0], linear(point));
                assert_eq!(found.ao[1..], [0.0; 3]);
                assert_eq!(found.is_front, from.y > 0.0);
                assert!((found.normal - up).length() < 1e-6, "{scale}: {}", found.normal);
            }
        }
    }
}

#[test]
fn both_sides_of_a_double_sided_face_are_fronts() {
    let mut full = Full::one(plane(2.0, 0.0), DAffine3::IDENTITY, linear);
    full.parts[0].mesh.groups[0].double_sided = true;
    for from in [DVec3::Y, -DVec3::Y] {
        let found = look(&full, DVec3::new(0.3, 0.0, 0.9), from).expect("a plane");
        assert!(found.is_front && (found.normal - from).length() < 1e-9);
        assert!((found.ao[0] - linear(DVec3::new(0.3, 0.0, 0.9))).abs() < 1e-6);
    }
    let below = Full::one(turned(&plane(2.0, 0.0)), DAffine3::IDENTITY, linear);
    let found = look(&below, DVec3::new(0.3, 0.0, 0.9), DVec3::Y).expect("a plane");
    assert!(!found.is_front && (found.normal + DVec3::Y).length() < 1e-9);
}

#[test]
fn what_is_not_there_reads_nothing() {
    let full = Full::one(plane(2.0, 0.0), DAffine3::IDENTITY, linear);
    let baked = full.baked();
    let ray = Ray { origin: Vec3::Y, direction: -Vec3::Y, t_max: 9.0 };
    let hit = Hit { t: 1.0, instance: 0, primitive: 0, back_face: false };
    assert!(baked.read(&ray, &hit).is_some());
    for hit in [Hit::MISS, Hit { instance: 1, ..hit }, Hit { primitive: 8, ..hit }, Hit { t: f32::NAN, ..hit }] {
        assert_eq!(baked.read(&ray, &hit), None);
    }
}

#[test]
fn values_that_cannot_be_read_are_refused() {
    let mesh = plane(2.0, 0.0);
    let of = |channels: usize, values: &[f32]| {
        let instance = BakedInstance { mesh: &mesh, world_from_object: DAffine3::IDENTITY, values };
        BakedSurface::new(channels, &[None, Some(instance)]).map(|baked| baked.channel_count())
    };
    let mut values = vec![0.5; 18];
    assert_eq!(of(2, &values), Ok(2));
    assert_eq!(of(0, &[]), Err(BakedError::Channels { channels: 0 }));
    assert_eq!(of(5, &values), Err(BakedError::Channels { channels: 5 }));
    assert_eq!(of(1, &values), Err(BakedError::Length { instance: 1, found: 18, expected: 9 }));
    values[7] = 1.5;
    assert_eq!(of(2, &values), Err(BakedError::Value { instance: 1, vertex: 3, value: 1.5 }));
    values[7] = f32::NAN;
    assert!(matches!(of(2, &values), Err(BakedError::Value { vertex: 3, .. })));
    let mut broken = mesh.clone();
    broken.faces[5] = [0, 1, 9];
    let instance = BakedInstance { mesh: &broken, world_from_object: DAffine3::IDENTITY, values: &[0.5; 9] };
    let refused = BakedSurface::new(1, &[Some(instance)]).map(|_| ());
    assert_eq!(refused, Err(BakedError::Face { instance: 0, face: 5 }));
}

#[test]
fn what_is_flattened_is_nowhere() {
    let mut full = Full::one(plane(2.0, 0.0), DAffine3::IDENTITY, linear);
    let bounds = full.baked().bounds_m();
    assert!((bounds.diagonal() - 32f64.sqrt()).abs() < 1e-3);
    full.parts.push(full.parts[0].clone());
    full.parts[1].place = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
    assert_eq!(full.baked().bounds_m(), bounds);
}
