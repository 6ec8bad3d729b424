//! What must not harm the solve: bad geometry, few samples, many components. Each against the clean mesh's answer.

mod shapes;

use glam::{DAffine3, DVec3};
use kiln_core::{ComponentMethod, FaceMoments, Mesh};
use kiln_solve::{SolveError, SolveInput, SolverParams};
use shapes::*;

fn wave(p: DVec3) -> f64 {
    0.5 + 0.3 * (0.4 * p.x + 0.3).sin() * (0.3 * p.y - 0.4).cos()
}

fn wave_samples(mesh: &Mesh) -> FaceMoments {
    quadrature(mesh, wave)
}

fn clean() -> Mesh {
    grid(&steps(12), &steps(12))
}

fn add_face(mesh: &mut Mesh, face: [u32; 3]) {
    mesh.faces.push(face);
    mesh.face_group.push(0);
}

fn add_vertex(mesh: &mut Mesh, position: [f32; 3]) -> u32 {
    mesh.positions.push(position);
    mesh.normals.push([0.0; 3]);
    mesh.positions.len() as u32 - 1
}

#[test]
fn faces_without_area_do_nothing() {
    let base = solve(&clean(), &wave_samples(&clean()), &settings(1.0, 1e-3));
    let mut mesh = clean();
    let lonely = add_vertex(&mut mesh, [3.0, 3.0, 0.0]);
    add_face(&mut mesh, [0, 1, 1]);
    add_face(&mut mesh, [0, 1, 2]);
    add_face(&mut mesh, [lonely, lonely, 39]);
    let found = solve(&mesh, &wave_samples(&mesh), &settings(1.0, 1e-3));
    assert_eq!(found.values[..144], base.values[..]);
    // The vertex of nothing but such a face has the value of the one at its place.
    assert_eq!(found.values[144], base.values[39]);
}

#[test]
fn repeated_faces_change_little() {
    let base = solve(&clean(), &wave_samples(&clean()), &settings(1.0, 1e-3));
    let mut mesh = clean();
    for face in [5, 60, 61, 62, 200] {
        let [a, b, c] = mesh.faces[face];
        add_face(&mut mesh, [b, c, a]);
    }
    let found = solve(&mesh, &wave_samples(&mesh), &settings(1.0, 1e-3));
    assert!(distance(found.values, base.values) < 0.01);
}

#[test]
fn vertices_of_no_face_have_the_nearest_value() {
    let mut mesh = clean();
    let base = solve(&mesh, &wave_samples(&mesh), &settings(1.0, 1e-3));
    add_vertex(&mut mesh, [4.1, 6.9, 5.0]);
    add_vertex(&mut mesh, [1e9, 1e9, 0.0]);
    let found = solve(&mesh, &wave_samples(&mesh), &settings(1.0, 1e-3));
    assert_eq!(found.values[..144], base.values[..]);
    assert_eq!(found.values[144..], [base.values[4 * 12 + 7], base.values[143]]);
}

#[test]
fn faces_that_do_not_receive_take_no_part() {
    let mut mesh = clean();
    let base = solve(&mesh, &wave_samples(&mesh), &settings(1.0, 1e-3));
    let mut group = mesh.groups[0].clone();
    group.receives = false;
    mesh.groups.push(group);
    let far = add_vertex(&mut mesh, [-5.0, 0.2, 0.0]);
    add_face(&mut mesh, [0, 1, far]);
    *mesh.face_group.last_mut().unwrap() = 1;
    let found = solve(&mesh, &wave_samples(&mesh), &settings(1.0, 1e-3));
    assert_eq!(found.values[..144], base.values[..]);
    assert_eq!(found.values[144], base.values[0]);
    assert_eq!(found.summary.visible_area_m2, base.summary.visible_area_m2);
}

#[test]
fn slivers_neither_harm_nor_slow() {
    let solvers = by_conjugate_gradients(1e-6);
    let solve = |mesh: &Mesh| solve_at(mesh, &wave_samples(mesh), &settings(1.0, 1e-3), DAffine3::IDENTITY, &solvers);
    let base = solve(&clean());
    for aspect in [1e2, 1e4, 1e6] {
        // A column of slivers, needles and caps, between columns 5 and 6: 5 + 1/aspect.
        let mut xs = steps(12);
        xs.insert(6, 5.0 + 1.0 / aspect);
        let mut mesh = grid(&xs, &steps(12));
        // Skewed: the thin column is shifted along itself, so the needles lean.
        mesh.positions[72..84].iter_mut().for_each(|p| p[1] += 0.37);
        let found = solve(&mesh);
        let kept = found.values[..72].iter().chain(&found.values[84..]);
        let off = distance(kept.copied(), base.values.iter().copied());
        assert!(off < 0.03, "aspect {aspect}: {off}");
        let iterations = (found.summary.iterations, base.summary.iterations);
        assert!(iterations.0 <= 2 * iterations.1, "aspect {aspect}: {iterations:?}");
        assert_eq!(found.summary.methods, [(ComponentMethod::Pcg, 1)]);
    }
}

