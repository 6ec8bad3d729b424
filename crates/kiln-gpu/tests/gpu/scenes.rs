//! Scenes made by code: geometry with what is hard for a tracer, and samples on its surface.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_core::{FaceGroup, Mesh};
use kiln_trace::{MeshBvh, PositionError, Scene, SceneObject, SobolScramble, SurfaceSample};
use std::sync::Arc;

/// Some numbers that look random, from a seed (Steele et al. 2014, SplitMix).
pub(crate) struct Numbers(pub(crate) u64);

impl Numbers {
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / 16_777_216.0
    }

    pub(crate) fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }

    pub(crate) fn scramble(&mut self) -> SobolScramble {
        let bits = self.bits();
        SobolScramble([bits as u32, (bits >> 32) as u32])
    }
}

type Triangle = [Vec3; 3];

/// A mesh whose triangles from `double_sided` on are double-sided.
fn mesh(triangles: &[Triangle], double_sided: usize) -> Mesh {
    let group = |double_sided| FaceGroup { double_sided, ..FaceGroup::PLAIN };
    Mesh {
        positions: triangles.iter().flatten().map(Vec3::to_array).collect(),
        normals: vec![[0.0; 3]; 3 * triangles.len()],
        faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        face_group: (0..triangles.len()).map(|i| u16::from(i >= double_sided)).collect(),
        groups: vec![group(false), group(true)],
        ..Mesh::default()
    }
}

fn quad(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> [Triangle; 2] {
    [[a, b, c], [a, c, d]]
}

/// The faces of a box, seen from outside.
fn cuboid(center: Vec3, half: Vec3) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let [mut n, mut u, mut v] = [Vec3::ZERO; 3];
            n[axis] = sign * half[axis];
            u[(axis + 1) % 3] = sign * half[(axis + 1) % 3];
            v[(axis + 2) % 3] = half[(axis + 2) % 3];
            triangles.extend(quad(center + n - u - v, center + n + u - v, center + n + u + v, center + n - u + v));
        }
    }
    triangles
}

fn inside_out(mut triangles: Vec<Triangle>) -> Vec<Triangle> {
    triangles.iter_mut().for_each(|t| t.swap(1, 2));
    triangles
}

/// A ball of `4 n (n − 1)` faces, seen from outside; neighbours share their corners bit for bit.
fn ball(radius: f32, n: u32) -> Vec<Triangle> {
    use std::f32::consts::{PI, TAU};
    let at = |i: u32, j: u32| {
        let (polar, around) = (PI * i as f32 / n as f32, TAU * (j % (2 * n)) as f32 / (2 * n) as f32);
        let ring = if i.is_multiple_of(n) { 0.0 } else { polar.sin() };
        Vec3::new(ring * around.cos(), ring * around.sin(), polar.cos()) * radius
    };
    let quads = (0..n).flat_map(|i| (0..2 * n).map(move |j| (i, j)));
    let faces = quads.flat_map(|(i, j)| quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)));
    faces.filter(|[a, b, c]| a != b && b != c && c != a).collect()
}

/// A square grid with heights, seen from above.
fn terrain(n: u32, size: f32, height: impl Fn(f32, f32) -> f32) -> Vec<Triangle> {
    let at = |i: u32, j: u32| {
        let (x, y) = (size * (i as f32 / n as f32 - 0.5), size * (j as f32 / n as f32 - 0.5));
        Vec3::new(x, y, height(x, y))
    };
    let cells = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    cells.flat_map(|(i, j)| quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1))).collect()
}

fn placed(mesh: usize, scale: DVec3, rotation: DQuat, translation: DVec3) -> SceneObject {
    SceneObject { mesh, world_from_object: DAffine3::from_scale_rotation_translation(scale, rotation, translation) }
}

fn still(mesh: usize) -> SceneObject {
    SceneObject { mesh, world_from_object: DAffine3::IDENTITY }
}

/// A scene, with what is needed to put samples on it.
pub(crate) struct TestScene {
    pub(crate) name: &'static str,
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) objects: Vec<SceneObject>,
}

