//! The CPU tracer against brute force in f64, and its laws.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_core::{FaceGroup, Kernel, Mesh};
use kiln_trace::{
    CosineSums, CpuTracer, Hit, KernelRates, MeshBvh, Path, PositionError, Ray, Scene, SceneObject, SobolScramble,
    SurfaceSample, Tracer, is_open_above,
};
use proptest::prelude::*;
use std::sync::Arc;

fn mesh(triangles: &[[Vec3; 3]]) -> Mesh {
    let group = FaceGroup::PLAIN;
    Mesh {
        positions: triangles.iter().flatten().map(Vec3::to_array).collect(),
        normals: vec![[0.0; 3]; 3 * triangles.len()],
        faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        face_group: vec![0; triangles.len()],
        groups: vec![group],
        ..Mesh::default()
    }
}

fn tracer(meshes: &[Mesh], objects: &[SceneObject]) -> CpuTracer {
    let meshes = meshes.iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
    CpuTracer::new(Arc::new(Scene::build(meshes, objects)))
}

/// Distance of the closest hit in f64, and how far the ray passes from the nearest edge of any triangle's plane.
fn brute_force(meshes: &[Mesh], objects: &[SceneObject], ray: &Ray) -> (f64, Option<(u32, u32, bool)>, f64) {
    let (mut best, mut id, mut margin) = (f64::from(ray.t_max), None, f64::INFINITY);
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    for (instance, object) in objects.iter().enumerate() {
        for face in 0..meshes[object.mesh].faces.len() {
            let corners = meshes[object.mesh].corners(face);
            let [a, b, c] = corners.map(|p| object.world_from_object.transform_point3(p.as_dvec3()));
            let normal = (b - a).cross(c - a);
            let slope = normal.dot(d);
            let t = normal.dot(a - o) / slope;
            let p = o + d * t;
            let area = normal.length_squared();
            let bary = [(b, c), (c, a), (a, b)].map(|(q, r)| (r - q).cross(p - q).dot(normal) / area);
            let inside = bary.iter().fold(f64::INFINITY, |m: f64, &x| m.min(x));
            if t > -1e-3 && t < best + 1e-3 {
                margin = margin.min(inside.abs());
            }
            if inside > 0.0 && t > 0.0 && t < best {
                margin = margin.min(t);
                best = t;
                let flips = object.world_from_object.matrix3.determinant() < 0.0;
                id = Some((instance as u32, face as u32, (slope > 0.0) != flips));
            }
        }
    }
    (best, id, margin)
}

fn vec3() -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-1f32..1.0).prop_map(Vec3::from_array)
}

fn transform() -> impl Strategy<Value = DAffine3> {
    let scale = prop::array::uniform3(prop_oneof![0.3f64..2.0, -2.0..-0.3]);
    (scale, prop::array::uniform3(-3.0f64..3.0), prop::array::uniform3(-2.0f64..2.0)).prop_map(|(s, r, t)| {
        let rotation = DQuat::from_rotation_x(r[0]) * DQuat::from_rotation_y(r[1]) * DQuat::from_rotation_z(r[2]);
        DAffine3::from_scale_rotation_translation(DVec3::from_array(s), rotation, DVec3::from_array(t))
    })
}

/// Corners of a face: any, in a plane across an axis, or nearly on a line.
fn corners() -> impl Strategy<Value = [Vec3; 3]> {
    let sides = prop::array::uniform2(0.3f32..1.0);
    let flat = (0usize..3, sides).prop_map(|(axis, sides)| {
        let (u, v) = (Vec3::AXES[(axis + 1) % 3] * sides[0], Vec3::AXES[(axis + 2) % 3] * sides[1]);
        [Vec3::ZERO, u, v + u * 0.3]
    });
    let sliver = (vec3(), vec3(), vec3(), 0f32..1.0, -6f32..-2.0)
        .prop_map(|(a, b, off, s, thin)| [a, b, a + (b - a) * s + off * 10f32.powf(thin)]);
    prop_oneof![prop::array::uniform3(vec3()), flat, sliver]
}

/// How steeply a ray meets a face.
fn slope() -> impl Strategy<Value = f32> {
    prop_oneof![0.1f32..1.0, (-6f32..-1.0).prop_map(|x| 10f32.powf(x))]
}

