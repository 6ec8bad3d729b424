//! Laws of alternating between the local AO of a model and the fits of its instances.

mod shapes;
mod trees;

use kiln_core::Mesh;
use kiln_solve::{
    AlternateParams, Alternated, ModelSamples, TreeError, TreeInstance, TreeModel, alternate, error_table,
};
use proptest::prelude::*;
use trees::*;

/// A model whose instances have signals.
#[derive(Debug)]
struct Forest {
    mesh: Mesh,
    samples: ModelSamples,
    local: Vec<f32>,
    channels: usize,
    signals: Vec<Vec<f32>>,
}

impl Forest {
    /// Signals `G L` of the given local AO with noise, some of it not valid; the start is another local AO.
    fn new(truth: [f64; 2], disturbed: f64, noise: f64, instances: u64, channels: usize) -> Self {
        let mesh = bush(4, 4);
        let samples = model(&mesh, 3);
        let truth = values(mesh.positions.len() * channels, 1, truth);
        let local = samples.local(&truth, channels).expect("values for all vertices");
        let signal = |j: u64| {
            let y: Vec<_> = (0..channels as u64).map(|channel| globals(10 * j + channel)).collect();
            let disturb = |(i, f): (usize, f32)| f + (noise * (shapes::noise(7919 * j + i as u64) - 0.5)) as f32;
            product(&samples, &local, &y).into_iter().enumerate().map(disturb).collect()
        };
        let start = truth.iter().zip(values(truth.len(), 9, [-disturbed, disturbed]));
        let start = start.map(|(l, d)| (l + d).clamp(0.0, 1.0)).collect();
        Self { signals: (0..instances).map(signal).collect(), samples, local: start, channels, mesh }
    }

    fn model(&self) -> TreeModel<'_> {
        let Self { mesh, samples, local, channels, .. } = self;
        TreeModel { mesh, samples, local, channels: *channels }
    }

    fn instances(&self) -> Vec<TreeInstance<'_>> {
        (0..).zip(&self.signals).map(|(j, values)| TreeInstance { key: key(j), values }).collect()
    }

    fn alternate(&self, params: &AlternateParams) -> Alternated {
        alternate(&self.model(), &self.instances(), params).expect("the parts fit together")
    }
}

fn free(rounds: usize) -> AlternateParams {
    AlternateParams { rounds, tolerance: 0.0, regularization: 0.0, anchor: 0.0, ..AlternateParams::default() }
}

/// Descent to the bit, bounds, and an end that is not above the start.
fn holds(found: &Alternated) -> bool {
    let descends = found.steps.iter().all(|steps| steps.windows(2).all(|two| two[1].objective <= two[0].objective));
    let settled = found.steps.iter().all(|s| s[s.len() - 1].squared_error <= s[0].squared_error);
    descends && settled && found.fits.iter().all(is_bounded) && found.local.iter().all(|l| (0.0..=1.0).contains(l))
}

#[test]
fn known_local_ao_comes_back_up_to_its_scale() {
    let forest = Forest::new([0.3, 0.8], 0.1, 0.0, 8, 1);
    let found = forest.alternate(&free(3000));
    assert!(holds(&found));
    let truth = values(forest.mesh.positions.len(), 1, [0.3, 0.8]);
    let ratios: Vec<f64> = found.local.iter().zip(&truth).map(|(l, t)| f64::from(l / t)).collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    let worst = ratios.iter().map(|r| (r / mean - 1.0).abs()).fold(0.0, f64::max);
    let table = error_table(&forest.model(), &forest.instances(), &found).unwrap()[0];
    assert!(worst <= 1e-3 && table.alternated <= 1e-5, "{worst}, {mean}, {table:?} {}", found.steps[0].len());
    for (j, fit) in (0..).zip(&found.fits) {
        let off = fit.y.iter().zip(globals(10 * j)).map(|(y, t)| (f64::from(*y) * mean - t).abs()).fold(0.0, f64::max);
        assert!(off <= 1e-3, "{fit:?} {:?} {mean}", globals(10 * j));
    }
}

#[test]
fn the_truth_stays() {
    let forest = Forest::new([0.2, 1.0], 0.0, 0.0, 5, 2);
    let found = forest.alternate(&AlternateParams::default());
    let moved = shapes::distance(found.local.iter().copied(), forest.local.iter().copied());
    assert!(moved <= 1e-5 && found.steps.iter().all(|s| s[s.len() - 1].objective <= 1e-9), "{moved}");
}

#[test]
fn default_settings_take_most_of_what_a_wrong_start_costs() {
    let forest = Forest::new([0.2, 0.9], 0.15, 0.02, 10, 2);
    let found = forest.alternate(&AlternateParams::default());
    for row in error_table(&forest.model(), &forest.instances(), &found).unwrap() {
        // Noise of ±0.01 has an RMS of 0.0058.
        assert!(row.alternated <= 0.0065 && row.local_global >= 0.02 && row.global_only >= 0.05, "{row:?}");
    }
}

#[test]
fn without_instances_or_samples_local_ao_stays() {
    let mut forest = Forest::new([0.2, 0.9], 0.1, 0.0, 0, 2);
    assert_eq!(forest.alternate(&AlternateParams::default()).local, forest.local);
    forest.signals = vec![vec![f32::NAN; forest.samples.len() * 2]; 3];
    let found = forest.alternate(&AlternateParams::default());
    assert_eq!(found.local, forest.local);
    assert!(found.fits.iter().all(|fit| fit.y == [1.0, 0.0, 0.0, 0.0] && fit.rank == 0));
    forest.samples = ModelSamples::new(&forest.mesh, &[]).unwrap();
    forest.signals = vec![Vec::new(); 2];
    assert_eq!(forest.alternate(&AlternateParams::default()).local, forest.local);
}

