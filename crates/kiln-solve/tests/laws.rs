//! Laws of the whole solve: what it must reproduce, what must not change it, and a second way to the same answer.

mod shapes;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use kiln_core::{ComponentMethod, FaceMoments, HalfMoments, Mesh};
use kiln_solve::{
    ComponentSystem, SolverParams,
    assemble::Assembly,
    components::{Components, assembly_system},
    dense,
    edges::Edges,
    frame::Frame,
    pcg,
    pcg::PcgParams,
    sparse,
    surface::Surface,
    weld::Weld,
};
use proptest::prelude::*;
use shapes::*;

fn linear(p: DVec3) -> f64 {
    0.3 + 0.02 * p.x + 0.03 * p.y
}

fn wave(p: DVec3) -> f64 {
    0.5 + 0.4 * (0.9 * p.x + 0.3).sin() * (0.7 * p.y - 0.4).cos() * (0.8 * p.z).cos()
}

/// A wave that two samples of one place see differently.
fn noisy(s: &Sample) -> Option<f64> {
    let key = s.point.to_array().iter().fold(1, |k: u64, x| k.wrapping_mul(31) ^ x.to_bits());
    Some((wave(s.point) + 0.1 * (noise(key) - 0.5)).clamp(0.0, 1.0))
}

#[test]
fn constants_stay() {
    let mesh = jittered(9);
    for value in [0.0, 0.37, 1.0] {
        let solution = solve(&mesh, &moments(&mesh, 3, |_| Some(value)), &settings(1.0, 1e-3));
        assert!(distance_from(&mesh, &solution, |_| value) <= 2e-7);
        assert!(solution.summary.error[0].max <= 2e-7, "{:?}", solution.summary.error);
    }
}

#[test]
fn linear_functions_stay_with_any_weight_of_the_regulariser() {
    let mesh = jittered(9);
    for alpha in [0.0, 0.1, 1.0, 30.0] {
        let solution = solve(&mesh, &quadrature(&mesh, linear), &settings(alpha, 0.0));
        let off = distance_from(&mesh, &solution, linear);
        assert!(off <= 2e-6, "alpha {alpha}: {off}");
    }
    // The anchor pulls towards averages, which are not linear; by a thousandth of what they are off.
    let anchored = solve(&mesh, &quadrature(&mesh, linear), &settings(1.0, 1e-3));
    assert!(distance_from(&mesh, &anchored, linear) <= 1e-4);
}

#[test]
fn what_few_samples_miss_of_linear_functions_falls_with_their_number() {
    let mesh = jittered(20);
    let gentle = |p: DVec3| 0.2 + 0.01 * p.x + 0.02 * p.y;
    let off = |count| {
        let solution = solve(&mesh, &moments(&mesh, count, |s| Some(gentle(s.point))), &settings(1.0, 1e-3));
        surface_rmse(&mesh, |v| f64::from(solution.values[v]) - gentle(DVec3::from(mesh.positions[v].map(f64::from))))
    };
    // A face spans about 0.02 of the function.
    let (few, many) = (off(2), off(128));
    assert!(few <= 0.005 && many <= few / 4.0, "{few}, {many}");
}

/// Root of the mean over the surface of the square of a function that is linear over faces.
fn surface_rmse(mesh: &Mesh, at: impl Fn(usize) -> f64) -> f64 {
    let (mut total, mut whole) = (0.0, 0.0);
    for (face, vertices) in mesh.faces.iter().enumerate() {
        let [a, b, c] = vertices.map(|v| at(v as usize));
        total += area(mesh, face) * (a * a + b * b + c * c + a * b + b * c + c * a) / 6.0;
        whole += area(mesh, face);
    }
    f64::sqrt(total / whole)
}