/// Points on a coarse lattice, so that edges often lie along axes and in planes across them; or anywhere.
fn lattice() -> impl Strategy<Value = Vec3> {
    prop_oneof![prop::array::uniform3(-2i32..3).prop_map(|p| Vec3::from_array(p.map(|x| x as f32))), vec3()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn closest_hits_match(
        soups in prop::collection::vec(prop::collection::vec(prop::array::uniform3(vec3()), 1..60), 1..4),
        placements in prop::collection::vec((0usize..4, transform()), 1..8),
        rays in prop::collection::vec((vec3(), vec3()), 50),
    ) {
        let meshes: Vec<Mesh> = soups.iter().map(|soup| mesh(soup)).collect();
        let objects: Vec<SceneObject> = placements
            .iter()
            .map(|&(mesh, world_from_object)| SceneObject { mesh: mesh % meshes.len(), world_from_object })
            .collect();
        let tracer = tracer(&meshes, &objects);
        for &(origin, direction) in &rays {
            let ray = Ray { origin: origin * 3.0, direction, t_max: 50.0 };
            let (t, id, margin) = brute_force(&meshes, &objects, &ray);
            // Rays through an edge, or direction almost in a plane, may go either way.
            if margin < 1e-3 || direction.length() < 0.05 {
                continue;
            }
            let hit = tracer.closest_hit(&ray);
            prop_assert_eq!(hit.is_hit(), id.is_some());
            if let Some((instance, face, back)) = id {
                prop_assert!((f64::from(hit.t) - t).abs() < 1e-3 * (1.0 + t), "{hit:?} {t}");
                if (f64::from(hit.t) - t).abs() < 1e-5 {
                    prop_assert_eq!((hit.instance, hit.primitive, hit.back_face), (instance, face, back));
                }
            }
        }
    }

    /// Rays in bundles, of one origin or of many, find what each finds alone, with every path's instructions, and whether
    /// anything is hit is whether there is a closest hit.
    #[test]
    fn bundles_find_what_rays_find_alone(
        soups in prop::collection::vec(prop::collection::vec(prop::array::uniform3(vec3()), 1..200), 1..3),
        placements in prop::collection::vec((0usize..3, transform()), 1..12),
        origins in prop::collection::vec(vec3(), 1..5),
        directions in prop::collection::vec(vec3(), 1..150),
        t_max in prop_oneof![Just(f32::INFINITY), 0.1f32..5.0],
    ) {
        let meshes: Vec<Mesh> = soups.iter().map(|soup| mesh(soup)).collect();
        let mut objects: Vec<SceneObject> = placements
            .iter()
            .map(|&(mesh, world_from_object)| SceneObject { mesh: mesh % meshes.len(), world_from_object })
            .collect();
        objects.push(SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY });
        let fast = tracer(&meshes, &objects);
        let portable = CpuTracer::with_path(fast.scene().clone(), Path::Portable);
        let axis = |i: usize, d: Vec3| if i.is_multiple_of(7) { Vec3::new(0.0, d.y, 0.0) } else { d };
        let ray = |(i, d): (usize, &Vec3)| Ray { origin: origins[i % origins.len()], direction: axis(i, *d), t_max };
        let rays: Vec<Ray> = directions.iter().enumerate().map(ray).collect();
        let alone: Vec<Hit> = rays.iter().map(|ray| portable.closest_hit(ray)).collect();
        for tracer in [&fast, &portable] {
            let mut hits = vec![Hit::MISS; rays.len()];
            tracer.trace(&rays, &mut hits).unwrap();
            prop_assert_eq!(&hits, &alone);
            let mut blocked = vec![false; rays.len()];
            tracer.any_hit(&rays, &mut blocked).unwrap();
            prop_assert!(blocked.iter().zip(&alone).all(|(blocked, hit)| *blocked == hit.is_hit()));
        }
        let samples: Vec<SurfaceSample> = directions.iter().enumerate().map(|(i, d)| {
            let normal = d.normalize_or(Vec3::Y);
            let scramble = SobolScramble([i as u32, 7]);
            SurfaceSample { origin: origins[i % origins.len()], normal, geometric: normal, scramble, first_index: 0 }
        }).collect();
        let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![0.5, 2.0] });
        for rays_per_sample in [1, 16, 128] {
            let sums = [&fast, &portable].map(|tracer| {
                let mut sums = vec![CosineSums::default(); samples.len()];
                tracer.gather_cosine(&samples, &kernel, rays_per_sample, &mut sums).unwrap();
                sums
            });
            prop_assert_eq!(&sums[0], &sums[1]);
            prop_assert!(sums[0].iter().all(|sum| sum.rays <= rays_per_sample && sum.values[0] <= sum.rays << 16));
        }
    }

    /// The closest hit is that of all triangles to the bit, whatever the tree: of one mesh, and of instances of their own
    /// that rays reach as they are. Coincident faces, slivers, and rays that graze a face from near by included.
    #[test]
    fn the_closest_hit_is_that_of_all_triangles(
        triangles in prop::collection::vec((corners(), 0.02f32..20.0, vec3()), 1..20),
        aims in prop::collection::vec((0usize..20, 0f32..1.0, 0f32..1.0, vec3(), slope()), 60),
    ) {
        let place = |(corners, size, at): &([Vec3; 3], f32, Vec3)| corners.map(|p| p * *size + *at * 30.0);
        let corners: Vec<[Vec3; 3]> = triangles.iter().map(place).collect();
        // Each face, its back, and both again with their corners in another order.
        let all: Vec<[Vec3; 3]> =
            corners.iter().flat_map(|&[a, b, c]| [[a, b, c], [a, c, b], [b, c, a], [c, b, a]]).collect();
        let soups: Vec<Mesh> = all.iter().map(|&triangle| mesh(&[triangle])).collect();
        let object = |mesh| SceneObject { mesh, world_from_object: DAffine3::IDENTITY };
        let objects: Vec<SceneObject> = (0..soups.len()).map(object).collect();
        let apart = tracer(&soups, &objects);
        let together = tracer(&[mesh(&corners)], &[object(0)]);
        let alone: Vec<CpuTracer> = soups.iter().map(|soup| tracer(std::slice::from_ref(soup), &[object(0)])).collect();
        let ray = |&(at, s, r, from, slope): &(usize, f32, f32, Vec3, f32)| {
            let [a, b, c] = corners[at % corners.len()];
            let target = a + (b - a) * (s * (1.0 - r)) + (c - a) * (s * r);
            let along = (b - a) * from.x + (c - a) * from.y;
            let direction = along + (b - a).cross(c - a).normalize_or_zero() * (slope * along.length());
            Ray { origin: target - direction * (0.1 + from.z.abs()), direction, t_max: f32::INFINITY }
        };
        let rays: Vec<Ray> = aims.iter().map(ray).collect();
        let [apart, together] = [apart, together].map(|tracer| {
            let mut hits = vec![Hit::MISS; rays.len()];
            tracer.trace(&rays, &mut hits).unwrap();
            hits
        });
        for ((ray, apart), together) in rays.iter().zip(&apart).zip(&together) {
            let each = alone.iter().zip(0..).map(|(tracer, instance)| Hit { instance, ..tracer.closest_hit(ray) });
            let first = |hits: &mut dyn Iterator<Item = Hit>| {
                let first = hits.filter(Hit::is_hit).min_by(|a, b| {
                    a.t.total_cmp(&b.t).then((a.back_face, a.instance).cmp(&(b.back_face, b.instance)))
                });
                first.unwrap_or(Hit::MISS)
            };
            let each: Vec<Hit> = each.collect();
            prop_assert_eq!(*apart, first(&mut each.iter().copied()), "{:?}", ray);
            let one_mesh = first(&mut each.iter().step_by(4).copied());
            let face = if one_mesh.is_hit() { (0, one_mesh.instance / 4) } else { (u32::MAX, u32::MAX) };
            prop_assert_eq!((together.t, together.back_face), (one_mesh.t, one_mesh.back_face), "{:?}", ray);
            prop_assert_eq!((together.instance, together.primitive), face, "{:?}", ray);
        }
    }

    /// Distances are those of the faces' planes to 18 bits, however large the face and near the ray's origin.
    #[test]
    fn distances_are_those_of_planes(
        corners in corners(), size in -3f32..4.0, s in 0.01f32..0.98, r in 0.01f32..0.99, direction in vec3(), reach in -4f32..2.0,
    ) {
        let corners = corners.map(|p| p * 10f32.powf(size));
        let [a, b, c] = corners.map(Vec3::as_dvec3);
        let target = (corners[0] + (corners[1] - corners[0]) * (s * (1.0 - r)) + (corners[2] - corners[0]) * (s * r)).as_dvec3();
        let ray = Ray { origin: (target - direction.as_dvec3() * f64::from(10f32.powf(reach))).as_vec3(), direction, t_max: f32::INFINITY };
        let tracer = tracer(&[mesh(&[corners])], &[SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY }]);
        let hit = tracer.closest_hit(&ray);
        let normal = (b - a).cross(c - a);
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let plane = normal.dot(a - o) / normal.dot(d);
        // Not where rounded coordinates put the ray past an edge, or in the plane.
        let thinness = normal.length() / [b - a, c - a, c - b].map(DVec3::length_squared).into_iter().fold(0.0, f64::max);
        let inside = f64::from(s.min(1.0 - s) * r.min(1.0 - r)) * thinness;
        let is_clear = inside > 1e-4 && normal.dot(d).abs() > 1e-3 * normal.length() * d.length();
        if is_clear && hit.is_hit() {
            prop_assert!((f64::from(hit.t) - plane).abs() <= 5e-6 * plane.abs(), "{hit:?} {plane}");
        }
    }

    /// Walls back to back, of instances whose rays are rounded differently: the front one is found, but for the few rays whose
    /// distances lie where rounding parts.
    #[test]
    fn coincident_faces_of_different_instances_tie(
        at in prop::array::uniform3(-9i32..10), steps in 1i32..5, aims in prop::collection::vec((vec3(), vec3(), 0.2f32..3.0), 256),
    ) {
        let wall = [Vec3::new(0.5, -1.0, -1.0), Vec3::new(0.5, 1.0, -1.0), Vec3::new(0.5, 0.0, 1.0)];
        let back = [wall[0], wall[2], wall[1]].map(|p| p - Vec3::X * steps as f32);
        let at = DVec3::from_array(at.map(f64::from));
        let place = |mesh, x: f64| SceneObject { mesh, world_from_object: DAffine3::from_translation(at + DVec3::X * x) };
        let tracer = tracer(&[mesh(&[wall]), mesh(&[back])], &[place(1, f64::from(steps)), place(0, 0.0)]);
        let mut wrong = 0;
        for (target, side, distance) in &aims {
            let target = at + wall[2].lerp(Vec3::new(0.5, 0.3 * target.y, -0.5), 0.5 + 0.4 * target.z.abs()).as_dvec3();
            let direction = Vec3::new(-1.0 - side.x.abs(), side.y, side.z);
            let origin = (target - direction.as_dvec3() * f64::from(*distance)).as_vec3();
            let hit = tracer.closest_hit(&Ray { origin, direction, t_max: f32::INFINITY });
            prop_assert!(hit.is_hit(), "{origin} {direction}");
            wrong += usize::from(hit.back_face);
        }
        prop_assert!(wrong <= aims.len() / 10, "{wrong} of {}", aims.len());
    }

    /// Rays at points of an edge that two faces share hit one of them, also where the edge lies in a side of their boxes.
    #[test]
    fn shared_edges_have_no_gap(
        [a, b] in prop::array::uniform2(lattice()), away in prop::array::uniform2(lattice()), size in -3f32..4.0,
        along in prop::collection::vec((0.0f32..=1.0, vec3(), 0.01f32..100.0), 60),
    ) {
        let [c, d] = away;
        prop_assume!((b - a).cross(c - a).length() > 0.0 && (b - a).cross(d - a).length() > 0.0);
        let [a, b, c, d] = [a, b, c, d].map(|p| p * 10f32.powf(size));
        let tracer = tracer(&[mesh(&[[a, b, c], [b, a, d]])], &[SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY }]);
        for (s, direction, distance) in along {
            let target = a + (b - a) * s;
            let origin = target - direction * (distance * 10f32.powf(size));
            let ray = Ray { origin, direction, t_max: f32::INFINITY };
            // The faces must lie on different sides of the plane through the edge and the ray, well away from it, and the
            // ray must pass the edge between its ends.
            let plane = (b - a).cross(direction).normalize_or_zero().as_dvec3();
            let side = |p: Vec3| plane.dot((p - a).as_dvec3()) / f64::from((p - a).length());
            if side(c) * side(d) < -1e-4 && (0.01..0.99).contains(&s) && plane.length() > 0.5 {
                prop_assert!(tracer.closest_hit(&ray).is_hit(), "{ray:?}");
            }
        }
    }

    /// A ray that starts on a surface, moved off it by the error bound, does not hit that surface again.
    #[test]
    fn origins_are_robust(
        triangle in prop::array::uniform3(vec3()), size in -3f32..4.0, place in transform(), far in -3f64..5.0,
        s in 0f64..1.0, r in 0f64..1.0, directions in prop::collection::vec(vec3(), 8),
    ) {
        let corners = triangle.map(|p| p * 10f32.powf(size));
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        prop_assume!(normal.length() > 0.05 * 100f32.powf(size));
        let mut place = place;
        place.translation *= 10f64.powf(far);
        let tracer = tracer(&[mesh(&[corners])], &[SceneObject { mesh: 0, world_from_object: place }]);
        let (s, r) = if s + r > 1.0 { (1.0 - s, 1.0 - r) } else { (s, r) };
        let [a, b, c] = corners.map(Vec3::as_dvec3);
        let p = place.transform_point3(a + (b - a) * s + (c - a) * r);
        let n = (place.matrix3.inverse().transpose() * normal.as_dvec3()).normalize();
        let extent = (b - a).length().max((c - a).length()).max((c - b).length());
        let off = PositionError::new(&place).bound(p, extent).dot(n.abs());
        let origin = (p + n * off).as_vec3();
        let n = n.as_vec3();
        for d in directions {
            let d = (n * 0.02 + (d - n * d.dot(n)) + n * d.dot(n).abs()).normalize();
            let hit = tracer.closest_hit(&Ray { origin, direction: d, t_max: f32::MAX });
            prop_assert!(!hit.is_hit(), "{hit:?} off {off} at {p}");
        }
        // The bound is small against the coordinates and the face.
        let scale = p.abs().max_element().max(f64::from(10f32.powf(size)) * 10.0);
        prop_assert!(off < 1e-3 * scale, "{off} {scale}");
    }
}

