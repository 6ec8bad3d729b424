//! Rays and faces with holes: against brute force in f64, and by law.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_core::{Cutouts, FaceGroup, Foliage as FaceFoliage, FoliageMode, Kernel, Mask, Mesh, OpticalDepth, Wrap};
use kiln_trace::{
    CosineSums, CpuTracer, CrossingMesh, CutoutMesh, Foliage, FoliageObject, Hit, KernelRates, MeshBvh, Path, Ray,
    Scene, SceneObject, SobolScramble, SpherePoint, SphereSums, SurfaceSample, Tracer, is_open_above,
};
use proptest::prelude::*;
use std::sync::Arc;

const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Mirrored, Wrap::Clamp];

/// A triangle, and the texture coordinates of its corners if it has a mask.
type Face = ([Vec3; 3], Option<[[f32; 2]; 3]>);

/// Group 0 is whole, group 1 has the mask.
fn mesh(faces: &[Face], mask: &Mask, masked: &FaceGroup) -> Mesh {
    Mesh {
        positions: faces.iter().flat_map(|(corners, _)| corners.map(|corner| corner.to_array())).collect(),
        normals: vec![[0.0; 3]; 3 * faces.len()],
        faces: (0..faces.len() as u32).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect(),
        face_group: faces.iter().map(|(_, uv)| u16::from(uv.is_some())).collect(),
        groups: vec![FaceGroup::PLAIN, FaceGroup { cutout: Some(0), ..masked.clone() }],
        cutouts: Cutouts {
            masks: vec![Arc::new(mask.clone())],
            corners: faces.iter().filter_map(|(_, uv)| *uv).collect(),
        },
    }
}

fn scene(meshes: &[Mesh], places: &[(usize, DAffine3)]) -> Scene {
    let objects: Vec<SceneObject> =
        places.iter().map(|&(mesh, world_from_object)| SceneObject { mesh, world_from_object }).collect();
    let cutouts = meshes.iter().map(|mesh| CutoutMesh::build(mesh).map(Arc::new)).collect();
    let bvhs = meshes.iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
    Scene::build(bvhs, &objects).with_cutouts(cutouts, &objects)
}

fn trace(scene: Scene, rays: &[Ray], path: Path) -> (Vec<Hit>, Vec<bool>) {
    let tracer = CpuTracer::with_path(Arc::new(scene), path);
    let (mut hits, mut blocked) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
    tracer.trace(rays, &mut hits).expect("the processor traces");
    tracer.any_hit(rays, &mut blocked).expect("the processor traces");
    (hits, blocked)
}

/// What a ray meets, in f64.
enum Meeting {
    Nothing,
    At(f64, bool),
    /// So near to an edge of the face, or of a texel, that rounding decides.
    Unclear,
}

const CLEAR: f64 = 1e-4;

fn meet((corners, uv): &Face, mask: &Mask, place: &DAffine3, ray: &Ray) -> Meeting {
    let [a, b, c] = corners.map(|corner| place.transform_point3(corner.as_dvec3()));
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let normal = (b - a).cross(c - a);
    let slope = normal.dot(direction);
    let t = normal.dot(a - origin) / slope;
    if slope.abs() < 1e-3 * normal.length() || normal.length() < 1e-3 {
        return Meeting::Unclear;
    }
    let at = origin + direction * t;
    let part = |p: DVec3, q: DVec3| normal.dot((p - at).cross(q - at)) / normal.length_squared();
    let weights = [part(b, c), part(c, a), part(a, b)];
    if weights.iter().any(|weight| *weight < -CLEAR) || t < -CLEAR || t > f64::from(ray.t_max) + CLEAR {
        return Meeting::Nothing;
    }
    if weights.iter().any(|weight| *weight < CLEAR) || t < CLEAR || t > f64::from(ray.t_max) - CLEAR {
        return Meeting::Unclear;
    }
    // A mirroring transform turns the face over.
    let is_front = (slope < 0.0) == (place.matrix3.determinant() > 0.0);
    let Some(uv) = uv else { return Meeting::At(t, is_front) };
    let coordinate = |axis: usize| (0..3).map(|i| weights[i] * f64::from(uv[i][axis])).sum::<f64>();
    let uv = [coordinate(0), coordinate(1)];
    let from_edge = |axis: usize| {
        let cells = uv[axis] * f64::from(mask.size()[axis]);
        (cells - cells.round()).abs()
    };
    if from_edge(0).min(from_edge(1)) < 1e-2 {
        return Meeting::Unclear;
    }
    if mask.is_opaque(uv) { Meeting::At(t, is_front) } else { Meeting::Nothing }
}

