//! Import: source files and settings to a level and its meshes.

mod recentre;
#[cfg(test)]
mod robustness;
#[cfg(test)]
mod tests;

use crate::{
    SceneError, Sidecar, SidecarText, SourceFiles,
    document::{Document, read_level},
    extensions::check_required,
    findings::{Finding, Findings},
    gather::{Gathered, Rules, Variant, gather},
    import::recentre::recentre,
    limits,
    lods::Lods,
    mesh::{Built, Tally, build},
    resolve::{Resolved, check, only, origin, resolve},
    scene::placements,
};
use glam::{DAffine3, DVec3, Vec3};
use kiln_core::{
    Attribute, BakeSettings, Bounds, Class, Digest, Gets, Instance, Level, LevelCounts, Mesh, MeshEntry,
    OutputSettings, Regions, ValueFormat, codec,
};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::collections::{BTreeMap, BTreeSet};

/// An encoded mesh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MeshBlob {
    /// Digest of the bytes.
    pub digest: Digest,
    /// The encoded [`kiln_core::Mesh`].
    pub bytes: Vec<u8>,
}

/// An imported level.
#[derive(Clone, Debug, PartialEq)]
pub struct Import {
    /// The manifest.
    pub level: Level,
    /// The distinct meshes, each once; every [`MeshEntry::digest`] of the level is the digest of one.
    pub meshes: Vec<MeshBlob>,
}

/// Imports a level: reads its files, checks and cleans them, classifies, and resolves the settings.
///
/// `level_name` is the level's path in `files`, and paths of other files are relative to its folder. The result
/// depends on nothing but the arguments.
///
/// # Errors
/// [`SceneError`] with the place and the remedy, for anything that can't be baked as it stands.
pub fn import(
    level_name: &str,
    files: &dyn SourceFiles,
    sidecar: Option<SidecarText<'_>>,
    settings: &BakeSettings,
) -> Result<Import, SceneError> {
    check(settings)?;
    let sidecar = sidecar.map_or(Ok(Sidecar::default()), Sidecar::parse)?;
    let level_bytes = read_level(level_name, files)?;
    let document = Document::parse(level_name, &level_bytes, files)?;
    check_required(&document)?;

    let mut findings = Findings::default();
    findings.add(Finding::BytesAfterEnd, level_name, document.bytes_after_end as u64);
    let lods = Lods::find(&document, &sidecar.lods, &mut findings)?;
    let placements = placements(&document, &lods, &mut findings)?;
    let only = only(settings)?;
    let mut regions = sidecar.regions.clone();
    regions.retain(|region| only.as_ref().is_none_or(|only| only.is_match(&region.id)));
    let rules = Rules {
        classes: &sidecar.classes,
        only,
        foliage: settings.foliage,
        trees: settings.trees,
        output: &settings.output,
    };
    let gathered = gather(&document, files, &placements, &rules, &mut findings)?;
    check_only(settings, &gathered, &regions)?;

    let cast = cast_all(&gathered, settings)?;
    report(&gathered, &cast, &mut findings);
    let world = cast.iter().fold(Bounds::EMPTY, |mut all, cast| {
        all.merge(&cast.world_bounds);
        all
    });
    let origin_m = origin(&world);
    let bounds = Bounds { min: world.min - origin_m, max: world.max - origin_m };
    check_extent(level_name, &bounds)?;
    let resolved = resolve(settings, &sidecar, &bounds, faces(&gathered, &cast), &mut findings)?;
    let regions = relative(regions, origin_m);
    let import = assemble(gathered, cast, World { origin_m, bounds, regions }, resolved, findings);
    check_output_size(level_name, level_bytes.len(), &import.level)?;
    Ok(import)
}

/// Where a level is, and the regions in it, relative to the origin.
struct World {
    origin_m: DVec3,
    bounds: Bounds,
    regions: Regions,
}

/// Regions in world space, relative to the level's origin.
fn relative(mut regions: Regions, origin_m: DVec3) -> Regions {
    for region in &mut regions.regions {
        region.bounds = Bounds { min: region.bounds.min - origin_m, max: region.bounds.max - origin_m };
    }
    regions.edges.iter_mut().for_each(|edge| edge.center -= origin_m);
    regions
}

/// A `--only` that matches nothing is a slip of the pen.
fn check_only(settings: &BakeSettings, gathered: &Gathered<'_>, regions: &Regions) -> Result<(), SceneError> {
    let matches_none = regions.regions.is_empty() && !gathered.instances.iter().any(|instance| instance.receives);
    match &settings.only {
        Some(only) if matches_none => Err(SceneError::Setting {
            setting: "--only",
            problem: format!("{only:?} matches no node, mesh, material or region that could be baked"),
        }),
        _ => Ok(()),
    }
}