impl TestScene {
    pub(crate) fn new(name: &'static str, triangles: &[Triangle], objects: Vec<SceneObject>) -> Self {
        Self { name, meshes: vec![mesh(triangles, usize::MAX)], objects }
    }

    pub(crate) fn build(&self) -> Arc<Scene> {
        let meshes = self.meshes.iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
        Arc::new(Scene::build(meshes, &self.objects))
    }

    /// Runs of 8 samples on faces, in the order of the faces, as a bake gives them. Origins are off the surface as the
    /// bake puts them.
    pub(crate) fn samples(&self, count: usize, rays_per_sample: u32) -> Vec<SurfaceSample> {
        let mut numbers = Numbers(7);
        let faces: Vec<(usize, usize)> = self
            .objects
            .iter()
            .enumerate()
            .flat_map(|(object, o)| (0..self.meshes[o.mesh].faces.len()).map(move |face| (object, face)))
            .collect();
        (0..count)
            .map(|i| {
                if faces.is_empty() {
                    return free_sample(numbers.point(), Vec3::Z, numbers.scramble());
                }
                let runs = count.div_ceil(8);
                let (object, face) = faces[(i / 8) * faces.len() / runs];
                let first_index = rays_per_sample * (numbers.bits() % 64) as u32;
                SurfaceSample { first_index, ..self.surface_sample(object, face, &mut numbers) }
            })
            .collect()
    }

    fn surface_sample(&self, object: usize, face: usize, numbers: &mut Numbers) -> SurfaceSample {
        let object = &self.objects[object];
        let transform = object.world_from_object;
        let [a, b, c] = self.meshes[object.mesh].corners(face).map(Vec3::as_dvec3);
        let (mut s, mut r) = (f64::from(numbers.unit()), f64::from(numbers.unit()));
        if s + r > 1.0 {
            (s, r) = (1.0 - s, 1.0 - r);
        }
        let p = transform.transform_point3(a + (b - a) * s + (c - a) * r);
        let normal = transform.matrix3.inverse().transpose() * (b - a).cross(c - a);
        let geometric = normal.normalize_or(DVec3::Z);
        let extent = (b - a).length().max((c - a).length()).max((c - b).length());
        let off = PositionError::new(&transform).bound(p, extent).dot(geometric.abs());
        // A shading normal that leans, as on a smooth mesh.
        let lean = geometric + numbers.point().as_dvec3() * 0.2;
        SurfaceSample {
            origin: (p + geometric * off).as_vec3(),
            normal: lean.normalize().as_vec3(),
            geometric: geometric.as_vec3(),
            scramble: numbers.scramble(),
            first_index: 0,
        }
    }
}

/// A sample in the air.
pub(crate) fn free_sample(origin: Vec3, normal: Vec3, scramble: SobolScramble) -> SurfaceSample {
    SurfaceSample { origin, normal, geometric: normal, scramble, first_index: 0 }
}

fn soup(count: usize, size: f32, numbers: &mut Numbers) -> Vec<Triangle> {
    let triangle = |_| {
        let center = numbers.point();
        [0; 3].map(|_| center + numbers.point() * size)
    };
    (0..count).map(triangle).collect()
}

/// Random triangles in instances: turned, mirrored, unevenly scaled, far from the origin.
fn instanced_soup() -> TestScene {
    let mut numbers = Numbers(1);
    let meshes = vec![mesh(&soup(400, 0.2, &mut numbers), usize::MAX), mesh(&soup(60, 0.5, &mut numbers), 30)];
    let objects = (0..12)
        .map(|i| {
            let scale = numbers.point().as_dvec3() * 0.5 + DVec3::splat(1.0);
            let mirror = DVec3::new(if i % 2 == 0 { -1.0 } else { 1.0 }, 1.0, if i % 3 == 0 { -1.0 } else { 1.0 });
            let [x, y, z] = (numbers.point().as_dvec3() * 3.0).to_array();
            let rotation = DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y) * DQuat::from_rotation_z(z);
            placed(i % 2, scale * mirror, rotation, numbers.point().as_dvec3() * 4.0 + DVec3::new(500.0, -300.0, 10.0))
        })
        .collect();
    TestScene { name: "instanced soup", meshes, objects }
}