fn vec3() -> impl Strategy<Value = Vec3> {
    prop::array::uniform3(-1f32..1.0).prop_map(Vec3::from_array)
}

fn transform() -> impl Strategy<Value = DAffine3> {
    let scale = prop::array::uniform3(prop_oneof![0.4f64..2.0, -2.0..-0.4]);
    (scale, prop::array::uniform3(-3.0f64..3.0), prop::array::uniform3(-1.0f64..1.0)).prop_map(|(s, r, t)| {
        let rotation = DQuat::from_rotation_x(r[0]) * DQuat::from_rotation_y(r[1]) * DQuat::from_rotation_z(r[2]);
        DAffine3::from_scale_rotation_translation(DVec3::from_array(s), rotation, DVec3::from_array(t))
    })
}

fn mask() -> impl Strategy<Value = Mask> {
    (1u32..20, 1u32..20, prop::array::uniform2(0usize..3), prop::collection::vec(any::<bool>(), 400)).prop_map(
        |(width, height, wraps, bits)| {
            Mask::new([width, height], wraps.map(|wrap| WRAPS[wrap]), |[x, y]| bits[(y * 20 + x) as usize])
        },
    )
}

fn faces() -> impl Strategy<Value = Vec<Face>> {
    let uv = prop::array::uniform3(prop::array::uniform2(-2.5f32..2.5));
    prop::collection::vec((prop::array::uniform3(vec3()), prop::option::weighted(0.7, uv)), 1..60)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// The closest hit is that of all faces, each with its holes, and any hit is one.
    #[test]
    fn hits_are_those_of_brute_force(
        faces in prop::collection::vec(faces(), 1..3), mask in mask(), double_sided: bool,
        places in prop::collection::vec((any::<prop::sample::Index>(), transform()), 1..4),
        rays in prop::collection::vec((vec3(), vec3(), 0.5f32..6.0), 1..130), is_shared: bool,
    ) {
        let masked = FaceGroup { double_sided, ..FaceGroup::PLAIN };
        let meshes: Vec<Mesh> = faces.iter().map(|faces| mesh(faces, &mask, &masked)).collect();
        let places: Vec<_> = places.into_iter().map(|(mesh, place)| (mesh.index(meshes.len()), place)).collect();
        let first = rays[0].0;
        let ray = |(origin, direction, t_max): &(Vec3, Vec3, f32)| {
            Ray { origin: if is_shared { first } else { *origin } * 2.0, direction: direction.normalize_or(Vec3::X), t_max: *t_max }
        };
        let rays: Vec<Ray> = rays.iter().map(ray).collect();
        let (hits, blocked) = trace(scene(&meshes, &places), &rays, Path::detect());
        prop_assert_eq!(&(hits.clone(), blocked.clone()), &trace(scene(&meshes, &places), &rays, Path::Portable));
        for (index, ray) in rays.iter().enumerate() {
            let (mut nearest, mut unclear) = (None::<(f64, usize, usize, bool)>, f64::INFINITY);
            for (instance, (which, place)) in places.iter().enumerate() {
                for (face, textured) in faces[*which].iter().enumerate() {
                    match meet(textured, &mask, place, ray) {
                        Meeting::At(t, front) if nearest.is_none_or(|best| t < best.0) => {
                            nearest = Some((t, instance, face, front));
                        }
                        Meeting::Unclear => unclear = 0.0,
                        _ => {}
                    }
                }
            }
            if unclear == 0.0 {
                continue;
            }
            let hit = hits[index];
            prop_assert_eq!(blocked[index], nearest.is_some());
            prop_assert_eq!(hit.is_hit(), nearest.is_some(), "{:?} {:?}", hit, nearest);
            if let Some((t, instance, face, is_front)) = nearest {
                prop_assert!((f64::from(hit.t) - t).abs() < 1e-3 * t.max(0.1), "{} {t}", hit.t);
                if (hit.instance, hit.primitive) == (instance as u32, face as u32) {
                    let both = double_sided && faces[places[instance].0][face].1.is_some();
                    prop_assert_eq!(hit.back_face, !is_front && !both);
                }
            }
        }
    }

    /// A mask of one value is no mask, or no face: hits and sums are the same to the bit, back faces among them.
    #[test]
    fn masks_of_one_value(
        faces in faces(), double_sided: bool, places in prop::collection::vec(transform(), 1..3), seed: u32,
        points in prop::collection::vec((vec3(), vec3()), 1..6),
    ) {
        let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![0.5, 4.0] });
        let samples: Vec<SurfaceSample> = points.iter().map(|(origin, normal)| sample(*origin, *normal, seed)).collect();
        let places: Vec<_> = places.into_iter().map(|place| (0, place)).collect();
        let masked = FaceGroup { double_sided, ..FaceGroup::PLAIN };
        let sums = |mesh: Mesh| gathered(scene(&[mesh], &places), &samples, &kernel);
        let with = |opaque| mesh(&faces, &Mask::uniform(opaque), &masked);
        let as_whole = |keeps: bool| {
            let mut whole = with(true);
            whole.groups[1] = FaceGroup { occludes: keeps, ..masked.clone() };
            whole
        };
        prop_assert_eq!(sums(with(true)), sums(as_whole(true)));
        prop_assert_eq!(sums(with(false)), sums(as_whole(false)));
    }
}