/// What became of a variant.
struct Cast {
    entry: MeshEntry,
    /// Where the mesh's own origin is in the object space of the file.
    center: DVec3,
    bytes: Vec<u8>,
    /// Faces for each class.
    classes: BTreeMap<Class, u64>,
    areas: Areas,
    /// Bounds of all its instances in the file's world, metres.
    world_bounds: Bounds,
    tally: Tally,
}

/// How many faces all instances have, and the area of those that make up most of the level, square metres: the mean by
/// area, distant scenery apart.
fn faces(gathered: &Gathered<'_>, cast: &[Cast]) -> (u64, f64) {
    let (mut faces, mut area, mut squares) = (0u64, 0.0, 0.0);
    for (variant, cast) in gathered.variants.iter().zip(cast) {
        for &instance in &variant.instances {
            let matrix = gathered.instances[instance].world_from_object.matrix3;
            let scale = matrix.determinant().abs().cbrt().powi(2);
            faces = faces.saturating_add(u64::from(cast.entry.face_count));
            area += scale * cast.areas.sum;
            squares += scale * scale * cast.areas.squares;
        }
    }
    (faces, if area > 0.0 { squares / area } else { 0.0 })
}

/// Areas of the faces of a mesh that receive, distant scenery apart.
#[derive(Clone, Copy, Debug, Default)]
struct Areas {
    sum: f64,
    squares: f64,
}

impl Areas {
    fn new(mesh: &Mesh) -> Self {
        let counts = |face: &usize| mesh.group(*face).receives && mesh.group(*face).class != Class::Distant;
        (0..mesh.faces.len()).filter(counts).fold(Self::default(), |areas, face| {
            let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
            let area = 0.5 * (b - a).cross(c - a).length();
            Self { sum: areas.sum + area, squares: areas.squares + area * area }
        })
    }
}

/// Reads, cleans and encodes every variant, in parallel; the first error in the order of variants counts.
fn cast_all(gathered: &Gathered<'_>, settings: &BakeSettings) -> Result<Vec<Cast>, SceneError> {
    let cast = |variant: &Variant<'_>| build(&variant.primitives, settings).map(|b| cast(variant, b, gathered));
    let all: Vec<Result<Cast, SceneError>> = gathered.variants.par_iter().map(cast).collect();
    all.into_iter().collect()
}

fn cast(variant: &Variant<'_>, built: Built, gathered: &Gathered<'_>) -> Cast {
    let Built { mut mesh, blocks, mut bounds, tally } = built;
    let transforms = variant.instances.iter().map(|&index| &gathered.instances[index].world_from_object);
    let world_bounds = world_bounds(&mesh, transforms);
    let center = recentre(&mut mesh, &mut bounds);
    let bytes = codec::encode(&mesh);
    let entry = MeshEntry {
        digest: Digest::of(&bytes),
        name: variant.name.clone(),
        vertex_count: mesh.positions.len() as u32,
        face_count: mesh.faces.len() as u32,
        duplicate_faces: u32::try_from(tally.duplicate).unwrap_or(u32::MAX),
        bounds,
        center,
        source_mesh: variant.source_mesh as u32,
        blocks,
    };
    let mut classes = BTreeMap::new();
    for face in 0..mesh.faces.len() {
        *classes.entry(mesh.group(face).class).or_default() += 1;
    }
    Cast { entry, center, bytes, classes, areas: Areas::new(&mesh), world_bounds, tally }
}

/// Bounds of a mesh's faces under several transforms.
fn world_bounds<'t>(mesh: &Mesh, transforms: impl Iterator<Item = &'t DAffine3>) -> Bounds {
    let mut used = vec![false; mesh.positions.len()];
    mesh.faces.iter().flatten().for_each(|&vertex| used[vertex as usize] = true);
    let points = mesh.positions.iter().zip(used).filter(|(_, used)| *used);
    let points: Vec<DVec3> = points.map(|(position, _)| DVec3::from(position.map(f64::from))).collect();
    let mut bounds = Bounds::EMPTY;
    for transform in transforms {
        points.iter().for_each(|point| bounds.add(transform.transform_point3(*point)));
    }
    bounds
}

/// Tells what was found in the meshes, once for each mesh of the document, whatever its variants.
fn report(gathered: &Gathered<'_>, cast: &[Cast], findings: &mut Findings) {
    let mut told = BTreeSet::new();
    for (variant, cast) in gathered.variants.iter().zip(cast) {
        if !told.insert(variant.source_mesh) {
            continue;
        }
        let tally = &cast.tally;
        for (finding, count) in [
            (Finding::NonFiniteFaces, tally.non_finite),
            (Finding::OutOfRangeFaces, tally.out_of_range),
            (Finding::DegenerateFaces, tally.degenerate),
            (Finding::DuplicateFaces, tally.duplicate),
            (Finding::InvalidNormals, tally.invalid_normals),
            (Finding::UnreferencedVertices, tally.unreferenced),
            (Finding::IncompleteFaces, tally.left_over),
        ] {
            findings.add(finding, &variant.name, count);
        }
    }
}