#[test]
fn the_unfolding_makes_a_bent_sheet_as_good_as_a_flat_one() {
    // Folded by 70° along a line of edges: no face is bent, so the function is linear over the unfolded sheet.
    let straight = grid(&steps(9), &steps(9));
    let mut bent = straight.clone();
    let fold = |p: [f32; 3]| {
        let (sin, cos) = 70f32.to_radians().sin_cos();
        let beyond = (p[0] - 4.0).max(0.0);
        [p[0].min(4.0) + cos * beyond, p[1], sin * beyond]
    };
    bent.positions.iter_mut().for_each(|p| *p = fold(*p));
    let solution = solve(&bent, &quadrature(&straight, linear), &settings(1.0, 0.0));
    assert!(distance_from(&straight, &solution, linear) <= 2e-6);
}

#[test]
fn the_halves_tell_the_error() {
    let mesh = jittered(30);
    let solution = solve(&mesh, &moments(&mesh, 4, noisy), &settings(1.0, 1e-3));
    let converged = solve(&mesh, &moments(&mesh, 1000, |s| Some(wave(s.point))), &settings(1.0, 1e-3));
    let rmse = surface_rmse(&mesh, |v| f64::from(solution.values[v] - converged.values[v]));
    let told = solution.summary.error[0].clone();
    assert!((0.7..1.4).contains(&(told.rmse / rmse)), "told {told:?}, is {rmse}");
    assert!(told.rmse < told.p99 && told.p99 < told.max, "{told:?}");
}

#[test]
fn scale_and_placement_do_not_matter() {
    let mesh = jittered(12);
    let moments = moments(&mesh, 4, noisy);
    let at = |transform| solve_at(&mesh, &moments, &settings(1.0, 1e-3), transform, &SolverParams::default());
    let base = at(DAffine3::IDENTITY);
    for scale in [1e-3, 1e4, 1e-30, 1e60] {
        let scaled = at(DAffine3::from_scale(DVec3::splat(scale)));
        assert!(distance(scaled.values.iter().copied(), base.values.iter().copied()) <= 1e-6);
        let area = scaled.summary.visible_area_m2 / base.summary.visible_area_m2 / (scale * scale);
        assert!((area - 1.0).abs() <= 1e-12, "{area}");
    }
    let turned = at(DAffine3::from_quat(DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.0)));
    assert!(distance(turned.values.iter().copied(), base.values.iter().copied()) <= 1e-6);
    let mirrored = at(DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)));
    assert!(distance(mirrored.values.iter().copied(), base.values.iter().copied()) <= 1e-6);
    let moved = at(DAffine3::from_translation(DVec3::new(1e7, -3e7, 1e7)));
    assert_eq!(moved.values, base.values);
}

#[test]
fn order_does_not_matter() {
    let mesh = jittered(12);
    let base = solve(&mesh, &moments(&mesh, 4, noisy), &settings(1.0, 1e-3));
    let mut order: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    order.sort_by_key(|v| noise(u64::from(*v)).to_bits());
    let mut other = mesh.clone();
    other.positions = order.iter().map(|v| mesh.positions[*v as usize]).collect();
    let mut place = order.clone();
    order.iter().zip(0..).for_each(|(v, at)| place[*v as usize] = at);
    other.faces = mesh.faces.iter().rev().map(|[a, b, c]| [*b, *c, *a].map(|v| place[v as usize])).collect();
    let found = solve(&other, &moments(&other, 4, noisy), &settings(1.0, 1e-3));
    let back = place.iter().map(|at| found.values[*at as usize]);
    assert!(distance(back, base.values.iter().copied()) <= 1e-6);
}

#[test]
fn threads_change_no_bit() {
    let mut mesh = jittered(80);
    let shift = mesh.positions.len() as u32;
    let small = jittered(20);
    mesh.positions.extend(small.positions.iter().map(|p| [p[0], p[1], 9.0]));
    mesh.normals.resize(mesh.positions.len(), [0.0; 3]);
    mesh.faces.extend(small.faces.iter().map(|f| f.map(|v| v + shift)));
    mesh.face_group.resize(mesh.faces.len(), 0);
    let moments = moments(&mesh, 2, noisy);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let params = SolverParams { sparse_limit: 1000, ..SolverParams::default() };
        pool.install(|| solve_at(&mesh, &moments, &settings(1.0, 1e-3), DAffine3::IDENTITY, &params))
    };
    let one = with(1);
    assert_eq!(one.summary.methods, [(ComponentMethod::Sparse, 1), (ComponentMethod::Pcg, 1)]);
    assert_eq!(one, with(2));
    assert_eq!(one, with(2));
}

