//! Rays through foliage on the GPU: against the processor's tracer, against closed forms, and by law.

mod closed_forms;
mod laws;
mod processor;

use crate::scenes::{self, Numbers, TestScene};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use kiln_core::{Bounds, FaceGroup, Fog, Foliage as FaceFoliage, FoliageMode, Kernel, Mesh, OpticalDepth};
use kiln_gpu::{GpuDevice, GpuTracer};
use kiln_trace::{
    CosineSums, CpuTracer, CrossingMesh, Foliage, FoliageObject, Hit, KernelRates, MeshBvh, Ray, Scene, SpherePoint,
    SphereSums, SurfaceSample, Tracer, cosine_direction, orthonormal_basis, sobol_point,
};
use std::sync::Arc;

const BOTH: [FoliageMode; 2] = [FoliageMode::Attenuate, FoliageMode::Expected];

type Triangle = [Vec3; 3];

fn crossing_mesh(triangles: &[Triangle], kept: f64) -> Arc<CrossingMesh> {
    let foliage = Some(FaceFoliage::Crossing(OpticalDepth::of_transmittance(kept)));
    let mesh = Mesh {
        positions: triangles.iter().flatten().map(Vec3::to_array).collect(),
        normals: vec![[0.0; 3]; 3 * triangles.len()],
        faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        face_group: vec![0; triangles.len()],
        groups: vec![FaceGroup { occludes: false, foliage, ..FaceGroup::PLAIN }],
        ..Mesh::default()
    };
    Arc::new(CrossingMesh::build(&mesh).expect("its faces are foliage"))
}

fn placed(mesh: &Arc<CrossingMesh>, world_from_object: DAffine3) -> FoliageObject {
    FoliageObject::Crossings { mesh: Arc::clone(mesh), world_from_object }
}

fn fog(min: DVec3, max: DVec3, density_per_m: f64, world_from_object: DAffine3) -> FoliageObject {
    FoliageObject::Fog { fog: Fog { bounds: Bounds { min, max }, density_per_m }, world_from_object }
}

/// Fog without end between two heights.
fn slab(bottom: f64, top: f64, density_per_m: f64) -> FoliageObject {
    let far = 20_000.0;
    fog(DVec3::new(-far, bottom, -far), DVec3::new(far, top, far), density_per_m, DAffine3::IDENTITY)
}

/// A wide square across the y axis.
fn ceiling(y: f32, half: f32) -> [Triangle; 2] {
    let at = |x: f32, z: f32| Vec3::new(x * half, y, z * half);
    [[at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)], [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]]
}

fn up(y: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::Y * y)
}

fn scene(opaque: &TestScene, foliage: &[FoliageObject], mode: FoliageMode) -> Arc<Scene> {
    let meshes = opaque.meshes.iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
    Arc::new(Scene::build(meshes, &opaque.objects).with_foliage(Foliage::build(foliage, mode)))
}

fn nothing() -> TestScene {
    TestScene::new("nothing", &[], Vec::new())
}

fn wall(y: f32, half: f32) -> TestScene {
    // Its front is seen from below.
    scenes::square("wall", Vec3::Y * y, Vec3::X * half, Vec3::Z * half)
}

fn on(device: Arc<GpuDevice>, scene: &Scene) -> GpuTracer {
    GpuTracer::new(device, scene).expect("the scene fits")
}

fn gather(tracer: &dyn Tracer, samples: &[SurfaceSample], kernel: &KernelRates, rays: u32) -> Vec<CosineSums> {
    let mut sums = vec![CosineSums::default(); samples.len()];
    tracer.gather_cosine(samples, kernel, rays, &mut sums).expect("it traces");
    sums
}

fn obscurance(half_distances_m: &[f64]) -> KernelRates {
    KernelRates::new(&Kernel::Obscurance { half_distances_m: half_distances_m.to_vec() })
}

fn occlusion() -> KernelRates {
    KernelRates::new(&Kernel::Occlusion { ray_distance_m: f64::INFINITY })
}

/// Samples at the origin of one ray each, all about +y.
fn upwards(count: usize) -> Vec<SurfaceSample> {
    let mut numbers = Numbers(41);
    (0..count).map(|_| scenes::free_sample(Vec3::ZERO, Vec3::Y, numbers.scramble())).collect()
}

/// The direction of the one ray of a sample.
fn direction_of(sample: &SurfaceSample) -> Vec3 {
    cosine_direction(sobol_point(sample.first_index, sample.scramble), sample.normal, orthonormal_basis(sample.normal))
}

fn transform(numbers: &mut Numbers) -> DAffine3 {
    let scale = numbers.point().as_dvec3().map(|x| x.signum() * (0.3 + 1.7 * x.abs()));
    let [x, y, z] = (numbers.point().as_dvec3() * 3.0).to_array();
    let turn = DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y) * DQuat::from_rotation_z(z);
    DAffine3::from_scale_rotation_translation(scale, turn, numbers.point().as_dvec3() * 2.0)
}

fn soup(numbers: &mut Numbers, count: usize) -> Vec<Triangle> {
    (0..count).map(|_| [0; 3].map(|_| numbers.point())).collect()
}

/// Trees of which several are instances of one mesh, and boxes of fog that overlap, all turned, mirrored and scaled unevenly.
fn things(numbers: &mut Numbers, count: usize) -> Vec<FoliageObject> {
    let meshes = [1, 9, 70].map(|faces| {
        let triangles = soup(numbers, faces);
        crossing_mesh(&triangles, 0.2 + 0.75 * f64::from(numbers.unit()))
    });
    let mut thing = |i: usize| {
        let place = transform(numbers);
        if i.is_multiple_of(2) {
            return placed(&meshes[i / 2 % 3], place);
        }
        let (a, b) = (numbers.point().as_dvec3(), numbers.point().as_dvec3());
        fog(a.min(b) - 1e-3, a.max(b) + 1e-3, 0.01 + 2.0 * f64::from(numbers.unit()), place)
    };
    (0..count).map(&mut thing).collect()
}

fn samples(numbers: &mut Numbers, count: usize) -> Vec<SurfaceSample> {
    let mut sample = |_| {
        let (origin, normal) = (numbers.point() * 3.0, numbers.point().normalize_or(Vec3::Y));
        scenes::free_sample(origin, normal, numbers.scramble())
    };
    (0..count).map(&mut sample).collect()
}
