//! Points in the air: directions over the whole sphere, and their sums.
//!
//! The projection is that of Sloan et al. 2013, section 2.2. A ray's value times a basis function is rounded to
//! 2⁻¹⁶, so that sums are integers and do not depend on any order; they fit 32 bits with a sign.

use crate::{
    HARMONICS, Hit, KernelRates, MAX_RAYS_PER_SAMPLE, ONE, Ray, SobolScramble, TraceError, Tracer, quadratic_harmonics,
    sobol_point, sphere_direction,
};
use glam::Vec3;
use kiln_core::MAX_CHANNELS;

/// Rays that are in memory at once where a tracer is given them one by one: 64 MB with their hits and values.
const RAYS_PER_CALL: usize = 1 << 20;

/// Rays that are traced together, where there are so many: a part of the sphere each.
const RAYS_PER_CONE: u32 = crate::rays::BUNDLE as u32;

/// Directions that are made at once.
const LANES: usize = 8;

/// A point whose whole sphere is gathered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpherePoint {
    /// Ray origin, metres relative to the level's origin.
    pub origin: Vec3,
    /// Scramble of the directions, which are the first points of its sequence.
    pub scramble: SobolScramble,
}

/// What gathering one point gives, in integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct SphereSums {
    /// Sums of the rays' values times each basis function ([`quadratic_harmonics`]) for each channel, in units of 2⁻¹⁶.
    pub values: [[i32; HARMONICS]; MAX_CHANNELS],
    /// The same for rays that are all open: what the directions themselves sum to.
    pub basis: [i32; HARMONICS],
    /// Rays traced.
    pub rays: u32,
    /// Of these, rays whose closest hit is the back of a single-sided face.
    pub back_faces: u32,
}

impl SphereSums {
    /// Adds a ray in a unit direction, by its value in each channel in units of 2⁻¹⁶.
    #[inline(always)]
    pub(crate) fn add(&mut self, direction: Vec3, values: &[u32; MAX_CHANNELS], channels: usize, back_face: bool) {
        let basis = quadratic_harmonics(direction);
        add_product(&mut self.basis, &basis, ONE);
        for (sums, value) in self.values.iter_mut().zip(values).take(channels) {
            add_product(sums, &basis, *value);
        }
        self.rays += 1;
        self.back_faces += u32::from(back_face);
    }

    /// Coefficients of a channel's values as a function over the sphere: those of an open sky where there is no ray.
    ///
    /// `4π/N Σ (v − v̄) Y`, with the mean v̄ added to the constant function: the directions' own error, which is that of
    /// a function that is the same everywhere, is taken out. A sky that is open is exact, and so is one
    /// that is evenly dark, to 3e-5.
    pub fn coefficients(&self, channel: usize) -> [f64; HARMONICS] {
        let sphere = 4.0 * std::f64::consts::PI;
        let mut coefficients = [0.0; HARMONICS];
        coefficients[0] = sphere.sqrt();
        if self.rays == 0 {
            return coefficients;
        }
        let values = &self.values[channel];
        let mean = f64::from(values[0]) / f64::from(self.basis[0]);
        let weight = sphere / (f64::from(ONE) * f64::from(self.rays));
        for ((coefficient, value), basis) in coefficients.iter_mut().zip(values).zip(&self.basis).skip(1) {
            *coefficient = weight * (f64::from(*value) - mean * f64::from(*basis));
        }
        coefficients[0] *= mean;
        coefficients
    }

    /// Fraction of rays whose closest hit is a back face; 0 without rays.
    pub fn back_face_fraction(&self) -> f64 {
        if self.rays == 0 { 0.0 } else { f64::from(self.back_faces) / f64::from(self.rays) }
    }
}

/// A float of this size has a last bit of 1: added to a number below 2²² it rounds it to an integer, ties to even.
const ROUNDER: f32 = 12_582_912.0;