#[test]
fn seams_do_not_show_and_hard_edges_stay() {
    // Two halves of a grid that share positions but no vertex, with a step of the signal between them.
    let step = |x: f64| if x < 3.0 { 0.2 } else { 0.8 };
    let mut mesh = grid(&steps(7), &steps(4));
    let seam: Vec<u32> = (12..16).collect();
    let copies = mesh.positions.len() as u32;
    for v in &seam {
        mesh.positions.push(mesh.positions[*v as usize]);
    }
    mesh.normals = vec![[0.0, 0.0, 1.0]; mesh.positions.len()];
    for face in 18..36 {
        mesh.faces[face] = mesh.faces[face].map(|v| seam.iter().position(|s| *s == v).map_or(v, |i| copies + i as u32));
    }
    let samples = moments(&mesh, 8, |s| Some(step(s.point.x)));
    let welded = solve(&mesh, &samples, &settings(1.0, 1e-3));
    assert_eq!(welded.values[12..16], welded.values[copies as usize..]);
    assert_eq!(welded.summary.unknowns, 28);
    for v in copies..copies + 4 {
        mesh.normals[v as usize] = [1.0, 0.0, 0.0];
    }
    let hard = solve(&mesh, &samples, &settings(1.0, 1e-3));
    assert!(distance(hard.values[12..16].iter().copied(), [0.2; 4]) < 1e-6);
    assert!(distance(hard.values[copies as usize..].iter().copied(), [0.8; 4]) < 1e-6);
}

/// A system over few vertices built from the definition, with samples one by one and every edge by search, and
/// solved by elimination with pivoting.
struct Definition {
    a: Vec<Vec<f64>>,
    b: Vec<f64>,
}

