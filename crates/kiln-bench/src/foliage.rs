//! `kiln bench foliage`: what trees and shrubs do to what stands under them, by each mode, against a reference bake of their real
//! geometry; and what each costs.

use crate::{
    BenchError, Provenance, baked,
    imported::{Imported, import_as},
    lods::mesh,
    scratch::Scratch,
};
use glam::{DAffine3, DVec3, Vec3};
use kiln_bake::{BakedInstance, BakedSurface};
use kiln_core::{FaceGroup, Foliage as FaceFoliage, FoliageMode, Mesh};
use kiln_scene::{BakedPart, BakedScene};
use kiln_trace::{CpuTracer, Hit, MeshBvh, Ray, Scene, SceneObject, Tracer};
use kiln_worker::tasks::foliage_of;
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

/// Options of `kiln bench foliage`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln bench foliage level.glb --only 'terrain*'")]
pub struct Args {
    /// The level; a sidecar beside it says what is foliage
    #[arg(value_name = "LEVEL")]
    level: PathBuf,
    /// What is baked and compared
    #[arg(long, value_name = "GLOB", default_value = "terrain*")]
    only: String,
}

/// Ways to bake.
const MODES: [&str; 3] = ["expected", "attenuate", "geometry"];

/// Runs the measurement and prints its tables.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &Args) -> Result<(), BenchError> {
    println!("{}; foliage over {:?}\n", Provenance::now().sentence(), args.only);
    memory(&args.level)?;
    let scratch = Scratch::new("foliage")?;
    let bake = |name: &str, options: &[&str]| {
        let folder = scratch.path().join(name);
        std::fs::create_dir_all(&folder)
            .map_err(|error| BenchError::File { path: folder.clone(), reason: error.to_string() })?;
        let began = Instant::now();
        let all = [&["--only", args.only.as_str(), "--half-distance", "2,300"], options].concat();
        let baked = baked::bake(&args.level, &all, &folder)?;
        let seconds = began.elapsed().as_secs_f64();
        Ok::<_, BenchError>((baked, seconds))
    };
    let gold = bake("gold", &["--quality", "reference", "--foliage", "geometry"])?.0;
    println!("Over the area that can be seen:\n");
    println!("| foliage | RMSE 2 m | RMSE 300 m | mean error | bake, s | CPU s | Mrays |");
    println!("|---|---|---|---|---|---|---|");
    for mode in MODES {
        let (baked, seconds) = bake(mode, &["--foliage", mode])?;
        let errors = baked::compare(&gold.path, &baked.path)?;
        let (rmse, mean) = (errors.map(|error| error.rmse), errors.map(|error| -error.bias));
        let number = |path: &str| baked.report.pointer(path).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN);
        println!(
            "| {} | {:.4} | {:.4} | {:+.4}, {:+.4} | {seconds:.1} | {:.1} | {:.1} |",
            mode,
            rmse[0],
            rmse[1],
            mean[0],
            mean[1],
            number("/cpu_seconds"),
            number("/rays/traced") / 1e6
        );
    }
    let whole = baked::bake(&args.level, &["--half-distance", "2,300"], scratch.path())?;
    grass(&whole.scene, &gold.scene)
}

/// Points around a shrub or decorator at which the ground is read.
const AROUND: usize = 64;

