//! Closed forms of ambient obscurance, against which tracing is tested.
//!
//! The kernel is `ρ(t) = 1 − exp(−k t)`, `k = ln 2 / d` for the half-distance `d`; a miss counts 1
//! (P.-P. Sloan et al. 2013, equation 1). All functions take lengths in metres and return AO, 1 = open. An
//! infinite half-distance gives plain occlusion without a ray limit. Errors are below 1e-13.
//!
//! Most of the forms rest on one integral. For a fixed azimuth, the blocked directions between two elevations
//! contribute `∫ μ exp(−k h/μ) dμ`, with μ the cosine (or the sine) of the polar angle and h the distance at
//! μ = 1, and that is a difference of `μ² E3(k h/μ)` at the two ends.

use super::quadrature::integrate;
use std::f64::consts::{FRAC_PI_2, LN_2, PI, TAU};

/// Decay of the kernel, 1/m.
fn decay(half_distance_m: f64) -> f64 {
    LN_2 / half_distance_m
}

/// Exponential integral of order 3, `E3(z) = ∫_0^1 μ exp(−z/μ) dμ`, for z ≥ 0.
///
/// Below 1 by the series of E1 and two recurrences `n E_{n+1} = e^{−z} − z E_n`; above, by the continued fraction
/// of E3 (Abramowitz and Stegun, 5.1.11, 5.1.14 and 5.1.22).
pub fn exponential_integral_3(z: f64) -> f64 {
    if z <= 0.0 {
        0.5
    } else if z < 1.0 {
        const EULER_GAMMA: f64 = 0.577_215_664_901_532_9;
        let (mut power, mut series) = (1.0, 0.0);
        for n in 1..=20 {
            let n = f64::from(n);
            power *= -z / n;
            series -= power / n;
        }
        let e1 = -EULER_GAMMA - z.ln() + series;
        0.5 * ((1.0 - z) * (-z).exp() + z * z * e1)
    } else if z > 745.0 {
        0.0 // exp underflows
    } else {
        exponential_integral_3_fraction(z)
    }
}

/// `E3(z) = e^{−z} / (z + 3 − 1·3/(z + 5 − 2·4/(z + 7 − …)))`, evaluated from the far end, z ≥ 1.
fn exponential_integral_3_fraction(z: f64) -> f64 {
    // 100 terms reach 1e-16 at z = 1, where the fraction converges slowest.
    let tail = (1..=100).rev().map(f64::from).fold(0.0, |tail, i| i * (i + 2.0) / (z + 2.0 * i + 3.0 - tail));
    (-z).exp() / (z + 3.0 - tail)
}

/// Bickley–Naylor function `Ki_n(x) = ∫_0^{π/2} exp(−x / sin t) sin^{n−1} t dt`, for n ≥ 1 and x ≥ 0.
pub fn bickley(n: i32, x: f64) -> f64 {
    integrate(|t| (-x / t.sin()).exp() * t.sin().powi(n - 1), 0.0, FRAC_PI_2)
}

/// A receiver facing a parallel infinite plane at a height.
pub fn plane(height_m: f64, half_distance_m: f64) -> f64 {
    1.0 - 2.0 * exponential_integral_3(decay(half_distance_m) * height_m)
}

/// The centre of a sphere, any normal.
pub fn sphere_centre(radius_m: f64, half_distance_m: f64) -> f64 {
    -(-decay(half_distance_m) * radius_m).exp_m1()
}

/// The inner surface of a sphere, the normal to its centre: `1 − 2 (1 − (1 + c) e^{−c}) / c²`, c = 2 k R.
pub fn sphere_inner(radius_m: f64, half_distance_m: f64) -> f64 {
    let c = 2.0 * decay(half_distance_m) * radius_m;
    if c < 1.0 {
        // The form cancels; its series is 2 Σ_{n≥1} (−1)^{n+1} cⁿ (n + 1) / (n + 2)!.
        let (mut power, mut sum) = (0.5, 0.0);
        for n in 1..=20 {
            let n = f64::from(n);
            power *= -c / (n + 2.0);
            sum -= 2.0 * power * (n + 1.0);
        }
        sum
    } else {
        1.0 - 2.0 * (1.0 - (1.0 + c) * (-c).exp()) / (c * c)
    }
}