#[test]
fn all_slivers_neither_harm_nor_slow() {
    let solvers = by_conjugate_gradients(1e-6);
    let iterations = |aspect: f32| {
        let mesh = grid(&steps(12), &steps(12).iter().map(|y| y / aspect).collect::<Vec<_>>());
        let samples = quadrature(&mesh, |p| wave(p * DVec3::new(1.0, f64::from(aspect), 1.0)));
        let solution = solve_at(&mesh, &samples, &settings(1.0, 1e-3), DAffine3::IDENTITY, &solvers);
        let off = distance_from(&mesh, &solution, |p| wave(p * DVec3::new(1.0, f64::from(aspect), 1.0)));
        assert!(off < 0.08, "aspect {aspect}: {off}");
        solution.summary.iterations
    };
    let base = iterations(1.0);
    for aspect in [1e2, 1e4, 1e6] {
        assert!(iterations(aspect) <= 2 * base, "aspect {aspect}");
    }
}

#[test]
fn two_scales_in_one_mesh() {
    let mut mesh = clean();
    let samples = |mesh: &Mesh| moments(mesh, 6, |s| Some(0.5 + 0.3 * noise(s.point.x.to_bits() ^ s.number)));
    let base = solve(&mesh, &samples(&mesh), &settings(1.0, 1e-3));
    let small = 1.0 / 1_048_576.0;
    let copies = mesh.positions.iter().map(|p| [p[0] * small, p[1] * small, 0.0]).collect::<Vec<_>>();
    let mut both = mesh.clone();
    both.positions.extend(copies.iter().map(|p| [p[0] * 16_777_216.0 - 900.0, p[1] * 16_777_216.0, 3.0]));
    mesh.positions = copies;
    let alone = solve(&mesh, &samples(&mesh), &settings(1.0, 1e-3));
    both.normals.resize(288, [0.0; 3]);
    both.faces.extend_from_within(..);
    both.faces[242..].iter_mut().flatten().for_each(|v| *v += 144);
    both.face_group.resize(484, 0);
    both.positions[..144].copy_from_slice(&mesh.positions);
    let found = solve(&both, &samples(&both), &settings(1.0, 1e-3));
    assert!(distance(found.values[..144].iter().copied(), alone.values) <= 1e-6);
    assert_eq!(found.summary.components, 2);
    assert_eq!(base.values.len(), 144);
}

#[test]
fn fans_windings_and_a_moebius_strip() {
    let near = |mesh: &Mesh, what: &str| {
        let solution = solve(mesh, &wave_samples(mesh), &settings(1.0, 1e-3));
        let off = distance_from(mesh, &solution, wave);
        assert!(off < 0.05, "{what}: {off}");
        solution
    };
    near(&clean(), "clean");
    let mut turned = clean();
    turned.faces.iter_mut().step_by(3).for_each(|f| f.swap(1, 2));
    near(&turned, "every third face turned");
    let mut fan = clean();
    for (i, row) in (60..71).enumerate() {
        let tip = add_vertex(&mut fan, [5.0 + i as f32 * 0.01, 0.5 + i as f32, 1.0]);
        add_face(&mut fan, [row, row + 1, tip]);
        add_face(&mut fan, [row, tip, row + 1]);
    }
    near(&fan, "fans");
    let turns = 48u32;
    let mut strip = mesh(Vec::new(), Vec::new());
    for i in 0..turns {
        let angle = f64::from(i) / f64::from(turns) * std::f64::consts::TAU;
        for side in [-1.0, 1.0] {
            let r = 4.0 + side * (0.5 * angle).cos();
            let p = [r * angle.cos(), r * angle.sin(), side * (0.5 * angle).sin()];
            add_vertex(&mut strip, p.map(|x| x as f32));
        }
    }
    for i in 0..turns {
        let next = |k: u32| if i + 1 == turns { 1 - k } else { 2 * i + 2 + k };
        add_face(&mut strip, [2 * i, next(0), 2 * i + 1]);
        add_face(&mut strip, [2 * i + 1, next(0), next(1)]);
    }
    assert_eq!(near(&strip, "Möbius strip").summary.unknowns, 96);
}

