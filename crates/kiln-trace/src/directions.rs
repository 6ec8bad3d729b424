//! Cosine-distributed directions from points of the unit square.
//!
//! Sources: Shirley and Chiu 1997 (concentric map), Malley's method (lifting the disk), Duff et al. 2017 (basis
//! from one vector). Sine and cosine are our own polynomials, since GPU and platform versions differ;
//! `kiln-gpu` has the same functions in WGSL (`sampling.wgsl`): keep them in sync. Both agree to 4 ULP.

use crate::{SobolScramble, sobol_point};
use glam::Vec3;

/// Sine and cosine for |x| ≤ π/4: Taylor polynomials, absolute error below 4e-8 before rounding.
#[inline(always)]
fn sin_cos_quarter(x: f32) -> (f32, f32) {
    let s = x * x;
    let sine = x * (1.0 + s * (-1.0 / 6.0 + s * (1.0 / 120.0 + s * (-1.0 / 5040.0))));
    let cosine = 1.0 + s * (-0.5 + s * (1.0 / 24.0 + s * (-1.0 / 720.0 + s * (1.0 / 40320.0))));
    (sine, cosine)
}

/// A point of the unit disk from one of the unit square, and its distance from the centre, which has a sign.
/// Area-preserving and continuous. Without branches, so that eight points become the lanes of a vector.
#[inline(always)]
fn concentric_disk([u, v]: [f32; 2]) -> ([f32; 2], f32) {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    let is_wide = a.abs() > b.abs();
    let r = if is_wide { a } else { b };
    let ratio = if is_wide { b } else { a } / r;
    // Only the center of the square has 0 / 0.
    let (sine, cosine) = sin_cos_quarter(if r == 0.0 { 0.0 } else { std::f32::consts::FRAC_PI_4 * ratio });
    (if is_wide { [r * cosine, r * sine] } else { [r * sine, r * cosine] }, r)
}

/// A direction about +z with density cos θ / π, from a point of the unit square: area-preserving and continuous.
#[inline(always)]
fn cosine_about_z(point: [f32; 2]) -> Vec3 {
    let ([x, y], r) = concentric_disk(point);
    let height = 1.0 - r * r;
    Vec3::new(x, y, if height > 0.0 { height } else { 0.0 }.sqrt())
}

/// A unit direction with the same density everywhere, from a point of the unit square: its left half is the half of the sphere
/// above y = 0, each half a square of its own as Shirley and Chiu have it. Planes across the axes, of which levels
/// consist, so lie on the edges of strata.
#[inline(always)]
pub fn sphere_direction([u, v]: [f32; 2]) -> Vec3 {
    let is_above = u < 0.5;
    let ([z, x], r) = concentric_disk([if is_above { 2.0 * u } else { 2.0 * u - 1.0 }, v]);
    let height = 1.0 - r * r;
    let stretch = (1.0 + height).sqrt();
    Vec3::new(x * stretch, if is_above { height } else { -height }, z * stretch)
}