impl Definition {
    fn new(mesh: &Mesh, count: u64, f: &dyn Fn(&Sample) -> Option<f64>, alpha: f64, mu: f64) -> Self {
        let n = mesh.positions.len();
        let mut this = Self { a: vec![vec![0.0; n]; n], b: vec![0.0; n] };
        // Weighted samples: each half weighs the face's area, the mean of the halves that have valid samples.
        let mut weighted: Vec<([usize; 3], [f64; 3], f64, f64)> = Vec::new();
        let mut hidden: Vec<(usize, usize, f64)> = Vec::new();
        for face in 0..mesh.faces.len() {
            let corners = mesh.faces[face].map(|v| v as usize);
            let all: Vec<_> = samples(mesh, face, count).collect();
            let sizes = [0, 1].map(|half| all.iter().filter(|s| s.number % 2 == half).count());
            let halves = sizes.iter().filter(|size| **size > 0).count();
            let mut visible = 0.0;
            for s in all {
                let Some(value) = f(&s) else { continue };
                let weight = area(mesh, face) / (halves * sizes[s.number as usize % 2]) as f64;
                visible += weight;
                weighted.push((corners, s.phi, value, weight));
                for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                    this.a[corners[i]][corners[j]] += 0.9 * weight * s.phi[i] * s.phi[j];
                }
            }
            for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                this.a[corners[i]][corners[j]] += 0.1 * visible / if i == j { 6.0 } else { 12.0 };
                let membrane = 0.01 * (area(mesh, face) - visible) / 3.0;
                hidden.push((corners[i], corners[j], if i == j { 2.0 * membrane } else { -membrane }));
            }
        }
        let mut weight = vec![0.0; n];
        let mut x0 = vec![0.0; n];
        for (corners, phi, value, w) in &weighted {
            for i in 0..3 {
                weight[corners[i]] += w * phi[i];
                x0[corners[i]] += w * phi[i] * value;
            }
        }
        x0.iter_mut().zip(&weight).filter(|(_, w)| **w > 0.0).for_each(|(x, w)| *x /= w);
        for i in 0..n {
            this.b[i] = (0..n).map(|j| this.a[i][j] * x0[j]).sum::<f64>() + mu * weight[i] * x0[i];
            this.a[i][i] += if weight[i] > 0.0 { mu * weight[i] } else { 1.0 };
        }
        for (corners, phi, value, w) in weighted {
            let g: f64 = (0..3).map(|i| phi[i] * x0[corners[i]]).sum();
            (0..3).for_each(|i| this.b[corners[i]] += w * phi[i] * (value - g));
        }
        hidden.into_iter().for_each(|(i, j, weight)| this.a[i][j] += weight);
        this.add_edges(mesh, alpha);
        this
    }

    fn add_edges(&mut self, mesh: &Mesh, alpha: f64) {
        let n = mesh.positions.len();
        let at = |v: usize| DVec3::from(mesh.positions[v].map(f64::from));
        let opposite = |from: usize, to: usize| -> Vec<(usize, usize)> {
            let turns = |f: [u32; 3]| [[f[0], f[1], f[2]], [f[1], f[2], f[0]], [f[2], f[0], f[1]]];
            let sides = mesh.faces.iter().enumerate().flat_map(|(i, f)| turns(*f).map(|t| (i, t.map(|v| v as usize))));
            sides.filter(|(_, t)| (t[0], t[1]) == (from, to)).map(|(i, t)| (i, t[2])).collect()
        };
        for (a, b) in (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))) {
            let ([(f1, c)], [(f2, d)]) = (&opposite(a, b)[..], &opposite(b, a)[..]) else { continue };
            if c == d {
                continue;
            }
            let [pa, pb, pc, pd] = [a, b, *c, *d].map(at);
            let along = pb - pa;
            let extent = [along.length(), pa.distance(pc), pb.distance(pc), pa.distance(pd), pb.distance(pd)];
            let extent = extent.into_iter().fold(0.0, f64::max);
            // The gradient of each triangle across the edge, from the corner's height and foot.
            let (a1, a2) = (area(mesh, *f1), area(mesh, *f2));
            let mut row = vec![0.0; n];
            for (corner, point, face_area) in [(*c, pc, a1), (*d, pd, a2)] {
                let foot = (point - pa).dot(along) / along.length_squared();
                let height = (2.0 * face_area / along.length()).max(0.1 * extent);
                row[corner] += 1.0 / height;
                row[a] -= (1.0 - foot) / height;
                row[b] -= foot / height;
            }
            row.iter_mut().for_each(|r| *r *= (a1 + a2) / 3.0);
            for i in 0..n {
                (0..n).for_each(|j| self.a[i][j] += alpha * row[i] * row[j]);
            }
        }
    }

    fn solve(mut self) -> Vec<f64> {
        let n = self.b.len();
        for k in 0..n {
            let pivot = (k..n).max_by(|i, j| self.a[*i][k].abs().total_cmp(&self.a[*j][k].abs())).expect("k < n");
            self.a.swap(k, pivot);
            self.b.swap(k, pivot);
            for i in k + 1..n {
                let factor = self.a[i][k] / self.a[k][k];
                let (above, below) = self.a.split_at_mut(i);
                below[0].iter_mut().zip(&above[k]).for_each(|(x, y)| *x -= factor * y);
                self.b[i] -= factor * self.b[k];
            }
        }
        for k in (0..n).rev() {
            let known: f64 = (k + 1..n).map(|j| self.a[k][j] * self.b[j]).sum();
            self.b[k] = (self.b[k] - known) / self.a[k][k];
        }
        self.b
    }
}

fn area(mesh: &Mesh, face: usize) -> f64 {
    let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
    0.5 * (b - a).cross(c - a).length()
}

