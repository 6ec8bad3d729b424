//! Laws of the fit of four numbers to an instance.

mod shapes;
mod trees;

use kiln_core::Mesh;
use kiln_solve::{GLOBAL_BOUND, TreeError, TreeFit, fit_blended, fit_global, fit_instance};
use proptest::prelude::*;
use shapes::{grid, steps};
use trees::*;

fn off(fit: &TreeFit, y: &[f64; 4]) -> f64 {
    fit.y.iter().zip(y).map(|(found, y)| (f64::from(*found) - y).abs()).fold(0.0, f64::max)
}

#[test]
fn known_globals_come_back() {
    let mesh = bush(5, 4);
    let samples = model(&mesh, 3);
    let local = samples.local(&values(mesh.positions.len() * 2, 1, [0.1, 1.0]), 2).unwrap();
    for seed in 0..20 {
        let y = [globals(2 * seed), globals(2 * seed + 1)];
        let fits = fit_instance(&samples, &local, &product(&samples, &local, &y)).unwrap();
        for (fit, y) in fits.iter().zip(&y) {
            assert!(off(fit, y) <= 1e-6 && fit.rmse() <= 1e-6, "{fit:?} {y:?}");
            assert_eq!((fit.rank, fit.useful), (4, samples.len()));
        }
    }
}

#[test]
fn invalid_samples_have_no_say() {
    let mesh = bush(5, 4);
    let samples = model(&mesh, 3);
    let local = samples.local(&values(mesh.positions.len(), 1, [0.1, 1.0]), 1).unwrap();
    let mut f = product(&samples, &local, &[globals(3)]);
    f.iter_mut().step_by(3).for_each(|f| *f = f32::NAN);
    f.iter_mut().skip(1).step_by(7).for_each(|f| *f = f32::INFINITY);
    let fit = fit_instance(&samples, &local, &f).unwrap()[0];
    assert!(off(&fit, &globals(3)) <= 1e-6, "{fit:?}");
    assert_eq!(fit.useful, f.iter().filter(|f| f.is_finite()).count());
}

#[test]
fn the_blend_is_fitted_as_an_engine_evaluates_it() {
    let mesh = bush(5, 4);
    let samples = model(&mesh, 3);
    let local = samples.local(&values(mesh.positions.len() * 2, 1, [0.1, 1.0]), 2).unwrap();
    let mut f = product(&samples, &local, &[globals(5); 2]);
    let fit = fit_blended(&samples, &local, &f, &[0.3, 0.7]).unwrap();
    assert!(off(&fit, &globals(5)) <= 1e-6, "{fit:?}");
    // A channel of the blend alone is that channel, and what is not valid in the other does not matter.
    f.iter_mut().skip(1).step_by(2).for_each(|f| *f = f32::NAN);
    let single = fit_blended(&samples, &local, &f, &[1.0, 0.0]).unwrap();
    assert_eq!(single, fit_instance(&samples, &local, &f).unwrap()[0]);
    assert_eq!(fit_blended(&samples, &local, &f, &[0.3, 0.7]).unwrap(), TreeFit::NONE);
    for blend in [[0.5, 0.6], [1.5, -0.5], [f64::NAN, 1.0]] {
        assert!(matches!(fit_blended(&samples, &local, &f, &blend), Err(TreeError::Blend { .. })));
    }
}

#[test]
fn the_global_function_alone_has_no_local_ao() {
    let mesh = bush(5, 4);
    let samples = model(&mesh, 3);
    let ones = samples.local(&vec![1.0; mesh.positions.len()], 1).unwrap();
    let f = product(&samples, &ones, &[globals(7)]);
    assert!(off(&fit_global(&samples, 1, &f).unwrap()[0], &globals(7)) <= 1e-6);
    assert_eq!(fit_global(&samples, 5, &f), Err(TreeError::Channels { channels: 5 }));
    assert!(matches!(fit_global(&samples, 2, &f), Err(TreeError::Length { .. })));
}

