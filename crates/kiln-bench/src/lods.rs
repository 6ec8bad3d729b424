//! `kiln bench lods`: levels of detail by least squares beside reading the full detail at their vertices.
//!
//! Both are compared, at points all over each level of detail, with what 256 rays read there of the finished full detail.

use crate::{BenchError, Provenance, baked, scratch::Scratch};
use glam::{DAffine3, DVec3};
use kiln_bake::{BakedInstance, BakedSurface, ModelPoint, model_points, read_at_vertices};
use kiln_core::{FaceGroup, Mesh};
use kiln_scene::{BakedLod, BakedPart, BakedScene};
use kiln_trace::{CpuTracer, MeshBvh, Scene, SceneObject};
use rayon::prelude::*;
use std::{path::PathBuf, sync::Arc};

/// Rays that say what a point should have.
const TRUTH: u32 = 256;

/// Rays that read at each vertex.
const AT_VERTICES: u32 = 64;

const SEED: u64 = 0x10d5;

/// Options of `kiln bench lods`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  kiln example lods -o lods.glb && kiln bench lods lods.glb
  kiln example lods --from kit.glb -o kit_lods.glb && kiln bench lods kit_lods.glb")]
pub struct Args {
    /// Levels with lower levels of detail
    #[arg(value_name = "LEVEL", required = true)]
    levels: Vec<PathBuf>,
    /// Print each pair, not the totals alone
    #[arg(long)]
    pairs: bool,
}

/// One level of detail beside what it stands for.
struct Row {
    name: String,
    full_faces: usize,
    faces: usize,
    /// Squared errors by area, area: of least squares, and of reading at the vertices.
    least_squares: f64,
    at_vertices: f64,
    area_m2: f64,
}

impl Row {
    fn rmse(&self) -> [f64; 2] {
        [self.least_squares, self.at_vertices].map(|sum| (sum / self.area_m2).sqrt())
    }
}

/// Runs the measurement and prints its tables.
#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &Args) -> Result<(), BenchError> {
    println!("{}; levels of detail, all half-distances together\n", Provenance::now().sentence());
    println!(
        "| level | pairs | faces, full and lower | RMSE least squares | RMSE at vertices | ratio | least squares lower |"
    );
    println!("|---|---|---|---|---|---|---|");
    for level in &args.levels {
        let scratch = Scratch::new("lods")?;
        let scene = baked::bake(level, &["--foliage", "geometry"], scratch.path())?.scene;
        let rows = by_node(scene.lods.par_iter().filter_map(|lod| row(&scene, lod)).collect());
        let name = level.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let sum = |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>();
        let total = Row {
            name,
            full_faces: rows.iter().map(|row| row.full_faces).sum(),
            faces: rows.iter().map(|row| row.faces).sum(),
            least_squares: sum(|row| row.least_squares),
            at_vertices: sum(|row| row.at_vertices),
            area_m2: sum(|row| row.area_m2),
        };
        let lower = rows.iter().filter(|row| row.least_squares < row.at_vertices).count();
        println!(
            "| {} | {} | {} {}",
            total.name,
            rows.len(),
            cells(&total),
            format_args!("| {lower} of {} |", rows.len())
        );
        if args.pairs {
            for row in &rows {
                let mark = if row.least_squares < row.at_vertices { "" } else { "no" };
                println!("| {} | | {} | {mark} |", row.name, cells(row));
            }
        }
    }
    Ok(())
}

/// Primitives of one node are one level of detail: they are solved as one mesh.
fn by_node(rows: Vec<Row>) -> Vec<Row> {
    let mut nodes: Vec<Row> = Vec::with_capacity(rows.len());
    for row in rows {
        match nodes.last_mut().filter(|last| last.name == row.name) {
            Some(last) => {
                last.faces += row.faces;
                last.least_squares += row.least_squares;
                last.at_vertices += row.at_vertices;
                last.area_m2 += row.area_m2;
            }
            None => nodes.push(row),
        }
    }
    nodes
}

fn cells(row: &Row) -> String {
    let [least_squares, at_vertices] = row.rmse();
    let ratio = least_squares / at_vertices;
    format!("{}, {} | {least_squares:.4} | {at_vertices:.4} | {ratio:.3}", row.full_faces, row.faces)
}

