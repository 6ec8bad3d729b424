//! Laws of smoothing between regions.

#[expect(dead_code, reason = "each test program uses a part")]
mod rooms;

use glam::DVec3;
use kiln_core::{CandidateBits, Region, RegionEdge, RegionModels, Regions};
use kiln_solve::{
    model_regions,
    region::{
        CenterRule, OPEN_SKY, RegionError, RegionFit, RegionPoints, SmoothNorm, SmoothParams, Smoother, fit_region,
        jumps, smooth,
    },
};
use proptest::prelude::*;
use rooms::*;

const COUNT: u32 = 12;

fn all(regions: &Regions) -> Vec<CandidateBits> {
    vec![CandidateBits::ALL; regions.regions.len()]
}

fn uneven_models(smoothing: f64) -> RegionModels {
    let regions = row(COUNT, smoothing);
    model_regions(&regions, &samples(&regions, all(&regions), 2, uneven)).expect("a level that fits together")
}

/// Points and models of a level, with some bits missing.
fn fitted(regions: &Regions, seed: u64) -> (Vec<RegionPoints>, Vec<RegionFit>) {
    let of_region = |(r, region): (usize, &Region)| {
        let valid = bits(|i| noise(seed + (512 * r + i) as u64) < 0.3 + 0.1 * (r % 7) as f64);
        points(region, &valid, 2, |p, k| uneven(r + seed as usize % 1000, p, k))
    };
    let points: Vec<_> = regions.regions.iter().enumerate().map(of_region).collect();
    let fits = points.iter().map(|points| fit_region(points, CenterRule::Refined)).collect();
    (points, fits)
}

/// More edges than a row has, so that colours are several.
fn tangled(smoothing: f64) -> Regions {
    let mut regions = row(COUNT, smoothing);
    for (a, b) in [(0, 2), (1, 3), (0, 3), (4, 9), (5, 11), (2, 11)] {
        let center = 0.5 * (regions.regions[a].bounds.center() + regions.regions[b].bounds.center());
        regions.edges.push(RegionEdge { regions: [a as u32, b as u32], area_m2: 0.5 + a as f64, center });
    }
    regions
}

fn params(smoothing: f64, norm: SmoothNorm) -> SmoothParams {
    SmoothParams { smoothing, norm, ..SmoothParams::default() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn energy_never_rises(
        seed in 0u64..1_000_000, exponent in -3..4i32, norm in prop_oneof![Just(SmoothNorm::Points), Just(SmoothNorm::Coefficients)],
    ) {
        let regions = tangled(10f64.powi(exponent));
        let (points, fits) = fitted(&regions, seed);
        let mut smoother = Smoother::new(&points, &fits, &regions.edges, &params(regions.settings.smoothing, norm)).unwrap();
        let mut energy = smoother.energy();
        for step in 0..4 * smoother.len() {
            smoother.step(step * 5 % smoother.len());
            let next = smoother.energy();
            prop_assert!(next <= energy * (1.0 + 1e-12), "{step}: {energy} to {next}");
            energy = next;
        }
        smoother.sweep();
        prop_assert!(smoother.energy() <= energy * (1.0 + 1e-12));
    }
}

#[test]
fn a_sweep_is_its_steps_colour_by_colour() {
    let regions = row(6, 2.0);
    let (points, fits) = fitted(&regions, 5);
    let new = || Smoother::new(&points, &fits, &regions.edges, &params(2.0, SmoothNorm::Points)).unwrap();
    let (mut swept, mut stepped) = (new(), new());
    swept.sweep();
    [0, 2, 4, 1, 3, 5].into_iter().for_each(|region| stepped.step(region));
    assert_eq!(swept.energy().to_bits(), stepped.energy().to_bits());
}

#[test]
fn beta_zero_changes_nothing() {
    let regions = tangled(0.0);
    let (points, fits) = fitted(&regions, 1);
    let mut smoothed = fits.clone();
    let how = smooth(&points, &mut smoothed, &regions.edges, &params(0.0, SmoothNorm::Points)).unwrap();
    assert_eq!((&smoothed, how.sweeps(), how.held), (&fits, 0, 0));
    let models = model_regions(&regions, &samples(&regions, all(&regions), 2, uneven)).unwrap();
    for (region, model) in models.models.iter().enumerate() {
        let alone = points_of(&regions, region);
        assert_eq!(*model, fit_region(&alone, CenterRule::Refined).model());
    }
    let errors = models.summary.errors[0];
    assert_eq!((errors.smoothed, errors.jump_smoothed), (errors.refined, errors.jump_fitted));
    assert!(errors.best_center <= errors.point_center.min(errors.box_center) && errors.refined <= errors.best_center);
}

fn points_of(regions: &Regions, region: usize) -> RegionPoints {
    points(&regions.regions[region], &CandidateBits::ALL, 2, |p, k| uneven(region, p, k))
}

#[test]
fn jumps_fall_with_beta() {
    let models = [0.0, 0.01, 0.1, 1.0, 10.0].map(uneven_models);
    let jumps = models.each_ref().map(|models| models.summary.errors[0].jump_smoothed);
    let errors = models.each_ref().map(|models| models.summary.errors[0].smoothed);
    assert!(jumps.is_sorted_by(|a, b| a > b) && errors.is_sorted_by(|a, b| a < b), "{jumps:?} {errors:?}");
    assert!(jumps[4] < 0.3 * jumps[0], "{jumps:?}");
    for models in models {
        let energy = &models.summary.energy;
        assert!(energy.is_sorted_by(|a, b| a >= b) && energy.len() == 1 + models.summary.sweeps as usize, "{energy:?}");
        models.check(COUNT as usize, 2).unwrap();
    }
}

#[test]
fn threads_and_the_order_of_edges_change_nothing() {
    let regions = tangled(1.0);
    let samples = samples(&regions, all(&regions), 2, uneven);
    let expected = model_regions(&regions, &samples).unwrap();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| model_regions(&regions, &samples)).unwrap(), expected);
    }
    let mut other = regions.clone();
    other.edges.reverse();
    other.edges.swap(2, 7);
    other.edges.iter_mut().step_by(2).for_each(|edge| edge.regions.reverse());
    assert_eq!(model_regions(&other, &samples).unwrap(), expected);
}

