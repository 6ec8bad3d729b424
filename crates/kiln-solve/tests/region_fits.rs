//! Laws of the fit of seven parameters to a region.

#[expect(dead_code, reason = "each test program uses a part")]
mod rooms;

use glam::DVec3;
use kiln_core::{CandidateBits, REGION_HARMONICS};
use kiln_solve::region::{CenterRule, OPEN_SKY, RegionError, RegionFit, RegionPoints, fit_region};
use proptest::prelude::*;
use rooms::*;

const RULES: [CenterRule; 6] = [
    CenterRule::Mean,
    CenterRule::Gradient,
    CenterRule::Points,
    CenterRule::Box,
    CenterRule::Best,
    CenterRule::Refined,
];

/// The greatest difference of parameters per metre, by the half-extent of their axis.
fn off(fit: &RegionFit, known: &Known) -> f64 {
    let (model, half) = (fit.model(), [1.0, 6.0, 6.0, 1.5, 1.5, 2.0, 2.0]);
    let pairs = model.coefficients.iter().zip(&known.parameters);
    let differences = pairs.flat_map(|(a, b)| (0..7).map(move |i| (f64::from(a[i]) - b[i]).abs() * half[i]));
    differences.fold(0.0, f64::max)
}

/// The mean of the valid points.
fn mean(valid: &CandidateBits) -> DVec3 {
    valid.iter().map(|index| hall().candidate(index)).sum::<DVec3>() / valid.count() as f64
}

#[test]
fn a_known_model_comes_back() {
    let region = hall();
    for seed in 0..20 {
        let valid = if seed == 0 { CandidateBits::ALL } else { bits(|i| noise(seed * 512 + i as u64) < 0.4) };
        for (rule, center) in [(CenterRule::Points, mean(&valid)), (CenterRule::Box, region.bounds.center())] {
            let known = Known::new(&region, center, seed);
            let points = points(&region, &valid, 2, |p, k| known.at(p, k));
            for rule in [rule, CenterRule::Best, CenterRule::Refined] {
                let fit = fit_region(&points, rule);
                assert!(off(&fit, &known) < 1e-5, "{seed} {rule:?}: {} {}", off(&fit, &known), fit.is_shrunk());
                assert!(
                    fit.center().distance(center) < 1e-9 && !fit.is_shrunk(),
                    "{:?} {}",
                    fit.center(),
                    fit.is_shrunk()
                );
                assert!(fit.squared_errors().iter().all(|error| *error < 1e-9), "{fit:?}");
            }
        }
    }
}

#[test]
fn a_centre_is_found() {
    let region = hall();
    for seed in 0..60 {
        // Two slabs at least are well on each side: with one, the slope could make up for the centre, and the ridge bends
        // a slope that hangs on little.
        let valid = if seed < 5 { CandidateBits::ALL } else { bits(|i| noise(seed * 512 + i as u64) < 0.4) };
        let place = [0, 1, 2].map(|axis| noise(77 * seed + axis) - 0.5);
        let center = region.bounds.center() + 0.5 * (region.bounds.max - region.bounds.min) * DVec3::from(place);
        let known = Known::new(&region, center, seed);
        let fit = fit_region(&points(&region, &valid, 2, |p, k| known.at(p, k)), CenterRule::Refined);
        assert!(fit.is_refined() && fit.center().distance(center) < 1e-5, "{seed}: {:?} {center:?}", fit.center());
        assert!(off(&fit, &known) < 1e-5, "{seed}: {} {}", fit.is_shrunk(), off(&fit, &known));
    }
}