/// A sheet that stands in the plane x = y.
fn diagonal() -> Mesh {
    let mut mesh = grid(&steps(5), &steps(5));
    mesh.positions.iter_mut().for_each(|p| *p = [p[0], p[0], p[1]]);
    mesh
}

#[test]
fn directions_without_spread_have_no_gradient() {
    let wave = |u: &[f64; 3]| (0.5 + 0.2 * u[0] + 0.2 * u[2]) as f32;
    for (mesh, missing) in [(grid(&steps(5), &steps(5)), [0.0, 0.0, 1.0]), (diagonal(), [1.0, -1.0, 0.0])] {
        let samples = model(&mesh, 4);
        let local = samples.local(&vec![0.8; mesh.positions.len()], 1).unwrap();
        let f: Vec<f32> = samples.unit_positions().iter().map(wave).collect();
        let fit = fit_instance(&samples, &local, &f).unwrap()[0];
        let along: f64 = fit.y[1..].iter().zip(missing).map(|(y, d)| f64::from(*y) * d).sum();
        assert!(fit.rank == 3 && along.abs() <= 1e-6 && fit.rmse() <= 1e-6, "{fit:?}");
    }
}

#[test]
fn what_determines_no_gradient_gives_the_constant() {
    let mesh = bush(2, 3);
    let all = |value: f32| vec![value; mesh.positions.len()];
    let line = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]];
    let cases = [
        (0.5, vec![0.2, 0.3, 0.4], 0.6, 1),
        (0.5, vec![0.2, f32::NAN, f32::NAN], 0.4, 1),
        (0.0, vec![0.2, 0.3, 0.4], 0.3, 0),
        (0.5, vec![f32::NAN; 3], 1.0, 0),
        (0.5, vec![], 1.0, 0),
    ];
    for (value, f, y0, rank) in cases {
        let positions = &line[..f.len()];
        let samples = points(&mesh, positions);
        let fit = fit_instance(&samples, &samples.local(&all(value), 1).unwrap(), &f).unwrap()[0];
        assert!(off(&fit, &[y0, 0.0, 0.0, 0.0]) <= 1e-6 && fit.rank == rank, "{fit:?}");
    }
    // Any number of samples at one place, too.
    let heap = points(&mesh, &[[0.05, 0.0, 0.1]; 9]);
    let fit = fit_instance(&heap, &heap.local(&all(0.5), 1).unwrap(), &[0.25; 9]).unwrap()[0];
    assert!(off(&fit, &[0.5, 0.0, 0.0, 0.0]) <= 1e-6 && fit.rank == 1 && fit.useful == 9, "{fit:?}");
}

#[test]
fn what_a_thin_layer_of_samples_tells_of_its_normal_is_noise() {
    let mesh = bush(4, 3);
    let thickness = |z: f64| {
        let place = |i: u64| [shapes::noise(3 * i) - 0.5, shapes::noise(3 * i + 1) - 0.5, z * shapes::noise(3 * i + 2)];
        let samples = points(&mesh, &(0..60).map(place).collect::<Vec<_>>());
        let local = samples.local(&vec![1.0; mesh.positions.len()], 1).unwrap();
        fit_instance(&samples, &local, &values(60, 5, [0.4, 0.6])).unwrap()[0]
    };
    let (thin, thick) = (thickness(1e-3), thickness(0.5));
    assert!(thin.rank == 3 && thick.rank == 4 && thin.y[3].abs() <= 0.01, "{thin:?} {thick:?}");
}

#[test]
fn steep_fits_stop_at_the_bound_and_are_no_worse_than_the_constant() {
    // All samples on one side of the box, close together: what they say of the gradient is beyond any AO.
    let mesh = bush(4, 3);
    let places: Vec<[f64; 3]> = (0..40).map(|i| [0, 1, 2].map(|k| 0.04 * shapes::noise(3 * i + k))).collect();
    let samples = points(&mesh, &places);
    let local = samples.local(&vec![1.0; mesh.positions.len()], 1).unwrap();
    let f: Vec<f32> = places.iter().map(|p| f32::from(p[0] > 0.02)).collect();
    let fit = fit_instance(&samples, &local, &f).unwrap()[0];
    let size: f64 = fit.y.iter().map(|y| f64::from(y.abs())).sum();
    assert!(is_bounded(&fit) && size >= GLOBAL_BOUND * 0.999 && fit.rank == 4, "{fit:?}");
    let mean = f.iter().map(|f| f64::from(*f)).sum::<f64>() / 40.0;
    assert!(fit.squared_error < error_of(&samples, local.values(), &f, &[mean, 0.0, 0.0, 0.0]));
}