#[test]
fn one_linear_field_stays() {
    let regions = row(2, 5.0);
    let field = |_: usize, p: DVec3, k: usize| {
        if k.is_multiple_of(9) { 0.5 * OPEN_SKY + 0.05 * p.x - 0.02 * p.y } else { 0.01 * k as f64 + 0.005 * p.z }
    };
    let models = model_regions(&regions, &samples(&regions, all(&regions), 1, field)).unwrap();
    let errors = models.summary.errors[0];
    assert!(errors.jump_fitted < 1e-6 && errors.jump_smoothed < 1e-6 && errors.smoothed < 1e-6, "{errors:?}");
    let [left, right] = [0, 1].map(|model| &models.models[model].coefficients[0]);
    assert!((left[1] - 0.05).abs() < 1e-5 && (right[2] - 0.05).abs() < 1e-5, "{left:?} {right:?}");
}

#[test]
fn smoothing_does_not_overshoot() {
    // A dark room beside a bright one: neither may leave what its points see by more than 0.1.
    let regions = row(2, 100.0);
    let field = |r: usize, p: DVec3, k: usize| flat([0.1, 0.9][r])(p, k);
    let models = model_regions(&regions, &samples(&regions, all(&regions), 1, field)).unwrap();
    for (model, region) in models.models.iter().zip(&regions.regions) {
        let expected = if region.bounds.min.x == 0.0 { 0.1 } else { 0.9 };
        for i in 0..27 {
            let place = DVec3::new((i % 3) as f64, (i / 3 % 3) as f64, (i / 9) as f64) / 2.0;
            let at = region.bounds.min + place * (region.bounds.max - region.bounds.min);
            let ao = model.at(at).next().unwrap() / OPEN_SKY;
            assert!((ao - expected).abs() < 0.1 + 1e-6, "{ao} {expected}");
        }
    }
    assert!(models.summary.held == 2 && models.summary.errors[0].jump_smoothed < 0.65, "{:?}", models.summary);
}

