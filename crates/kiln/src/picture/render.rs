//! One ray through each of four points of a pixel; the AO of what it hits, or its residual, interpolated.
//!
//! Back faces of single-sided geometry are looked through, so that a closed room shows its inside.

use super::{Camera, Image, ramp};
use crate::one_mesh::{one_mesh, scene_of};
use glam::{DVec3, Vec3};
use kiln_core::Mesh;
use kiln_scene::{BakedPart, BakedScene};
use kiln_trace::{CpuTracer, Ray};
use rayon::prelude::*;

/// Back faces looked through before a ray is given up.
const MAX_LAYERS: usize = 64;

/// What is shown.
pub(crate) enum Shading {
    /// The AO as grey, by the weight of each half-distance.
    Ao(Vec<f64>),
    /// How far the signal strays from the values, by colours: of one half-distance, or the greatest.
    Residual(Option<usize>),
}

impl Shading {
    /// The AO of one half-distance, or the usual blend: 3 % of the shortest and 97 % of the longest.
    pub(crate) fn ao(channel: Option<usize>, channels: usize) -> Result<Self, String> {
        let mut weights = vec![0.0; channels];
        match in_range(channel, channels)? {
            Some(c) => weights[c] = 1.0,
            None if channels == 2 => weights = vec![0.03, 0.97],
            None => weights.fill(1.0 / channels.max(1) as f64),
        }
        Ok(Self::Ao(weights))
    }

    /// The deviations of one half-distance, or the greatest of all.
    pub(crate) fn residual(channel: Option<usize>, channels: usize) -> Result<Self, String> {
        Ok(Self::Residual(in_range(channel, channels)?))
    }

    /// What a vertex shows; NaN where it has nothing.
    fn value(&self, part: &BakedPart, vertex: u32) -> f32 {
        let of = |numbers: &'_ [f32], channels: usize| {
            let first = vertex as usize * channels;
            numbers.get(first..first + channels).map(<[f32]>::to_vec).filter(|all| !all.is_empty())
        };
        match self {
            Self::Ao(weights) => of(&part.ao, part.channels)
                .map_or(f32::NAN, |all| all.iter().zip(weights).map(|(&ao, w)| f64::from(ao) * w).sum::<f64>() as f32),
            Self::Residual(channel) => of(&part.residual, part.residual_channels).map_or(f32::NAN, |all| {
                let greatest = || all.iter().copied().fold(0.0, f32::max);
                channel.map_or_else(greatest, |channel| all.get(channel).copied().unwrap_or(f32::NAN))
            }),
        }
    }
}

fn in_range(channel: Option<usize>, channels: usize) -> Result<Option<usize>, String> {
    match channel {
        Some(c) if c >= channels => {
            Err(format!("there is no half-distance number {c}; the file has {channels}, from 0"))
        }
        _ => Ok(channel),
    }
}

/// All surfaces of a baked file.
pub(crate) struct Surface {
    tracer: CpuTracer,
    mesh: Mesh,
    /// Shown value of each corner of each face; NaN where there is none.
    values: Vec<[f32; 3]>,
    origin: DVec3,
    /// Values are deviations.
    is_residual: bool,
}

/// A ball amid the level.
pub(crate) struct Ball {
    /// World space, metres.
    pub(crate) center: DVec3,
    pub(crate) radius_m: f64,
}

/// A rotated grid of four points of a pixel.
const POINTS: [(f64, f64); 4] = [(0.125, 0.625), (0.375, 0.125), (0.625, 0.875), (0.875, 0.375)];

/// Renders a baked file.
pub(crate) fn render(scene: &BakedScene, camera: &Camera, shading: &Shading, width: u32, height: u32) -> Image {
    // Relative to what is looked at, so that f32 holds far-away levels.
    let surface = Surface::new(scene, shading, camera.target);
    let aspect = f64::from(width) / f64::from(height);
    let eye = (camera.eye - surface.origin).as_vec3();
    let pixel = |index: u32| {
        let (x, y) = (index % width, index / width);
        let mut sum = Vec3::ZERO;
        for point in POINTS {
            let [u, v] = place([x, y], point, [width, height]);
            sum += surface.color(eye, camera.direction(u, v, aspect)).0;
        }
        (sum * 0.25).to_array().map(to_srgb)
    };
    let rgb = (0..width * height).into_par_iter().flat_map_iter(pixel).collect();
    let mut image = Image { width, height, rgb };
    if surface.is_residual {
        ramp::draw_bar(&mut image, to_srgb);
    }
    image
}

/// A point of a pixel in the picture, each coordinate in [−1, 1], y up.
fn place([x, y]: [u32; 2], (dx, dy): (f64, f64), [width, height]: [u32; 2]) -> [f64; 2] {
    [2.0 * (f64::from(x) + dx) / f64::from(width) - 1.0, 1.0 - 2.0 * (f64::from(y) + dy) / f64::from(height)]
}