/// A closed box of 12 triangles facing inwards, and one with the same corners facing outwards.
fn cube(half: f32, inward: bool) -> Vec<[Vec3; 3]> {
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let mut n = Vec3::ZERO;
            n[axis] = sign * half;
            let mut u = Vec3::ZERO;
            u[(axis + 1) % 3] = half * sign;
            let mut v = Vec3::ZERO;
            v[(axis + 2) % 3] = half;
            let quad = [n - u - v, n + u - v, n + u + v, n - u + v];
            for [i, j, k] in [[0, 1, 2], [0, 2, 3]] {
                triangles.push(if inward { [quad[i], quad[k], quad[j]] } else { [quad[i], quad[j], quad[k]] });
            }
        }
    }
    triangles
}

fn identity(mesh: usize) -> SceneObject {
    SceneObject { mesh, world_from_object: DAffine3::IDENTITY }
}

fn sample(origin: Vec3, normal: Vec3, seed: u32) -> SurfaceSample {
    let scramble = SobolScramble([seed, seed.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b]);
    SurfaceSample { origin, normal, geometric: normal, scramble, first_index: 0 }
}

#[test]
fn nothing_leaks_from_a_closed_box() {
    let tracer = tracer(&[mesh(&cube(1.0, true))], &[identity(0)]);
    let kernel = KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY });
    let samples: Vec<SurfaceSample> =
        (0..64).map(|i| sample(Vec3::new(0.3, 0.1 * (i % 8) as f32, -0.2), Vec3::Y, i)).collect();
    let mut sums = vec![CosineSums::default(); samples.len()];
    tracer.gather_cosine(&samples, &kernel, 4096, &mut sums).unwrap();
    assert!(sums.iter().all(|s| s.values[0] == 0 && s.back_faces == 0 && s.rays > 4000));
}

