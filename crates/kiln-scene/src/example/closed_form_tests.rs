//! The closed forms against reference values, limits, and independent integrals of their definitions.

use super::*;

const HALF_DISTANCES_M: [f64; 4] = [0.1, 2.0, 300.0, f64::INFINITY];

#[track_caller]
fn near(value: f64, expected: f64, tolerance: f64) {
    assert!((value - expected).abs() <= tolerance, "{value:.13} is not {expected:.13}");
}

/// Values to ten digits that were checked against Monte Carlo integration.
#[test]
fn reference_values() {
    type Case = (&'static str, fn(f64) -> f64, f64, f64);
    let table: [Case; 9] = [
        ("plane, h = 2", |d| plane(2.0, d), 0.664_639_946_4, 0.009_107_404_1),
        ("wall, x = 1", |d| wall(1.0, d), 0.811_674_088_3, 0.509_102_009_5),
        ("wall 3 m high, x = 1", |d| wall_finite(1.0, 3.0, d), 0.827_270_676_9, 0.659_801_594_9),
        ("disk R = 1, h = 1", |d| disk(1.0, 1.0, d), 0.666_583_923_7, 0.501_351_605_6),
        ("ball R = 1, centre 2 above", |d| ball(2.0, 1.0, d), 0.834_957_395_7, 0.750_693_647_6),
        ("sphere centre, R = 1", |d| sphere_centre(1.0, d), 0.292_893_218_8, 0.002_307_823_5),
        ("inner sphere surface, R = 1", |d| sphere_inner(1.0, d), 0.361_326_059_9, 0.003_075_322_3),
        ("box 4×6×3, (1, 2)", |d| closed_box([1.0, 2.0], [4.0, 6.0, 3.0], d), 0.625_497_061_0, 0.006_930_196_1),
        ("fog slab", |d| fog_slab(3.0, 1.0, 0.3, d), 0.460_383_452_6, 0.006_460_076_5),
    ];
    for (name, form, short, long) in table {
        for (d, expected) in [(2.0, short), (300.0, long)] {
            let value = form(d);
            assert!((value - expected).abs() < 1e-10, "{name}, d = {d}: {value:.12} is not {expected:.10}");
        }
    }
}

#[test]
fn e3_is_its_definition() {
    for z in [1e-9, 1e-3, 0.1, 0.5, 0.999_999, 1.0, 1.5, 4.0, 30.0, 700.0] {
        let definition = integrate(|mu| mu * (-z / mu).exp(), 0.0, 1.0);
        near(exponential_integral_3(z) / definition, 1.0, 1e-13);
    }
    near(exponential_integral_3(0.0), 0.5, 0.0);
    assert!(exponential_integral_3(f64::INFINITY) == 0.0);
}

/// `x (Ki0 − Ki2) = 2 Ki3 − Ki1`, with `Ki0 = K0`; here K0 by its own integral `∫_0^∞ exp(−x cosh u) du`.
#[test]
fn bickley_recurrence() {
    for x in [0.1, 1.0, 3.0] {
        let k0 = integrate(|u: f64| (-x * u.cosh()).exp(), 0.0, 8.0);
        near(2.0 * bickley(3, x), bickley(1, x) + x * (k0 - bickley(2, x)), 1e-13);
    }
    near(bickley(1, 0.0), FRAC_PI_2, 1e-14);
    near(bickley(2, 0.0), 1.0, 1e-14);
    near(bickley(3, 0.0), FRAC_PI_2 / 2.0, 1e-14);
}

/// Without decay every form is plain occlusion, known by geometry alone.
#[test]
fn plain_occlusion() {
    let d = f64::INFINITY;
    near(plane(2.0, d), 0.0, 1e-15);
    near(wall(1.0, d), 0.5, 1e-14);
    near(wall_finite(1.0, 3.0, d), 0.5 + 0.5 / 10f64.sqrt(), 1e-14);
    near(disk(3.0, 1.0, d), 0.1, 1e-15);
    near(ball(2.0, 1.0, d), 0.75, 1e-14);
    near(ball(5.0, 2.0, d), 1.0 - 4.0 / 25.0, 1e-14);
    near(closed_box([1.0, 2.0], [4.0, 6.0, 3.0], d), 0.0, 1e-14);
    near(sphere_inner(1.0, d), 0.0, 0.0);
    near(sphere_centre(1.0, d), 0.0, 0.0);
    near(cylinder_axis(1.0, d), 0.0, 1e-14);
}

/// Forms that contain each other agree at the limit.
#[test]
fn limits_join() {
    for d in [0.1, 2.0, 300.0] {
        near(wall_finite(1.0, 1e9, d), wall(1.0, d), 1e-12);
        near(disk(1e9, 2.0, d), plane(2.0, d), 1e-12);
        near(closed_box([5e8, 5e8], [1e9, 1e9, 2.0], d), plane(2.0, d), 1e-8);
        near(ball(1e7 + 2.0, 1e7, d), plane(2.0, d), 1e-6);
        near(ball(1.0 + 1e-9, 1.0, d), 1.0, 1.0);
        near(fog_slab(2.0, 0.0, 0.3, d), plane(2.0, d), 1e-15);
    }
}

/// The box as the sum of its five rectangles, each by quadrature over its area.
#[test]
fn box_by_area() {
    let (px, py, width, length, height) = (1.0, 2.0, 4.0, 6.0, 3.0);
    for d in HALF_DISTANCES_M {
        let k = decay(d);
        let ceiling = over(-px, width - px, -py, length - py, |x, y| {
            let s = x * x + y * y + height * height;
            height * height / (s * s) * (-k * s.sqrt()).exp()
        });
        let wall = |distance: f64, from: f64, to: f64| {
            over(from, to, 0.0, height, |y, z| {
                let s = distance * distance + y * y + z * z;
                distance * z / (s * s) * (-k * s.sqrt()).exp()
            })
        };
        let walls = wall(width - px, -py, length - py)
            + wall(px, -py, length - py)
            + wall(length - py, -px, width - px)
            + wall(py, -px, width - px);
        near(closed_box([px, py], [width, length, height], d), 1.0 - (ceiling + walls) / PI, 1e-12);
    }
}

/// The finite wall by elevation and azimuth, straight from the definition.
#[test]
fn finite_wall_by_angles() {
    for d in [2.0, 300.0] {
        let k = decay(d);
        let blocked = |azimuth: f64| {
            let floor = 1.0 / azimuth.cos();
            let top = 3f64.atan2(floor);
            integrate(|e| (-k * floor / e.cos()).exp() * e.sin() * e.cos(), 0.0, top)
        };
        near(wall_finite(1.0, 3.0, d), 1.0 - integrate(blocked, 0.0, FRAC_PI_2) * 2.0 / PI, 1e-12);
    }
}

/// Ball, disk, cylinder and inner sphere by the definition: `O = 2 ∫ exp(−k t(μ)) μ dμ` where t depends on the
/// polar angle alone, and a further average over the azimuth for the cylinder.
#[test]
fn round_shapes_by_polar_angle() {
    for d in [0.1, 2.0, 300.0] {
        let k = decay(d);
        let blocked = |from: f64, t: &dyn Fn(f64) -> f64| 2.0 * integrate(|mu| (-k * t(mu)).exp() * mu, from, 1.0);
        near(sphere_inner(1.0, d), 1.0 - blocked(0.0, &|mu| 2.0 * mu), 1e-13);
        near(disk(1.0, 1.0, d), 1.0 - blocked(0.5f64.sqrt(), &|mu| 1.0 / mu), 1e-13);
        let ball_t = |mu: f64| 2.0 * mu - (4.0 * mu * mu - 3.0).max(0.0).sqrt();
        near(ball(2.0, 1.0, d), 1.0 - blocked(0.75f64.sqrt(), &ball_t), 1e-8);
        let slice = |azimuth: f64| blocked(0.0, &|mu| 1.0 / (mu * mu + (1.0 - mu * mu) * azimuth.cos().powi(2)).sqrt());
        near(cylinder_axis(1.0, d), 1.0 - integrate(slice, 0.0, FRAC_PI_2) / FRAC_PI_2, 1e-11);
    }
}

/// The series of the inner sphere continues the closed form.
#[test]
fn sphere_series_joins() {
    let at = |c: f64| sphere_inner(0.5 * c / LN_2, 1.0);
    let slope = (at(1.000_1) - at(1.0)) / 1e-4;
    near(at(1.0 - 1e-9), at(1.0) - slope * 1e-9, 1e-13);
    near(at(1e-12), 2e-12 / 3.0, 1e-24);
}

/// Farther blockers and shorter half-distances open.
#[test]
fn monotone() {
    let forms: [fn(f64, f64) -> f64; 6] = [plane, wall, sphere_inner, sphere_centre, cylinder_axis, |height, d| {
        closed_box([1.0, 2.0], [4.0, 6.0, height], d)
    }];
    for form in forms {
        let values: Vec<f64> = [0.25, 0.5, 1.0, 2.0, 4.0].map(|s| form(s, 2.0)).to_vec();
        assert!(values.is_sorted_by(|a, b| a < b), "{values:?}");
        assert!(form(1.0, 1.0) > form(1.0, 2.0));
        assert!(values.iter().all(|v| (0.0..=1.0).contains(v)));
    }
}

fn over(x0: f64, x1: f64, y0: f64, y1: f64, f: impl Fn(f64, f64) -> f64) -> f64 {
    integrate(|x| integrate(|y| f(x, y), y0, y1), x0, x1)
}