/// Adds `round(value · basis)`. No product is above 41,400, so that [`MAX_RAYS_PER_SAMPLE`] of them fit.
#[expect(clippy::cast_precision_loss, reason = "17 bits fit")]
#[inline(always)]
fn add_product(sums: &mut [i32; HARMONICS], basis: &[f32; HARMONICS], value: u32) {
    for (sum, y) in sums.iter_mut().zip(basis) {
        let rounded = (value as f32 * y + ROUNDER).to_bits().wrapping_sub(ROUNDER.to_bits());
        *sum += rounded.cast_signed();
    }
}

/// What a ray brings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayValue {
    /// Its value for each channel, in units of 2⁻¹⁶; those of channels that are not used do not count.
    pub values: [u32; MAX_CHANNELS],
    /// Its closest hit is the back of a single-sided face.
    pub back_face: bool,
}

impl RayValue {
    /// Of a ray that ends so, without foliage.
    fn of(kernel: &KernelRates, hit: &Hit) -> Self {
        let mut values = [ONE; MAX_CHANNELS];
        if hit.is_hit() {
            for (channel, value) in values.iter_mut().enumerate().take(kernel.channels) {
                *value = kernel.hit_value(channel, hit.t);
            }
        }
        Self { values, back_face: hit.is_hit() && hit.back_face }
    }
}

/// The first `rays` directions of a scrambled sequence, a power of two up to [`MAX_RAYS_PER_SAMPLE`], parted into cones
/// of 64: each has the points of one rectangle of the square, of which a (0, k, 2)-net has as many in each.
///
/// # Panics
/// If `rays` is another number.
pub fn sphere_directions(scramble: SobolScramble, rays: u32, directions: &mut Vec<Vec3>) {
    directions_in_cones(scramble, rays, directions);
}

/// [`sphere_directions`], for kernels.
#[inline(always)]
pub(crate) fn directions_in_cones(scramble: SobolScramble, rays: u32, directions: &mut Vec<Vec3>) {
    assert!(
        rays.is_power_of_two() && rays <= MAX_RAYS_PER_SAMPLE,
        "{rays} directions are no power of two up to 32,768"
    );
    let bits = (rays / RAYS_PER_CONE).max(1).ilog2();
    let (columns, rows) = ((1u32 << bits.div_ceil(2)) as f32, (1u32 << (bits / 2)) as f32);
    let mut filled = [0u8; (MAX_RAYS_PER_SAMPLE / RAYS_PER_CONE) as usize];
    directions.clear();
    directions.resize(rays as usize, Vec3::ZERO);
    for first in (0..rays).step_by(LANES) {
        // All lanes at once, and only then to their places.
        let (mut ways, mut cones) = ([Vec3::ZERO; LANES], [0; LANES]);
        for lane in 0..LANES {
            let [u, v] = sobol_point(first + lane as u32, scramble);
            ways[lane] = sphere_direction([u, v]);
            cones[lane] = (u * columns) as usize * rows as usize + (v * rows) as usize;
        }
        for (way, cone) in ways.iter().zip(cones).take(rays as usize) {
            directions[cone * RAYS_PER_CONE as usize + usize::from(filled[cone])] = *way;
            filled[cone] += 1;
        }
    }
}

/// [`Tracer::gather_sphere`] by the closest hits of [`Tracer::trace`], for backends without a kernel for it: the same sums,
/// a million rays at a time, where there is no foliage, which those hits do not know of. `rays_per_point` is a power of two up to [`MAX_RAYS_PER_SAMPLE`].
pub fn gather_sphere_by_rays(
    tracer: &dyn Tracer,
    points: &[SpherePoint],
    kernel: &KernelRates,
    rays_per_point: u32,
    sums: &mut [SphereSums],
) -> Result<(), TraceError> {
    let mut hits = Vec::new();
    gather_sphere_by_values(points, kernel, rays_per_point, sums, |rays, values| {
        hits.clear();
        hits.resize(rays.len(), Hit::MISS);
        tracer.trace(rays, &mut hits)?;
        values.iter_mut().zip(&hits).for_each(|(value, hit)| *value = RayValue::of(kernel, hit));
        Ok(())
    })
}

