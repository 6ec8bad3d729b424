//! Geometry as modelling tools leave it: slivers, repeated, opposite, crossing and broken faces.

use crate::{
    bake::{Outcome, adaptive, bake, fixed, try_bake},
    compare::{Correspondence, assert_same, clean_room, difference},
    geometry::{Surface, floor_and_wall, room},
    level::Level,
};
use glam::{DVec3, dvec3};
use kiln_core::{BakeSettings, Quality::Medium};

fn bake_room(surface: &Surface) -> Outcome {
    bake(&Level::of(surface), &adaptive(Medium, 1.0))
}

/// Every third face is cut into three at a point so close to one of its edges that one part is a sliver.
fn with_slivers(mut surface: Surface, aspect: f64) -> Surface {
    for index in (0..surface.faces.len()).step_by(3) {
        let [a, b, c] = surface.faces[index];
        let [p, q, r] = [a, b, c].map(|v| surface.positions[v as usize]);
        let middle = 0.5 * (p + q);
        let inwards = (r - middle).reject_from_normalized((q - p).normalize()).normalize();
        let m = surface.positions.len() as u32;
        surface.positions.push(middle + inwards * (p.distance(q) / aspect));
        surface.faces[index] = [a, b, m];
        surface.faces.extend([[b, c, m], [c, a, m]]);
    }
    surface
}

/// The new vertices have values of their own, so even a converged answer is not the clean mesh's; but it is no further from it
/// than that of faces cut without slivers, and how thin a sliver is makes no difference.
#[test]
fn slivers() {
    let cut = |aspect: f64| bake_room(&with_slivers(room(), aspect));
    let from_clean = |case: &Outcome| difference(clean_room(Medium), case, &Correspondence::SAME);
    let (mild, thin) = (from_clean(&cut(10.0)), cut(1e2));
    for aspect in [1e2, 1e4, 1e6] {
        let case = cut(aspect);
        assert_eq!(case.warned("degenerate_faces"), 0, "the slivers are there");
        difference(&thin, &case, &Correspondence::SAME).assert_within_error(&format!("aspect {aspect}"));
        let found = from_clean(&case);
        let is_no_further = found.rmse.iter().zip(&mild.rmse).all(|(found, mild)| *found < 1.5 * mild);
        assert!(is_no_further, "aspect {aspect}: RMSE {:.5?}, without slivers {:.5?}", found.rmse, mild.rmse);
    }
}

#[test]
fn repeated_and_degenerate_faces_and_unused_vertices_are_as_if_they_were_not_there() {
    let faces = room().faces.len() as u64;
    let mut repeated = room();
    repeated.faces.extend(room().faces.iter().map(|&[a, b, c]| [b, c, a]));
    repeated.append(&room());
    let repeated = bake_room(&repeated);
    assert_eq!(repeated.warned("duplicate_faces"), 2 * faces);
    assert_same(clean_room(Medium), &repeated, "repeated");

    let mut degenerate = room();
    degenerate.faces.extend(room().faces.iter().flat_map(|&[a, b, _]| [[a, a, b], [b, b, b]]));
    degenerate.faces.extend((0..7).map(|i| [i, i + 1, i + 2]));
    let degenerate = bake_room(&degenerate);
    assert_eq!(degenerate.warned("degenerate_faces"), 2 * faces + 7);
    assert_same(clean_room(Medium), &degenerate, "degenerate");

    let mut unused = room();
    unused.positions.extend([DVec3::splat(1e6), DVec3::ZERO, DVec3::NAN]);
    let unused = bake_room(&unused);
    assert_eq!(unused.warned("unreferenced_vertices"), 3);
    assert_same(clean_room(Medium), &unused, "unused");
}

#[test]
fn the_same_mesh_twice_at_one_place() {
    let mut level = Level::of(&room());
    level.node(0, serde_json::json!({}));
    let twice = bake(&level, &fixed(32));
    let once = bake(&Level::of(&room()), &fixed(32));
    // Faces that coincide do not hide one another: the same samples find the same.
    assert_same(&once, &twice, "twice");
    assert_eq!(twice.scene.parts[0].ao, twice.scene.parts[1].ao);
}

#[test]
fn coincident_opposite_faces() {
    let canopy = Surface::sheet(dvec3(0.5, 1.0, 0.5), DVec3::Z * 2.0, DVec3::X * 2.0, [4, 4]);
    let level = |gap_m: f64| {
        let mut surface = floor_and_wall();
        surface.append(&canopy);
        surface.append(&canopy.flipped().map(|p| p - DVec3::Y * gap_m));
        surface
    };
    // A sheet as thin as a hair has the same answer, but for 10⁻⁴ of a half-distance.
    let thin = bake_room(&level(5e-5));
    difference(&thin, &bake_room(&level(0.0)), &Correspondence::SAME).assert_within_error("opposite");
}