/// Two unit vectors that make an orthonormal basis with the unit vector `n` (Duff et al. 2017).
pub fn orthonormal_basis(n: Vec3) -> (Vec3, Vec3) {
    let sign = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// A unit direction about the normal with density cos θ / π. `basis` is [`orthonormal_basis`] of the normal.
#[inline(always)]
pub fn cosine_direction(point: [f32; 2], normal: Vec3, basis: (Vec3, Vec3)) -> Vec3 {
    let local = cosine_about_z(point);
    basis.0 * local.x + basis.1 * local.y + normal * local.z
}

/// [`cosine_direction`] of eight points of a scrambled sequence from `first` on.
#[inline(always)]
pub(crate) fn cosine_directions(first: u32, scramble: SobolScramble, normal: Vec3, basis: (Vec3, Vec3)) -> [Vec3; 8] {
    let (mut x, mut y, mut z) = ([0.0; 8], [0.0; 8], [0.0; 8]);
    for lane in 0..8 {
        let direction = cosine_direction(sobol_point(first.wrapping_add(lane as u32), scramble), normal, basis);
        (x[lane], y[lane], z[lane]) = (direction.x, direction.y, direction.z);
    }
    let mut directions = [Vec3::ZERO; 8];
    for lane in 0..8 {
        directions[lane] = Vec3::new(x[lane], y[lane], z[lane]);
    }
    directions
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn polynomials_match() {
        for i in -1000..=1000 {
            let x = std::f32::consts::FRAC_PI_4 * i as f32 / 1000.0;
            let (sine, cosine) = sin_cos_quarter(x);
            assert!((f64::from(sine) - f64::from(x).sin()).abs() < 4e-7, "{x}");
            assert!((f64::from(cosine) - f64::from(x).cos()).abs() < 2e-7, "{x}");
        }
    }

    #[test]
    fn moments_of_the_uniform_distribution() {
        // Midpoints of a grid, so that what is left is the error of the map: means of xᵢ, xᵢ xⱼ, xᵢ⁴.
        let n = 512u32;
        let (mut first, mut second, mut fourth) = (glam::DVec3::ZERO, glam::DMat3::ZERO, glam::DVec3::ZERO);
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let d = sphere_direction([i, j].map(|k| (k as f32 + 0.5) / n as f32)).as_dvec3();
            assert!((d.length() - 1.0).abs() < 1e-6);
            first += d;
            second += glam::DMat3::from_cols(d * d.x, d * d.y, d * d.z);
            fourth += d * d * d * d;
        }
        let count = f64::from(n * n);
        assert!((first / count).length() < 1e-5, "{first}");
        let off = second * (1.0 / count) - glam::DMat3::IDENTITY * (1.0 / 3.0);
        assert!(off.to_cols_array().iter().all(|x| x.abs() < 1e-4), "{off}");
        assert!((fourth / count - 0.2).abs().max_element() < 1e-4, "{fourth}");
    }

    #[test]
    fn planes_across_the_axes_part_the_square_at_edges_of_strata() {
        let at = |u: f32, v: f32| sphere_direction([u, v]);
        for (i, j) in (0..64).flat_map(|i| (0..64).map(move |j| (i, j))) {
            let (u, v) = ((i as f32 + 0.5) / 64.0, (j as f32 + 0.5) / 64.0);
            assert_eq!(at(u, v).y > 0.0, u < 0.5);
            assert_eq!(at(u, v).x > 0.0, v > 0.5);
            assert_eq!(at(u, v).z > 0.0, (2.0 * u).fract() > 0.5);
        }
        assert_eq!((at(0.25, 0.5), at(0.75, 0.5)), (Vec3::Y, Vec3::NEG_Y));
    }

    #[test]
    fn moments_of_the_cosine_distribution() {
        // E[z] = 2/3, E[z²] = 1/2, E[x] = E[y] = 0, E[x²] = 1/4.
        let n = 512;
        let mut sums = [0.0f64; 5];
        for i in 0..n * n {
            let point = [((i % n) as f32 + 0.5) / n as f32, ((i / n) as f32 + 0.5) / n as f32];
            let d = cosine_about_z(point).as_dvec3();
            for (sum, value) in sums.iter_mut().zip([d.z, d.z * d.z, d.x, d.y, d.x * d.x]) {
                *sum += value / f64::from(n * n);
            }
        }
        for (sum, expected) in sums.iter().zip([2.0 / 3.0, 0.5, 0.0, 0.0, 0.25]) {
            assert!((sum - expected).abs() < 1e-4, "{sums:?}");
        }
    }

    proptest! {
        #[test]
        fn directions_are_unit_and_above(x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0, u in 0f32..1.0, v in 0f32..1.0) {
            prop_assume!(Vec3::new(x, y, z).length() > 0.1);
            let normal = Vec3::new(x, y, z).normalize();
            let (t, b) = orthonormal_basis(normal);
            prop_assert!(t.dot(b).abs() < 1e-5 && t.dot(normal).abs() < 1e-5 && t.cross(b).dot(normal) > 0.9999);
            let d = cosine_direction([u, v], normal, (t, b));
            prop_assert!((d.length() - 1.0).abs() < 1e-5 && d.dot(normal) > -1e-5);
        }
    }
}
