//! Against closed forms.

use super::*;

/// What a ray is worth between layers at heights `1 + step · i`, in f64.
fn through_layers(cosine: f64, layers: usize, step: f64, kept: f64, half_distance: Option<f64>) -> f64 {
    let Some(d) = half_distance else { return kept.powi(layers as i32) };
    let rho = |t: f64| 1.0 - (-t / d).exp2();
    let at = |i: usize| (1.0 + step * i as f64) / cosine;
    let absorbed = (0..layers).map(|i| kept.powi(i as i32) * (1.0 - kept) * rho(at(i)));
    absorbed.sum::<f64>() + kept.powi(layers as i32)
}

/// More layers than a list has room for, in trees of their own and in one: the closed form, to 4 of 65,536.
#[test]
fn layers_beyond_the_list_are_not_lost() {
    let samples = upwards(256);
    for layers in [1usize, 15, 16, 17, 31, 32, 33, 200] {
        let step = 0.01;
        // In no order of their height.
        let shuffled = (0..layers).map(|i| (i * 89 + 5) % layers);
        let height = |i: usize| 1.0 + step * i as f64;
        let flat = crossing_mesh(&ceiling(0.0, 9e3), 0.99);
        let one: Vec<Triangle> = (0..layers).flat_map(|i| ceiling(height(i) as f32, 9e3)).collect();
        let apart: Vec<FoliageObject> = shuffled.map(|i| placed(&flat, up(height(i)))).collect();
        let together = vec![placed(&crossing_mesh(&one, 0.99), DAffine3::IDENTITY)];
        for (objects, mode) in [(&apart, BOTH[0]), (&apart, BOTH[1]), (&together, BOTH[0]), (&together, BOTH[1])] {
            let tracer = on(crate::device(), &scene(&nothing(), objects, mode));
            for half_distance in [None, Some(1.0), Some(20.0)] {
                let kernel = half_distance.map_or_else(occlusion, |d| obscurance(&[d, 300.0]));
                for (sample, sums) in samples.iter().zip(gather(&tracer, &samples, &kernel, 1)) {
                    let cosine = f64::from(direction_of(sample).y);
                    // Rays at the horizon pass by, or end before.
                    if sums.rays == 0 || cosine < 0.01 {
                        continue;
                    }
                    let kept = OpticalDepth::of_transmittance(0.99).transmittance();
                    let d = if mode == FoliageMode::Attenuate { None } else { half_distance };
                    let expected = 65536.0 * through_layers(cosine, layers, step, kept, d);
                    let found = f64::from(sums.values[0]);
                    assert!(
                        (found - expected).abs() < 4.0,
                        "{mode:?} {layers} {half_distance:?} {cosine}: {found} {expected}"
                    );
                }
            }
        }
    }
}

/// Slabs of fog that overlap, with more beginnings and ends than a list has room for, against f64; the fog of an equal number of
/// boxes in one place is as dense as all.
#[test]
fn fog_is_neither_lost_nor_left_on() {
    let samples = upwards(512);
    let (d, density) = (1.5, 0.02);
    let kernel = obscurance(&[d]);
    let slabs: Vec<[f64; 2]> =
        (0..60).map(|i| [0.1 * f64::from(i * 7 % 60), 0.1 * f64::from(i * 7 % 60) + 1.0]).collect();
    let objects: Vec<FoliageObject> = slabs.iter().map(|[bottom, top]| slab(*bottom, *top, density)).collect();
    for mode in BOTH {
        let tracer = on(crate::device(), &scene(&nothing(), &objects, mode));
        for (sample, sums) in samples.iter().zip(gather(&tracer, &samples, &kernel, 1)) {
            let cosine = f64::from(direction_of(sample).y);
            if sums.rays == 0 || cosine < 0.01 {
                continue;
            }
            let reach = f64::from(kernel.t_max);
            let depth =
                |t: f64| slabs.iter().map(|[a, b]| (t.min(b / cosine) - a / cosine).max(0.0) * density).sum::<f64>();
            let rate = std::f64::consts::LN_2 / d;
            let mut expected = (-depth(reach)).exp();
            if mode == FoliageMode::Expected {
                expected *= (-rate * reach).exp();
                let mut bounds: Vec<f64> =
                    slabs.iter().flatten().map(|y| (y / cosine).min(reach)).chain([0.0, reach]).collect();
                bounds.sort_by(f64::total_cmp);
                for pair in bounds.windows(2).filter(|pair| pair[0] < pair[1]) {
                    let sigma = (depth(pair[1]) - depth(pair[0])) / (pair[1] - pair[0]);
                    let both = rate + sigma;
                    expected += rate / both
                        * (-depth(pair[0]) - rate * pair[0]).exp()
                        * (1.0 - (-both * (pair[1] - pair[0])).exp());
                }
            }
            let found = f64::from(sums.values[0]) / 65536.0;
            assert!((found - expected).abs() < 1e-4, "{mode:?} {cosine}: {found} {expected}");
        }
        // 25 boxes of one density in one place, and one of 25 times as much.
        let [many, one] = [(25, 0.04), (1, 1.0)].map(|(copies, density)| {
            let objects: Vec<FoliageObject> = (0..copies).map(|_| slab(0.5, 1.5, density)).collect();
            gather(&on(crate::device(), &scene(&wall(2.0, 50.0), &objects, mode)), &samples, &kernel, 1)
        });
        let off = many.iter().zip(&one).filter(|(a, b)| a.values[0].abs_diff(b.values[0]) > 26).count();
        assert_eq!(off, 0, "{mode:?}");
    }
}

/// Mean over the cosine-weighted hemisphere of a function of the cosine.
fn over_hemisphere(value: impl Fn(f64) -> f64) -> f64 {
    let steps = 20_000;
    (0..steps).map(|i| ((f64::from(i) + 0.5) / f64::from(steps)).sqrt()).map(value).sum::<f64>() / f64::from(steps)
}

#[test]
fn a_slab_of_fog_is_as_its_closed_form_says() {
    let (thickness, density, height) = (1.0, 0.3, 3.0);
    for (half_distance, with_ceiling) in [(2.0, false), (300.0, false), (2.0, true), (300.0, true)] {
        for mode in BOTH {
            let k = std::f64::consts::LN_2 / half_distance;
            let opaque = if with_ceiling { wall(height as f32, 2e4) } else { nothing() };
            let tracer = on(crate::device(), &scene(&opaque, &[slab(0.0, thickness, density)], mode));
            let kernel = obscurance(&[half_distance]);
            let sample = scenes::free_sample(Vec3::Y * 1e-4, Vec3::Y, Numbers(3).scramble());
            let found = gather(&tracer, &[sample], &kernel, 1 << 14)[0].ao(0);
            let reach = f64::from(kernel.t_max);
            let expected = over_hemisphere(|cosine| {
                let in_fog = (thickness / cosine).min(reach);
                let end = if with_ceiling && height / cosine < reach { height / cosine } else { f64::INFINITY };
                let kept = (-density * in_fog).exp();
                match mode {
                    FoliageMode::Attenuate => kept * (1.0 - (-k * end).exp()),
                    _ => {
                        k / (k + density) * (1.0 - (-(k + density) * in_fog).exp())
                            + kept * ((-k * in_fog).exp() - (-k * end).exp())
                    }
                }
            });
            assert!((found - expected).abs() < 2e-3, "{mode:?} {half_distance} {with_ceiling}: {found} {expected}");
        }
    }
}
