//! Ambient obscurance of a set of triangles by quadrature over their area: no rays, no noise.
//!
//! Where no triangle hides another, as in every oracle scene, `1 − AO = Σ ∫ e^{−k t} cos θ cos α / (π t²) dA` over
//! the triangles that show their front. This is the check that an oracle scene's triangles are close enough to the
//! ideal shape.

use glam::DVec3;
use std::f64::consts::{LN_2, PI};

/// AO at a point, for a half-distance in metres.
pub(super) fn ambient_obscurance(triangles: &[[DVec3; 3]], point: DVec3, normal: DVec3, half_distance_m: f64) -> f64 {
    let k = LN_2 / half_distance_m;
    let blocked: f64 = triangles
        .iter()
        .map(|corners| corners.map(|c| c - point))
        .filter(|[a, b, c]| a.dot((b - a).cross(c - a)) < 0.0)
        .flat_map(|triangle| above_horizon(triangle, normal))
        .map(|triangle| blocked_by(triangle, normal, k))
        .sum();
    1.0 - blocked
}

/// The part of a triangle where `p · normal > 0`, as a fan.
fn above_horizon(triangle: [DVec3; 3], normal: DVec3) -> Vec<[DVec3; 3]> {
    let mut polygon = Vec::new();
    for i in 0..3 {
        let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
        let (height_a, height_b) = (a.dot(normal), b.dot(normal));
        if height_a >= 0.0 {
            polygon.push(a);
        }
        if (height_a >= 0.0) != (height_b >= 0.0) {
            polygon.push(a.lerp(b, height_a / (height_a - height_b)));
        }
    }
    (2..polygon.len()).map(|i| [polygon[0], polygon[i - 1], polygon[i]]).collect()
}

/// Halves the longest edge until the triangle is small as seen from the origin, then takes a rule of degree 5
/// (J. Radon 1948).
fn blocked_by([a, b, c]: [DVec3; 3], normal: DVec3, k: f64) -> f64 {
    let edges = [(b - c).length_squared(), (c - a).length_squared(), (a - b).length_squared()];
    let longest = edges[0].max(edges[1]).max(edges[2]);
    let cross = (b - a).cross(c - a);
    let distance_squared = a.length_squared().min(b.length_squared()).min(c.length_squared());
    // What is left is below 1e-9 where the solid angle is as small.
    if longest > 0.06 * distance_squared && cross.length() > 1e-9 * distance_squared {
        let halves = if longest == edges[0] {
            let middle = b.midpoint(c);
            [[a, b, middle], [a, middle, c]]
        } else if longest == edges[1] {
            let middle = c.midpoint(a);
            [[b, c, middle], [b, middle, a]]
        } else {
            let middle = a.midpoint(b);
            [[c, a, middle], [c, middle, b]]
        };
        return halves.into_iter().map(|half| blocked_by(half, normal, k)).sum();
    }
    let value = |p: DVec3| {
        let t = p.length();
        // cos α dA is −p · cross / 2t.
        (-k * t).exp() * p.dot(normal).max(0.0) * -p.dot(cross) / (2.0 * PI * t.powi(4))
    };
    let root = 15f64.sqrt();
    let mut sum = 9.0 / 40.0 * value((a + b + c) / 3.0);
    for (near, weight) in
        [((6.0 - root) / 21.0, (155.0 - root) / 1200.0), ((6.0 + root) / 21.0, (155.0 + root) / 1200.0)]
    {
        let far = 1.0 - 2.0 * near;
        let points = [far * a + near * (b + c), far * b + near * (c + a), far * c + near * (a + b)];
        sum += weight * points.into_iter().map(value).sum::<f64>();
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The form factor of a rectangle at a height over one corner, in closed form (radiative heat transfer).
    #[test]
    fn one_rectangle() {
        let [x, y] = [1.5f64, 0.7];
        let corner = |x: f64, z: f64| DVec3::new(x, 1.0, z);
        // Facing down.
        let (a, b, c, d) = (corner(0.0, 0.0), corner(x, 0.0), corner(x, y), corner(0.0, y));
        let triangles = [[a, b, c], [a, c, d]];
        let (rx, ry) = (x.hypot(1.0), y.hypot(1.0));
        let expected = 1.0 - (x / rx * (y / rx).atan() + y / ry * (x / ry).atan()) / (2.0 * PI);
        let value = ambient_obscurance(&triangles, DVec3::ZERO, DVec3::Y, f64::INFINITY);
        assert!((value - expected).abs() < 1e-8, "{value} {expected}");
    }

    /// A floor through the point's height is cut at the horizon.
    #[test]
    fn the_horizon_cuts() {
        let corner = |y: f64, z: f64| DVec3::new(1.0, y, z);
        let sheet = |from: f64| {
            let (a, b, c, d) = (corner(from, -1.0), corner(from, 1.0), corner(1.0, 1.0), corner(1.0, -1.0));
            ambient_obscurance(&[[a, b, c], [a, c, d]], DVec3::ZERO, DVec3::Y, 2.0)
        };
        assert!((sheet(0.0) - sheet(-3.0)).abs() < 1e-8);
        assert!(sheet(0.0) < 0.99);
    }
}
