//! What every example must be, and that the oracle scenes are what their closed forms say.

use super::inspect::{File, count, transform};
use super::surface_integral::ambient_obscurance;
use super::{EXAMPLES, build, names, oracle, oracles};
use glam::DVec3;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

fn all_files() -> impl Iterator<Item = (&'static str, File)> {
    names().iter().map(|&(name, _)| (name, File::of(name)))
}

#[test]
fn names_are_distinct_and_groups_clear() {
    let distinct: BTreeSet<_> = names().iter().map(|&(name, _)| name).collect();
    assert_eq!(distinct.len(), EXAMPLES.len());
    assert_eq!(names()[0].0, "courtyard");
    for (name, description) in names() {
        assert!(["level: ", "part: ", "oracle: ", "case: "].iter().any(|group| description.starts_with(group)));
        assert_eq!(name.starts_with("oracle_"), description.starts_with("oracle: "));
    }
    assert!(build("no such thing").is_none());
}

#[test]
fn the_same_bytes_every_time() {
    for (name, _) in names() {
        assert_eq!(build(name), build(name), "{name}");
    }
}

#[test]
fn triangle_counts() {
    let expected: BTreeMap<&str, usize> = BTreeMap::from([
        ("oracle_plane", 2 * 256 + 2 * 14 * 14),
        ("oracle_sphere", 20 * 1024),
        ("oracle_wall", 2 * 256 + 2 * 20 * 20),
        ("oracle_wall_finite", 2 * 256 + 2 * 8 * 14),
        ("oracle_disk", 2 * 256 + 128 * 31),
        ("oracle_ball", 2 * 256 + 20 * 1024),
        ("oracle_box", 2 * 2 * (16 * 24 + 16 * 12 + 24 * 12)),
        ("oracle_cylinder", 2 * 256 * 10),
        ("double_sided", 2 * 256 + 2 * 64),
        ("empty", 0),
        ("triangle", 1),
    ]);
    for (name, file) in all_files() {
        let triangles = file.triangle_count();
        if let Some(&expected) = expected.get(name) {
            assert_eq!(triangles, expected, "{name}");
        }
        let wanted = match name {
            "courtyard" => 10_000..30_000,
            "lods" => 20_000..60_000,
            "empty" | "triangle" => 0..2,
            _ => 500..25_000,
        };
        assert!(wanted.contains(&triangles), "{name}: {triangles}");
    }
}

#[test]
fn accessors_hold_what_they_say() {
    for (name, file) in all_files() {
        for (i, accessor) in file.list("accessors").iter().enumerate() {
            let stored = file.stored(i);
            assert!(stored.iter().flatten().all(|c| c.is_finite()), "{name}");
            let fold = |f: fn(f64, f64) -> f64| {
                stored.iter().fold(stored[0].clone(), |m, v| m.iter().zip(v).map(|(&a, &b)| f(a, b)).collect())
            };
            let bound = |key: &str| -> Option<Vec<f64>> {
                Some(accessor.get(key)?.as_array()?.iter().filter_map(Value::as_f64).collect())
            };
            for (stated, found) in [(bound("min"), fold(f64::min)), (bound("max"), fold(f64::max))] {
                assert!(stated.is_none_or(|stated| stated == found), "{name}, accessor {i}");
            }
        }
        for primitive in (0..file.list("meshes").len()).flat_map(|mesh| file.primitives(mesh)) {
            assert_eq!(primitive.positions.len(), primitive.normals.len());
            let used: BTreeSet<usize> = primitive.faces.iter().flatten().copied().collect();
            // In range, and none without use.
            assert_eq!(
                used.into_iter().collect::<Vec<_>>(),
                (0..primitive.positions.len()).collect::<Vec<_>>(),
                "{name}"
            );
        }
        for position in file.list("meshes").iter().flat_map(|m| m["primitives"].as_array().unwrap()) {
            let accessor = &file.list("accessors")[count(&position["attributes"]["POSITION"])];
            assert!(accessor.get("min").is_some() && accessor.get("max").is_some(), "{name}");
        }
    }
}

#[test]
fn normals_are_unit_and_agree_with_the_winding() {
    for (name, file) in all_files() {
        for primitive in (0..file.list("meshes").len()).flat_map(|mesh| file.primitives(mesh)) {
            assert!(primitive.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-6), "{name}");
            for face in &primitive.faces {
                let [a, b, c] = face.map(|v| primitive.positions[v]);
                let cross = (b - a).cross(c - a);
                assert!(cross.length() > 0.0, "{name}: a face has no area");
                let least = face.iter().map(|&v| primitive.normals[v].dot(cross.normalize())).fold(1.0, f64::min);
                // A level of detail has the normals of the vertices that are left.
                assert!(least > 0.8 || name == "lods", "{name}: {least}");
            }
        }
    }
}

