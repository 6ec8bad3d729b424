//! Lower levels of detail, made of a level by a mesh simplifier and linked by MSFT_lod.

use super::{
    builder::{Builder, Mesh as MeshIndex},
    surface::Surface,
};
use crate::{Import, SceneError, SourceFiles, import};
use glam::{DVec3, Vec3};
use kiln_core::{BakeSettings, FoliageMode, Mesh, codec};
use meshopt::SimplifyOptions;
use std::collections::BTreeMap;

/// Part of the faces that each level keeps.
const PARTS: [f64; 3] = [0.5, 0.25, 0.1];

/// A level that has not at least so much fewer faces than the one before is left out.
const LEAST_GAIN: f64 = 0.9;

/// Meshes with fewer faces have no levels.
const LEAST_FACES: usize = 64;

/// Levels with fewer faces are left out: hardly more than a box.
const LEAST_OF_LEVEL: usize = 16;

const COLOR: [f32; 3] = [0.6, 0.6, 0.6];

/// A level again, with up to three lower levels of detail for each mesh of at least 64 faces: half, a quarter and a tenth of
/// the faces, but none of fewer than 16. Nodes keep their names, and their levels have `_lod1`, `_lod2` and `_lod3` after it; they are outside of the
/// scene. Materials keep only whether they are seen from both sides.
///
/// # Errors
/// As [`import`].
pub fn with_lods(level_name: &str, files: &dyn SourceFiles) -> Result<Vec<u8>, SceneError> {
    let settings = BakeSettings { foliage: FoliageMode::Geometry, ..BakeSettings::default() };
    Ok(build(&import(level_name, files, None, &settings)?))
}

/// The courtyard with its levels of detail.
pub(super) fn courtyard() -> Vec<u8> {
    let files = BTreeMap::from([("courtyard.glb".to_owned(), super::level::courtyard())]);
    with_lods("courtyard.glb", &files).expect("Kiln reads its own example")
}

fn build(source: &Import) -> Vec<u8> {
    let blobs: BTreeMap<_, _> = source.meshes.iter().map(|blob| (blob.digest, &blob.bytes)).collect();
    let mut builder = Builder::new();
    let materials = [builder.material("one side", COLOR), builder.double_sided_material("both sides", COLOR)];
    let mut meshes: Vec<Vec<MeshIndex>> = Vec::new();
    for entry in &source.level.meshes {
        let mesh: Mesh = blobs.get(&entry.digest).and_then(|b| codec::decode("a mesh", b).ok()).unwrap_or_default();
        let full = [false, true].map(|both| side(&mesh, entry.center, both));
        let mut levels = vec![full];
        for part in PARTS {
            let last = faces_of(&levels[levels.len() - 1]);
            let lower = levels[0].each_ref().map(|surface| simplified(surface, part));
            let is_less = (faces_of(&lower) as f64) < LEAST_GAIN * last as f64;
            if faces_of(&levels[0]) >= LEAST_FACES && faces_of(&lower) >= LEAST_OF_LEVEL && is_less {
                levels.push(lower);
            }
        }
        let mut of_mesh = Vec::new();
        for (number, surfaces) in levels.iter().enumerate() {
            let name = if number == 0 { entry.name.clone() } else { format!("{}_lod{number}", entry.name) };
            let parts: Vec<_> =
                surfaces.iter().zip(materials).filter(|(surface, _)| !surface.faces.is_empty()).collect();
            of_mesh.push(builder.mesh(&name, &parts));
        }
        meshes.push(of_mesh);
    }
    for instance in &source.level.instances {
        let mut place = instance.world_from_object;
        let center = source.level.meshes[instance.mesh as usize].center;
        place.translation += source.level.origin_m - place.matrix3 * center;
        let levels = &meshes[instance.mesh as usize];
        let name = |number: usize| format!("{}_lod{number}", instance.name);
        let lower: Vec<usize> =
            (1..levels.len()).map(|number| builder.level_node(&name(number), levels[number], &place)).collect();
        builder.node_with_levels(&instance.name, levels[0], &place, &lower);
    }
    builder.finish("levels of detail")
}

