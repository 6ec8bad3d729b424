//! `kiln check`: reads and validates, bakes nothing.

use crate::{
    args::{CheckArgs, Common},
    failure::Failure,
    half_distances::channel_names,
    report::warning_lines,
    source::Source,
};
use kiln_bake::FaceAreas;
use kiln_core::{Digest, Level, Mesh, SkipRule, codec};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};

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

/// Faces of distinct meshes whose holes a texture says, and the textures.
#[derive(Default, serde::Serialize)]
struct Masks {
    faces: u64,
    /// Of each mask: texels along u and v, or bits where it has several for each texel.
    sizes: BTreeSet<[u32; 2]>,
}

pub(crate) fn run(args: &CheckArgs, common: &Common) -> Result<(), Failure> {
    super::use_threads(common)?;
    let source = Source::read(&args.level, args.settings.sidecar.as_deref())?;
    let settings = args.settings.resolve()?;
    let import = kiln_scene::import(source.name(), &source, source.sidecar(), &settings).map_err(Failure::refused)?;
    let meshes = decode(&import).map_err(anyhow::Error::from)?;
    let estimate = estimate(&import.level, &meshes, common.thread_count());
    print(&import.level, &masks(&meshes), &estimate, common);
    Ok(())
}

type Meshes = BTreeMap<Digest, Mesh>;

fn decode(import: &kiln_scene::Import) -> Result<Meshes, codec::DecodeError> {
    import.meshes.iter().map(|blob| Ok((blob.digest, codec::decode("a mesh", &blob.bytes)?))).collect()
}

fn masks(meshes: &Meshes) -> Masks {
    let mut masks = Masks::default();
    for mesh in meshes.values() {
        masks.faces += mesh.cutouts.corners.len() as u64;
        masks.sizes.extend(mesh.cutouts.masks.iter().map(|mask| mask.size()));
    }
    masks
}

fn estimate(level: &Level, meshes: &Meshes, threads: usize) -> Estimate {
    let mut samples = 0;
    for instance in level.instances.iter().filter(|i| i.receives) {
        let Some(mesh) = meshes.get(&level.meshes[instance.mesh as usize].digest) else { continue };
        let areas = FaceAreas::new(mesh, &instance.world_from_object);
        let density = kiln_bake::density(&areas, &level.sampling);
        let sides = |face: usize| if mesh.group(face).double_sided { 2 } else { 1 };
        let of_face = |face: usize| u64::from(areas.samples(face, density, &level.sampling)) * sides(face);
        samples += (0..mesh.faces.len()).map(of_face).sum::<u64>();
    }
    let is_adaptive = !level.sampling.no_skip.contains(&SkipRule::Adaptive);
    let of_regions = level.regions.regions.iter().map(|region| level.regions.rays_of(region, is_adaptive)).sum::<u64>();
    let rays = samples * u64::from(level.sampling.rays_per_sample) + of_regions;
    let memory_bytes = level.counts.unique_faces * BYTES_PER_UNIQUE_FACE + level.counts.faces * BYTES_PER_FACE;
    Estimate { samples, rays, seconds: rays as f64 / (RAYS_PER_CORE_SECOND * threads as f64), memory_bytes }
}

#[expect(clippy::print_stdout, reason = "this is the command's output")]
fn print(level: &Level, masks: &Masks, estimate: &Estimate, common: &Common) {
    let counts = &level.counts;
    if common.json {
        let report = json!({
            "level": counts, "origin_m": level.origin_m.to_array(), "sampling": level.sampling,
            "solve": level.solve, "output": level.output, "warnings": level.warnings, "masks": masks,
            "regions": {
                "regions": level.regions.regions.len(), "edges": level.regions.edges.len(),
                "settings": level.regions.settings,
            },
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
    if masks.faces > 0 {
        let sizes: Vec<String> = masks.sizes.iter().map(|[width, height]| format!("{width} × {height}")).collect();
        println!("faces with holes: {} of distinct meshes, by masks of {}", masks.faces, sizes.join(", "));
    }
    let (regions, edges) = (level.regions.regions.len(), level.regions.edges.len());
    if regions > 0 {
        println!("{regions} visibility regions, {edges} edges between them");
    }
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
