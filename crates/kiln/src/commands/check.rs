//! `kiln check`: reads and validates, bakes nothing.

use crate::{
    args::{CheckArgs, Common},
    failure::Failure,
    half_distances::channel_names,
    report::warning_lines,
    source::Source,
};
use kiln_bake::FaceAreas;
use kiln_core::{Level, Mesh, codec};
use serde_json::json;
use std::collections::BTreeMap;

/// Rays per second of one core on a large level, as a rule of thumb for estimates only.
const RAYS_PER_CORE_SECOND: f64 = 1.0e6;

/// Bytes of BVH, meshes and moments for each face, likewise.
const BYTES_PER_UNIQUE_FACE: u64 = 300;
const BYTES_PER_FACE: u64 = 150;

struct Estimate {
    samples: u64,
    rays: u64,
    seconds: f64,
    memory_bytes: u64,
}

pub(crate) fn run(args: &CheckArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let source = Source::read(&args.level, args.settings.sidecar.as_deref())?;
    let settings = args.settings.resolve()?;
    let import = kiln_scene::import(source.name(), &source, source.sidecar(), &settings).map_err(Failure::refused)?;
    let estimate = estimate(&import, common.thread_count()).map_err(anyhow::Error::from)?;
    print(&import.level, &estimate, common);
    Ok(())
}

fn estimate(import: &kiln_scene::Import, threads: usize) -> Result<Estimate, codec::DecodeError> {
    let mut meshes: BTreeMap<_, Mesh> = BTreeMap::new();
    for blob in &import.meshes {
        meshes.insert(blob.digest, codec::decode("a mesh", &blob.bytes)?);
    }
    let level = &import.level;
    let mut samples = 0;
    for instance in level.instances.iter().filter(|i| i.receives) {
        let Some(mesh) = meshes.get(&level.meshes[instance.mesh as usize].digest) else { continue };
        let areas = FaceAreas::new(mesh, &instance.world_from_object);
        let density = kiln_bake::density(&areas, &level.sampling);
        let sides = |face: usize| if mesh.group(face).double_sided { 2 } else { 1 };
        let of_face = |face: usize| u64::from(areas.samples(face, density, &level.sampling)) * sides(face);
        samples += (0..mesh.faces.len()).map(of_face).sum::<u64>();
    }
    let rays = samples * u64::from(level.sampling.rays_per_sample);
    let memory_bytes = level.counts.unique_faces * BYTES_PER_UNIQUE_FACE + level.counts.faces * BYTES_PER_FACE;
    Ok(Estimate { samples, rays, seconds: rays as f64 / (RAYS_PER_CORE_SECOND * threads as f64), memory_bytes })
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print(level: &Level, estimate: &Estimate, common: &Common) {
    let counts = &level.counts;
    if common.json {
        let report = json!({
            "level": counts, "origin_m": level.origin_m.to_array(), "sampling": level.sampling,
            "solve": level.solve, "output": level.output, "warnings": level.warnings,
            "estimate": {
                "samples": estimate.samples, "rays": estimate.rays,
                "seconds": estimate.seconds, "memory_bytes": estimate.memory_bytes,
            },
        });
        println!("{report}");
        return;
    }
    println!(
        "{} meshes, {} instances, {} vertices, {} faces ({} of distinct meshes)",
        counts.meshes, counts.instances, counts.vertices, counts.faces, counts.unique_faces
    );
    let classes: Vec<String> =
        counts.classes.iter().map(|(class, n)| format!("{n} {class:?}").to_lowercase()).collect();
    println!("faces by class: {}", classes.join(", "));
    let size = level.bounds.max - level.bounds.min;
    if !level.bounds.is_empty() {
        println!("size {:.3} × {:.3} × {:.3} m", size.x, size.y, size.z);
    }
    println!("half-distances {}", channel_names(&level.sampling.kernel).join(", "));
    println!(
        "{} samples, {} rays: about {:.0} s and {} MiB on this machine's CPU",
        estimate.samples,
        estimate.rays,
        estimate.seconds.ceil(),
        estimate.memory_bytes >> 20
    );
    warning_lines(&level.warnings).iter().for_each(|line| println!("{line}"));
}
