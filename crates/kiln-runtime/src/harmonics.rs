//! AO as a function of the normal, in real spherical harmonics.
//!
//! The coefficients of a pack are those of AO itself (what is seen, convolved with the clamped cosine and divided by π):
//! the sum of coefficients times harmonics at a normal is AO there. Basis: Ramamoorthi and Hanrahan 2001, "An efficient
//! representation for irradiance environment maps", equation 3. The tracer has the same constants, and so has
//! `shaders/kiln_runtime.wgsl`: keep them in sync.

use crate::{format::HARMONICS, remap::unit};

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

/// The linear basis at a unit direction: 1; y, z, x, each times its constant.
#[inline]
pub fn linear_harmonics([x, y, z]: [f32; 3]) -> [f32; 4] {
    [CONSTANT, LINEAR * y, LINEAR * z, LINEAR * x]
}

/// The quadratic basis at a unit direction: the linear one, then xy, yz, 3z² − 1, xz, x² − y², each times its constant.
#[inline]
pub fn quadratic_harmonics([x, y, z]: [f32; 3]) -> [f32; HARMONICS] {
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

/// AO for a unit normal, 0 to 1, from linear coefficients. What is not a number is 0.
#[inline]
pub fn ao_linear(coefficients: [f32; 4], normal: [f32; 3]) -> f32 {
    dot(coefficients, linear_harmonics(normal))
}

/// AO for a unit normal, 0 to 1, from quadratic coefficients. What is not a number is 0.
#[inline]
pub fn ao_quadratic(coefficients: [f32; HARMONICS], normal: [f32; 3]) -> f32 {
    dot(coefficients, quadratic_harmonics(normal))
}

#[inline]
fn dot<const N: usize>(a: [f32; N], b: [f32; N]) -> f32 {
    unit(a.into_iter().zip(b).map(|(a, b)| a * b).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    const AXES: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    /// Over an infinite plane AO is (1 + n·up) / 2, which linear harmonics hold exactly.
    #[test]
    fn a_plane_is_exact_in_linear_harmonics() {
        for (axis, coefficient) in [(0, 3), (1, 1), (2, 2)] {
            let mut coefficients = [0.0; 4];
            coefficients[0] = PI.sqrt();
            coefficients[coefficient] = (PI / 3.0).sqrt();
            for step in 0..64 {
                let angle = step as f32 * 0.1;
                let mut normal = [0.0; 3];
                normal[axis] = angle.cos();
                normal[(axis + 1) % 3] = angle.sin() * 0.6;
                normal[(axis + 2) % 3] = angle.sin() * 0.8;
                let ao = ao_linear(coefficients, normal);
                assert!((ao - (1.0 + normal[axis]) / 2.0).abs() < 2e-7, "{axis} {angle}: {ao}");
            }
        }
    }

    #[test]
    fn an_open_sky_is_one_and_values_stay_in_range() {
        let open = [(4.0 * PI).sqrt(), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        for normal in AXES {
            assert!((ao_quadratic(open, normal) - 1.0).abs() < 1e-6);
            assert_eq!(ao_quadratic(open.map(|c| c * 2.0), normal), 1.0);
            assert_eq!(ao_quadratic(open.map(|c| -c), normal), 0.0);
        }
    }

    /// Quadrature that is exact up to degree 5: three rows of Gauss and Legendre, seven points about the axis.
    #[test]
    fn the_basis_is_orthonormal() {
        let side = 0.6f32.sqrt();
        let mut products = [[0.0f64; HARMONICS]; HARMONICS];
        for (z, weight) in [(-side, 5.0 / 9.0), (0.0, 8.0 / 9.0), (side, 5.0 / 9.0)] {
            let radius = (1.0 - z * z).sqrt();
            for step in 0..7 {
                let angle = 2.0 * PI * step as f32 / 7.0;
                let basis = quadratic_harmonics([radius * angle.cos(), radius * angle.sin(), z]);
                for (i, row) in products.iter_mut().enumerate() {
                    for (product, other) in row.iter_mut().zip(basis) {
                        *product += weight * 2.0 * std::f64::consts::PI / 7.0 * f64::from(basis[i]) * f64::from(other);
                    }
                }
            }
        }
        for (i, row) in products.iter().enumerate() {
            for (j, product) in row.iter().enumerate() {
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-6, "{i} {j}: {product}");
            }
        }
    }
}