/// Box and model as far away as a level may be; positions are f64.
#[test]
fn distance_from_the_origin_changes_nothing() {
    let far = DVec3::new(1.0e6, -3.0e6, 2.0e5);
    let moved = region((hall().bounds.min + far).to_array(), (hall().bounds.max + far).to_array());
    let valid = bits(|i| i % 3 > 0);
    let near = fit_region(&points(&hall(), &valid, 1, |p, k| uneven(4, p, k)), CenterRule::Refined);
    let fit = fit_region(&points(&moved, &valid, 1, |p, k| uneven(4, p - far, k)), CenterRule::Refined);
    assert!(fit.center().distance(near.center() + far) < 1e-4);
    for (a, b) in fit.model().coefficients.iter().zip(near.model().coefficients) {
        assert!((0..7).all(|i| (a[i] - b[i]).abs() < 1e-5), "{a:?} {b:?}");
    }
}

#[test]
fn a_gradient_is_no_more_than_a_gradient() {
    let region = hall();
    let linear = |p: DVec3, k: usize| 0.1 * k as f64 + 0.02 * p.x - 0.03 * p.y + 0.01 * p.z;
    let valid = bits(|i| i % 3 != 0);
    for rule in [CenterRule::Gradient, CenterRule::Points, CenterRule::Box, CenterRule::Best, CenterRule::Refined] {
        let fit = fit_region(&points(&region, &valid, 1, linear), rule);
        for corner in [region.bounds.min, region.bounds.max] {
            fit.at(corner).enumerate().for_each(|(k, v)| assert!((v - linear(corner, k)).abs() < 1e-5, "{rule:?}"));
        }
        assert!(!fit.is_refined());
    }
    let [constant, gradient] = [CenterRule::Mean, CenterRule::Gradient]
        .map(|rule| fit_region(&points(&region, &valid, 1, |p, _| 0.1 * (p.x - 3.0).abs()), rule).squared_errors()[0]);
    assert!(gradient > 0.9 * constant, "{gradient} {constant}");
}

/// AO at a point of a box for the direction d: half a metre away hides half.
fn hidden(region: &kiln_core::Region, point: DVec3, d: DVec3) -> f64 {
    let to_wall = |axis: usize| {
        let wall = if d[axis] > 0.0 { region.bounds.max[axis] } else { region.bounds.min[axis] };
        if d[axis] == 0.0 { f64::INFINITY } else { (wall - point[axis]) / d[axis] }
    };
    1.0 - 0.5f64.powf(to_wall(0).min(to_wall(1)).min(to_wall(2)) / 2.0)
}

/// Its harmonics, convolved with the clamped cosine, by 2,000 directions on a spiral.
fn room(region: &kiln_core::Region, point: DVec3) -> [f64; REGION_HARMONICS] {
    let mut sums = [0.0; REGION_HARMONICS];
    for i in 0..2000 {
        let (z, turn) = (1.0 - (2.0 * f64::from(i) + 1.0) / 2000.0, f64::from(i) * 2.399_963_229_728_653);
        let r = (1.0 - z * z).sqrt();
        let d = DVec3::new(r * turn.cos(), r * turn.sin(), z);
        let harmonics = [
            0.282095,
            0.488603 * d.y,
            0.488603 * d.z,
            0.488603 * d.x,
            1.092548 * d.x * d.y,
            1.092548 * d.y * d.z,
            0.315392 * (3.0 * d.z * d.z - 1.0),
            1.092548 * d.x * d.z,
            0.546274 * (d.x * d.x - d.y * d.y),
        ];
        let seen = hidden(region, point, d) * 4.0 * std::f64::consts::PI / 2000.0;
        sums.iter_mut().zip(harmonics).for_each(|(sum, y)| *sum += seen * y);
    }
    std::array::from_fn(|k| sums[k] * [1.0, 2.0 / 3.0, 0.25][usize::from(k > 0) + usize::from(k > 3)])
}

