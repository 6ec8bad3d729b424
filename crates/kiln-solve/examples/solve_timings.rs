//! Times solves of synthetic instances, and checks conjugate gradients against the factorisation.
//!
//! `cargo run --release -p kiln-solve --example solve_timings -- terrain 1200`: one component of 1,200² vertices.
//! `… -- pieces 57000`: so many components of 4 to 400 vertices, and some of thousands.
//! `… -- crossover 450`: both solvers on one component of 450² vertices.

use glam::DAffine3;
use kiln_core::{FaceGroup, FaceMoments, HalfMoments, Mesh, SolveSettings};
use kiln_solve::{
    ComponentSystem, SolveInput, SolverParams,
    assemble::Assembly,
    components::{Components, assembly_system},
    edges::Edges,
    frame::Frame,
    pcg, solve_component, solve_with, sparse,
    surface::Surface,
    weld::Weld,
};
use std::time::Instant;

#[expect(clippy::print_stdout, reason = "its output is what this program is for")]
fn main() {
    let mut args = std::env::args().skip(1);
    let what = args.next().unwrap_or_else(|| "terrain".to_owned());
    let size = args.next().and_then(|n| n.parse().ok()).unwrap_or(300u32);
    let mut scene = Scene::default();
    match what.as_str() {
        "pieces" => (0..size).for_each(|i| scene.add_grid(if i % 500 == 0 { 40 } else { 2 + i % 7 * (i % 3) })),
        _ => scene.add_grid(size),
    }
    scene.sample(args.next().and_then(|n| n.parse().ok()).unwrap_or(0.0));
    let settings = SolveSettings::default();
    if what == "crossover" {
        for line in crossover(&scene, &settings) {
            println!("{line}");
        }
    } else {
        let input = scene.input(&settings);
        let start = Instant::now();
        let solution = solve_with(&input, &SolverParams::default());
        println!("whole solve: {:.2} s, peak {} MB", start.elapsed().as_secs_f64(), peak_megabytes());
        println!("{:#?}", solution.map(|s| s.summary));
        for line in stages(&scene, &settings) {
            println!("{line}");
        }
    }
}

fn stages(scene: &Scene, settings: &SolveSettings) -> Vec<String> {
    let mut lines = Vec::new();
    let mut last = Instant::now();
    let mut lap = |what: &str| {
        lines.push(format!("{what}: {:.3} s", last.elapsed().as_secs_f64()));
        last = Instant::now();
    };
    let Some(frame) = Frame::new(&scene.mesh, &DAffine3::IDENTITY) else { return lines };
    let weld = Weld::new(&scene.mesh, &frame, settings.weld_degrees);
    lap("weld");
    let surface = Surface::new(&scene.mesh, &frame, &weld);
    lap("surface");
    let edges = Edges::new(&surface);
    lap("edges");
    let assembly = Assembly::new(&surface, &edges, &scene.moments, settings);
    lap("assemble");
    let components = Components::new(&surface);
    lap("components");
    let whole = assembly_system(&assembly);
    let systems: Vec<ComponentSystem<'_>> = (0..components.count()).map(|c| components.part(c, &whole)).collect();
    lap("systems");
    systems.iter().for_each(|system| {
        solve_component(system, &SolverParams::default());
    });
    lap("solve, components one after another");
    lines
}

fn crossover(scene: &Scene, settings: &SolveSettings) -> Vec<String> {
    let Some(frame) = Frame::new(&scene.mesh, &DAffine3::IDENTITY) else { return Vec::new() };
    let weld = Weld::new(&scene.mesh, &frame, settings.weld_degrees);
    let surface = Surface::new(&scene.mesh, &frame, &weld);
    let assembly = Assembly::new(&surface, &Edges::new(&surface), &scene.moments, settings);
    let whole = assembly_system(&assembly);
    let system = Components::new(&surface).part(0, &whole);
    let start = Instant::now();
    let direct = sparse::solve(&system, u64::MAX);
    let direct_secs = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let iterative = pcg::solve(&system, &SolverParams::default().pcg);
    let iterative_secs = start.elapsed().as_secs_f64();
    let difference = match (&direct, &iterative) {
        (Ok(a), Ok((b, _))) => a.iter().zip(b).fold(0.0, |max: f64, (a, b)| max.max((a - b).abs())),
        _ => f64::NAN,
    };
    vec![
        format!(
            "{} unknowns, {} entries, holes {} edges deep",
            system.len(),
            system.matrix.entry_count(),
            system.hole_depth()
        ),
        format!("sparse: {direct_secs:.3} s"),
        format!("pcg: {iterative_secs:.3} s, {:?}", iterative.map(|(_, info)| info)),
        format!("greatest difference: {difference:.2e}; peak {} MB", peak_megabytes()),
    ]
}

