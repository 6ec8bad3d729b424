//! Laws of the absorption of small regions.

mod rooms;

use glam::DVec3;
use kiln_core::{CandidateBits, RegionEdge, RegionSettings, Regions};
use kiln_solve::{
    model_regions,
    region::{CenterRule, OPEN_SKY, RegionPoints, absorb, fit_region},
};
use proptest::prelude::*;
use rooms::*;

/// Rooms in a row with so many valid points and with flat AO.
fn chain(counts: &[usize], ao: &[f64]) -> (Regions, Vec<RegionPoints>) {
    let regions = row(counts.len() as u32, 0.0);
    let of_region = |r: usize| points(&regions.regions[r], &bits(|i| i < counts[r]), 1, flat(ao[r]));
    let points = (0..counts.len()).map(of_region).collect();
    (regions, points)
}

#[test]
fn the_best_predictor_absorbs() {
    // Of the third room's neighbours the last sees what it sees.
    let (regions, points) = chain(&[512, 512, 3, 512], &[0.5, 0.2, 0.6, 0.7]);
    let found = absorb(points, &regions.edges, 8, 1.0).unwrap();
    assert_eq!((found.model_of, found.region_of), (vec![0, 1, 2, 2], vec![0, 1, 3]));
    assert_eq!(found.edges.iter().map(|edge| edge.regions).collect::<Vec<_>>(), [[0, 1], [1, 2]]);
    assert_eq!(found.edges[1], RegionEdge { regions: [1, 2], ..regions.edges[1].clone() });
    let both = &found.points[2];
    assert_eq!((both.len(), both.bounds().min.x, both.bounds().max.x, both.volume_m3()), (515, 8.0, 16.0, 96.0));
    let mean = fit_region(both, CenterRule::Mean).model().coefficients[0][0];
    assert!((f64::from(mean) / OPEN_SKY - (0.6 * 3.0 + 0.7 * 512.0) / 515.0).abs() < 1e-6);
}

#[test]
fn what_is_merged_is_fitted_to_all_its_points() {
    let halves = [region([0.0, 0.0, 0.0], [4.0, 4.0, 3.0]), region([4.0, 1.0, -1.0], [7.0, 4.0, 3.0])];
    let valid = [bits(|i| i % 3 > 0), bits(|i| i % 5 > 2)];
    let merged = |f: &dyn Fn(DVec3, usize) -> f64| {
        let [mut both, other] = [0, 1].map(|r| points(&halves[r], &valid[r], 2, f));
        both.merge(&other);
        both
    };
    // The box of both is what is scaled to.
    let hull = region([0.0, 0.0, -1.0], [7.0, 4.0, 3.0]);
    let known = Known::new(&hull, hull.bounds.center(), 3);
    let fit = fit_region(&merged(&|p, k| known.at(p, k)), CenterRule::Box).model();
    for (found, known) in fit.coefficients.iter().zip(&known.parameters) {
        assert!((0..7).all(|i| (f64::from(found[i]) - known[i]).abs() < 1e-5), "{found:?} {known:?}");
    }
    let fit = fit_region(&merged(&|p, k| uneven(7, p, k)), CenterRule::Refined);
    let mut direct = [0.0; 2];
    for (half, valid) in halves.iter().zip(&valid) {
        for point in valid.iter().map(|index| half.candidate(index)) {
            let squares = fit.at(point).enumerate().map(|(k, v)| (f64::from(uneven(7, point, k) as f32) - v).powi(2));
            squares.enumerate().for_each(|(k, square)| direct[k / 9] += square / (4.0 * std::f64::consts::PI));
        }
    }
    let found = fit.squared_errors();
    assert!((0..2).all(|c| (found[c] - direct[c]).abs() < 1e-9), "{found:?} {direct:?}");
}

/// What a neighbour absorbed before counts when it is compared again.
#[test]
fn neighbours_are_fitted_again() {
    // All in one box: 0 sees 0.5 and takes 1 (0.9), since 4 sees 0.1; then it predicts 2 (0.62) better than 3 (0.52).
    let of_region = |(count, ao): (usize, f64)| points(&hall(), &bits(|i| i < count), 1, flat(ao));
    let points = [(8, 0.5), (6, 0.9), (7, 0.62), (512, 0.52), (512, 0.1)].map(of_region);
    let edge = |a, b| RegionEdge { regions: [a, b], area_m2: 1.0, center: hall().bounds.center() };
    let found = absorb(points.to_vec(), &[edge(0, 1), edge(1, 4), edge(0, 2), edge(2, 3)], 8, 1.0).unwrap();
    assert_eq!(found.model_of, [0, 0, 0, 1, 2]);
    let without = [points[0].clone(), points[2].clone(), points[3].clone()].to_vec();
    assert_eq!(absorb(without, &[edge(0, 1), edge(1, 2)], 8, 1.0).unwrap().model_of, [0, 1, 1]);
}

#[test]
fn ties_go_to_the_larger_boundary_then_the_lower_index() {
    let (mut regions, points) = chain(&[512, 2, 512], &[0.5; 3]);
    assert!(regions.edges[0].area_m2 < regions.edges[1].area_m2);
    let larger = absorb(points.clone(), &regions.edges, 8, 1.0).unwrap();
    assert_eq!(larger.model_of, [0, 1, 1]);
    regions.edges[1].area_m2 = regions.edges[0].area_m2;
    assert_eq!(absorb(points, &regions.edges, 8, 1.0).unwrap().model_of, [0, 0, 1]);
}