#[test]
fn a_closed_room_is_brightest_in_its_middle() {
    let region = hall();
    let at: Vec<_> = CandidateBits::ALL.iter().map(|index| room(&region, region.candidate(index))).collect();
    let values: Vec<f32> = at.iter().flatten().map(|value| *value as f32).collect();
    let points = RegionPoints::new(&region, &CandidateBits::ALL, &values, 1).unwrap();
    for rule in [CenterRule::Points, CenterRule::Box, CenterRule::Best, CenterRule::Refined] {
        let fit = fit_region(&points, rule);
        let model = fit.model();
        assert!((DVec3::from(model.center) - region.bounds.center()).length() < 0.1, "{model:?}");
        let [at_center, slopes @ ..] = model.coefficients[0];
        assert!(slopes.iter().enumerate().all(|(i, slope)| if i % 2 == 0 { *slope < 0.0 } else { *slope > 0.0 }));
        assert!(at_center > 0.3 * OPEN_SKY as f32, "{model:?}");
    }
    // What one gradient cannot say.
    let [gradient, seven] = [CenterRule::Gradient, CenterRule::Best].map(|rule| fit_region(&points, rule));
    assert!(seven.squared_errors()[0] < 0.4 * gradient.squared_errors()[0], "{seven:?} {gradient:?}");
}

