//! Rays from the boundaries of small spheres towards their centres, and the weighted means of what they read.

use super::baked::{BakedPoint, BakedSurface};
use glam::{DVec3, Vec3};
use kiln_core::MAX_CHANNELS;
use kiln_trace::{Hit, Ray, SobolScramble, TraceError, Tracer, cosine_direction, orthonormal_basis, sobol_point};
use rayon::prelude::*;

/// Rays of one call of the tracer: enough to keep it busy, few enough to hold (46 MB).
const RAYS_PER_CALL: usize = 1 << 20;

/// Rays go on beyond the centre by this part of the radius, so that rounding has no say in whether a surface through the
/// centre is met.
const BEYOND: f64 = 1.0 / 256.0;

/// Which surfaces in a sphere are read, and how far its rays go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Reach {
    /// All surfaces, from either side, by rays from everywhere that end at the centre.
    Center,
    /// Fronts whose normals are within 90° of this unit normal, by rays from its side that go through the whole sphere.
    Through(Vec3),
}

/// A sphere to be read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sphere {
    /// Metres relative to the level's origin.
    pub(crate) center_m: DVec3,
    /// Metres, greater than 0.
    pub(crate) radius_m: f64,
    pub(crate) reach: Reach,
    /// Scramble of the directions.
    pub(crate) scramble: SobolScramble,
    /// Index of the first direction in the scrambled sequence.
    pub(crate) first_index: u32,
}

/// What the rays of a sphere read.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub(crate) struct Reading {
    /// Weighted mean for each channel; 0 without hits.
    pub(crate) ao: [f64; MAX_CHANNELS],
    /// Rays that read a value.
    pub(crate) hits: u32,
}

/// Reads spheres, each for itself: what one reads depends neither on the others nor on their order.
pub(crate) struct SphereReader<'a> {
    pub(crate) tracer: &'a dyn Tracer,
    pub(crate) baked: &'a BakedSurface<'a>,
    /// Directions of each sphere, at least 1.
    pub(crate) directions: u32,
}

impl SphereReader<'_> {
    /// Reads each sphere.
    pub(crate) fn read(&self, spheres: &[Sphere]) -> Result<Vec<Reading>, TraceError> {
        let directions = self.directions as usize;
        let mut readings = Vec::with_capacity(spheres.len());
        for spheres in spheres.chunks((RAYS_PER_CALL / directions).max(1)) {
            let rays: Vec<Ray> = spheres.par_iter().flat_map_iter(|sphere| sphere.rays(self.directions)).collect();
            let mut hits = vec![Hit::MISS; rays.len()];
            self.tracer.trace(&rays, &mut hits)?;
            let of = |((sphere, rays), hits): ((&Sphere, &[Ray]), &[Hit])| sphere.mean(self.baked, rays, hits);
            readings.par_extend(
                spheres.par_iter().zip(rays.par_chunks(directions)).zip(hits.par_chunks(directions)).map(of),
            );
        }
        Ok(readings)
    }
}

impl Sphere {
    fn rays(&self, count: u32) -> impl Iterator<Item = Ray> {
        let length = match self.reach {
            Reach::Center => 1.0 + BEYOND,
            Reach::Through(_) => 2.0,
        };
        (0..count).map(move |index| {
            let point = sobol_point(self.first_index.wrapping_add(index), self.scramble);
            let from_center = match self.reach {
                Reach::Center => uniform_direction(point),
                Reach::Through(normal) => cosine_direction(point, normal, orthonormal_basis(normal)).as_dvec3(),
            };
            let origin = (self.center_m + self.radius_m * from_center).as_vec3();
            // Its length makes the centre's distance 1, wherever rounding has put the origin.
            let direction = (self.center_m - origin.as_dvec3()).as_vec3();
            Ray { origin, direction, t_max: length as f32 }
        })
    }