/// Directed edges between positions; closed where each is met once in each direction.
fn is_closed(faces: &[[DVec3; 3]]) -> bool {
    let key = |p: DVec3| p.to_array().map(f64::to_bits);
    let mut edges: BTreeMap<_, i32> = BTreeMap::new();
    for f in faces {
        for i in 0..3 {
            *edges.entry((key(f[i]), key(f[(i + 1) % 3]))).or_default() += 1;
        }
    }
    edges.iter().all(|(&(a, b), &times)| times == 1 && edges.get(&(b, a)) == Some(&1))
}

fn mesh_triangles(file: &File, name: &str) -> Vec<[DVec3; 3]> {
    let mesh = file.list("meshes").iter().position(|mesh| mesh["name"] == name).expect("the mesh exists");
    let primitives = file.primitives(mesh);
    primitives.iter().flat_map(|p| p.faces.iter().map(|f| f.map(|v| p.positions[v]))).collect()
}

#[test]
fn closed_pieces_are_watertight() {
    let closed = [
        ("courtyard", "room"),
        ("courtyard", "stairs"),
        ("courtyard", "terrace"),
        ("courtyard", "pillar"),
        ("courtyard", "beam"),
        ("courtyard", "rafter"),
        ("courtyard", "crate"),
        ("courtyard", "roof_gallery"),
        ("courtyard", "wall_gallery"),
        ("oracle_sphere", "receiver"),
        ("oracle_ball", "ball"),
        ("oracle_box", "receiver"),
        ("mirrored", "steps"),
    ];
    for (example, mesh) in closed {
        assert!(is_closed(&mesh_triangles(&File::of(example), mesh)), "{mesh} of {example} is open");
    }
    for (example, mesh) in [("courtyard", "terrain"), ("double_sided", "sheet"), ("oracle_disk", "disk")] {
        assert!(!is_closed(&mesh_triangles(&File::of(example), mesh)), "{mesh} of {example} is closed");
    }
}

#[test]
fn closed_pieces_face_the_right_way() {
    let volume = |example: &str, mesh: &str| -> f64 {
        mesh_triangles(&File::of(example), mesh).iter().map(|[a, b, c]| a.dot(b.cross(*c)) / 6.0).sum()
    };
    let gap = super::RECEIVER_GAP_M;
    let exact = [
        ("oracle_box", "receiver", -4.0 * 6.0 * (3.0 + gap)),
        ("oracle_sphere", "receiver", -4.0 / 3.0 * std::f64::consts::PI),
        ("oracle_ball", "ball", 4.0 / 3.0 * std::f64::consts::PI),
        ("stairs", "stairs", 1.5 * 0.18 * 0.3 * f64::from(15 * 16 / 2)),
        ("room", "room", 5.0 * 6.0 * 3.7 - 4.0 * 5.0 * 2.9 - 0.5 * 1.5 * 1.1),
        ("crates", "crate", 1.0 - 6.0 * 0.8 * 0.8 * 0.04),
    ];
    for (example, mesh, expected) in exact {
        let found = volume(example, mesh);
        assert!((found - expected).abs() < 1e-5 * expected.abs(), "{mesh} of {example}: {found}, not {expected}");
    }
}

/// The triangles of every oracle scene, integrated without a ray, give the closed form.
#[test]
fn oracle_scenes_are_what_they_say() {
    for oracle in oracles() {
        let triangles = File::of(oracle.scene).world_triangles(|_| true);
        let (point, normal) = (DVec3::from_array(oracle.position), DVec3::from_array(oracle.normal));
        assert!((normal.length() - 1.0).abs() < 1e-12, "{}", oracle.name);
        for d in [1.0, 2.0, 30.0, 300.0, f64::INFINITY] {
            let found = ambient_obscurance(&triangles, point, normal, d);
            let expected = (oracle.expected)(d);
            println!("{:22} d = {d:5}: {found:.8}, closed form {expected:.8}, {:+.1e}", oracle.name, found - expected);
            assert!((found - expected).abs() < oracle.tolerance, "{}, d = {d}: {found} {expected}", oracle.name);
        }
    }
}

#[test]
fn oracles_have_scenes_and_receivers() {
    for o in oracles() {
        assert!(names().iter().any(|&(name, _)| name == o.scene), "{}", o.name);
        assert_eq!(oracle(o.name).map(|found| found.position), Some(o.position));
        let file = File::of(o.scene);
        let triangles = file.world_triangles(|node| node == "receiver");
        let on_axis = ["oracle_sphere_centre", "oracle_cylinder"].contains(&o.name);
        // Where the receiver is a plane the gap is exact; the sphere's corners are rounded to f32.
        let (point, normal) = (DVec3::from_array(o.position), DVec3::from_array(o.normal));
        let heights = triangles.iter().filter_map(|&corners| below(corners, point, normal));
        let nearest = heights.fold(f64::INFINITY, f64::min);
        let off = if o.scene == "oracle_sphere" { 1e-6 } else { 0.0 };
        assert_eq!((nearest - super::RECEIVER_GAP_M).abs() <= off, !on_axis, "{}: {nearest}", o.name);
    }
    assert_eq!(
        oracles().iter().map(|o| o.scene).collect::<BTreeSet<_>>(),
        names().iter().map(|&(name, _)| name).filter(|name| name.starts_with("oracle_")).collect()
    );
}