#[test]
fn ties_prefer_the_front_then_the_lowest() {
    let square = [[Vec3::ZERO, Vec3::X, Vec3::Y]];
    let flipped = [[Vec3::ZERO, Vec3::Y, Vec3::X]];
    let meshes = [mesh(&square), mesh(&flipped)];
    let ray = Ray { origin: Vec3::new(0.2, 0.2, 1.0), direction: Vec3::NEG_Z, t_max: 10.0 };
    for order in [[0, 1, 0], [1, 0, 0], [1, 1, 0]] {
        let objects = order.map(identity);
        let hit = tracer(&meshes, &objects).closest_hit(&ray);
        let first_front = order.iter().position(|&m| m == 0).unwrap() as u32;
        assert_eq!(hit, Hit { t: 1.0, instance: first_front, primitive: 0, back_face: false });
    }
    // In one mesh, coincident opposite faces are one that has no back.
    let both = mesh(&[square[0], flipped[0]]);
    let tracer = tracer(&[both], &[identity(0)]);
    for z in [1.0, -1.0] {
        let hit = tracer.closest_hit(&Ray { origin: Vec3::new(0.2, 0.2, z), direction: Vec3::NEG_Z * z, t_max: 10.0 });
        assert_eq!(hit, Hit { t: 1.0, instance: 0, primitive: 0, back_face: false });
    }
}