#[test]
fn interpenetrating_boxes() {
    // Sunk half a metre into the floor, against the same surface without what is hidden.
    let is_under = |p: DVec3| p.y == 0.0 && p.x.clamp(1.0, 2.0) == p.x && p.z.clamp(1.0, 2.0) == p.z;
    let (mut sunk, mut standing) = (floor_and_wall(), floor_and_wall().filtered(|p| !is_under(p)));
    sunk.append(&box_from(-0.5));
    standing.append(&box_from(0.0));
    let (clean, case) = (bake_room(&standing), bake_room(&sunk));
    difference(&clean, &case, &Correspondence::SAME).assert_within_error("sunk");
}

/// The sides and top of a box of 1 × 1 m up to 1 m, in cells of half a metre from its lowest edge on.
fn box_from(lowest: f64) -> Surface {
    let rows = ((1.0 - lowest) * 2.0).round() as u32;
    let up = DVec3::Y * (1.0 - lowest);
    let corners = [(1.0, 2.0, DVec3::X), (2.0, 2.0, -DVec3::Z), (2.0, 1.0, -DVec3::X), (1.0, 1.0, DVec3::Z)];
    let mut surface = Surface::sheet(dvec3(1.0, 1.0, 1.0), DVec3::Z, DVec3::X, [2, 2]);
    for (x, z, along) in corners {
        surface.append(&Surface::sheet(dvec3(x, lowest, z), along, up, [2, rows]));
    }
    surface
}

#[test]
fn edges_of_many_faces() {
    // Each square of the floor is there with both of its diagonals: edges have up to four faces.
    let mut crossed = room();
    let floor = floor_and_wall().filtered(|p| p.y == 0.0);
    for pair in floor.faces.chunks_exact(2) {
        let ([a, b, d], [_, _, c]) = (pair[0], pair[1]);
        crossed.faces.extend([[a, b, c], [b, d, c]]);
    }
    difference(clean_room(Medium), &bake_room(&crossed), &Correspondence::SAME).assert_within_error("crossed");
}

/// Six fins around a vertical axis; they share the axis' vertices, or have their own.
fn fan(is_shared: bool) -> Surface {
    let mut fan = Surface::sheet(dvec3(-2.0, 0.0, -2.0), DVec3::Z * 4.0, DVec3::X * 4.0, [8, 8]);
    let mut axis = None;
    for fin in 0..6u32 {
        let along = glam::DQuat::from_rotation_y(f64::from(fin).mul_add(1.047, 0.1)) * DVec3::X;
        let first = fan.positions.len() as u32;
        fan.append(&Surface::sheet(DVec3::Y * 0.25, along, DVec3::Y, [4, 4]));
        let axis = *axis.get_or_insert(first);
        if is_shared {
            let on_axis = |v: u32| v >= first && (v - first).is_multiple_of(5);
            let shared = |v: u32| if on_axis(v) { axis + (v - first) } else { v };
            fan.faces.iter_mut().for_each(|face| *face = face.map(shared));
        }
    }
    fan
}

#[test]
fn fans_around_one_edge() {
    let settings = adaptive(Medium, 1.0);
    let clean = bake(&Level::double_sided(&fan(false)), &settings);
    let case = bake(&Level::double_sided(&fan(true)), &settings);
    // The axis itself has one value where the clean one has six; a cell away nothing is left of that.
    let by = Correspondence { counts: &|p| p.with_y(0.0).length() > 0.3, ..Correspondence::SAME };
    difference(&clean, &case, &by).assert_within_error("fan");
}

#[test]
fn windings_of_a_double_sided_surface_do_not_matter() {
    let mut mixed = room();
    mixed.faces.iter_mut().step_by(3).for_each(|face| face.swap(1, 2));
    let settings = adaptive(Medium, 1.0);
    let clean = bake(&Level::double_sided(&room()), &settings);
    let mixed = bake(&Level::double_sided(&mixed), &settings);
    // Vertex by vertex in the order of the file: the normals that tell them apart are what is mixed up.
    let pairs = || clean.scene.parts[0].ao.iter().zip(&mixed.scene.parts[0].ao);
    let rmse = (pairs().map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / pairs().count() as f64).sqrt();
    let expected = clean.summary.error.iter().zip(&mixed.summary.error).map(|(a, b)| a.rmse.hypot(b.rmse));
    let limit = 3.0 * expected.fold(0.0, f64::max);
    assert!(rmse <= limit, "{rmse}, at most {limit}");
}

#[test]
fn positions_that_are_not_numbers_are_refused_or_dropped() {
    for bad in [f64::NAN, f64::INFINITY] {
        let mut broken = room();
        let first = broken.positions.len() as u32;
        broken.positions.push(dvec3(0.0, bad, 0.0));
        broken.faces.extend([[0, 1, first], [first, 2, 3]]);
        let level = Level::of(&broken);
        let refusal = try_bake(&level, &adaptive(Medium, 1.0)).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(refusal.contains("meshes[0]") && refusal.contains("--drop-bad-faces"), "{refusal}");
        let settings = BakeSettings { drop_bad_faces: true, ..adaptive(Medium, 1.0) };
        let dropped = bake(&level, &settings);
        assert_eq!(dropped.warned("non_finite_faces"), 2);
        assert_same(clean_room(Medium), &dropped, "dropped");
    }
}
