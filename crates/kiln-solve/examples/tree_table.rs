//! Prints the errors of the three models of trees on a synthetic forest, and how long fits take.
//!
//! `cargo run --release -p kiln-solve --example tree_table -- 40 200`: 40 instances of a model of 200 leaves. What each
//! instance has is its local AO, shaded by its surroundings: not quite a linear function, differently by the two sides
//! of leaves, and noisy.

use glam::{DVec3, Vec3};
use kiln_core::{Class, Digest, FaceGroup, Mesh};
use kiln_solve::{
    AlternateParams, ModelSample, ModelSamples, TreeInstance, TreeModel, alternate, error_table, fit_instance,
};
use std::time::Instant;

const CHANNELS: usize = 2;

#[expect(clippy::print_stdout, reason = "its output is what this program is for")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1).map(|arg| arg.parse::<u64>());
    let instances = args.next().unwrap_or(Ok(40))?;
    let mesh = leaves(args.next().unwrap_or(Ok(200))?);
    let samples = sample(&mesh)?;
    let local: Vec<f32> = mesh.positions.iter().flat_map(|p| own_ao(*p)).collect();
    let sampled = samples.local(&local, CHANNELS)?;
    let signals: Vec<Vec<f32>> = (0..instances).map(|j| signal(&samples, sampled.values(), j)).collect();

    let start = Instant::now();
    for values in &signals {
        fit_instance(&samples, &sampled, values)?;
    }
    let fits = instances as f64 * CHANNELS as f64;
    let micros = 1e6 * start.elapsed().as_secs_f64() / fits;
    println!("{} samples, {} vertices: {micros:.1} µs a fit", samples.len(), mesh.positions.len());

    let keyed = (0u64..).zip(&signals).map(|(j, values)| TreeInstance { key: Digest::of(&j.to_le_bytes()), values });
    let keyed: Vec<_> = keyed.collect();
    let model = TreeModel { mesh: &mesh, samples: &samples, local: &local, channels: CHANNELS };
    let start = Instant::now();
    let found = alternate(&model, &keyed, &AlternateParams::default())?;
    println!("alternated in {:.0} ms", 1e3 * start.elapsed().as_secs_f64());
    println!("channel  half-steps  global only  local x global  alternated");
    for (channel, row) in error_table(&model, &keyed, &found)?.iter().enumerate() {
        let steps = found.steps[channel].len();
        println!(
            "{channel:7}  {steps:10}  {:11.4}  {:14.4}  {:10.4}",
            row.global_only, row.local_global, row.alternated
        );
    }
    Ok(())
}

/// Noise in [0, 1) by splitmix64.
fn noise(i: u64) -> f64 {
    let mut z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// A crown of leaves, two triangles each, about a trunk that is not there.
fn leaves(count: u64) -> Mesh {
    let random = |i: u64| Vec3::from_array([0, 1, 2].map(|k| noise(3 * i + k) as f32 * 2.0 - 1.0));
    let mut mesh = Mesh::default();
    for leaf in 0..count {
        let center = random(3 * leaf).normalize_or_zero() * (2.0 * noise(leaf) as f32).sqrt() + Vec3::Y * 3.0;
        let [across, along] = [1, 2].map(|k| 0.4 * random(3 * leaf + k));
        let first = mesh.positions.len() as u32;
        let corners = [center - across, center - along, center + across, center + along];
        mesh.positions.extend(corners.map(|corner| corner.to_array()));
        mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    mesh.normals = vec![[0.0; 3]; mesh.positions.len()];
    mesh.face_group = vec![0; mesh.faces.len()];
    mesh.groups = vec![FaceGroup { class: Class::Tree, double_sided: true, ..FaceGroup::PLAIN }];
    mesh
}

fn sample(mesh: &Mesh) -> Result<ModelSamples, kiln_solve::TreeError> {
    let mut samples = Vec::new();
    for face in 0..mesh.faces.len() as u32 {
        let [a, b, c] = mesh.corners(face as usize).map(Vec3::as_dvec3);
        let area = 0.5 * (b - a).cross(c - a).length();
        for k in 0..5 {
            let [s, t] = [0, 1].map(|i| noise(u64::from(face) * 16 + 2 * k + i));
            let phi = [1.0 - s.sqrt(), s.sqrt() * (1.0 - t), s.sqrt() * t];
            samples.push(ModelSample { face, phi, position: a * phi[0] + b * phi[1] + c * phi[2], weight: area / 5.0 });
        }
    }
    ModelSamples::new(mesh, &samples)
}

/// Darker inside of the crown, for the longer half-distance the more.
fn own_ao(position: [f32; 3]) -> [f32; CHANNELS] {
    let radius = (Vec3::from_array(position) - Vec3::Y * 3.0).length() / 2.0;
    [0.5, 0.8].map(|depth| 1.0 - depth * (1.0 - radius.min(1.0)))
}

/// What the surroundings leave: a linear shade by a wall or the ground, and a bend that no linear function has.
fn signal(samples: &ModelSamples, local: &[f64], instance: u64) -> Vec<f32> {
    let random = |k: u64| noise(1_000_003 * (instance + 1) + k);
    let wall = DVec3::new(random(0) - 0.5, 0.5 * random(1), random(2) - 0.5);
    let mut values = Vec::with_capacity(local.len());
    for (sample, u) in samples.unit_positions().iter().enumerate() {
        let u = DVec3::from_array(*u);
        // A defect that all instances share: leaves near the ground see less than the model alone tells.
        let shared = 1.0 - 0.25 * (1.0 - u.y) / 2.0 * (1.0 - u.x * u.x);
        let shade = (0.6 + 0.4 * wall.dot(u) - 0.1 * u.x * u.z * random(3)) * shared;
        for channel in 0..CHANNELS {
            let grain = 0.03 * (noise(instance * 7919 + (sample * CHANNELS + channel) as u64) - 0.5);
            values.push((shade * local[sample * CHANNELS + channel] + grain) as f32);
        }
    }
    values
}
