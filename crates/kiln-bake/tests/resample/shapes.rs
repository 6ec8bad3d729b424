//! Meshes with values, made by code.

use glam::{DAffine3, DVec3, Vec3};
use kiln_bake::{BakedInstance, BakedSurface};
use kiln_core::{FaceGroup, Kernel, Mesh, Sampling};
use kiln_trace::{CpuTracer, MeshBvh, Scene, SceneObject};
use std::{collections::BTreeSet, f64::consts::TAU, sync::Arc};

/// Placed meshes, and values at their vertices where there are some.
#[derive(Clone)]
pub(crate) struct Full {
    pub(crate) parts: Vec<Part>,
    pub(crate) channels: usize,
}

#[derive(Clone)]
pub(crate) struct Part {
    pub(crate) mesh: Mesh,
    pub(crate) place: DAffine3,
    pub(crate) values: Option<Vec<f32>>,
}

impl Full {
    /// One mesh with one channel of values, a function of object-space positions.
    pub(crate) fn one(mesh: Mesh, place: DAffine3, ao: impl Fn(DVec3) -> f64) -> Self {
        let values = Some(mesh.positions.iter().map(|p| ao(Vec3::from_array(*p).as_dvec3()) as f32).collect());
        Self { parts: vec![Part { mesh, place, values }], channels: 1 }
    }

    pub(crate) fn tracer(&self) -> CpuTracer {
        let bvhs = self.parts.iter().map(|part| Arc::new(MeshBvh::build(&part.mesh))).collect();
        let object = |(mesh, part): (usize, &Part)| SceneObject { mesh, world_from_object: part.place };
        let objects: Vec<SceneObject> = self.parts.iter().enumerate().map(object).collect();
        CpuTracer::new(Arc::new(Scene::build(bvhs, &objects)))
    }

    pub(crate) fn baked<'a>(&'a self) -> BakedSurface<'a> {
        let instance = |part: &'a Part| {
            let values = part.values.as_deref()?;
            Some(BakedInstance { mesh: &part.mesh, world_from_object: part.place, values })
        };
        let instances: Vec<Option<BakedInstance<'a>>> = self.parts.iter().map(instance).collect();
        BakedSurface::new(self.channels, &instances).expect("values fit")
    }
}

/// A mesh of one group, with smooth normals from its faces.
fn mesh(positions: &[Vec3], faces: Vec<[u32; 3]>) -> Mesh {
    let mut normals = vec![Vec3::ZERO; positions.len()];
    for corners in &faces {
        let [a, b, c] = corners.map(|vertex| positions[vertex as usize]);
        corners.iter().for_each(|vertex| normals[*vertex as usize] += (b - a).cross(c - a));
    }
    Mesh {
        positions: positions.iter().map(Vec3::to_array).collect(),
        normals: normals.iter().map(|normal| normal.normalize_or_zero().to_array()).collect(),
        face_group: vec![0; faces.len()],
        faces,
        groups: vec![FaceGroup::PLAIN],
        ..Mesh::default()
    }
}

/// A grid of `n × m` cells over the unit square, seen from `∂u × ∂v`.
fn grid(n: u32, m: u32, at: impl Fn(f64, f64) -> DVec3, is_closed: bool) -> Mesh {
    let (columns, rows) = if is_closed { (n, m) } else { (n + 1, m + 1) };
    let position = |i: u32, j: u32| at(f64::from(i) / f64::from(n), f64::from(j) / f64::from(m)).as_vec3();
    let positions: Vec<Vec3> =
        (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j))).map(|(i, j)| position(i, j)).collect();
    let vertex = |i: u32, j: u32| j % rows * columns + i % columns;
    let cell = |(i, j): (u32, u32)| {
        let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    let faces = (0..m).flat_map(|j| (0..n).map(move |i| (i, j))).flat_map(cell).collect();
    mesh(&positions, faces)
}

/// Hills of 40 × 40 m in `n × n` cells, y up: the coarser ones are decimated from the finer.
pub(crate) fn terrain(n: u32) -> Mesh {
    let height = |x: f64, z: f64| {
        1.5 * (0.22 * x).sin() * (0.17 * z + 0.4).cos()
            + 0.35 * (0.9 * x + 0.3 * z).sin() * (0.8 * z).cos()
            + 0.06 * (2.7 * x).sin() * (2.9 * z + 1.0).sin()
    };
    let at = |u: f64, v: f64| {
        let (x, z) = (40.0 * (v - 0.5), 40.0 * (u - 0.5));
        DVec3::new(x, height(x, z), z)
    };
    grid(n, n, at, false)
}

/// A torus of radii 3 and 1 m with bumps, in `2 n × n` cells.
pub(crate) fn bumpy_torus(n: u32) -> Mesh {
    let at = |u: f64, v: f64| {
        let (a, b) = (TAU * u, TAU * v);
        let radius = 1.0 + 0.12 * (5.0 * a).sin() * (3.0 * b).cos() + 0.03 * (14.0 * a + 9.0 * b).sin();
        let ring = 3.0 + radius * b.cos();
        DVec3::new(ring * a.cos(), ring * a.sin(), radius * b.sin())
    };
    grid(2 * n, n, at, true)
}

/// A flat square of 2 × 2 cells at a height, y up, centred on the axis.
pub(crate) fn plane(half: f64, height: f64) -> Mesh {
    grid(2, 2, |u, v| DVec3::new(half * (2.0 * v - 1.0), height, half * (2.0 * u - 1.0)), false)
}

/// A mesh seen from its other side.
pub(crate) fn turned(mesh: &Mesh) -> Mesh {
    let mut turned = mesh.clone();
    turned.faces.iter_mut().for_each(|corners| corners.swap(1, 2));
    turned.normals.iter_mut().flatten().for_each(|x| *x = -*x);
    turned
}

/// A smooth function with detail that the full meshes hold and their LODs do not, in [0, 1].
pub(crate) fn detailed(p: DVec3) -> f64 {
    let smooth = 0.55 + 0.25 * (0.35 * p.x + 0.2).sin() * (0.31 * p.z - 0.4).cos() * (0.5 * p.y).cos();
    smooth + 0.12 * (2.1 * p.x + 0.7 * p.y).sin() * (1.9 * p.z).cos()
}

/// How LODs are sampled where nothing is said.
pub(crate) fn sampling() -> Sampling {
    kiln_bake::lod_sampling(
        &Sampling {
            target: None,
            kernel: Kernel::Obscurance { half_distances_m: vec![2.0] },
            rays_per_sample: 16,
            mean_samples_per_face: 4.0,
            density_per_m2: None,
            min_samples_per_face: 2,
            max_samples_per_face: 64,
            back_face_limit: 0.25,
            seed: 7,
            foliage: kiln_core::FoliageMode::default(),
            ground_plane_y_m: None,
            no_skip: BTreeSet::new(),
        },
        usize::MAX,
    )
}
