//! Rays through foliage: against closed forms, against brute force, and by law.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use kiln_core::{
    Bounds, Digest, FaceGroup, Fog, Foliage as FaceFoliage, FoliageMode, Kernel, Mesh, OpticalDepth, TaskKind,
};
use kiln_trace::{
    CosineSums, CpuTracer, CrossingMesh, Foliage, FoliageObject, FoliageView, KernelRates, MeshBvh, Path, Scene,
    SceneObject, ShrubRecord, SobolScramble, SurfaceSample, Tracer, cosine_direction, is_open_above, orthonormal_basis,
    sobol_point,
};
use proptest::prelude::*;
use std::sync::Arc;

const BOTH: [FoliageMode; 2] = [FoliageMode::Attenuate, FoliageMode::Expected];

fn mesh(triangles: &[[Vec3; 3]], transmittance: Option<f64>) -> Mesh {
    let foliage = transmittance.map(|kept| FaceFoliage::Crossing(OpticalDepth::of_transmittance(kept)));
    let group = FaceGroup { occludes: foliage.is_none(), foliage, ..FaceGroup::PLAIN };
    Mesh {
        positions: triangles.iter().flatten().map(Vec3::to_array).collect(),
        normals: vec![[0.0; 3]; 3 * triangles.len()],
        faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        face_group: vec![0; triangles.len()],
        groups: vec![group],
        ..Mesh::default()
    }
}

/// A wide square across the y axis, seen from below.
fn ceiling(y: f32, half: f32) -> [[Vec3; 3]; 2] {
    let at = |x: f32, z: f32| Vec3::new(x * half, y, z * half);
    [[at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)], [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]]
}

fn crossings(triangles: &[[Vec3; 3]], transmittance: f64, world_from_object: DAffine3) -> FoliageObject {
    let mesh = CrossingMesh::build(&mesh(triangles, Some(transmittance))).expect("foliage");
    FoliageObject::Crossings { mesh: Arc::new(mesh), world_from_object }
}

fn fog(min: DVec3, max: DVec3, density_per_m: f64, world_from_object: DAffine3) -> FoliageObject {
    FoliageObject::Fog { fog: Fog { bounds: Bounds { min, max }, density_per_m }, world_from_object }
}

/// Fog between two heights, and so wide that no record has room for it.
fn slab(bottom: f64, top: f64, density_per_m: f64) -> FoliageObject {
    wide_slab(20_000.0, bottom, top, density_per_m)
}

fn wide_slab(far: f64, bottom: f64, top: f64, density_per_m: f64) -> FoliageObject {
    fog(DVec3::new(-far, bottom, -far), DVec3::new(far, top, far), density_per_m, DAffine3::IDENTITY)
}

fn scene(opaque: &[[Vec3; 3]], foliage: &[FoliageObject], mode: FoliageMode) -> Scene {
    let objects = [SceneObject { mesh: 0, world_from_object: DAffine3::IDENTITY }];
    Scene::build(vec![Arc::new(MeshBvh::build(&mesh(opaque, None)))], &objects)
        .with_foliage(Foliage::build(foliage, mode))
}

fn sample(origin: Vec3, normal: Vec3, seed: u32) -> SurfaceSample {
    let scramble = SobolScramble([seed.wrapping_mul(0x9e37_79b9), seed ^ 0x51ed_270b]);
    SurfaceSample { origin, normal, geometric: normal, scramble, first_index: 0 }
}

fn gather(scene: Scene, sample: SurfaceSample, kernel: &KernelRates, rays: u32, path: Path) -> CosineSums {
    let mut sums = [CosineSums::default()];
    let tracer = CpuTracer::with_path(Arc::new(scene), path);
    tracer.gather_cosine(&[sample], kernel, rays, &mut sums).expect("the processor traces");
    sums[0]
}

/// Mean over the cosine-weighted hemisphere of a function of the cosine.
fn over_hemisphere(value: impl Fn(f64) -> f64) -> f64 {
    let steps = 20_000;
    (0..steps).map(|i| ((f64::from(i) + 0.5) / f64::from(steps)).sqrt()).map(value).sum::<f64>() / f64::from(steps)
}