/// Two rooms of one point each have no slopes: `(x − a)² + (y − b)² + 2β (x − y)²` is least where the jump is
/// `(a − b) / (1 + 4β)`, whatever the area.
#[test]
fn two_constants_meet_where_they_should() {
    let regions = row(2, 0.0);
    let of_room = |r: usize| points(&regions.regions[r], &bits(|i| i == 77), 1, flat([0.5, 0.6][r]));
    let points = [of_room(0), of_room(1)];
    for smoothing in [0.1, 1.0, 7.0] {
        let mut fits = points.each_ref().map(|points| fit_region(points, CenterRule::Best));
        let params = SmoothParams { smoothing, sweeps: 500, tolerance: 0.0, norm: SmoothNorm::Points };
        let how = smooth(&points, &mut fits, &regions.edges, &params).unwrap();
        let (jump, expected) = (jumps(&fits, &regions.edges)[0], 0.1 / (1.0 + 4.0 * smoothing));
        assert!((jump - expected).abs() < 1e-6 && how.held == 0, "{smoothing}: {jump} {expected}");
        let moved = 0.05 - 0.5 * expected;
        let energy = 2.0 * moved * moved + 2.0 * smoothing * expected * expected;
        assert!((how.energy[how.energy.len() - 1] - energy).abs() < 1e-8, "{how:?} {energy}");
    }
}

/// In the norm of coefficients a slope of a long box costs next to nothing; in that of points its values do.
#[test]
fn the_norm_of_points_values_long_slopes() {
    let regions = [region([0.0; 3], [40.0, 4.0, 3.0]), region([40.0, 0.0, 0.0], [80.0, 4.0, 3.0])];
    let edges = [RegionEdge { regions: [0, 1], area_m2: 12.0, center: DVec3::new(40.0, 2.0, 1.5) }];
    let points = [0, 1].map(|r| points(&regions[r], &CandidateBits::ALL, 1, flat([0.5, 0.6][r])));
    let slope = |norm| {
        let mut fits = points.each_ref().map(|points| fit_region(points, CenterRule::Box));
        smooth(&points, &mut fits, &edges, &params(0.05, norm)).unwrap();
        fits[0].model().coefficients[0][1]
    };
    let [of_points, of_coefficients] = [SmoothNorm::Points, SmoothNorm::Coefficients].map(slope);
    assert!(0.0 < of_points && 1.5 * of_points < of_coefficients, "{of_points} {of_coefficients}");
}

#[test]
fn frozen_slopes_stay_frozen() {
    let regions = row(3, 1.0);
    let valid = vec![CandidateBits::ALL, bits(|i| i / 64 == 3), CandidateBits::ALL];
    let models = model_regions(&regions, &samples(&regions, valid, 1, uneven)).unwrap();
    assert!(models.models[1].coefficients.iter().all(|c| c[5] == 0.0 && c[6] == 0.0 && c[1] != 0.0));
}

#[test]
fn jumps_are_weighted_by_area() {
    let regions = row(3, 0.0);
    let fits: Vec<_> = (0..3)
        .map(|r| {
            fit_region(&points(&regions.regions[r], &CandidateBits::ALL, 1, flat([0.2, 0.5, 0.6][r])), CenterRule::Best)
        })
        .collect();
    let expected = ((3.0 * 0.3f64.powi(2) + 4.0 * 0.1f64.powi(2)) / 7.0).sqrt();
    assert!((jumps(&fits, &regions.edges)[0] - expected).abs() < 1e-6);
    assert_eq!(jumps(&fits, &[]), [0.0]);
}

#[test]
fn what_cannot_be_is_refused() {
    let regions = row(3, 1.0);
    let good = samples(&regions, all(&regions), 1, uneven);
    let with = |change: &dyn Fn(&mut Regions)| {
        let mut wrong = regions.clone();
        change(&mut wrong);
        model_regions(&wrong, &good).unwrap_err()
    };
    assert!(matches!(with(&|r| r.settings.smoothing = f64::NAN), RegionError::Setting { .. }));
    assert!(matches!(with(&|r| r.settings.min_volume_m3 = -1.0), RegionError::Setting { .. }));
    assert!(matches!(with(&|r| r.edges[1].regions[1] = 9), RegionError::Edge { edge: 1, .. }));
    assert!(matches!(with(&|r| r.regions[2].bounds.max.x = f64::INFINITY), RegionError::Box { region: 2 }));
    assert!(matches!(with(&|r| _ = r.regions.pop()), RegionError::Samples(_)));
    let (points, mut fits) = fitted(&regions, 3);
    let missing = smooth(&points[..2], &mut fits, &[], &SmoothParams::default());
    assert!(matches!(missing, Err(RegionError::Length { found: 3, expected: 2, .. })));
    let nothing = model_regions(&Regions::default(), &samples(&Regions::default(), vec![], 2, uneven)).unwrap();
    nothing.check(0, 2).unwrap();
}
