//! The nine real spherical harmonics up to the quadratic ones.
//!
//! Source: Ramamoorthi and Hanrahan 2001, "An efficient representation for irradiance environment maps", equation 3, whose
//! signs are all positive.

use glam::Vec3;

/// Functions of the quadratic basis.
pub const HARMONICS: usize = 9;

/// √(1 / 4π).
const CONSTANT: f32 = 0.282_094_79;
/// √(3 / 4π).
const LINEAR: f32 = 0.488_602_51;
/// √(15 / 4π).
const MIXED: f32 = 1.092_548_4;
/// √(5 / 16π).
const ZONAL: f32 = 0.315_391_57;
/// √(15 / 16π).
const SECTORAL: f32 = 0.546_274_2;

/// The basis at a unit direction: 1; y, z, x; xy, yz, 3z² − 1, xz, x² − y², each times its constant. Orthonormal over the
/// sphere; no value is above 0.631.
#[inline(always)]
pub fn quadratic_harmonics(direction: Vec3) -> [f32; HARMONICS] {
    let Vec3 { x, y, z } = direction;
    [
        CONSTANT,
        LINEAR * y,
        LINEAR * z,
        LINEAR * x,
        MIXED * (x * y),
        MIXED * (y * z),
        ZONAL * (3.0 * (z * z) - 1.0),
        MIXED * (x * z),
        SECTORAL * (x * x - y * y),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Quadrature that is exact for polynomials up to degree 5: Gauss and Legendre's three points in z, seven about the
    /// axis.
    fn over_the_sphere(f: impl Fn(Vec3) -> f64) -> f64 {
        let side = 0.6f64.sqrt();
        let rows = [(-side, 5.0 / 9.0), (0.0, 8.0 / 9.0), (side, 5.0 / 9.0)];
        let row = |(z, weight): (f64, f64)| {
            let r = (1.0 - z * z).sqrt();
            let at = |i: u32| std::f64::consts::TAU * f64::from(i) / 7.0;
            weight * (0..7).map(|i| f(DVec3::new(r * at(i).cos(), r * at(i).sin(), z).as_vec3())).sum::<f64>()
        };
        rows.into_iter().map(row).sum::<f64>() * std::f64::consts::TAU / 7.0
    }

    #[test]
    fn the_basis_is_orthonormal() {
        for (i, j) in (0..HARMONICS).flat_map(|i| (0..HARMONICS).map(move |j| (i, j))) {
            let product = over_the_sphere(|d| {
                let basis = quadratic_harmonics(d);
                f64::from(basis[i]) * f64::from(basis[j])
            });
            let expected = if i == j { 1.0 } else { 0.0 };
            assert!((product - expected).abs() < 1e-6, "{i} {j}: {product}");
        }
    }

    /// Of degree l means that the Laplacian on the sphere is −l (l + 1) times the function.
    #[test]
    fn each_function_has_its_degree() {
        let at = DVec3::new(0.36, -0.48, 0.8);
        let f = |p: DVec3, i: usize| f64::from(quadratic_harmonics(p.normalize().as_vec3())[i]);
        let step = 0.05;
        for (i, degree) in [0, 1, 1, 1, 2, 2, 2, 2, 2].into_iter().enumerate() {
            let second = |axis: DVec3| f(at + axis * step, i) + f(at - axis * step, i) - 2.0 * f(at, i);
            let laplacian = DVec3::AXES.into_iter().map(second).sum::<f64>() / (step * step);
            let expected = -f64::from(degree * (degree + 1)) * f(at, i);
            assert!((laplacian - expected).abs() < 0.03, "{i}: {laplacian} for {expected}");
        }
    }
}
