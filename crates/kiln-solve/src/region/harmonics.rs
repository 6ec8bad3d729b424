//! AO for normals along the axes from its nine harmonics, in the order and with the signs of `kiln_trace`: 1; y, z, x;
//! xy, yz, 3z² − 1, xz, x² − y².

use kiln_core::REGION_HARMONICS;

/// +x, −x, +y, −y, +z and −z.
pub(crate) const NORMALS: usize = 6;

/// √(1 / 4π).
const CONSTANT: f64 = 0.282_094_791_773_878_14;
/// √(3 / 4π).
const LINEAR: f64 = 0.488_602_511_902_919_9;
/// √(5 / 16π).
const ZONAL: f64 = 0.315_391_565_252_520_05;
/// √(15 / 16π).
const SECTORAL: f64 = 0.546_274_215_296_039_6;

/// The first coefficient of an open sky, √4π: all others are 0, and AO is 1 for every normal.
pub const OPEN_SKY: f64 = 3.544_907_701_811_032;

/// What squares of coefficients are divided by for squares of AO averaged over all normals (Parseval): 4π.
pub(crate) const SPHERE: f64 = 4.0 * std::f64::consts::PI;

/// AO for the six normals, from a function that gives its nine coefficients. The mixed harmonics are 0 there.
pub(crate) fn at_axes(coefficient: impl Fn(usize) -> f64) -> [f64; NORMALS] {
    let [constant, zonal, sectoral] = [CONSTANT * coefficient(0), ZONAL * coefficient(6), SECTORAL * coefficient(8)];
    let even = [constant - zonal + sectoral, constant - zonal - sectoral, constant + 2.0 * zonal];
    let odd = [3, 1, 2].map(|harmonic| LINEAR * coefficient(harmonic));
    std::array::from_fn(|n| if n % 2 == 0 { even[n / 2] + odd[n / 2] } else { even[n / 2] - odd[n / 2] })
}

/// The nine harmonics at a normal, by its place among the six.
pub(crate) fn basis(normal: usize) -> [f64; REGION_HARMONICS] {
    std::array::from_fn(|harmonic| at_axes(|k| f64::from(u8::from(k == harmonic)))[normal])
}

/// The sum of their squares, the same for every normal.
pub(crate) const BASIS_SQUARES: f64 = REGION_HARMONICS as f64 / SPHERE;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_sky_is_one_for_every_normal() {
        let open = at_axes(|k| if k == 0 { OPEN_SKY } else { 0.0 });
        assert!(open.iter().all(|ao| (ao - 1.0).abs() < 1e-15), "{open:?}");
        assert!((OPEN_SKY * OPEN_SKY / SPHERE - 1.0).abs() < 1e-15);
    }

    /// Over a ground plane AO is (1 + n·up) / 2, which linear harmonics hold.
    #[test]
    fn a_ground_plane_is_half_for_walls() {
        let coefficients = [0.5 * OPEN_SKY, 0.0, 0.5 / LINEAR, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let ao = at_axes(|k| coefficients[k]);
        let expected = [0.5, 0.5, 0.5, 0.5, 1.0, 0.0];
        assert!(ao.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{ao:?}");
    }

    #[test]
    fn squares_add_up_to_the_same_for_every_normal() {
        for normal in 0..NORMALS {
            let squares: f64 = basis(normal).iter().map(|y| y * y).sum();
            assert!((squares - BASIS_SQUARES).abs() < 1e-15, "{normal}: {squares}");
        }
    }

    #[test]
    fn quadratic_harmonics_have_the_signs_of_their_polynomials() {
        let zonal = at_axes(|k| f64::from(u8::from(k == 6))).map(f64::signum);
        let sectoral = at_axes(|k| f64::from(u8::from(k == 8)));
        assert_eq!(zonal, [-1.0, -1.0, -1.0, -1.0, 1.0, 1.0]);
        assert_eq!(sectoral, [SECTORAL, SECTORAL, -SECTORAL, -SECTORAL, 0.0, 0.0]);
    }
}