/// The one number of each shrub and decorator beside the mean of what is baked on the ground within its box. `ground` has
/// values for the ground alone.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn grass(whole: &BakedScene, ground: &BakedScene) -> Result<(), BenchError> {
    let failed = |reason: String| BenchError::Failed { step: "the ground", reason };
    let parts: Vec<&BakedPart> =
        whole.parts.iter().zip(&ground.parts).filter(|(_, g)| g.channels == 2).map(|(part, _)| part).collect();
    let Some(origin) = parts.first().and_then(|part| part.positions.first()).copied() else { return Ok(()) };
    let meshes: Vec<Mesh> = parts.iter().map(|part| mesh(part, origin)).collect();
    let baked: Vec<Option<BakedInstance<'_>>> = parts
        .iter()
        .zip(&meshes)
        .map(|(part, mesh)| Some(BakedInstance { mesh, world_from_object: DAffine3::IDENTITY, values: &part.ao }))
        .collect();
    let surface = BakedSurface::new(2, &baked).map_err(|error| failed(error.to_string()))?;
    let objects: Vec<SceneObject> =
        (0..meshes.len()).map(|mesh| SceneObject { mesh, world_from_object: DAffine3::IDENTITY }).collect();
    let trees = meshes.iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
    let tracer = CpuTracer::new(Arc::new(Scene::build(trees, &objects)));
    let mut pairs: [Vec<[f64; 2]>; 2] = [Vec::new(), Vec::new()];
    for part in whole.parts.iter().filter(|part| has_one_number(part)) {
        let (low, high) = part
            .positions
            .iter()
            .fold((part.positions[0], part.positions[0]), |(low, high), p| (low.min(*p), high.max(*p)));
        let rays: Vec<Ray> = (0..AROUND)
            .map(|index| {
                // A lattice of rank 1 over the box's floor.
                let (u, v) = ((index as f64 + 0.5) / AROUND as f64, (index as f64 * 0.618_033_988_75).fract());
                let from = DVec3::new(low.x + u * (high.x - low.x), high.y + 1.0, low.z + v * (high.z - low.z));
                Ray { origin: (from - origin).as_vec3(), direction: Vec3::NEG_Y, t_max: (high.y - low.y + 3.0) as f32 }
            })
            .collect();
        let mut hits = vec![Hit::MISS; AROUND];
        tracer.trace(&rays, &mut hits).map_err(|error| failed(error.to_string()))?;
        let read: Vec<_> = rays.iter().zip(&hits).filter_map(|(ray, hit)| surface.read(ray, hit)).collect();
        if !read.is_empty() {
            for (channel, pairs) in pairs.iter_mut().enumerate() {
                let mean = read.iter().map(|point| point.ao[channel]).sum::<f64>() / read.len() as f64;
                pairs.push([f64::from(part.ao[channel]), mean]);
            }
        }
    }
    println!("\nNumbers of {} shrubs and decorators beside the ground's AO within their boxes:\n", pairs[0].len());
    println!("| half-distance | RMS difference | mean difference | deviation of the ground's | correlation |");
    println!("|---|---|---|---|---|");
    for (name, pairs) in ["2 m", "300 m"].iter().zip(&pairs) {
        let count = pairs.len().max(1) as f64;
        let mean = |of: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(of).sum::<f64>() / count;
        let means = [mean(&|pair| pair[0]), mean(&|pair| pair[1])];
        let product = |a: usize, b: usize| mean(&|pair| (pair[a] - means[a]) * (pair[b] - means[b]));
        let correlation = product(0, 1) / (product(0, 0) * product(1, 1)).sqrt();
        let rms = mean(&|[scalar, ground]| (scalar - ground).powi(2)).sqrt();
        let deviation = product(1, 1).sqrt();
        println!("| {name} | {rms:.4} | {:+.4} | {deviation:.4} | {correlation:.3} |", means[0] - means[1]);
    }
    Ok(())
}

/// Whether all vertices of a part have the same values.
fn has_one_number(part: &BakedPart) -> bool {
    part.channels == 2 && part.ao.len() > 2 && part.ao.chunks_exact(2).all(|ao| ao == &part.ao[..2])
}