impl Surface {
    /// Relative to an origin near what is looked at.
    pub(crate) fn new(scene: &BakedScene, shading: &Shading, origin: DVec3) -> Self {
        let mesh = one_mesh(scene, origin, |_| true);
        let values = |part: &BakedPart| {
            part.faces.iter().map(|face| face.map(|v| shading.value(part, v))).collect::<Vec<[f32; 3]>>()
        };
        let values = scene.parts.iter().flat_map(values).collect();
        let tracer = CpuTracer::new(scene_of(&mesh));
        Self { tracer, mesh, values, origin, is_residual: matches!(shading, Shading::Residual(_)) }
    }

    /// The same picture with a ball that is shaded in so many ways: `shades` gives what each shows for a normal.
    pub(crate) fn render_ball(
        &self,
        camera: &Camera,
        ball: &Ball,
        shades: &(dyn Fn(Vec3) -> Vec<f32> + Sync),
        ways: usize,
        [width, height]: [u32; 2],
    ) -> Vec<Image> {
        let aspect = f64::from(width) / f64::from(height);
        let eye = (camera.eye - self.origin).as_vec3();
        let pixel = |index: u32| {
            let mut sums = vec![Vec3::ZERO; ways];
            for point in POINTS {
                let [u, v] = place([index % width, index / width], point, [width, height]);
                let direction = camera.direction(u, v, aspect);
                let (color, distance) = self.color(eye, direction);
                let normal =
                    ball.normal(camera.eye, direction).filter(|(t, _)| *t < distance).map(|(_, normal)| normal);
                let shown =
                    normal.map_or_else(|| vec![color; ways], |n| shades(n).into_iter().map(Vec3::splat).collect());
                sums.iter_mut().zip(shown).for_each(|(sum, color)| *sum += color);
            }
            sums.into_iter().map(|sum| (sum * 0.25).to_array().map(to_srgb)).collect::<Vec<[u8; 3]>>()
        };
        let pixels: Vec<Vec<[u8; 3]>> = (0..width * height).into_par_iter().map(pixel).collect();
        let image = |way: usize| Image { width, height, rgb: pixels.iter().flat_map(|ways| ways[way]).collect() };
        (0..ways).map(image).collect()
    }

    /// What a ray from the eye shows, and how far away that is.
    fn color(&self, eye: Vec3, direction: Vec3) -> (Vec3, f32) {
        let mut origin = eye;
        for _ in 0..MAX_LAYERS {
            let hit = self.tracer.closest_hit(&Ray { origin, direction, t_max: f32::MAX });
            if !hit.is_hit() {
                break;
            }
            let point = origin + direction * hit.t;
            if !hit.back_face {
                return (self.shade(hit.primitive as usize, point, direction), point.distance(eye));
            }
            origin = point + direction * (1e-6 * point.abs().max_element().max(hit.t) + f32::MIN_POSITIVE);
        }
        // A plain ground for what is empty.
        let sky = Vec3::new(0.36, 0.45, 0.58).lerp(Vec3::new(0.62, 0.70, 0.80), 0.5 + 0.5 * direction.y);
        (sky, f32::INFINITY)
    }

    fn shade(&self, face: usize, point: Vec3, direction: Vec3) -> Vec3 {
        let [a, b, c] = self.mesh.corners(face);
        let normal = (b - a).cross(c - a);
        let area = normal.length_squared();
        let u = (c - b).cross(point - b).dot(normal) / area;
        let v = (a - c).cross(point - c).dot(normal) / area;
        let [x, y, z] = self.values[face];
        let value = x * u + y * v + z * (1.0 - u - v);
        match (value.is_finite(), self.is_residual) {
            (true, false) => Vec3::splat(value.clamp(0.0, 1.0)),
            // A little light from the eye, so that shapes can be told.
            (true, true) => ramp::color(value) * (0.7 + 0.3 * (normal.dot(direction) / area.sqrt()).abs()),
            // Geometry without values stands out.
            (false, false) => Vec3::new(0.35, 0.16, 0.30),
            (false, true) => Vec3::splat(0.25),
        }
    }
}

impl Ball {
    /// Where a ray from outside first meets the ball: its distance in units of the direction's length, and the normal.
    fn normal(&self, eye: DVec3, direction: Vec3) -> Option<(f32, Vec3)> {
        let (direction, offset) = (direction.as_dvec3(), eye - self.center);
        let (a, b) = (direction.length_squared(), offset.dot(direction));
        let root = b * b - a * (offset.length_squared() - self.radius_m * self.radius_m);
        let t = (-b - root.sqrt()) / a;
        // Not for NaN either.
        (t > 0.0).then(|| (t as f32, ((offset + direction * t) / self.radius_m).as_vec3()))
    }
}

/// AO is shown as reflected light, so it is encoded as such.
fn to_srgb(linear: f32) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0 + 0.5) as u8
}