#[test]
fn thread_count_changes_nothing() {
    let mut triangles = cube(1.0, true);
    triangles.extend(cube(0.3, false));
    let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![0.5, 20.0] });
    let samples: Vec<SurfaceSample> =
        (0..500).map(|i| sample(Vec3::new(0.7, -0.9, 0.001 * i as f32), Vec3::Y, i)).collect();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let tracer = tracer(&[mesh(&triangles)], &[identity(0)]);
            let mut sums = vec![CosineSums::default(); samples.len()];
            tracer.gather_cosine(&samples, &kernel, 64, &mut sums).unwrap();
            sums
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn open_sky_is_found_and_agrees_with_rays() {
    let floor = mesh(&[[Vec3::new(-9.0, 0.0, -9.0), Vec3::new(-9.0, 0.0, 9.0), Vec3::new(9.0, 0.0, -9.0)]]);
    let block = mesh(&cube(0.5, false));
    let up = |height: f64| SceneObject { mesh: 1, world_from_object: DAffine3::from_translation(DVec3::Y * height) };
    let meshes = [floor, block];
    let open = |objects: &[SceneObject], p: Vec3, reach: f32| {
        is_open_above(tracer(&meshes, objects).scene(), p, Vec3::Y, reach)
    };
    let p = Vec3::new(-3.0, 1e-5, -3.0);
    assert!(open(&[identity(0)], p, 100.0));
    assert!(open(&[identity(0), up(-2.0)], p, 100.0));
    assert!(!open(&[identity(0), up(0.0)], p, 100.0));
    assert!(open(&[identity(0), up(20.0)], p, 5.0));
    assert!(!open(&[identity(0), up(20.0)], p, 50.0));
    assert!(open(&[], p, 50.0));
}