#[test]
fn chains_of_small_regions_become_one_by_one() {
    // All but the last are small: the smallest first, until what is left is large enough.
    let (regions, points) = chain(&[3, 1, 2, 400], &[0.5; 4]);
    let found = absorb(points, &regions.edges, 8, 1.0).unwrap();
    assert_eq!((found.model_of, found.region_of, found.edges.len()), (vec![0; 4], vec![3], 0));
    // Small ones only: together they are large enough, and stop.
    let (regions, points) = chain(&[5, 5, 5, 5], &[0.5; 4]);
    let found = absorb(points, &regions.edges, 8, 1.0).unwrap();
    assert_eq!(found.region_of.len(), 2, "{:?}", found.model_of);
    // By volume, all boxes together.
    let (regions, points) = chain(&[512; 4], &[0.5; 4]);
    assert_eq!(absorb(points.clone(), &regions.edges, 8, 48.0).unwrap().region_of.len(), 4);
    assert_eq!(absorb(points.clone(), &regions.edges, 8, 60.0).unwrap().region_of.len(), 2);
    assert_eq!(absorb(points, &regions.edges, 8, 1e9).unwrap().region_of.len(), 1);
}

#[test]
fn what_has_no_neighbour_stays() {
    let (_, points) = chain(&[2, 0, 512], &[0.5; 3]);
    let found = absorb(points, &[], 8, 1.0).unwrap();
    assert_eq!((found.model_of, found.points.len()), (vec![0, 1, 2], 3));
}

#[test]
fn regions_without_points_are_what_a_neighbour_is() {
    // Even without limits; and open sky where no neighbour has points.
    let mut regions = row(5, 1.0);
    regions.edges.remove(2);
    regions.settings = RegionSettings { min_points: 0, min_volume_m3: 0.0, ..regions.settings };
    let valid = vec![CandidateBits::ALL, CandidateBits::default(), bits(|i| i < 2)];
    let valid = valid.into_iter().chain([CandidateBits::default(); 2]).collect();
    let samples = samples(&regions, valid, 1, |r, p, k| flat([0.5, 9.0, 0.6, 9.0, 9.0][r])(p, k));
    let models = model_regions(&regions, &samples).unwrap();
    models.check(5, 1).unwrap();
    assert_eq!((models.model_of, models.summary.empty, models.summary.absorbed), (vec![0, 1, 1, 2, 2], 3, 2));
    assert_eq!(models.models[2].coefficients[0], [OPEN_SKY as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!((models.summary.dropped, models.summary.rays, models.summary.points), (5, 1024, 514));
}

/// Numbers of points and lengths of cubes; edges between any of them with their areas.
type Drawn = (Vec<(usize, f64)>, Vec<(usize, usize, f64)>);

fn level() -> impl Strategy<Value = Drawn> {
    let room = (prop_oneof![0..12usize, 0..512usize], 0.3..4.0f64);
    (2..14usize).prop_flat_map(move |count| {
        let edges = prop::collection::vec((0..count, 0..count, 0.1..9.0f64), 0..24);
        (prop::collection::vec(room.clone(), count), edges)
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn absorption_keeps_its_books((rooms, links) in level()) {
        let at = |r: usize| DVec3::new(5.0 * (r % 4) as f64, 0.0, 5.0 * (r / 4) as f64);
        let room = |(r, (_, size)): (usize, &(usize, f64))| region(at(r).to_array(), (at(r) + *size).to_array());
        let edge = |(a, b, area_m2): &(usize, usize, f64)| RegionEdge {
            regions: [*a.min(b) as u32, *a.max(b) as u32],
            area_m2: *area_m2,
            center: 0.5 * (at(*a) + at(*b)),
        };
        let regions = Regions {
            regions: rooms.iter().enumerate().map(room).collect(),
            edges: links.iter().filter(|(a, b, _)| a != b).map(edge).collect(),
            settings: RegionSettings::default(),
        };
        let valid: Vec<_> = rooms.iter().map(|(count, _)| bits(|i| i * 37 % 512 < *count)).collect();
        let samples = samples(&regions, valid.clone(), 1, uneven);
        let models = model_regions(&regions, &samples).unwrap();
        models.check(rooms.len(), 1).unwrap();

        let summary = &models.summary;
        prop_assert_eq!(summary.points, valid.iter().map(|valid| valid.count() as u64).sum::<u64>());
        prop_assert_eq!(models.models.len() as u64 + summary.absorbed, rooms.len() as u64);
        // What is left is its own model; a region's model is of one that it reaches by edges.
        prop_assert!(models.region_of.is_sorted_by(|a, b| a < b));
        for (model, region) in models.region_of.iter().enumerate() {
            prop_assert_eq!(models.model_of[*region as usize] as usize, model);
        }
        prop_assert!(models.edges.is_sorted_by(|a, b| a.regions < b.regions));
        prop_assert!(models.edges.iter().all(|edge| edge.regions[0] < edge.regions[1]));
        // Boundaries between models are all those between their regions.
        let area: f64 = models.edges.iter().map(|edge| edge.area_m2).sum();
        let outer = regions.edges.iter().filter(|edge| {
            let [a, b] = edge.regions.map(|region| models.model_of[region as usize]);
            a != b
        });
        prop_assert!((area - outer.map(|edge| edge.area_m2).sum::<f64>()).abs() < 1e-9);
        // Who is small is alone.
        for (model, region) in models.region_of.iter().enumerate() {
            let parts = (0..rooms.len()).filter(|r| models.model_of[*r] as usize == model);
            let (count, volume) = parts.fold((0, 0.0), |(n, v), r| (n + rooms[r].0, v + rooms[r].1.powi(3)));
            let is_alone = models.edges.iter().all(|edge| !edge.regions.contains(&(model as u32)));
            prop_assert!((count >= 8 && volume >= 1.0 - 1e-9) || is_alone, "{region} {count} {volume}");
        }
    }
}