/// [`Tracer::gather_sphere`] by the values of rays, which `trace` finds: one for each ray, a million rays at a time.
/// `rays_per_point` is a power of two up to [`MAX_RAYS_PER_SAMPLE`]. Fails where `trace` does.
pub fn gather_sphere_by_values(
    points: &[SpherePoint],
    kernel: &KernelRates,
    rays_per_point: u32,
    sums: &mut [SphereSums],
    mut trace: impl FnMut(&[Ray], &mut [RayValue]) -> Result<(), TraceError>,
) -> Result<(), TraceError> {
    let count = rays_per_point.max(1) as usize;
    let points_per_call = (RAYS_PER_CALL / count).max(1);
    let (mut directions, mut rays, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for (points, sums) in points.chunks(points_per_call).zip(sums.chunks_mut(points_per_call)) {
        rays.clear();
        for point in points {
            sphere_directions(point.scramble, rays_per_point, &mut directions);
            let ray = |direction: &Vec3| Ray { origin: point.origin, direction: *direction, t_max: kernel.t_max };
            rays.extend(directions.iter().map(ray));
        }
        values.clear();
        values.resize(rays.len(), RayValue::default());
        trace(&rays, &mut values)?;
        for ((sum, rays), values) in sums.iter_mut().zip(rays.chunks(count)).zip(values.chunks(count)) {
            *sum = SphereSums::default();
            for (ray, value) in rays.iter().zip(values) {
                sum.add(ray.direction, &value.values, kernel.channels, value.back_face);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn most_rays_do_not_overflow() {
        for (direction, value) in [(Vec3::Z, ONE), (Vec3::X, ONE), (Vec3::new(0.6, 0.0, -0.8), ONE)] {
            let mut sums = SphereSums::default();
            for _ in 0..MAX_RAYS_PER_SAMPLE {
                sums.add(direction, &[value; MAX_CHANNELS], MAX_CHANNELS, true);
            }
            assert_eq!(sums.basis, sums.values[3]);
            assert_eq!(sums.basis[2].signum(), if direction.z == 0.0 { 0 } else { direction.z.signum() as i32 });
            assert_eq!((sums.rays, sums.back_face_fraction()), (MAX_RAYS_PER_SAMPLE, 1.0));
        }
    }

    #[test]
    fn no_rays_are_an_open_sky() {
        let coefficients = SphereSums::default().coefficients(1);
        assert_eq!(coefficients[1..], [0.0; 8]);
        assert!((coefficients[0] * f64::from(quadratic_harmonics(Vec3::X)[0]) - 1.0).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn directions_are_those_of_the_sequence_in_cones(seed: [u32; 2], k in 0u32..12) {
            let (scramble, rays) = (SobolScramble(seed), 1u32 << k);
            let mut directions = Vec::new();
            sphere_directions(scramble, rays, &mut directions);
            let bits = |d: &Vec3| d.to_array().map(f32::to_bits);
            let mut found: Vec<_> = directions.iter().map(bits).collect();
            let mut expected: Vec<_> = (0..rays).map(|i| bits(&sphere_direction(sobol_point(i, scramble)))).collect();
            found.sort_unstable();
            expected.sort_unstable();
            prop_assert_eq!(found, expected);
            // A cone of 16 or more is narrower than a half-space.
            if k >= 10 {
                for cone in directions.chunks(RAYS_PER_CONE as usize) {
                    let axis = cone.iter().sum::<Vec3>();
                    prop_assert!(cone.iter().all(|d| d.dot(axis) > 0.0));
                }
            }
        }

        #[test]
        fn an_even_sky_is_exact(seed: [u32; 2], value in 0..=ONE) {
            let mut sums = SphereSums::default();
            let mut directions = Vec::new();
            sphere_directions(SobolScramble(seed), 256, &mut directions);
            for direction in directions {
                sums.add(direction, &[value; MAX_CHANNELS], 1, false);
            }
            let coefficients = sums.coefficients(0);
            let mean = f64::from(value) / f64::from(ONE);
            // Products are rounded to 2⁻¹⁶, those of the constant function all alike.
            prop_assert!((coefficients[0] - mean * (4.0 * std::f64::consts::PI).sqrt()).abs() < 2e-4);
            prop_assert!(coefficients[1..].iter().all(|c| c.abs() < 3e-4), "{:?}", coefficients);
        }
    }
}