/// Rays that are not finite, in world or object space, hit nothing that would not be there, in bundles, groups and alone.
#[test]
fn rays_that_are_not_finite_are_survived() {
    let faces: Vec<[Vec3; 3]> = (0..7).flat_map(|i| cube(0.1 + 0.2 * i as f32, false)).collect();
    let tiny = DAffine3::from_scale(DVec3::splat(1e-37));
    let place = |world_from_object: DAffine3| SceneObject { mesh: 0, world_from_object };
    let objects = [place(DAffine3::IDENTITY), place(tiny), place(DAffine3::from_translation(DVec3::X * 3.0))];
    let fast = tracer(&[mesh(&faces)], &objects);
    let portable = CpuTracer::with_path(fast.scene().clone(), Path::Portable);
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 0.0, 1.0];
    let vectors: Vec<Vec3> = odd.iter().flat_map(|&x| odd.map(|y| Vec3::new(x, y, 1.0))).collect();
    let ray = |origin: Vec3, direction: Vec3| Ray { origin, direction, t_max: f32::INFINITY };
    let mut rays: Vec<Ray> =
        vectors.iter().flat_map(|v| [ray(*v, Vec3::X), ray(Vec3::ZERO, *v), ray(*v, *v)]).collect();
    // One of them among many that are finite, and many from one origin.
    rays.extend((0..63).map(|i| ray(Vec3::splat(0.01 * i as f32), Vec3::ONE)));
    rays.extend(vectors.iter().map(|v| ray(Vec3::NAN, *v)));
    for tracer in [&fast, &portable] {
        let mut hits = vec![Hit::MISS; rays.len()];
        tracer.trace(&rays, &mut hits).unwrap();
        tracer.any_hit(&rays, &mut vec![false; rays.len()]).unwrap();
        let alone: Vec<Hit> = rays.iter().map(|ray| tracer.closest_hit(ray)).collect();
        assert!(hits.iter().chain(&alone).all(|hit| !hit.is_hit() || hit.t > 0.0));
        assert!(hits.iter().zip(&rays).all(|(hit, ray)| !hit.is_hit() || !ray.origin.is_nan()));
    }
}