    /// The mean of what rays read, in the order of the rays.
    fn mean(&self, baked: &BakedSurface<'_>, rays: &[Ray], hits: &[Hit]) -> Reading {
        let mut first = None;
        let (mut sums, mut weights, mut count) = ([0.0; MAX_CHANNELS], 0.0, 0);
        for (ray, hit) in rays.iter().zip(hits).filter(|(_, hit)| hit.is_hit()) {
            let weight = self.reach.weight(f64::from(hit.t));
            let Some(point) = baked.read(ray, hit).filter(|point| weight > 0.0 && self.reach.reads(point)) else {
                continue;
            };
            // As differences to what was read first, so that a constant has no rounding to suffer.
            let base = first.get_or_insert(point.ao);
            for ((sum, ao), base) in sums.iter_mut().zip(point.ao).zip(base) {
                *sum += weight * (ao - *base);
            }
            weights += weight;
            count += 1;
        }
        let Some(base) = first else { return Reading::default() };
        Reading { ao: std::array::from_fn(|c| (base[c] + sums[c] / weights).clamp(0.0, 1.0)), hits: count }
    }
}

impl Reach {
    /// Weight of a hit: 0 on the boundary, 1 at the centre. `t` is in radii from the ray's origin.
    fn weight(self, t: f64) -> f64 {
        match self {
            Self::Center => t.min(1.0),
            Self::Through(_) => 1.0 - (1.0 - t).abs(),
        }
    }

    fn reads(self, point: &BakedPoint) -> bool {
        match self {
            Self::Center => true,
            Self::Through(normal) => point.is_front && point.normal.dot(normal.as_dvec3()) > 0.0,
        }
    }
}

/// A unit direction, uniform over the sphere, from a point of the unit square: equal heights have equal areas
/// (Archimedes).
fn uniform_direction([u, v]: [f32; 2]) -> DVec3 {
    let height = 1.0 - 2.0 * f64::from(u);
    let (sine, cosine) = libm::sincos(std::f64::consts::TAU * f64::from(v));
    let radius = (1.0 - height * height).max(0.0).sqrt();
    DVec3::new(radius * cosine, radius * sine, height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_uniform() {
        // Over the sphere: E[x] = 0, E[x²] = 1/3, E[x y] = 0, E[x⁴] = 1/5.
        let n = 1 << 14;
        let (mut mean, mut squares, mut mixed, mut fourth) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        for index in 0..n {
            let u = uniform_direction(sobol_point(index, SobolScramble([3, 5])));
            assert!((u.length() - 1.0).abs() < 1e-12);
            mean += u;
            squares += u * u;
            mixed += u * DVec3::new(u.y, u.z, u.x);
            fourth += u * u * u * u;
        }
        let off = |sum: DVec3, expected: f64| (sum / f64::from(n) - expected).abs().max_element();
        assert!(off(mean, 0.0) < 1e-3 && off(mixed, 0.0) < 1e-3);
        assert!(off(squares, 1.0 / 3.0) < 1e-3 && off(fourth, 0.2) < 1e-3);
    }

    #[test]
    fn weights_rise_towards_the_centre() {
        let through = Reach::Through(Vec3::Y);
        for (t, center, chord) in [(0.0, 0.0, 0.0), (0.25, 0.25, 0.25), (1.0, 1.0, 1.0)] {
            assert_eq!((Reach::Center.weight(t), through.weight(t)), (center, chord));
        }
        assert_eq!((Reach::Center.weight(1.003), through.weight(1.75), through.weight(2.0)), (1.0, 0.25, 0.0));
    }

    #[test]
    fn rays_end_at_the_centre_or_on_the_other_side() {
        let center_m = DVec3::new(700.1, -20.3, 0.7);
        let mut sphere =
            Sphere { center_m, radius_m: 0.2, reach: Reach::Center, scramble: SobolScramble([1, 2]), first_index: 64 };
        for ray in sphere.rays(64) {
            assert!((ray.origin.as_dvec3() + ray.direction.as_dvec3() - center_m).length() < 1e-8);
            assert!((ray.direction.length() - 0.2).abs() < 1e-4);
            assert!((f64::from(ray.t_max) - 1.0 - BEYOND).abs() < 1e-6);
        }
        sphere.reach = Reach::Through(Vec3::Y);
        assert!(sphere.rays(64).all(|ray| ray.t_max == 2.0 && ray.direction.y < 1e-6));
    }
}