/// What trees of nodes and triangles come to, of foliage as it is traced and as real geometry: of shrubs alone, and with trees.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn memory(path: &Path) -> Result<(), BenchError> {
    let (mut soft, solid) = (import_as(path, FoliageMode::Expected)?, import_as(path, FoliageMode::Geometry)?);
    let Imported { level, meshes } = &mut soft;
    kiln_bake::place_fog(level, |index| meshes.get(index).map(|mesh| &**mesh));
    let is_shrub = |index: usize| soft.level.instances[index].fog.is_some();
    let crosses = |group: &FaceGroup| matches!(group.foliage, Some(FaceFoliage::Crossing(_)));
    let is_tree = |index: usize| soft.meshes[soft.level.instances[index].mesh as usize].groups.iter().any(crosses);
    println!("Memory of trees of boxes over foliage alone:\n");
    println!("| of | foliage as | MiB | bytes each | ratio | built, ms |");
    println!("|---|---|---|---|---|---|");
    let both = |index: usize| is_shrub(index) || is_tree(index);
    for (name, is_in) in [("shrubs", &is_shrub as &dyn Fn(usize) -> bool), ("shrubs and trees", &both)] {
        let count = (0..soft.level.instances.len()).filter(|index| is_in(*index)).count();
        let placed = soft.level.instances.iter().enumerate().filter(|(index, _)| is_in(*index));
        let placed = placed.map(|(_, instance)| (instance, &soft.meshes[instance.mesh as usize]));
        let began = Instant::now();
        let traced = foliage_of(placed, FoliageMode::Expected);
        let traced_secs = began.elapsed().as_secs_f64();
        let traced_bytes = traced.memory_bytes() as f64;
        let instanced = Instanced::build(&solid, is_in);
        let row = |what: &str, bytes: f64, secs: Option<f64>| {
            let (mib, each) = (bytes / f64::from(1 << 20), bytes / count.max(1) as f64);
            let ratio = bytes / traced_bytes.max(1.0);
            let built = secs.map(|secs| format!("{:.1}", 1e3 * secs)).unwrap_or_default();
            println!("| {count} {name} | {what} | {mib:.3} | {each:.1} | {ratio:.1} | {built} |");
        };
        row(
            &format!("foliage: {} fog boxes in records, models of trees once each", traced.packed_shrubs()),
            traced_bytes,
            Some(traced_secs),
        );
        row(&format!("instances of {} models, once each", instanced.models), instanced.bytes, Some(instanced.secs));
        row("these without the models", instanced.bytes - instanced.model_bytes, None);
        row(&format!("copies, {} faces", instanced.faces), instanced.faces as f64 * BYTES_PER_FACE, None);
    }
    println!();
    Ok(())
}

/// Instances of real geometry that were built.
struct Instanced {
    bytes: f64,
    /// The part of the models' own trees.
    model_bytes: f64,
    models: usize,
    /// Over all instances.
    faces: usize,
    secs: f64,
}

impl Instanced {
    /// Some instances of a level, in two levels.
    fn build(imported: &Imported, is_in: &dyn Fn(usize) -> bool) -> Self {
        let began = Instant::now();
        let (mut index_of, mut meshes, mut objects, mut faces) = (HashMap::new(), Vec::new(), Vec::new(), 0);
        for (_, instance) in imported.level.instances.iter().enumerate().filter(|(index, _)| is_in(*index)) {
            let mesh = *index_of.entry(instance.mesh).or_insert_with(|| {
                meshes.push(Arc::new(MeshBvh::build(&imported.meshes[instance.mesh as usize])));
                meshes.len() - 1
            });
            faces += imported.meshes[instance.mesh as usize].faces.len();
            objects.push(SceneObject { mesh, world_from_object: instance.world_from_object });
        }
        let scene = Scene::build(meshes, &objects);
        let secs = began.elapsed().as_secs_f64();
        let model_bytes = scene.meshes.iter().map(|mesh| mesh.memory_bytes()).sum::<usize>() as f64;
        let models = scene.meshes.len();
        Self { bytes: scene.memory_bytes() as f64, model_bytes, models, faces, secs }
    }
}

/// Bytes of nodes and triangles for each face of a flattened level of 1.8 million faces (docs/benchmarks/rays.md).
const BYTES_PER_FACE: f64 = 46.9;