/// Few vertices, no two at one place, and faces between any three, as non-manifold as it comes.
fn soup() -> impl Strategy<Value = Mesh> {
    let vertices = prop::collection::vec([0.0..4.0f32, 0.0..4.0f32, 0.0..4.0f32], 4..10);
    vertices.prop_flat_map(|positions| {
        let n = positions.len();
        let face = prop::sample::subsequence((0..n as u32).collect::<Vec<_>>(), 3);
        let turned =
            (face, any::<bool>()).prop_map(|(f, flip)| if flip { [f[0], f[2], f[1]] } else { [f[0], f[1], f[2]] });
        prop::collection::btree_set(turned, 1..12)
            .prop_map(move |faces| mesh(positions.clone(), faces.into_iter().collect()))
    })
}

/// As exact as conjugate gradients get.
const PRECISE: PcgParams = PcgParams {
    tolerance: 1e-14,
    patience: 1000,
    settle: 0.0,
    max_iterations: 1000,
    hole_limit: u32::MAX,
    hole_memory_bytes: 0,
};

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn agrees_with_the_definition(mesh in soup(), count in 1u64..6, alpha in 0.0..3.0f64, mu in 1e-3..0.1f64) {
        // Some samples are not valid, but never the first of a face.
        let f = |s: &Sample| if s.number > 0 && noise(s.point.x.to_bits()) < 0.3 { None } else { noisy(s) };
        let expected = Definition::new(&mesh, count, &f, alpha, mu).solve();
        let found = solve(&mesh, &moments(&mesh, count, f), &settings(alpha, mu));
        for v in mesh.faces.iter().flatten() {
            let (found, expected) = (f64::from(found.values[*v as usize]), expected[*v as usize].clamp(0.0, 1.0));
            prop_assert!((found - expected).abs() < 1e-5, "vertex {v}: {found}, by definition {expected}");
        }
    }

    #[test]
    fn all_solvers_agree(mesh in soup(), alpha in 0.0..3.0f64) {
        let moments = moments(&mesh, 3, noisy);
        for system in systems(&mesh, &moments, alpha) {
            let dense = dense::solve(&system).unwrap();
            let sparse = sparse::solve(&system, u64::MAX).unwrap();
            let (iterated, _) = pcg::solve(&system, &PRECISE).unwrap();
            for ((d, s), i) in dense.iter().zip(&sparse).zip(&iterated) {
                prop_assert!((d - s).abs() < 1e-9 && (d - i).abs() < 1e-8, "{d}, {s}, {i}");
            }
        }
    }

    #[test]
    fn whatever_the_moments_values_are_finite(
        mesh in soup(),
        counts in prop::collection::vec(0u32..3, 24),
        sums in prop::collection::vec(-1e30..1e30f64, 10),
    ) {
        let mut moments = FaceMoments::new(1);
        for face in 0..mesh.faces.len() {
            moments.push(&[0, 1].map(|half| {
                let mut sum = HalfMoments { valid: counts[2 * face + half], ..HalfMoments::default() };
                sum.phi_f[0] = [sums[0], sums[1], sums[2]];
                sum.phi_phi = [sums[3], sums[4], sums[5], sums[6], sums[7], sums[8]];
                sum
            }));
        }
        solve(&mesh, &moments, &settings(1.0, 1e-3));
    }

    #[test]
    fn whatever_the_transform_nothing_panics(mesh in soup(), columns in [any::<f64>(); 9]) {
        let matrix = DMat3::from_cols_array(&columns);
        let moments = moments(&mesh, 2, noisy);
        solve_at(&mesh, &moments, &settings(1.0, 1e-3), DAffine3::from_mat3(matrix), &SolverParams::default());
    }
}

fn systems(mesh: &Mesh, moments: &FaceMoments, alpha: f64) -> Vec<ComponentSystem<'static>> {
    let frame = Frame::new(mesh, &DAffine3::IDENTITY).expect("a soup has an extent");
    let surface = Surface::new(mesh, &frame, &Weld::new(mesh, &frame, 15.0));
    let assembly = Assembly::new(&surface, &Edges::new(&surface), moments, &settings(alpha, 1e-3));
    let components = Components::new(&surface);
    let whole = assembly_system(&assembly);
    (0..components.count()).map(|c| components.part(c, &whole).into_owned()).collect()
}