/// Peak resident memory of this process, where the system tells.
fn peak_megabytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok()).unwrap_or(0) / 1024
}

struct Scene {
    mesh: Mesh,
    moments: FaceMoments,
}

impl Default for Scene {
    fn default() -> Self {
        let group = FaceGroup::PLAIN;
        Self { mesh: Mesh { groups: vec![group], ..Mesh::default() }, moments: FaceMoments::new(2) }
    }
}

impl Scene {
    fn input<'a>(&'a self, settings: &'a SolveSettings) -> SolveInput<'a> {
        SolveInput { mesh: &self.mesh, world_from_object: DAffine3::IDENTITY, moments: &self.moments, settings }
    }

    /// A bumpy grid of `n × n` vertices, beside the ones before it, with rows of very different width.
    fn add_grid(&mut self, n: u32) {
        let n = n.max(2);
        let first = self.mesh.positions.len() as u32;
        let shift = first as f32;
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let (x, y) = (i as f32 + 0.3 * noise(u64::from(i * n + j)), j as f32 + 0.3 * noise(u64::from(j * n + i)));
            self.mesh.positions.push([x + shift, (0.1 * x).sin() * (0.13 * y).cos() * 3.0, y]);
            self.mesh.normals.push([0.0, 1.0, 0.0]);
        }
        for (i, j) in (0..n - 1).flat_map(|i| (0..n - 1).map(move |j| (i, j))) {
            let [a, b, c, d] = [i * n + j, i * n + j + 1, (i + 1) * n + j, (i + 1) * n + j + 1].map(|v| v + first);
            self.mesh.faces.extend([[a, b, c], [b, d, c]]);
            self.mesh.face_group.extend([0, 0]);
        }
    }

    /// Four noisy samples in each face of a smooth signal, none in the given fraction of the terrain's middle.
    fn sample(&mut self, hole: f32) {
        let extent = self.mesh.positions.last().map_or(0.0, |p| p[2]);
        for face in 0..self.mesh.faces.len() {
            let corners = self.mesh.corners(face);
            let off_middle = corners[0].z.min(extent - corners[0].z).min(corners[0].x).min(extent - corners[0].x);
            let mut halves = [HalfMoments::default(); 2];
            for s in 0..4u64 {
                let [u, v] = [0, 1].map(|k| f64::from(0.5 + 0.5 * noise((face as u64 * 4 + s) * 2 + k)));
                let phi = if u + v > 1.0 { [u + v - 1.0, 1.0 - u, 1.0 - v] } else { [1.0 - u - v, u, v] };
                let p = phi.iter().zip(corners).map(|(w, c)| *w * c.as_dvec3()).sum::<glam::DVec3>();
                let noise = 0.05 * f64::from(noise(face as u64 ^ (s << 40)));
                let f = 0.5 + 0.4 * (0.31 * p.x).sin() * (0.17 * p.z).cos() + noise;
                if off_middle < 0.5 * extent * (1.0 - hole) || hole == 0.0 {
                    halves[s as usize % 2].add(phi, &[f, f * f]);
                } else {
                    halves[s as usize % 2].add_invalid();
                }
            }
            self.moments.push(&halves);
        }
    }
}

/// Noise in (−1, 1) by splitmix64.
fn noise(i: u64) -> f32 {
    let mut z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}