fn sample(origin: Vec3, normal: Vec3, seed: u32) -> SurfaceSample {
    let normal = normal.normalize_or(Vec3::Y);
    let scramble = SobolScramble([seed.wrapping_mul(0x9e37_79b9), seed ^ 0x51ed_270b]);
    SurfaceSample { origin, normal, geometric: normal, scramble, first_index: 0 }
}

/// Over hemispheres, and over spheres.
fn gathered(scene: Scene, samples: &[SurfaceSample], kernel: &KernelRates) -> (Vec<CosineSums>, Vec<SphereSums>) {
    let tracer = CpuTracer::new(Arc::new(scene));
    let mut sums = vec![CosineSums::default(); samples.len()];
    tracer.gather_cosine(samples, kernel, 64, &mut sums).expect("the processor traces");
    let points: Vec<_> = samples.iter().map(|s| SpherePoint { origin: s.origin, scramble: s.scramble }).collect();
    let mut spheres = vec![SphereSums::default(); points.len()];
    tracer.gather_sphere(&points, kernel, 64, &mut spheres).expect("the processor traces");
    (sums, spheres)
}

/// A square across the y axis that looks down; its texture covers it once, u along x and v along z.
fn ceiling(y: f32, half: f32) -> [Face; 2] {
    let at = |u: f32, v: f32| (Vec3::new((2.0 * u - 1.0) * half, y, (2.0 * v - 1.0) * half), [u, v]);
    let face = |corners: [(Vec3, [f32; 2]); 3]| (corners.map(|corner| corner.0), Some(corners.map(|corner| corner.1)));
    [face([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)]), face([at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)])]
}

/// Opaque where x is positive.
fn half() -> Mask {
    Mask::new([2, 1], [Wrap::Clamp; 2], |[x, _]| x == 1)
}

fn up(x: f32) -> Ray {
    Ray { origin: Vec3::new(x, 0.0, 0.1), direction: Vec3::Y, t_max: 100.0 }
}

#[test]
fn coincident_faces_with_other_holes_are_not_one() {
    // The second's texture is mirrored: what one leaves open the other closes.
    let flipped = ceiling(1.0, 2.0).map(|(corners, uv)| (corners, uv.map(|uv| uv.map(|[u, v]| [1.0 - u, v]))));
    let both: Vec<Face> = ceiling(1.0, 2.0).into_iter().chain(flipped).collect();
    let place = [(0, DAffine3::IDENTITY)];
    let hits = |faces: &[Face]| {
        let (_, blocked) =
            trace(scene(&[mesh(faces, &half(), &FaceGroup::PLAIN)], &place), &[up(-1.0), up(1.0)], Path::detect());
        blocked
    };
    assert_eq!(hits(&ceiling(1.0, 2.0)), [false, true]);
    assert_eq!(hits(&both), [true, true]);
}