/// A floor at a distance from a vertical wall without end: `1 − (2/π) (Ki1 − Ki3)(k x)`.
pub fn wall(distance_m: f64, half_distance_m: f64) -> f64 {
    let x = decay(half_distance_m) * distance_m;
    // Ki1 − Ki3 under one integral, so that nothing cancels: 1 − sin² = cos².
    1.0 - integrate(|t| (-x / t.sin()).exp() * t.cos().powi(2), 0.0, FRAC_PI_2) / FRAC_PI_2
}

/// A floor at a distance from a vertical wall without end and of a finite height.
pub fn wall_finite(distance_m: f64, height_m: f64, half_distance_m: f64) -> f64 {
    let k = decay(half_distance_m);
    let blocked = |azimuth: f64| {
        let floor_m = distance_m / azimuth.cos();
        let top_m = floor_m.hypot(height_m);
        exponential_integral_3(k * floor_m) - (floor_m / top_m).powi(2) * exponential_integral_3(k * top_m)
    };
    1.0 - integrate(blocked, 0.0, FRAC_PI_2) / FRAC_PI_2
}

/// Under a parallel disk, on its axis.
pub fn disk(radius_m: f64, height_m: f64, half_distance_m: f64) -> f64 {
    let k = decay(half_distance_m);
    let rim_m = radius_m.hypot(height_m);
    let share = (height_m / rim_m).powi(2);
    1.0 - 2.0 * exponential_integral_3(k * height_m) + 2.0 * share * exponential_integral_3(k * rim_m)
}

/// Under a ball whose centre is on the normal, at a height greater than the radius.
///
/// With n the nearest distance and T the length of the tangent, cos θ = (t + T²/t) / 2H along the visible side,
/// and `O = (T⁴/n² E3(k n) − T² E3(k T) − ∫_n^T t e^{−k t} dt) / 2H²`.
pub fn ball(centre_height_m: f64, radius_m: f64, half_distance_m: f64) -> f64 {
    let k = decay(half_distance_m);
    let (h, near) = (centre_height_m, centre_height_m - radius_m);
    let tangent_squared = h * h - radius_m * radius_m;
    let tangent = tangent_squared.sqrt();
    let between = integrate(|t| t * (-k * t).exp(), near, tangent);
    let blocked = (tangent_squared / near).powi(2) * exponential_integral_3(k * near)
        - tangent_squared * exponential_integral_3(k * tangent)
        - between;
    1.0 - blocked / (2.0 * h * h)
}

/// The axis of a cylinder without end, the normal across it: `1 − (4/π) Ki3(k R)`.
pub fn cylinder_axis(radius_m: f64, half_distance_m: f64) -> f64 {
    1.0 - 4.0 / PI * bickley(3, decay(half_distance_m) * radius_m)
}

/// A point of the floor of a closed room of `size_m` (width, length, height), at a distance from the corner.
///
/// In a direction of azimuth φ the wall is ρ(φ) away on the floor and its top L = √(ρ² + H²); wall and ceiling
/// together block `E3(k ρ) + E3(k H) − E3(k L)`, for the two terms at their common edge add to one E3.
pub fn closed_box(point_m: [f64; 2], size_m: [f64; 3], half_distance_m: f64) -> f64 {
    let k = decay(half_distance_m);
    let height = size_m[2];
    let sides = [size_m[0] - point_m[0], size_m[1] - point_m[1], point_m[0], point_m[1]];
    let mut walls = 0.0;
    for (i, &distance) in sides.iter().enumerate() {
        // The wall spans the azimuths between its two corners, seen from its foot point.
        let blocked = |azimuth: f64| {
            let floor_m = distance / azimuth.cos();
            exponential_integral_3(k * floor_m) - exponential_integral_3(k * floor_m.hypot(height))
        };
        let (before, after) = (sides[(i + 3) % 4], sides[(i + 1) % 4]);
        walls += integrate(blocked, -before.atan2(distance), after.atan2(distance));
    }
    1.0 - (TAU * exponential_integral_3(k * height) + walls) / PI
}

/// Under an infinite slab of fog of a thickness and extinction that lies directly on the receiver, with an opaque
/// ceiling at a height no less than the thickness: `2 E3(σ s) − 2 E3(σ s + k h)`.
pub fn fog_slab(ceiling_m: f64, thickness_m: f64, extinction_per_m: f64, half_distance_m: f64) -> f64 {
    let depth = extinction_per_m * thickness_m;
    2.0 * exponential_integral_3(depth) - 2.0 * exponential_integral_3(depth + decay(half_distance_m) * ceiling_m)
}

#[cfg(test)]
#[path = "closed_form_tests.rs"]
mod tests;