#[test]
fn invalid_samples_are_no_loss() {
    let mesh = clean();
    let base = solve(&mesh, &moments(&mesh, 6, |s| Some(wave(s.point))), &settings(1.0, 1e-3));
    let dropped = moments(&mesh, 6, |s| (noise(s.point.x.to_bits()) >= 0.1).then(|| wave(s.point)));
    let found = solve(&mesh, &dropped, &settings(1.0, 1e-3));
    assert!(distance(found.values, base.values) < 0.03);
}

#[test]
fn a_hole_is_filled_smoothly() {
    let n = 24u32;
    let mesh = grid(&steps(n), &steps(n));
    let slope = |p: DVec3| 0.2 + 0.02 * p.x;
    let in_hole = |p: DVec3| (8.0..16.0).contains(&p.x) && (8.0..16.0).contains(&p.y);
    let samples = moments(&mesh, 6, |s| (!in_hole(s.point)).then(|| slope(s.point)));
    for solvers in [SolverParams::default(), by_conjugate_gradients(1e-9)] {
        let found = solve_at(&mesh, &samples, &settings(1.0, 1e-3), DAffine3::IDENTITY, &solvers);
        let off = distance_from(&mesh, &found, slope);
        assert!(off < 0.02, "{off}");
        // No step between neighbours is larger than a few times the slope's own.
        let at = |i: u32, j: u32| found.values[(i * n + j) as usize];
        for (i, j) in (7..17).flat_map(|i| (7..17).map(move |j| (i, j))) {
            let steps = [at(i + 1, j) - at(i, j) - 0.02, at(i, j + 1) - at(i, j)];
            assert!(steps.iter().all(|s| s.abs() < 0.02), "{i}, {j}: {steps:?}");
        }
    }
}

#[test]
fn a_patch_without_samples_that_hangs_by_a_vertex() {
    // Without an edge in common the regulariser does not reach it: only constants and slopes are free there.
    for alpha in [0.0, 1.0] {
        let mut mesh = clean();
        let [a, b, c] = [[12.0, 12.0, 0.0], [12.0, 13.0, 0.0], [13.0, 12.0, 1.0]].map(|p| add_vertex(&mut mesh, p));
        add_face(&mut mesh, [143, a, b]);
        add_face(&mut mesh, [a, c, b]);
        let samples = moments(&mesh, 6, |s| (s.face < 242).then(|| wave(s.point)));
        let found = solve(&mesh, &samples, &settings(alpha, 1e-3));
        assert!(found.values[144..].iter().all(|v| (v - found.values[143]).abs() < 0.05), "{:?}", &found.values[143..]);
        assert_eq!(found.summary.components, 1);
    }
}

#[test]
fn pairs_of_triangles_with_one_sample_each() {
    for seed in 0..200 {
        let mesh = grid(&[0.0, 1.0], &[0.0, 1.0]);
        let samples = moments(&mesh, 1, |s| Some(noise(seed * 2 + s.face as u64)));
        let found = solve(&mesh, &samples, &settings(1.0, 1e-3));
        let [low, high] = [0, 1].map(|f| noise(seed * 2 + f) as f32);
        let (low, high) = (low.min(high), low.max(high));
        // Overshoot of the fit is bounded by its range.
        let margin = high - low + 1e-6;
        assert!(found.values.iter().all(|v| (low - margin..=high + margin).contains(v)), "{:?}", found.values);
        assert_eq!(found.summary.methods, [(ComponentMethod::Dense, 1)]);
    }
}

#[test]
fn components_without_samples_take_the_nearest_surface() {
    let mut mesh = clean();
    for p in [[30.0, 11.0, 0.0], [31.0, 11.0, 0.0], [30.0, 12.0, 0.0]] {
        add_vertex(&mut mesh, p);
    }
    add_face(&mut mesh, [144, 145, 146]);
    let samples = moments(&mesh, 6, |s| (s.face < 242).then(|| wave(s.point)));
    let found = solve(&mesh, &samples, &settings(1.0, 1e-3));
    assert_eq!(found.values[144..], [found.values[143]; 3]);
    assert_eq!(found.summary.methods, [(ComponentMethod::Pcg, 1), (ComponentMethod::Filled, 1)]);
    assert!(!found.unsampled);
}