fn stairs() -> Vec<Triangle> {
    let mut triangles = quad(
        Vec3::new(-4.0, -4.0, 0.0),
        Vec3::new(8.0, -4.0, 0.0),
        Vec3::new(8.0, 4.0, 0.0),
        Vec3::new(-4.0, 4.0, 0.0),
    )
    .to_vec();
    for i in 0..10 {
        let height = 0.18 * (i + 1) as f32;
        let center = Vec3::new(0.3 * i as f32, 0.0, height / 2.0);
        triangles.extend(cuboid(center, Vec3::new(0.15, 1.0, height / 2.0)));
    }
    triangles
}

/// Sheets that are seen from either side, above a floor; every other one of two coincident faces instead.
fn sheets() -> TestScene {
    let floor = quad(
        Vec3::new(-5.0, -5.0, 0.0),
        Vec3::new(5.0, -5.0, 0.0),
        Vec3::new(5.0, 5.0, 0.0),
        Vec3::new(-5.0, 5.0, 0.0),
    );
    let (mut single, mut double) = (floor.to_vec(), Vec::new());
    for i in 0..20 {
        let x = i as f32 * 0.45 - 4.5;
        let corner = |y: f32, z: f32| Vec3::new(x + 0.3 * z, y, z);
        let sheet = quad(corner(-2.0, 0.1), corner(2.0, 0.1), corner(2.0, 1.5), corner(-2.0, 1.5));
        if i % 2 == 0 {
            double.extend(sheet);
        } else {
            single.extend(sheet);
            single.extend(inside_out(sheet.to_vec()));
        }
    }
    let first_double = single.len();
    single.extend(double);
    TestScene { name: "sheets", meshes: vec![mesh(&single, first_double)], objects: vec![still(0)] }
}

fn crates() -> TestScene {
    let mut numbers = Numbers(3);
    let unit = cuboid(Vec3::ZERO, Vec3::splat(0.5));
    let floor = cuboid(Vec3::new(0.0, 0.0, -0.05), Vec3::new(6.0, 6.0, 0.05));
    let mut objects = vec![still(1)];
    for i in 0..60 {
        let turn = DQuat::from_rotation_z(f64::from(numbers.unit()));
        let at = DVec3::new(f64::from(numbers.unit()) * 5.0 - 2.5, f64::from(numbers.unit()) * 5.0 - 2.5, 0.4);
        objects.push(placed(0, DVec3::splat(0.6 + 0.01 * f64::from(i)), turn, at));
    }
    TestScene {
        name: "crates that interpenetrate",
        meshes: vec![mesh(&unit, usize::MAX), mesh(&floor, usize::MAX)],
        objects,
    }
}

/// Boxes that share faces exactly, in one mesh (which makes them one) and as instances (which the tie rule decides).
fn coincident() -> TestScene {
    let unit = cuboid(Vec3::ZERO, Vec3::splat(0.5));
    let mut pair = unit.clone();
    pair.extend(inside_out(unit.clone()));
    let at = |mesh: usize, x: f64, y: f64| placed(mesh, DVec3::ONE, DQuat::IDENTITY, DVec3::new(x, y, 0.0));
    let mut objects: Vec<SceneObject> = (0..9).map(|i| at(0, f64::from(i % 3), f64::from(i / 3))).collect();
    objects.extend([at(1, -2.0, 0.0), at(0, -2.0, 0.0), at(1, -2.0, 0.0), at(1, -1.0, 1.0)]);
    TestScene { name: "coincident faces", meshes: vec![mesh(&unit, usize::MAX), mesh(&pair, usize::MAX)], objects }
}

/// A closed room with a crate in it.
fn furnished_room() -> Vec<Triangle> {
    let mut triangles = inside_out(cuboid(Vec3::new(1.0, 2.0, 1.5), Vec3::new(2.0, 3.0, 1.5)));
    triangles.extend(cuboid(Vec3::new(0.3, 1.0, 0.4), Vec3::new(0.4, 0.3, 0.4)));
    triangles
}