#[test]
fn a_slab_of_fog_is_as_its_closed_form_says() {
    let (thickness, density, height) = (1.0, 0.3, 3.0);
    for (half_distance, with_ceiling) in [(2.0, false), (300.0, false), (2.0, true), (300.0, true)] {
        for mode in BOTH {
            let k = std::f64::consts::LN_2 / half_distance;
            let opaque = if with_ceiling { ceiling(height as f32, 2e4).to_vec() } else { Vec::new() };
            let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![half_distance] });
            let reach = f64::from(kernel.t_max);
            let expected = over_hemisphere(|cosine| {
                let in_fog = (thickness / cosine).min(reach);
                let end = if with_ceiling && height / cosine < reach { height / cosine } else { f64::INFINITY };
                let kept = (-density * in_fog).exp();
                match mode {
                    FoliageMode::Attenuate => kept * (1.0 - (-k * end).exp()),
                    _ => {
                        k / (k + density) * (1.0 - (-(k + density) * in_fog).exp())
                            + kept * ((-k * in_fog).exp() - (-k * end).exp())
                    }
                }
            });
            for (far, in_records) in [(20_000.0, 0), (1000.0, 1)] {
                let scene = scene(&opaque, &[wide_slab(far, 0.0, thickness, density)], mode);
                assert_eq!(scene.foliage().expect("fog").packed_shrubs(), in_records);
                let found = gather(scene, sample(Vec3::Y * 1e-4, Vec3::Y, 3), &kernel, 1 << 14, Path::detect()).ao(0);
                assert!(
                    (found - expected).abs() < 2e-3,
                    "{mode:?} {half_distance} {with_ceiling} {far}: {found} {expected}"
                );
            }
        }
    }
}

#[test]
fn half_transparent_layers_halve_what_is_seen() {
    for mode in BOTH {
        let kernel = KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY });
        for layers in 0..5 {
            let foliage: Vec<_> =
                (0..layers).map(|i| crossings(&ceiling(1.0 + i as f32, 1e5), 0.5, DAffine3::IDENTITY)).collect();
            let sums =
                gather(scene(&[], &foliage, mode), sample(Vec3::ZERO, Vec3::Y, 1), &kernel, 1024, Path::detect());
            let expected = 0.5f64.powi(layers);
            // Rays at the horizon pass by.
            assert!((sums.ao(0) - expected).abs() < 1e-3, "{mode:?} {layers}: {} {expected}", sums.ao(0));
            assert_eq!(sums.back_faces, 0);
        }
    }
}

#[test]
fn what_has_no_density_is_not_there() {
    let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0, 300.0] });
    for mode in BOTH {
        let without = scene(&ceiling(2.0, 3.0), &[], mode);
        let with = scene(
            &ceiling(2.0, 3.0),
            &[slab(0.0, 1.0, 0.0), crossings(&ceiling(1.0, 9.0), 1.0, DAffine3::IDENTITY)],
            mode,
        );
        let [a, b] =
            [without, with].map(|scene| gather(scene, sample(Vec3::ZERO, Vec3::Y, 9), &kernel, 256, Path::detect()));
        for channel in 0..2 {
            assert!(a.values[channel].abs_diff(b.values[channel]) <= 256, "{mode:?}: half a unit a ray at most");
        }
        assert!(scene(&[], &[slab(0.0, 1.0, 0.0)], mode).foliage().is_none());
    }
}

#[test]
fn foliage_is_no_open_sky() {
    let above = |object| is_open_above(&scene(&[], &[object], FoliageMode::Expected), Vec3::ZERO, Vec3::Y, 100.0);
    assert!(!above(slab(1.0, 2.0, 0.1)) && above(slab(-2.0, -1.0, 0.1)) && above(slab(200.0, 201.0, 0.1)));
    assert!(!above(crossings(&ceiling(5.0, 1.0), 0.5, DAffine3::IDENTITY)));
}

/// Whether a sample is open follows from each shrub, not from the box around those that share its leaf.
#[test]
fn shrubs_on_either_side_leave_the_sky_open() {
    let at = |x: f64| fog(DVec3::NEG_ONE, DVec3::ONE, 0.5, DAffine3::from_translation(DVec3::new(x, 3.0, 0.0)));
    let is_open = |objects: &[FoliageObject]| {
        let scene = scene(&[], objects, FoliageMode::Expected);
        assert_eq!(scene.foliage().expect("fog").leaves().count(), 1);
        is_open_above(&scene, Vec3::ZERO, Vec3::Y, 10.0)
    };
    assert!(is_open(&[at(-15.0), at(15.0)]) && is_open(&[at(15.0)]));
    assert!(!is_open(&[at(-15.0), at(15.0), at(9.0)]) && !is_open(&[at(9.0)]));
}

