//! Closed forms on both backends: 64 independent scrambles of 1,024 rays at the points of the oracle scenes.

use glam::DVec3;
use kiln_bake::{ProbePoint, probe};
use kiln_core::{BakeSettings, Digest, Kernel, Mesh, codec};
use kiln_gpu::{AdapterChoice, GpuDevice, GpuTracer};
use kiln_scene::example::{Oracle, build, oracles};
use kiln_trace::{CpuTracer, MeshBvh, Scene, SceneObject, Tracer};
use std::{collections::BTreeMap, sync::Arc};

const HALF_DISTANCES_M: [f64; 2] = [2.0, 300.0];
const SCRAMBLES: u32 = 64;
const RAYS: u32 = 1024;

/// Bounds of the specification: of the mean over the scrambles, and of their root mean square.
const MEAN_LIMIT: f64 = 5e-4;
const RMSE_LIMIT: f64 = 3e-3;

fn scene(name: &str) -> (Arc<Scene>, DVec3) {
    let files = BTreeMap::from([("level.glb".to_owned(), build(name).expect("the oracle's scene exists"))]);
    let import = kiln_scene::import("level.glb", &files, None, &BakeSettings::default()).expect("examples import");
    let bvhs: BTreeMap<Digest, Arc<MeshBvh>> = import
        .meshes
        .iter()
        .map(|blob| (blob.digest, codec::decode::<Mesh>("a mesh", &blob.bytes).expect("its own encoding")))
        .map(|(digest, mesh)| (digest, Arc::new(MeshBvh::build(&mesh))))
        .collect();
    let level = import.level;
    let meshes = level.meshes.iter().map(|entry| Arc::clone(&bvhs[&entry.digest])).collect();
    let objects: Vec<SceneObject> = level
        .instances
        .iter()
        .map(|i| SceneObject { mesh: i.mesh as usize, world_from_object: i.world_from_object })
        .collect();
    (Arc::new(Scene::build(meshes, &objects)), level.origin_m)
}

/// Checks a point of an oracle with a tracer; what is wrong is returned, so that all are reported at once.
fn check(oracle: &Oracle, tracer: &dyn Tracer, origin: DVec3) -> Vec<String> {
    let point = ProbePoint {
        position: DVec3::from(oracle.position) - origin,
        normal: DVec3::from(oracle.normal),
        geometric: None,
    };
    let kernel = Kernel::Obscurance { half_distances_m: HALF_DISTANCES_M.to_vec() };
    let mut errors = vec![Vec::new(); HALF_DISTANCES_M.len()];
    for seed in 0..SCRAMBLES {
        let found = probe(tracer, &[point], &kernel, RAYS, seed).expect("the tracer traces");
        for (channel, &half_distance_m) in HALF_DISTANCES_M.iter().enumerate() {
            errors[channel].push(found[0].ao[channel] - (oracle.expected)(half_distance_m));
        }
    }
    let n = f64::from(SCRAMBLES);
    let judge = |(errors, d): (Vec<f64>, f64)| {
        let mean = errors.iter().sum::<f64>() / n;
        let rmse = (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
        let is_good = mean.abs() <= MEAN_LIMIT && rmse <= RMSE_LIMIT;
        (!is_good).then(|| format!("{} at d = {d} m: mean error {mean:.2e}, RMSE {rmse:.2e}", oracle.name))
    };
    errors.into_iter().zip(HALF_DISTANCES_M).filter_map(judge).collect()
}

fn check_all(tracer_of: impl Fn(&Arc<Scene>) -> Box<dyn Tracer>) {
    assert!(oracles().len() >= 8);
    let mut wrong = Vec::new();
    for oracle in oracles() {
        let (scene, origin) = scene(oracle.scene);
        wrong.extend(check(oracle, &*tracer_of(&scene), origin));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_cpu_meets_the_closed_forms() {
    check_all(|scene| Box::new(CpuTracer::new(Arc::clone(scene))));
}

#[test]
fn the_gpu_meets_the_closed_forms() {
    let device = GpuDevice::open(&AdapterChoice::Software).expect("the driver opens");
    let device = device.expect("a software Vulkan driver: apt-get install -y mesa-vulkan-drivers libvulkan1");
    check_all(|scene| Box::new(GpuTracer::new(Arc::clone(&device), scene).expect("the scene fits")));
}