prop_compose! {
    /// Samples, local AO and a signal without any sense.
    fn anything()(
        spread in prop::sample::select(vec![0.0, 1e-6, 1e-3, 0.1, 1.0]),
        dark in prop::sample::select(vec![0.0, 1e-8, 1e-3, 0.1, 1.0]),
        rows in prop::collection::vec((prop::array::uniform3(-1.0..1.0f64), 0.0..1.0f32, -0.5..1.5f32, 0..8u8), 0..40),
    ) -> (f64, f64, Vec<([f64; 3], f32, f32, u8)>) {
        (spread, dark, rows)
    }
}

proptest! {
    #[test]
    fn whatever_comes_the_fit_is_bounded_and_no_worse_than_the_constant((spread, dark, rows) in anything()) {
        let mesh = bush(4, 3);
        let samples = points(&mesh, &rows.iter().map(|row| row.0.map(|x| spread * x)).collect::<Vec<_>>());
        let vertices: Vec<f32> = (0..mesh.positions.len()).map(|v| {
            rows.get(v).map_or(0.5, |row| row.1) * dark as f32
        }).collect();
        let local = samples.local(&vertices, 1).unwrap();
        let f: Vec<f32> = rows.iter().map(|row| match row.3 { 0 => f32::NAN, 1 => f32::NEG_INFINITY, _ => row.2 }).collect();
        let fit = fit_instance(&samples, &local, &f).unwrap()[0];
        prop_assert!(is_bounded(&fit), "{fit:?}");
        for corner in 0..8u8 {
            let u = [1, 2, 4].map(|bit| if corner & bit == 0 { -1.0 } else { 1.0 });
            prop_assert!(fit.global(&u).abs() <= GLOBAL_BOUND + 1e-12);
        }
        let valid: Vec<usize> = (0..f.len()).filter(|i| f[*i].is_finite()).collect();
        let constant = |y0: f64| valid.iter().map(|i| {
            (f64::from(f[*i]).clamp(0.0, 1.0) - y0 * local.values()[*i]).powi(2)
        }).sum::<f64>();
        for y0 in [0.0, 0.3, 1.0, f64::from(fit.y[0]).clamp(0.0, 3.9)] {
            prop_assert!(fit.rank == 0 || fit.squared_error <= constant(y0) + 1e-6 * (1.0 + valid.len() as f64));
        }
    }

    #[test]
    fn no_other_four_numbers_are_better(
        rows in prop::collection::vec((prop::array::uniform3(-0.8..0.8f64), 0.0..1.0f32), 12..60),
        other in prop::array::uniform4(-1.0..1.0f64), near in prop::array::uniform4(-1e-2..1e-2f64),
    ) {
        let mesh = bush(4, 3);
        let samples = points(&mesh, &rows.iter().map(|row| row.0).collect::<Vec<_>>());
        let local = samples.local(&values(mesh.positions.len(), 4, [0.3, 1.0]), 1).unwrap();
        let f: Vec<f32> = rows.iter().map(|row| row.1).collect();
        let fit = fit_instance(&samples, &local, &f).unwrap()[0];
        let size: f64 = fit.y.iter().map(|y| f64::from(y.abs())).sum();
        prop_assume!(fit.rank == 4 && size < 0.99 * GLOBAL_BOUND);
        let y = fit.y.map(f64::from);
        let nearby = std::array::from_fn(|k| y[k] + near[k]);
        for other in [other, nearby] {
            prop_assert!(fit.squared_error <= error_of(&samples, local.values(), &f, &other) + 1e-9);
        }
    }
}