/// Nothing is kept of a ray that has lost all there was, however many crossings there are after it, and whoever takes it.
#[test]
fn what_is_lost_is_lost() {
    let kernel = KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY });
    for (layers, left) in [(16, 1), (17, 1), (18, 0), (20, 0), (40, 0)] {
        let foliage: Vec<_> =
            (0..layers).map(|i| crossings(&ceiling(1.0 + i as f32, 1e5), 0.5, DAffine3::IDENTITY)).collect();
        for rays in [1, 64] {
            let scene = scene(&[], &foliage, FoliageMode::Attenuate);
            let upwards = (0..).map(|seed| sample(Vec3::ZERO, Vec3::Y, seed)).find(|sample| {
                let basis = orthonormal_basis(Vec3::Y);
                (0..rays).all(|index| cosine_direction(sobol_point(index, sample.scramble), Vec3::Y, basis).y > 0.01)
            });
            let found = gather(scene, upwards.expect("no ray at the horizon"), &kernel, rays, Path::detect());
            assert_eq!(found.values[0], left * rays, "{layers} {rays}");
        }
    }
}

#[test]
fn what_is_behind_the_closest_hit_does_not_count() {
    let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0] });
    for mode in BOTH {
        let wide = ceiling(2.0, 1e5);
        let near = gather(
            scene(&wide, &[slab(0.5, 1.0, 0.5)], mode),
            sample(Vec3::ZERO, Vec3::Y, 2),
            &kernel,
            512,
            Path::detect(),
        );
        let both = [slab(0.5, 1.0, 0.5), slab(2.5, 9.0, 0.5), crossings(&ceiling(3.0, 1e4), 0.5, DAffine3::IDENTITY)];
        let far = gather(scene(&wide, &both, mode), sample(Vec3::ZERO, Vec3::Y, 2), &kernel, 512, Path::detect());
        assert_eq!(near, far, "{mode:?}");
    }
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

/// A tree, or a box of fog.
#[derive(Clone, Debug)]
enum Thing {
    Tree(Vec<[Vec3; 3]>, f64, DAffine3),
    Shrub(DVec3, DVec3, f64, DAffine3),
}

fn shrub() -> impl Strategy<Value = Thing> {
    (vec3(), vec3(), 0.01f64..2.0, transform()).prop_map(|(a, b, density, place)| {
        let (a, b) = (a.as_dvec3(), b.as_dvec3());
        Thing::Shrub(a.min(b) - 1e-3, a.max(b) + 1e-3, density, place)
    })
}

fn thing() -> impl Strategy<Value = Thing> {
    let triangles = prop::collection::vec(prop::array::uniform3(vec3()), 1..40);
    let tree = (triangles, 0.05f64..0.95, transform())
        .prop_map(|(triangles, kept, place)| Thing::Tree(triangles, kept, place));
    prop_oneof![tree, shrub()]
}

impl Thing {
    fn object(&self) -> FoliageObject {
        match self {
            Self::Tree(triangles, kept, place) => crossings(triangles, *kept, *place),
            Self::Shrub(min, max, density, place) => fog(*min, *max, *density, *place),
        }
    }

    /// The faces that a ray crosses on its way (where, part kept), and how nearly it misses or meets one.
    fn meet(&self, origin: DVec3, direction: DVec3, end: f64, points: &mut Vec<[f64; 2]>) -> f64 {
        let mut margin = f64::INFINITY;
        match self {
            Self::Tree(triangles, kept, place) => {
                for triangle in triangles {
                    let [a, b, c] = triangle.map(|p| place.transform_point3(p.as_dvec3()));
                    let normal = (b - a).cross(c - a);
                    let t = normal.dot(a - origin) / normal.dot(direction);
                    let (p, area) = (origin + direction * t, normal.length_squared());
                    let inside = [(b, c), (c, a), (a, b)].map(|(q, r)| (r - q).cross(p - q).dot(normal) / area);
                    let inside = inside.into_iter().fold(f64::INFINITY, f64::min);
                    if t > -1e-3 && t < end + 1e-3 {
                        margin =
                            margin.min(inside.abs()).min(if inside > 0.0 { t.abs().min((t - end).abs()) } else { 1.0 });
                    }
                    if inside > 0.0 && t > 0.0 && t < end {
                        points.push([t, *kept]);
                    }
                }
            }
            Self::Shrub(..) => {}
        }
        margin
    }
}

/// A box of fog as it is traced.
struct Traced {
    min: DVec3,
    max: DVec3,
    density_per_m: f64,
    object_from_world: DAffine3,
}

