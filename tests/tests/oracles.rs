//! Closed forms on both backends: 64 independent scrambles of 1,024 rays at the points of the oracle scenes.

use glam::DVec3;
use kiln_bake::{ProbePoint, RegionGather, gather_regions, probe};
use kiln_core::{BakeSettings, Bounds, Digest, Kernel, Mesh, Region, RegionSamples, RegionSettings, codec};
use kiln_gpu::{AdapterChoice, GpuDevice, GpuTracer};
use kiln_scene::example::{Oracle, build, oracles};
use kiln_trace::{CpuTracer, KernelRates, MeshBvh, Scene, SceneObject, Tracer};
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

/// Visibility regions of the courtyard: the same points are valid, and see the same.
#[test]
fn both_backends_see_the_same_in_regions() {
    let device = GpuDevice::open(&AdapterChoice::Software).expect("the driver opens");
    let device = device.expect("this test needs a software Vulkan driver, such as mesa-vulkan-drivers");
    let (scene, origin) = scene("courtyard");
    let region = |x: f64| Region {
        id: format!("at {x}"),
        bounds: Bounds { min: DVec3::new(x, -0.5, -6.0) - origin, max: DVec3::new(x + 8.0, 4.0, 6.0) - origin },
        valid: None,
    };
    let gather = RegionGather {
        kernel: KernelRates::new(&Kernel::Obscurance { half_distances_m: HALF_DISTANCES_M.to_vec() }),
        settings: RegionSettings::default(),
        is_adaptive: true,
        seed: 1,
    };
    let found = |tracer: &dyn Tracer| gather_regions(tracer, &[region(-8.0), region(0.0)], &gather).expect("it traces");
    let on_processor = found(&CpuTracer::new(Arc::clone(&scene)));
    let on_card = found(&GpuTracer::new(device, &scene).expect("the scene fits"));
    let (on_processor, on_card) = (by_point(&on_processor), by_point(&on_card));
    // Rays that graze an edge may go by it on one of them, and a point at the limit of back faces be dropped.
    let both: Vec<_> = on_processor.iter().filter_map(|(at, values)| Some((values, on_card.get(at)?))).collect();
    assert!(both.len() > 200 && on_processor.len() + on_card.len() <= 2 * both.len() + 2, "{}", both.len());
    let squares =
        both.iter().flat_map(|(a, b)| a.iter().zip(b.iter())).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
    let rms = (squares / (18 * both.len()) as f64).sqrt();
    assert!(rms < 1e-3, "{rms}");
}

/// What each valid point of each region sees.
fn by_point(samples: &RegionSamples) -> BTreeMap<(usize, usize), &[f32]> {
    let points =
        samples.valid.iter().enumerate().flat_map(|(region, valid)| valid.iter().map(move |index| (region, index)));
    points.zip(samples.values.chunks(18)).collect()
}