#[test]
fn a_strong_anchor_holds_local_ao() {
    let forest = Forest::new([0.2, 0.9], 0.1, 0.05, 4, 1);
    let moved = |anchor| {
        let found = forest.alternate(&AlternateParams { anchor, ..AlternateParams::default() });
        assert!(holds(&found));
        shapes::distance(found.local.iter().copied(), forest.local.iter().copied())
    };
    let (weak, strong) = (moved(1e-3), moved(1e5));
    assert!(strong <= 1e-3 && weak >= 0.05, "{weak} {strong}");
}

#[test]
fn vertices_at_one_position_keep_one_value() {
    let mut forest = Forest::new([0.2, 0.9], 0.1, 0.1, 4, 1);
    // The second half of the faces gets vertices of its own.
    let (count, half) = (forest.mesh.positions.len() as u32, forest.mesh.faces.len() / 2);
    forest.mesh.positions.extend_from_within(..);
    forest.mesh.normals = vec![[0.0, 0.0, 1.0]; 2 * count as usize];
    forest.mesh.faces[half..].iter_mut().for_each(|face| *face = face.map(|v| v + count));
    forest.local.extend_from_within(..);
    forest.samples = model(&forest.mesh, 3);
    let found = forest.alternate(&AlternateParams::default());
    let (first, second) = found.local.split_at(count as usize);
    assert!(holds(&found) && first == second);
    assert_ne!(first, &forest.local[..count as usize]);
}

#[test]
fn threads_change_no_bit() {
    let forest = Forest::new([0.1, 1.0], 0.2, 0.3, 7, 2);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let found = forest.alternate(&AlternateParams::default());
            let table = error_table(&forest.model(), &forest.instances(), &found).unwrap();
            (found, table)
        })
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(7));
}

#[test]
fn what_does_not_fit_is_refused() {
    let forest = Forest::new([0.2, 0.9], 0.1, 0.1, 2, 1);
    let (model, instances) = (forest.model(), forest.instances());
    let params = AlternateParams::default();
    let short = [TreeInstance { values: &forest.signals[0][1..], ..instances[0] }];
    assert!(matches!(alternate(&model, &short, &params), Err(TreeError::Length { .. })));
    let wrong = TreeModel { local: &forest.local[1..], ..model };
    assert!(matches!(alternate(&wrong, &instances, &params), Err(TreeError::Length { .. })));
    let wrong = TreeModel { channels: 0, ..model };
    assert_eq!(alternate(&wrong, &instances, &params), Err(TreeError::Channels { channels: 0 }));
    let negative = AlternateParams { anchor: -1.0, ..params };
    assert!(matches!(alternate(&model, &instances, &negative), Err(TreeError::Mesh(_))));
    let other = bush(3, 4);
    assert!(matches!(
        alternate(&TreeModel { mesh: &other, ..model }, &instances, &params),
        Err(TreeError::Length { .. })
    ));
}

prop_compose! {
    /// Local AO and signals without any relation, some values beyond their range or not valid.
    fn wild()(seed in 0..1000u64, low in -0.5..0.9f64, instances in 0..6u64, channels in 1..4usize) -> Forest {
        let mut forest = Forest::new([0.0, 1.0], 0.0, 0.0, 0, channels);
        let count = forest.samples.len() * channels;
        forest.local = values(forest.local.len(), seed, [low, 1.2]).iter().map(|l| l.clamp(0.0, 1.0)).collect();
        forest.signals = (0..instances).map(|j| values(count, seed + j + 1, [low, 1.3])).collect();
        for (i, f) in forest.signals.iter_mut().flatten().enumerate().filter(|(i, _)| shapes::noise(*i as u64) < 0.1) {
            *f = if i % 2 == 0 { f32::NAN } else { -3.0 };
        }
        forest
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_half_step_raises_the_objective(
        forest in wild(), regularization in prop::sample::select(vec![0.0, 0.003, 1.0]),
        anchor in prop::sample::select(vec![0.0, 1e-3, 1.0]),
    ) {
        let params = AlternateParams { regularization, anchor, tolerance: 0.0, rounds: 5, ..AlternateParams::default() };
        let found = forest.alternate(&params);
        prop_assert!(holds(&found), "{:?}", found.steps);
        for row in error_table(&forest.model(), &forest.instances(), &found).unwrap() {
            prop_assert!(row.alternated <= row.local_global, "{row:?}");
        }
    }

    #[test]
    fn the_order_of_instances_changes_no_bit(forest in wild(), turn in 0..6usize, equal in any::<bool>()) {
        let params = AlternateParams { rounds: 3, ..AlternateParams::default() };
        let mut instances = forest.instances();
        if equal {
            instances.iter_mut().for_each(|instance| instance.key = key(0));
        }
        let there = alternate(&forest.model(), &instances, &params).unwrap();
        let table = error_table(&forest.model(), &instances, &there).unwrap();
        let turn = turn % instances.len().max(1);
        instances.rotate_left(turn);
        instances.reverse();
        let mut back = alternate(&forest.model(), &instances, &params).unwrap();
        prop_assert_eq!(&table, &error_table(&forest.model(), &instances, &back).unwrap());
        let mut fits: Vec<_> = back.fits.chunks(forest.channels).rev().map(<[_]>::to_vec).collect();
        fits.rotate_right(turn);
        back.fits = fits.concat();
        prop_assert_eq!(there, back);
    }
}