impl Traced {
    fn all(foliage: &Foliage) -> Vec<Self> {
        let density = |rate: i64| rate as f64 / 16_777_216.0 * std::f64::consts::LN_2;
        let boxes = |leaf: FoliageView<'_>| match leaf {
            FoliageView::Crossings { .. } => Vec::new(),
            FoliageView::Fog { min, max, rate, place } => {
                let [x, y, z] = place.object_from_world.map(|row| row.map(f64::from));
                let column = |i: usize| DVec3::new(x[i], y[i], z[i]);
                let object_from_world =
                    DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) };
                let (min, max) = (min.as_dvec3(), max.as_dvec3());
                vec![Self { min, max, density_per_m: density(rate), object_from_world }]
            }
            FoliageView::Shrubs(group) => {
                let traced = |record: ShrubRecord| {
                    let fog = record.unpacked(group.base());
                    let turn = fog.axes.as_dmat3().transpose();
                    let half = fog.half.as_dvec3();
                    let object_from_world = DAffine3 { matrix3: turn, translation: -(turn * fog.center.as_dvec3()) };
                    Self { min: -half, max: half, density_per_m: density(fog.rate), object_from_world }
                };
                group.records().map(traced).collect()
            }
        };
        foliage.leaves().flat_map(boxes).collect()
    }

    /// The part of a ray that is in it, and the density.
    fn meet(&self, origin: DVec3, direction: DVec3, end: f64) -> Option<[f64; 3]> {
        let inverse = &self.object_from_world;
        let (o, d) = (inverse.transform_point3(origin), inverse.transform_vector3(direction));
        let (low, high) = ((self.min - o) / d, (self.max - o) / d);
        let near = low.min(high).max_element().max(0.0);
        let far = low.max(high).min_element().min(end);
        (near < far).then_some([near, far, self.density_per_m])
    }
}

/// The value of a ray, by adding up stretches between all that happens in f64.
fn value(stretches: &[[f64; 3]], points: &[[f64; 2]], d: f64, end: Option<f64>, reach: f64, mode: FoliageMode) -> f64 {
    let kept_until = |t: f64| {
        let fog: f64 = stretches.iter().map(|[near, far, density]| (t.min(*far) - near).max(0.0) * density).sum();
        (-fog).exp() * points.iter().filter(|[at, _]| *at < t).map(|[_, kept]| kept).product::<f64>()
    };
    let rho = |t: f64| 1.0 - (-t / d).exp2();
    let last = end.unwrap_or(reach);
    if mode == FoliageMode::Attenuate {
        return kept_until(last) * end.map_or(1.0, rho);
    }
    let mut bounds: Vec<f64> = stretches
        .iter()
        .flat_map(|[near, far, _]| [*near, *far])
        .chain(points.iter().map(|[t, _]| *t))
        .chain([0.0, last])
        .collect();
    bounds.sort_by(f64::total_cmp);
    let mut sum = kept_until(last) * end.map_or(1.0 - rho(last), |_| 0.0);
    for pair in bounds.windows(2) {
        // Simpson's rule on 16 parts of each stretch.
        let (a, b) = (pair[0], pair[1]);
        let f = |x: f64| {
            kept_until(a + (b - a) * x.clamp(1e-12, 1.0)) * std::f64::consts::LN_2 / d * (-(a + (b - a) * x) / d).exp2()
        };
        for i in 0..16 {
            let (x, h) = (f64::from(i) / 16.0, 1.0 / 16.0);
            sum += (b - a) * h / 6.0 * (f(x) + 4.0 * f(x + 0.5 * h) + f(x + h));
        }
    }
    sum
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn sums_match_brute_force(
        things in prop::collection::vec(thing(), 1..6), soup in prop::collection::vec(prop::array::uniform3(vec3()), 0..12),
        origin in vec3(), normal in vec3(), seed in any::<u32>(), expects in any::<bool>(),
    ) {
        prop_assume!(normal.length() > 0.1);
        let mode = BOTH[usize::from(expects)];
        let sample = sample(origin * 2.0, normal.normalize(), seed);
        let (d, rays) = (1.5, 32);
        let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![d] });
        let objects: Vec<_> = things.iter().map(Thing::object).collect();
        let scene = scene(&soup, &objects, mode);
        let fogs = scene.foliage().map(Traced::all).unwrap_or_default();
        let shrubs = things.iter().filter(|thing| matches!(thing, Thing::Shrub(..))).count();
        prop_assert_eq!(fogs.len(), shrubs);
        let tracer = CpuTracer::new(Arc::new(scene));
        let mut sums = [CosineSums::default()];
        tracer.gather_cosine(&[sample], &kernel, rays, &mut sums).unwrap();

        let basis = orthonormal_basis(sample.normal);
        let (mut expected, mut unsure, mut counted) = (0.0, 0u32, 0);
        for index in 0..rays {
            let direction = cosine_direction(sobol_point(index, sample.scramble), sample.normal, basis);
            if direction.dot(sample.geometric) <= 0.0 {
                continue;
            }
            counted += 1;
            let hit = tracer.closest_hit(&kiln_trace::Ray { origin: sample.origin, direction, t_max: kernel.t_max });
            let end = hit.is_hit().then(|| f64::from(hit.t));
            let (mut stretches, mut points) = (Vec::new(), Vec::new());
            let (o, w) = (sample.origin.as_dvec3(), direction.as_dvec3());
            let reach = f64::from(kernel.t_max);
            let last = end.unwrap_or(reach);
            let margin = things.iter().map(|thing| thing.meet(o, w, last, &mut points)).fold(f64::INFINITY, f64::min);
            stretches.extend(fogs.iter().filter_map(|fog| fog.meet(o, w, last)));
            unsure += u32::from(margin < 1e-3);
            expected += value(&stretches, &points, d, end, reach, mode);
        }
        prop_assert_eq!(sums[0].rays, counted);
        let found = f64::from(sums[0].values[0]) / 65536.0;
        let bound = 2e-4 * f64::from(rays) + f64::from(unsure);
        prop_assert!((found - expected).abs() < bound, "{:?}: {} {} of {} rays, {} unsure", mode, found, expected, counted, unsure);
    }

    /// Neither the order of things nor the processor's instructions change a bit, nor how rays are put together.
    #[test]
    fn order_and_path_change_no_bit(
        things in prop::collection::vec(thing(), 1..24), thicket in prop::collection::vec(shrub(), 0..150), shift in prop::sample::select(vec![0.0, 40.0, 3000.0]),
        origin in vec3(), normal in vec3(), seed in any::<u32>(), expects in any::<bool>(),
    ) {
        prop_assume!(normal.length() > 0.1);
        let mode = BOTH[usize::from(expects)];
        let kernel = KernelRates { t_max: 1e4, ..KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![0.7, 5.0] }) };
        let mut objects: Vec<_> = things.iter().chain(&thicket).map(Thing::object).collect();
        // Near it; and far away, where rays are rounded by more than boxes have of slack.
        let normal = normal.normalize();
        let sample = sample(origin * 2.0 - normal * shift, normal, seed);
        let first = gather(scene(&[], &objects, mode), sample, &kernel, 128, Path::Portable);
        prop_assert_eq!(gather(scene(&[], &objects, mode), sample, &kernel, 128, Path::detect()), first);
        objects.reverse();
        prop_assert_eq!(gather(scene(&[], &objects, mode), sample, &kernel, 128, Path::detect()), first);
        let mut parts = CosineSums::default();
        for start in (0..128).step_by(4) {
            let part = gather(scene(&[], &objects, mode), SurfaceSample { first_index: start, ..sample }, &kernel, 4, Path::detect());
            parts.rays += part.rays;
            parts.values.iter_mut().zip(part.values).for_each(|(sum, part)| *sum += part);
        }
        prop_assert_eq!(parts, first);
    }
}