#[test]
fn an_instance_without_samples_says_so() {
    let mesh = clean();
    let found = solve(&mesh, &moments(&mesh, 2, |_| None), &settings(1.0, 1e-3));
    assert!(found.unsampled && found.values.iter().all(|v| *v == 1.0));
    assert_eq!(found.summary.methods, [(ComponentMethod::Filled, 1)]);
    let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 0.0));
    let params = SolverParams::default();
    let found = solve_at(&mesh, &wave_samples(&mesh), &settings(1.0, 1e-3), flat, &params);
    assert!(found.unsampled && found.summary.visible_area_m2 == 0.0);
    let empty = solve(&mesh_of_nothing(), &FaceMoments::new(2), &settings(1.0, 1e-3));
    assert!(empty.unsampled && empty.values.is_empty() && empty.summary.error.len() == 2);
}

fn mesh_of_nothing() -> Mesh {
    mesh(Vec::new(), Vec::new())
}

#[test]
fn ten_thousand_components_of_one_triangle() {
    let corners = (0..10_000u32).flat_map(|i| [(0.0, 0.0), (0.4, 0.0), (0.0, 0.4)].map(|(dx, dy)| (i, dx, dy)));
    let positions = corners.map(|(i, dx, dy)| [(i % 100) as f32 + dx, (i / 100) as f32 + dy, 0.0]).collect();
    let mesh = mesh(positions, (0..10_000).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect());
    let value = |s: &Sample| Some(noise(s.face as u64));
    let found = solve(&mesh, &moments(&mesh, 2, value), &settings(1.0, 1e-3));
    assert_eq!(found.summary.methods, [(ComponentMethod::Dense, 10_000)]);
    let expected = (0..30_000).map(|v| noise(v / 3) as f32);
    // The moments are rounded to f32, and two samples leave a direction to the tenth of the mass that is analytic.
    assert!(distance(found.values, expected) < 1e-5);
}

#[test]
fn one_vertex_of_ten_thousand_faces() {
    let n = 10_000u32;
    let rim = (0..n).map(|i| f64::from(i) / f64::from(n) * std::f64::consts::TAU);
    let mut positions = vec![[0.0; 3]];
    positions.extend(rim.map(|angle| [(9.0 * angle.cos()) as f32, (9.0 * angle.sin()) as f32, 0.0]));
    let mesh = mesh(positions, (0..n).map(|i| [0, 1 + i, 1 + (i + 1) % n]).collect());
    let cone = |p: DVec3| 0.9 - 0.05 * p.length();
    let samples = quadrature(&mesh, cone);
    for solvers in [SolverParams::default(), SolverParams { sparse_limit: 100_000, ..SolverParams::default() }] {
        let found = solve_at(&mesh, &samples, &settings(1.0, 1e-3), DAffine3::IDENTITY, &solvers);
        let off = distance_from(&mesh, &found, cone);
        assert!(off < 0.05, "{off}");
    }
}

#[test]
fn input_that_does_not_fit_is_refused() {
    let good = clean();
    let samples = wave_samples(&good);
    let refused = |change: &dyn Fn(&mut Mesh), settings: kiln_core::SolveSettings| {
        let mut mesh = clean();
        change(&mut mesh);
        let input =
            SolveInput { mesh: &mesh, world_from_object: DAffine3::IDENTITY, moments: &samples, settings: &settings };
        kiln_solve::solve(&input).unwrap_err()
    };
    let usual = || settings(1.0, 1e-3);
    let count = refused(&|m| add_face(m, [0, 1, 2]), usual());
    assert_eq!(count, SolveError::FaceCount { faces: 243, moments: 242 });
    let index = refused(&|m| m.faces[7] = [0, 1, 144], usual());
    assert_eq!(index, SolveError::Index { face: 7, what: "vertex", index: 144, count: 144 });
    let group = refused(&|m| m.face_group[3] = 1, usual());
    assert_eq!(group, SolveError::Index { face: 3, what: "group", index: 1, count: 1 });
    let normals = refused(&|m| m.normals.clear(), usual());
    assert_eq!(normals, SolveError::Length { what: "normals", found: 0, expected: 144 });
    assert_eq!(refused(&|m| m.positions[5][1] = f32::NAN, usual()), SolveError::Position { vertex: 5 });
    let setting = refused(&|_| (), settings(-1.0, 1e-3));
    assert_eq!(setting, SolveError::Setting { setting: "regularization", value: -1.0 });
}