fn hills(n: u32) -> Vec<Triangle> {
    terrain(n, 60.0, |x, y| (0.3 * x).sin() * (0.23 * y).cos() * 3.0 + 0.4 * (1.7 * x + y).sin())
}

/// Every scene of the contract.
pub(crate) fn all() -> Vec<TestScene> {
    vec![
        TestScene::new("closed room", &furnished_room(), vec![still(0)]),
        TestScene::new("ball from outside", &ball(2.0, 24), vec![still(0)]),
        TestScene::new("ball from inside", &inside_out(ball(2.0, 24)), vec![still(0)]),
        TestScene::new("stairs", &stairs(), vec![still(0)]),
        instanced_soup(),
        sheets(),
        crates(),
        coincident(),
        TestScene::new("terrain", &hills(48), vec![still(0)]),
        TestScene::new("nothing", &[], vec![]),
    ]
}

/// Instances that strain a transform: far away, tiny and huge, flat and long, mirrored; and coincident with themselves.
pub(crate) fn strained() -> TestScene {
    let mut numbers = Numbers(21);
    let meshes = vec![mesh(&soup(300, 0.3, &mut numbers), usize::MAX), mesh(&hills(20), usize::MAX)];
    let far = DVec3::new(1900.0, -2500.0, 300.0);
    let scales = [
        DVec3::splat(1.0),
        DVec3::splat(0.02),
        DVec3::splat(40.0),
        DVec3::new(30.0, 0.5, 1.0),
        DVec3::new(-1.0, 1.0, 0.03),
        DVec3::new(-2.0, -0.7, -1.3),
    ];
    let objects = scales.iter().enumerate().flat_map(|(i, scale)| {
        let [x, y, z] = (numbers.point().as_dvec3() * 3.0).to_array();
        let turn = DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y) * DQuat::from_rotation_z(z);
        let object = placed(usize::from(i % 3 == 2), *scale, turn, far + numbers.point().as_dvec3() * 5.0);
        [object.clone(), object]
    });
    TestScene { name: "strained instances", objects: objects.collect(), meshes }
}

/// From 26 triangles to half a million.
pub(crate) fn for_benchmarks() -> Vec<TestScene> {
    vec![
        TestScene::new("closed room", &furnished_room(), vec![still(0)]),
        crates(),
        instanced_soup(),
        TestScene::new("hollow ball", &inside_out(ball(2.0, 200)), vec![still(0)]),
        TestScene::new("terrain", &hills(512), vec![still(0)]),
    ]
}

/// Faces that are given, single-sided.
pub(crate) fn of_faces(name: &'static str, positions: Vec<[f32; 3]>, faces: Vec<[u32; 3]>) -> TestScene {
    let mut whole = mesh(&[], usize::MAX);
    whole.normals = vec![[0.0; 3]; positions.len()];
    whole.face_group = vec![0; faces.len()];
    (whole.positions, whole.faces) = (positions, faces);
    TestScene { name, meshes: vec![whole], objects: vec![still(0)] }
}

/// Inward faces of a ball of the given radius.
pub(crate) fn hollow_ball(radius: f32, n: u32) -> TestScene {
    TestScene::new("hollow ball", &inside_out(ball(radius, n)), vec![still(0)])
}

/// A square in the plane through `center` that `u` and `v` span; its front is on the side of `u × v`.
pub(crate) fn square(name: &'static str, center: Vec3, u: Vec3, v: Vec3) -> TestScene {
    TestScene::new(name, &quad(center - u - v, center + u - v, center + u + v, center - u + v), vec![still(0)])
}

/// Instances in one place of a triangle that faces up (0) or down (1).
pub(crate) fn mirrored_pair(order: [usize; 3]) -> TestScene {
    let [up, down] = [[Vec3::ZERO, Vec3::X, Vec3::Y], [Vec3::ZERO, Vec3::Y, Vec3::X]];
    let meshes = [up, down].map(|triangle| mesh(&[triangle], usize::MAX)).to_vec();
    TestScene { name: "mirrored pair", meshes, objects: order.map(still).to_vec() }
}