/// Puts the parts together. Meshes that have no faces left are left out, with their instances.
fn assemble(gathered: Gathered<'_>, cast: Vec<Cast>, world: World, resolved: Resolved, findings: Findings) -> Import {
    let World { origin_m, bounds, regions } = world;
    let mut counts = LevelCounts::default();
    let mut index_of = vec![None; cast.len()];
    let (mut entries, mut meshes) = (Vec::new(), Vec::new());
    let mut known = BTreeSet::new();
    let (mut classes, mut centers) = (Vec::new(), Vec::new());
    for (variant, cast) in cast.into_iter().enumerate().filter(|(_, cast)| cast.entry.face_count > 0) {
        index_of[variant] = Some(entries.len());
        if known.insert(cast.entry.digest) {
            counts.meshes += 1;
            counts.unique_faces += u64::from(cast.entry.face_count);
            meshes.push(MeshBlob { digest: cast.entry.digest, bytes: cast.bytes });
        }
        entries.push(cast.entry);
        classes.push(cast.classes);
        centers.push(cast.center);
    }
    let mut instances: Vec<Instance> = Vec::with_capacity(gathered.instances.len());
    for mut instance in gathered.instances {
        let Some(mesh) = index_of[instance.mesh as usize] else { continue };
        instance.mesh = mesh as u32;
        instance.world_from_object.translation -= origin_m;
        instance.world_from_object.translation += instance.world_from_object.matrix3 * centers[mesh];
        if instance.is_lod() {
            counts.lod_instances += 1;
            counts.lod_vertices += u64::from(entries[mesh].vertex_count);
            counts.lod_faces += u64::from(entries[mesh].face_count);
            instances.push(instance);
            continue;
        }
        counts.instances += 1;
        counts.vertices += u64::from(entries[mesh].vertex_count);
        counts.faces += u64::from(entries[mesh].face_count);
        for (&class, &faces) in &classes[mesh] {
            *counts.classes.entry(class).or_default() += faces;
        }
        instances.push(instance);
    }
    if gathered.ignored_faces > 0 {
        counts.classes.insert(Class::Ignored, gathered.ignored_faces);
    }
    let level = Level {
        origin_m,
        bounds,
        meshes: entries,
        instances,
        regions,
        sampling: resolved.sampling,
        solve: resolved.solve,
        output: resolved.output,
        warnings: findings.into_warnings(),
        counts,
    };
    Import { level, meshes }
}

/// Refuses a level so large that f32 arithmetic in it would overflow.
fn check_extent(file: &str, bounds: &Bounds) -> Result<(), SceneError> {
    let extent =
        if bounds.is_empty() { 0.0 } else { bounds.min.abs().max_element().max(bounds.max.abs().max_element()) };
    if extent <= limits::COORDINATE_M {
        return Ok(());
    }
    Err(SceneError::TooBig {
        file: file.to_owned(),
        place: "the level's bounds".to_owned(),
        what: "metres from the middle",
        found: extent as u64,
        limit: limits::COORDINATE_M as u64,
        advice: "correct the transforms or the positions that lead so far",
    })
}

/// Refuses a level whose output could not be a .glb file, before it is baked.
fn check_output_size(file: &str, level_bytes: usize, level: &Level) -> Result<(), SceneError> {
    let vertices = output_vertices(level);
    let bytes = vertices * bytes_per_vertex(&level.output, level.sampling.kernel.channel_count()) + level_bytes as u64;
    if bytes <= limits::GLB_BYTES {
        return Ok(());
    }
    Err(SceneError::TooBig {
        file: file.to_owned(),
        place: "the output".to_owned(),
        what: "bytes",
        found: bytes,
        limit: limits::GLB_BYTES,
        advice: "use --format u16, fewer half-distances, or split the level",
    })
}

/// Vertices that get values: of each instance, and of each model of trees once.
fn output_vertices(level: &Level) -> u64 {
    let of = |mesh: u32| u64::from(level.meshes[mesh as usize].vertex_count);
    let receiving = || level.instances.iter().filter(|instance| instance.receives);
    let models: BTreeSet<u32> = receiving().filter(|i| i.gets.is_global()).map(|i| i.mesh).collect();
    receiving().filter(|i| i.gets == Gets::Vertices).map(|i| i.mesh).chain(models).map(of).sum()
}

/// Least bytes of output for a vertex.
fn bytes_per_vertex(output: &OutputSettings, channels: usize) -> u64 {
    let component = if output.format == ValueFormat::U16 { 2 } else { 4 };
    let ao = if output.attribute == Attribute::Color { 0 } else { (channels * component).next_multiple_of(4) };
    let color = if output.attribute == Attribute::Ao { 0 } else { (3 * component).next_multiple_of(4) };
    let residual = if output.residual { (channels * component).next_multiple_of(4) } else { 0 };
    (ao + color + residual) as u64
}