#[test]
fn nothing_counts_beyond_the_hit_of_a_cutout() {
    // Foliage of no transmittance behind it, and opaque geometry behind that.
    let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![1.0] });
    let tree = FaceGroup {
        occludes: false,
        foliage: Some(FaceFoliage::Crossing(OpticalDepth::of_transmittance(0.5))),
        ..FaceGroup::PLAIN
    };
    let whole: Vec<Face> = ceiling(2.0, 1e4).map(|(corners, _)| (corners, None)).into();
    let leaves = Mesh { groups: vec![tree], ..mesh(&whole, &half(), &FaceGroup::PLAIN) };
    let leaves = Arc::new(CrossingMesh::build(&leaves).expect("foliage"));
    for mode in [FoliageMode::Attenuate, FoliageMode::Expected] {
        let ao = |mask: Mask, foliage: bool| {
            let object = FoliageObject::Crossings { mesh: Arc::clone(&leaves), world_from_object: DAffine3::IDENTITY };
            let objects = if foliage { vec![object] } else { Vec::new() };
            let scene = scene(&[mesh(&ceiling(1.0, 1e4), &mask, &FaceGroup::PLAIN)], &[(0, DAffine3::IDENTITY)]);
            gathered(scene.with_foliage(Foliage::build(&objects, mode)), &[sample(Vec3::ZERO, Vec3::Y, 3)], &kernel).0
                [0]
        };
        assert_eq!(ao(Mask::uniform(true), true), ao(Mask::uniform(true), false), "{mode:?}");
        assert!(ao(Mask::uniform(false), true).ao(0) < ao(Mask::uniform(false), false).ao(0), "{mode:?}");
    }
}

#[test]
fn trees_lose_nothing_at_their_holes() {
    let kernel = KernelRates::new(&Kernel::Occlusion { ray_distance_m: 100.0 });
    for mode in [FoliageMode::Attenuate, FoliageMode::Expected] {
        let leaf = |kept: f64| FaceGroup {
            occludes: false,
            foliage: Some(FaceFoliage::Crossing(OpticalDepth::of_transmittance(kept))),
            ..FaceGroup::PLAIN
        };
        let ao = |kept: f64| {
            let mesh = mesh(&ceiling(1.0, 60.0), &half(), &leaf(kept));
            let world_from_object = DAffine3::IDENTITY;
            let objects: Vec<_> = CrossingMesh::build(&mesh)
                .into_iter()
                .map(|mesh| FoliageObject::Crossings { mesh: Arc::new(mesh), world_from_object })
                .collect();
            assert_eq!(objects.is_empty(), kept == 0.0, "what keeps nothing is geometry with holes");
            let scene = scene(&[mesh], &[(0, world_from_object)]).with_foliage(Foliage::build(&objects, mode));
            assert_eq!(scene.has_cutouts(), kept == 0.0);
            let samples: Vec<_> = (0..64).map(|seed| sample(Vec3::ZERO, Vec3::Y, seed)).collect();
            let sums = gathered(scene, &samples, &kernel).0;
            assert!(sums.iter().all(|sum| sum.back_faces == 0), "leaves have no back");
            sums.iter().map(|sum| sum.ao(0)).sum::<f64>() / 64.0
        };
        // Half of the sky is behind the leaf; rays that pass it by are at the horizon.
        for (kept, expected) in [(0.0, 0.5), (0.25, 0.625), (1.0, 1.0)] {
            assert!((ao(kept) - expected).abs() < 5e-3, "{mode:?} {kept}: {}", ao(kept));
        }
    }
}

#[test]
fn what_has_holes_is_no_open_sky() {
    let above = |y: f32| {
        let scene = scene(&[mesh(&ceiling(y, 1.0), &half(), &FaceGroup::PLAIN)], &[(0, DAffine3::IDENTITY)]);
        assert!(!scene.is_empty() && scene.has_cutouts());
        is_open_above(&scene, Vec3::ZERO, Vec3::Y, 100.0)
    };
    assert!(!above(5.0) && above(-5.0) && above(500.0));
    let whole: Vec<Face> = ceiling(1.0, 1.0).map(|(corners, _)| (corners, None)).into();
    assert!(!scene(&[mesh(&whole, &half(), &FaceGroup::PLAIN)], &[(0, DAffine3::IDENTITY)]).has_cutouts());
}