/// Nothing for a level of detail without values, or of nothing that has some.
fn row(scene: &BakedScene, lod: &BakedLod) -> Option<Row> {
    let channels = lod.part.channels;
    let full: Vec<&BakedPart> =
        lod.lod_of.iter().map(|index| &scene.parts[*index]).filter(|part| part.channels == channels).collect();
    if channels == 0 || full.is_empty() || lod.part.faces.is_empty() {
        return None;
    }
    let origin = full[0].positions[full[0].faces.first()?[0] as usize];
    let meshes: Vec<Mesh> = full.iter().map(|part| mesh(part, origin)).collect();
    let instance = |(part, mesh): (&&BakedPart, &Mesh)| -> Vec<f32> {
        debug_assert_eq!(part.positions.len(), mesh.positions.len());
        part.ao.iter().map(|ao| ao.clamp(0.0, 1.0)).collect()
    };
    let values: Vec<Vec<f32>> = full.iter().zip(&meshes).map(instance).collect();
    let baked: Vec<Option<BakedInstance<'_>>> = meshes
        .iter()
        .zip(&values)
        .map(|(mesh, values)| Some(BakedInstance { mesh, world_from_object: DAffine3::IDENTITY, values }))
        .collect();
    let surface = BakedSurface::new(channels, &baked).ok()?;
    let trees = meshes.iter().map(|mesh| Arc::new(MeshBvh::build(mesh))).collect();
    let objects: Vec<SceneObject> =
        (0..meshes.len()).map(|mesh| SceneObject { mesh, world_from_object: DAffine3::IDENTITY }).collect();
    let tracer = CpuTracer::new(Arc::new(Scene::build(trees, &objects)));

    let lower = mesh(&lod.part, origin);
    let points = model_points(&lower, SEED);
    let at_points = Mesh {
        positions: points.iter().map(|point| point.position.as_vec3().to_array()).collect(),
        normals: points.iter().map(|point| point.normal.as_vec3().to_array()).collect(),
        ..Mesh::default()
    };
    let read = |mesh: &Mesh, rays: u32| read_at_vertices(&tracer, &surface, mesh, &DAffine3::IDENTITY, rays, SEED).ok();
    let (truth, at_vertices) = (read(&at_points, TRUTH)?, read(&lower, AT_VERTICES)?);
    let mut row = Row {
        name: lod.part.node.clone(),
        full_faces: full.iter().map(|part| part.faces.len()).sum(),
        faces: lod.part.faces.len(),
        least_squares: 0.0,
        at_vertices: 0.0,
        area_m2: 0.0,
    };
    for (index, point) in points.iter().enumerate().filter(|(index, _)| truth.hits[*index] > 0) {
        for channel in 0..channels {
            let truth = f64::from(truth.values[index * channels + channel]);
            let error = |values: &[f32]| (interpolated(&lower, point, values, channels, channel) - truth).powi(2);
            row.least_squares += point.area_m2 * error(&lod.part.ao);
            row.at_vertices += point.area_m2 * error(&at_vertices.values);
            row.area_m2 += point.area_m2;
        }
    }
    (row.area_m2 > 0.0).then_some(row)
}

fn interpolated(mesh: &Mesh, point: &ModelPoint, values: &[f32], channels: usize, channel: usize) -> f64 {
    let corners = mesh.faces[point.face as usize];
    let at = |vertex: u32| f64::from(values[vertex as usize * channels + channel]);
    corners.iter().zip(point.phi).map(|(vertex, phi)| phi * at(*vertex)).sum()
}

/// A part near an origin, with the normals of its faces.
pub(crate) fn mesh(part: &BakedPart, origin: DVec3) -> Mesh {
    Mesh {
        positions: part.positions.iter().map(|p| (*p - origin).as_vec3().to_array()).collect(),
        normals: vec![[0.0; 3]; part.positions.len()],
        faces: part.faces.clone(),
        face_group: vec![0; part.faces.len()],
        groups: vec![FaceGroup { double_sided: part.double_sided, ..FaceGroup::PLAIN }],
        ..Mesh::default()
    }
}