/// Fails when rays lose something else in foliage: raise the kernel revisions of `TaskKind::Trace`, `Volume`, `Points` and `Regions`,
/// then this digest.
#[test]
fn output_is_what_the_kernel_revisions_say() {
    let place = |i: f64| {
        let turn = DQuat::from_rotation_y(i) * DQuat::from_rotation_x(0.2 * i.sin());
        let scale = DVec3::new(0.8, 1.0 + 0.1 * i.cos(), 0.9);
        DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(3.0 * (1.7 * i).sin(), 0.5, 3.0 * i.cos()))
    };
    let mut objects: Vec<FoliageObject> =
        (0..40).map(|i| fog(DVec3::splat(-0.7), DVec3::splat(0.7), 0.4, place(f64::from(i)))).collect();
    objects.extend([slab(2.0, 2.5, 0.2), crossings(&ceiling(1.5, 2.0), 0.5, place(0.5))]);
    let kernel = KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![0.7, 30.0] });
    let sums: Vec<u8> = BOTH
        .iter()
        .flat_map(|mode| {
            let scene = scene(&ceiling(4.0, 3.0), &objects, *mode);
            let sums = gather(scene, sample(Vec3::new(0.3, 0.0, 0.4), Vec3::Y, 5), &kernel, 512, Path::Portable);
            sums.values.into_iter().chain([sums.rays]).flat_map(u32::to_le_bytes).collect::<Vec<u8>>()
        })
        .collect();
    let revs = [TaskKind::Trace, TaskKind::Volume, TaskKind::Points, TaskKind::Regions].map(TaskKind::kernel_rev);
    assert_eq!((revs, Digest::of(&sums).short().as_str()), ([9, 3, 2, 2], "c7c12589"));
}