/// Distance along −normal from a point to a triangle that faces it.
fn below([a, b, c]: [DVec3; 3], point: DVec3, normal: DVec3) -> Option<f64> {
    let cross = (b - a).cross(c - a);
    let t = (point - a).dot(cross) / normal.dot(cross);
    let hit = point - t * normal;
    let inside = [(a, b), (b, c), (c, a)].iter().all(|(p, q)| (q - p).cross(hit - p).dot(cross) >= -1e-12);
    (normal.dot(cross) > 0.0 && t > 0.0 && inside).then_some(t)
}

#[test]
fn shared_meshes_are_instances() {
    let file = File::of("courtyard");
    let mut uses: BTreeMap<&str, usize> = BTreeMap::new();
    for node in file.list("nodes") {
        let mesh = file.list("meshes")[count(&node["mesh"])]["name"].as_str().unwrap();
        assert!(node["name"].as_str().unwrap().starts_with(mesh), "a node's name starts with its kind");
        *uses.entry(mesh).or_default() += 1;
    }
    for (mesh, expected) in [("arch", 5), ("pillar", 6), ("crate", 6), ("beam", 2), ("rafter", 9)] {
        assert_eq!(uses[mesh], expected, "{mesh}");
    }
}

#[test]
fn mirrored_turns_the_winding() {
    let file = File::of("mirrored");
    let determinant = |name: &str| {
        let node = file.list("nodes").iter().find(|node| node["name"] == name).unwrap();
        transform(node).matrix3.determinant()
    };
    assert!((determinant("steps_mirrored") + 1.0).abs() < 1e-6);
    assert!((determinant("steps_stretched") + 1.25).abs() < 1e-6);
}

#[test]
fn coincident_faces_come_in_pairs() {
    let file = File::of("coincident");
    let key = |f: &[DVec3; 3]| {
        let mut corners = f.map(|p| p.to_array().map(|c| (c * 1e4).round() as i64));
        corners.sort_unstable();
        corners
    };
    for (mesh, opposite) in [("sheet", true), ("crate", false)] {
        let mut facings: BTreeMap<_, Vec<DVec3>> = BTreeMap::new();
        for f in mesh_triangles(&file, mesh) {
            facings.entry(key(&f)).or_default().push((f[1] - f[0]).cross(f[2] - f[0]).normalize());
        }
        for normals in facings.values() {
            assert_eq!(normals.len(), 2);
            assert_eq!(normals[0].dot(normals[1]) < 0.0, opposite);
        }
    }
}

#[test]
fn quantized_is_the_same_crate() {
    let file = File::of("quantized");
    let mut quantized = file.world_triangles(|name| name == "crate");
    let plain = mesh_triangles(&File::of("crates"), "crate");
    assert_eq!(quantized.len(), plain.len());
    for (q, p) in quantized.iter_mut().flatten().zip(plain.iter().flatten()) {
        assert!((*q - *p).length() < 2e-5, "{q} {p}");
    }
    assert!(file.json["extensionsRequired"].as_array().unwrap().contains(&Value::from("KHR_mesh_quantization")));
}

#[test]
fn instancing_has_five_of_each() {
    let file = File::of("gpu_instancing");
    let node = file.list("nodes").iter().find(|node| node["name"] == "crates").unwrap();
    let attributes = &node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
    for (key, components) in [("TRANSLATION", 3), ("ROTATION", 4), ("SCALE", 3)] {
        let stored = file.stored(count(&attributes[key]));
        assert!(stored.len() == 5 && stored.iter().all(|v| v.len() == components), "{key}");
    }
    let unit = |q: &Vec<f64>| (q.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-6;
    assert!(file.stored(count(&attributes["ROTATION"])).iter().all(unit));
}

/// Import takes every example as it is; what it warns of is what the example is made for.
#[test]
fn imports_without_a_warning_that_is_not_meant() {
    for (name, _) in names() {
        let files = BTreeMap::from([("level.glb".to_owned(), build(name).unwrap())]);
        let import = crate::import("level.glb", &files, None, &kiln_core::BakeSettings::default()).unwrap();
        let codes: Vec<&str> = import.level.warnings.iter().map(|warning| warning.code.as_str()).collect();
        let meant: &[&str] = match *name {
            "coincident" => &["duplicate_faces"],
            _ => &[],
        };
        assert_eq!(codes, meant, "{name}");
    }
}