#[test]
fn no_point_is_open_sky() {
    let points = RegionPoints::new(&hall(), &CandidateBits::default(), &[], 2).unwrap();
    for rule in RULES {
        let model = fit_region(&points, rule).model();
        for (k, coefficients) in model.coefficients.iter().enumerate() {
            let expected = if k % 9 == 0 { OPEN_SKY as f32 } else { 0.0 };
            assert_eq!(*coefficients, [expected, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
    }
}

/// AO for every normal in and around the box, from values at corners and the middle of sides.
fn reach(fit: &RegionFit) -> f64 {
    let (middle, half) = (hall().bounds.center(), 0.5 * (hall().bounds.max - hall().bounds.min));
    let places = (0..27).map(|i| DVec3::new((i % 3) as f64, (i / 3 % 3) as f64, (i / 9) as f64) - 1.0);
    places.flat_map(|u| fit.at(middle + half * u).collect::<Vec<_>>()).fold(0.0, |a, b| f64::max(a, b.abs()))
}

#[test]
fn degenerate_sets_stay_bounded() {
    type IsValid = fn(usize) -> bool;
    let sets: [(&str, IsValid); 9] = [
        ("one", |i| i == 100),
        ("two", |i| i == 100 || i == 301),
        ("three", |i| [5, 100, 301].contains(&i)),
        ("flat", |i| i / 64 == 7),
        ("diagonal", |i| i % 8 == i / 8 % 8),
        ("line", |i| i / 8 == 9),
        ("diagonal line", |i| i % 73 == 0),
        ("half", |i| i % 8 > 5),
        ("corner", |i| i % 8 < 2 && i / 8 % 8 < 2 && i / 64 < 2),
    ];
    for (name, is_valid) in sets {
        let points =
            points(
                &hall(),
                &bits(is_valid),
                2,
                |_, k| {
                    if k % 9 == 0 { 1.0 + noise(k as u64) } else { 0.3 * noise(k as u64) }
                },
            );
        let noisy = rooms::points(&hall(), &bits(is_valid), 2, |p, k| {
            let seed = (p.x * 8.0 + p.y * 700.0 + p.z * 9000.0) as u64 + k as u64;
            if k % 9 == 0 { 1.0 + noise(seed) } else { 0.3 * noise(seed) }
        });
        for rule in RULES {
            assert!(reach(&fit_region(&points, rule)) < 2.1, "{name} {rule:?}");
            let fit = fit_region(&noisy, rule);
            assert!(reach(&fit) < 4.0 && fit.squared_errors().iter().all(|e| e.is_finite()), "{name} {rule:?}");
        }
    }
}

#[test]
fn unsupported_slopes_are_zero() {
    // Points of one slab along z, to one side of the middle along x.
    let valid = bits(|i| i / 64 == 2 && i % 8 > 3);
    let fit = fit_region(&points(&hall(), &valid, 1, |p, _| 0.02 * p.x + 0.01 * p.y), CenterRule::Box).model();
    for [_, plus_x, minus_x, plus_y, minus_y, plus_z, minus_z] in &fit.coefficients {
        assert_eq!((*minus_x, *plus_z, *minus_z), (0.0, 0.0, 0.0));
        assert!(
            (plus_x - 0.02).abs() < 1e-5 && (plus_y - 0.01).abs() < 1e-5 && (minus_y - 0.01).abs() < 1e-5,
            "{plus_x} {plus_y} {minus_y}"
        );
    }
}

#[test]
fn axes_without_extent_have_no_slope() {
    let flat = region([0.0, 1.0, 0.0], [4.0, 1.0, 4.0]);
    let fit = fit_region(&points(&flat, &CandidateBits::ALL, 1, |p, _| 0.1 * p.x), CenterRule::Refined).model();
    assert!(fit.coefficients.iter().all(|c| c[3] == 0.0 && c[4] == 0.0 && (c[1] - 0.1).abs() < 1e-5), "{fit:?}");
}

/// AO for the normals ±x, ±y and ±z of one channel.
fn at_normals(values: &[f64]) -> [f64; 6] {
    let (c, l, z, s) = (0.282_094_8 * values[0], 0.488_602_5, 0.315_391_6 * values[6], 0.546_274_2 * values[8]);
    [
        c + l * values[3] - z + s,
        c - l * values[3] - z + s,
        c + l * values[1] - z - s,
        c - l * values[1] - z - s,
        c + l * values[2] + 2.0 * z,
        c - l * values[2] + 2.0 * z,
    ]
}

/// By how much AO anywhere on a lattice over the box leaves the points' range.
fn overshoot(fit: &RegionFit, valid: &CandidateBits, f: impl Fn(DVec3, usize) -> f64) -> f64 {
    let (mut low, mut high) = ([f64::INFINITY; 6], [f64::NEG_INFINITY; 6]);
    for point in valid.iter().map(|index| hall().candidate(index)) {
        let ao = at_normals(&(0..9).map(|k| f(point, k)).collect::<Vec<_>>());
        (0..6).for_each(|n| (low[n], high[n]) = (low[n].min(ao[n]), high[n].max(ao[n])));
    }
    let size = hall().bounds.max - hall().bounds.min;
    let places = (0..1000).map(|i| DVec3::new((i % 10) as f64, (i / 10 % 10) as f64, (i / 100) as f64) / 9.0);
    let reached = places.map(|u| at_normals(&fit.at(hall().bounds.min + size * u).collect::<Vec<_>>()));
    let beyond = reached.flat_map(|ao| (0..6).map(move |n| f64::max(low[n] - ao[n], ao[n] - high[n])));
    beyond.fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn a_diagonal_wall_does_not_overshoot() {
    // Points on one side of a wall through the box, darker near to it.
    let valid = bits(|i| i % 8 + i / 8 % 8 < 7);
    let along = |p: DVec3| (p.x + 3.0) / 12.0 + (p.y - 2.0) / 3.0;
    let f = |p: DVec3, k: usize| if k == 0 { OPEN_SKY * (1.0 - along(p)).clamp(0.0, 1.0) } else { 0.0 };
    let points = points(&hall(), &valid, 1, f);
    for rule in [CenterRule::Gradient, CenterRule::Points, CenterRule::Box, CenterRule::Best, CenterRule::Refined] {
        let fit = fit_region(&points, rule);
        assert!(fit.is_shrunk(), "{rule:?} {}", fit.is_shrunk());
        let beyond = overshoot(&fit, &valid, f);
        assert!((0.05..0.1 + 1e-6).contains(&beyond), "{rule:?} {beyond}");
    }
}

/// Where the points hardly spread the slope gives way more than where they do: one factor would leave 0.056 of 0.1.
#[test]
fn what_is_known_well_is_kept() {
    let (middle, half) = (hall().bounds.center(), 0.5 * (hall().bounds.max - hall().bounds.min));
    let f = |p: DVec3, k: usize| {
        let u = (p - middle) / half;
        if k == 0 { OPEN_SKY * (0.5 + 0.4 * u.x + 0.1 * u.y) } else { 0.0 }
    };
    let valid = bits(|i| (3..5).contains(&(i % 8)));
    let fit = fit_region(&points(&hall(), &valid, 1, f), CenterRule::Box);
    let [_, plus_x, _, plus_y, ..] = fit.model().coefficients[0].map(|c| f64::from(c) / OPEN_SKY);
    assert!(fit.is_shrunk() && overshoot(&fit, &valid, f) < 0.1 + 1e-6);
    assert!(plus_x * half.x < 0.2 && plus_y * half.y > 0.075, "{} {}", plus_x * half.x, plus_y * half.y);
}

proptest! {
    #[test]
    fn nothing_overshoots_and_rules_are_ordered(seed in 0u64..1_000_000, share in 0.01..1.0f64) {
        let valid = bits(|i| noise(seed + i as u64) < share);
        let f = |p: DVec3, k: usize| {
            let at = noise((p.x * 100.0 + p.y * 10_000.0 + p.z * 777.0) as u64 + 1000 * k as u64);
            if k == 0 { OPEN_SKY * (0.3 + 0.4 * at + 0.02 * p.x) } else { 0.4 * (at - 0.5) }
        };
        let points = points(&hall(), &valid, 1, f);
        let fits = RULES.map(|rule| fit_region(&points, rule));
        if valid.count() > 0 {
            fits.iter().for_each(|fit| assert!(overshoot(fit, &valid, f) < 0.1 + 1e-6));
        }
        let [mean, gradient, of_points, of_box, best, refined] = fits.map(|fit| fit.squared_errors()[0]);
        prop_assert!(gradient <= mean + 1e-9 && best <= mean + 1e-9);
        prop_assert!(best == of_points.min(of_box) && refined <= best);
    }

    /// Errors from sums are those at the points.
    #[test]
    fn errors_are_those_at_points(seed in 0u64..1_000_000) {
        let valid = bits(|i| noise(seed + i as u64) < 0.3);
        let points = points(&hall(), &valid, 2, |p, k| uneven(seed as usize % 99, p, k));
        let other = rooms::points(&region([0.0, 0.0, 0.0], [9.0, 4.0, 12.0]), &CandidateBits::ALL, 2, |p, k| {
            uneven(3, p, k)
        });
        let fit = fit_region(&other, CenterRule::Refined);
        let mut direct = [0.0; 2];
        for point in valid.iter().map(|index| hall().candidate(index)) {
            for (k, value) in fit.at(point).enumerate() {
                let exact = f64::from(uneven(seed as usize % 99, point, k) as f32);
                direct[k / 9] += (exact - value).powi(2) / (4.0 * std::f64::consts::PI);
            }
        }
        let found = points.squared_errors(&fit);
        prop_assert!((0..2).all(|c| (found[c] - direct[c]).abs() < 1e-9 * (1.0 + direct[c])), "{found:?} {direct:?}");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let (valid, region) = (bits(|i| i < 2), hall());
    let new = |values: &[f32], channels| RegionPoints::new(&region, &valid, values, channels);
    assert!(matches!(new(&[0.5; 17], 1), Err(RegionError::Length { found: 17, expected: 18, .. })));
    assert!(matches!(new(&[], 0), Err(RegionError::Channels { channels: 0 })));
    let mut values = [0.5; 18];
    values[7] = f32::NAN;
    assert!(matches!(new(&values, 1), Err(RegionError::Value { index: 7 })));
    let swapped = rooms::region([1.0; 3], [0.0; 3]);
    assert!(matches!(RegionPoints::new(&swapped, &valid, &[0.5; 18], 1), Err(RegionError::Box { .. })));
}