/// All of a level as one surface that is seen from one side, and one that is seen from both.
pub(super) fn surfaces_of(source: &Import) -> [Surface; 2] {
    let blobs: BTreeMap<_, _> = source.meshes.iter().map(|blob| (blob.digest, &blob.bytes)).collect();
    let mut all = [Surface::default(), Surface::default()];
    for instance in source.level.instances.iter().filter(|instance| !instance.is_lod()) {
        let entry = &source.level.meshes[instance.mesh as usize];
        let mesh: Mesh = blobs.get(&entry.digest).and_then(|b| codec::decode("a mesh", b).ok()).unwrap_or_default();
        let place = &instance.world_from_object;
        let normals = place.matrix3.inverse().transpose();
        for (all, both) in all.iter_mut().zip([false, true]) {
            let mut surface = side(&mesh, DVec3::ZERO, both);
            let position = |p: &mut DVec3| *p = place.transform_point3(*p) + source.level.origin_m;
            surface.positions.iter_mut().for_each(position);
            surface.normals.iter_mut().for_each(|normal| *normal = (normals * *normal).normalize_or(DVec3::Y));
            if place.matrix3.determinant() < 0.0 {
                surface.faces.iter_mut().for_each(|face| face.swap(1, 2));
            }
            all.append(&surface);
        }
    }
    all
}

fn faces_of(surfaces: &[Surface; 2]) -> usize {
    surfaces.iter().map(|surface| surface.faces.len()).sum()
}

/// The faces of a mesh that are seen from one side, or from both, in the object space of its file.
fn side(mesh: &Mesh, center: DVec3, both: bool) -> Surface {
    let faces = (0..mesh.faces.len()).filter(|face| mesh.group(*face).double_sided == both);
    let positions = mesh.positions.iter().map(|p| Vec3::from_array(*p).as_dvec3() + center).collect();
    let normals = mesh.normals.iter().map(|n| Vec3::from_array(*n).as_dvec3()).collect();
    compact(&Surface { positions, normals, faces: faces.map(|face| mesh.faces[face]).collect() })
}

/// The surface with about a part of its faces.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a number of indices")]
fn simplified(surface: &Surface, part: f64) -> Surface {
    let indices: Vec<u32> = surface.faces.iter().flatten().copied().collect();
    let positions: Vec<[f32; 3]> = surface.positions.iter().map(|p| p.as_vec3().to_array()).collect();
    let target = 3 * (surface.faces.len() as f64 * part).ceil() as usize;
    let options = SimplifyOptions::Permissive;
    let kept = meshopt::simplify_decoder(&indices, &positions, target, f32::MAX, options, None);
    let faces = kept.chunks_exact(3).map(|face| [face[0], face[1], face[2]]).collect();
    compact(&Surface { positions: surface.positions.clone(), normals: surface.normals.clone(), faces })
}

/// Without faces that have no area as f32, and without the vertices that no face uses. Normals that are zero are made those of a face.
fn compact(surface: &Surface) -> Surface {
    let mut index_of = vec![None; surface.positions.len()];
    let mut left = Surface { positions: Vec::new(), normals: Vec::new(), faces: Vec::new() };
    for face in &surface.faces {
        let [a, b, c] = face.map(|vertex| surface.positions[vertex as usize].as_vec3().as_dvec3());
        let of_face = (b - a).cross(c - a).normalize_or_zero();
        if of_face == DVec3::ZERO {
            continue;
        }
        left.faces.push(face.map(|vertex| {
            *index_of[vertex as usize].get_or_insert_with(|| {
                left.positions.push(surface.positions[vertex as usize]);
                left.normals.push(surface.normals[vertex as usize].normalize_or(of_face));
                (left.positions.len() - 1) as u32
            })
        }));
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_courtyard_has_levels_of_detail_that_are_linked() {
        let files = BTreeMap::from([("lods.glb".to_owned(), courtyard())]);
        let level = import("lods.glb", &files, None, &BakeSettings::default()).unwrap().level;
        let named = |name: &str| level.instances.iter().position(|instance| instance.name == name).unwrap();
        let faces = |name: &str| level.meshes[level.instances[named(name)].mesh as usize].face_count;
        for number in 1..=3 {
            let lod = format!("terrain_lod{number}");
            assert_eq!(level.instances[named(&lod)].lod_of, [named("terrain") as u32]);
            let part = f64::from(faces(&lod)) / f64::from(faces("terrain"));
            assert!((part - PARTS[number - 1]).abs() < 0.02, "{part}");
        }
        let alone = BTreeMap::from([("a.glb".to_owned(), super::super::level::courtyard())]);
        let alone = import("a.glb", &alone, None, &BakeSettings::default()).unwrap().level;
        assert_eq!(level.counts.instances, alone.counts.instances);
        assert_eq!(level.counts.faces, alone.counts.faces);
        assert_eq!(level.sampling.kernel, alone.sampling.kernel);
        assert!(level.counts.lod_instances > 20 && level.counts.lod_faces > 5000, "{:?}", level.counts);
    }
}
