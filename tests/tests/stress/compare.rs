//! Comparison of two bakes at the vertices of the first.

use crate::bake::{Outcome, adaptive, bake};
use crate::{
    geometry::{floor_and_wall, room},
    level::Level,
};
use glam::DVec3;
use kiln_core::Quality;
use kiln_scene::BakedPart;
use std::sync::OnceLock;

/// Two bakes agree if their difference is at most this many times the root of the sum of the squares of their estimated
/// errors. The difference of two independent bakes is about once that; an estimate from a few hundred faces is itself
/// uncertain by some tens of percent, and the samples of few faces are no normal distribution.
const ERRORS: f64 = 2.0;

/// A vertex that faces use.
#[derive(Clone, Debug)]
pub(crate) struct Vertex {
    pub(crate) position: DVec3,
    /// Of the faces around it, by their areas.
    normal: DVec3,
    pub(crate) values: Vec<f32>,
}

/// A part's vertices; nothing where no face uses one.
fn vertices_of(part: &BakedPart) -> Vec<Option<Vertex>> {
    let mut areas = vec![None; part.positions.len()];
    for face in &part.faces {
        for vertex in face {
            *areas[*vertex as usize].get_or_insert(DVec3::ZERO) += area(part, face);
        }
    }
    let of = |(vertex, area): (usize, Option<DVec3>)| {
        let values = part.ao.get(vertex * part.channels..(vertex + 1) * part.channels)?.to_vec();
        Some(Vertex { position: part.positions[vertex], normal: area?.normalize_or_zero(), values })
    };
    areas.into_iter().enumerate().map(of).collect()
}

/// The vector area of a face, square metres.
fn area(part: &BakedPart, face: &[u32; 3]) -> DVec3 {
    let [a, b, c] = face.map(|vertex| part.positions[vertex as usize]);
    0.5 * (b - a).cross(c - a)
}

/// All vertices with values that faces use.
pub(crate) fn vertices(outcome: &Outcome) -> Vec<Vertex> {
    let parts = outcome.scene.parts.iter().filter(|part| part.channels > 0);
    parts.flat_map(vertices_of).flatten().collect()
}

/// Checks that all values are in [0, 1], and that a vertex has one for each half-distance.
pub(crate) fn assert_valid(outcome: &Outcome) {
    let channels = outcome.summary.sampling.kernel.channel_count();
    for part in outcome.scene.parts.iter().filter(|part| part.channels > 0) {
        assert_eq!(part.ao.len(), part.positions.len() * channels, "{}", part.node);
        assert!(part.ao.iter().all(|value| (0.0..=1.0).contains(value)), "{}", part.node);
    }
}

/// What one bake makes of another's vertices.
pub(crate) struct Difference {
    /// Area-weighted root mean square for each half-distance.
    pub(crate) rmse: Vec<f64>,
    /// The same as the two bakes' own estimates have it.
    expected: Vec<f64>,
}

impl Difference {
    /// The greatest ratio of found to expected.
    pub(crate) fn ratio(&self) -> f64 {
        self.rmse.iter().zip(&self.expected).map(|(found, expected)| found / expected).fold(0.0, f64::max)
    }

    /// Whether the difference is within the estimated errors.
    pub(crate) fn is_within_error(&self) -> bool {
        self.ratio() <= ERRORS
    }

    pub(crate) fn assert_within_error(&self, what: &str) {
        assert!(self.is_within_error(), "{what}: RMSE {:.5?}, expected {:.5?}", self.rmse, self.expected);
    }
}

/// How a case moves the clean vertices, and which of them count.
pub(crate) struct Correspondence<'a> {
    /// Where a clean vertex is in the case.
    pub(crate) moved: &'a dyn Fn(DVec3) -> DVec3,
    /// Whether a clean vertex counts.
    pub(crate) counts: &'a dyn Fn(DVec3) -> bool,
}

impl Correspondence<'_> {
    /// All vertices where they are.
    pub(crate) const SAME: Self = Self { moved: &|p| p, counts: &|_| true };
}

/// Compares a case with clean geometry: every clean vertex with the nearest of the case's that faces the same way, and
/// between vertices what a viewer sees, the interpolated values.
///
/// # Panics
/// If the case has no vertex where a clean one should be.
pub(crate) fn difference(clean: &Outcome, case: &Outcome, by: &Correspondence<'_>) -> Difference {
    assert_valid(case);
    let (found, channels) = (vertices(case), clean.summary.error.len());
    let (mut squares, mut area_m2) = (vec![0.0; channels], 0.0);
    for part in &clean.scene.parts {
        let errors: Vec<Option<Vec<f64>>> = vertices_of(part).iter().map(|v| errors(v.as_ref()?, &found, by)).collect();
        for face in &part.faces {
            let [Some(a), Some(b), Some(c)] = face.map(|vertex| errors[vertex as usize].as_ref()) else { continue };
            let area = area(part, face).length();
            area_m2 += area;
            squares.iter_mut().enumerate().for_each(|(i, sum)| *sum += area * mean_square([a[i], b[i], c[i]]));
        }
    }
    assert!(area_m2 > 0.0, "nothing is compared");
    let estimates = clean.summary.error.iter().zip(&case.summary.error);
    Difference {
        rmse: squares.iter().map(|sum| (sum / area_m2).sqrt()).collect(),
        expected: estimates.map(|(a, b)| a.rmse.hypot(b.rmse)).collect(),
    }
}

/// Mean and root mean square, by area, of the difference between the first half-distance's values and a constant.
pub(crate) fn errors_against(outcome: &Outcome, expected: f64) -> (f64, f64) {
    let (mut sum, mut squares, mut area_m2) = (0.0, 0.0, 0.0);
    for part in outcome.scene.parts.iter().filter(|part| part.channels > 0) {
        for face in &part.faces {
            let errors = face.map(|vertex| f64::from(part.ao[vertex as usize * part.channels]) - expected);
            let area = area(part, face).length();
            area_m2 += area;
            sum += area * errors.iter().sum::<f64>() / 3.0;
            squares += area * mean_square(errors);
        }
    }
    (sum / area_m2, (squares / area_m2).sqrt())
}

/// The difference at a vertex that counts.
fn errors(vertex: &Vertex, found: &[Vertex], by: &Correspondence<'_>) -> Option<Vec<f64>> {
    let other =
        (by.counts)(vertex.position).then(|| nearest(found, (by.moved)(vertex.position), moved_normal(vertex, by)));
    Some(vertex.values.iter().zip(&other?.values).map(|(a, b)| f64::from(a - b)).collect())
}

/// Of a function that is linear between three corners.
fn mean_square([a, b, c]: [f64; 3]) -> f64 {
    (a * a + b * b + c * c + a * b + b * c + c * a) / 6.0
}

/// The normal after the motion, from two directions in the surface.
fn moved_normal(vertex: &Vertex, by: &Correspondence<'_>) -> DVec3 {
    let (u, v) = vertex.normal.any_orthonormal_pair();
    let origin = (by.moved)(vertex.position);
    let along = |direction: DVec3| (by.moved)(vertex.position + direction) - origin;
    let normal = along(u).cross(along(v)).normalize_or_zero();
    // A mirror turns the winding of the two directions, and not what the surface looks at.
    let mirrored = along(u).cross(along(v)).dot(along(vertex.normal)) < 0.0;
    if mirrored { -normal } else { normal }
}

fn nearest(vertices: &[Vertex], position: DVec3, normal: DVec3) -> &Vertex {
    let extent = vertices.iter().map(|v| v.position.distance(position)).fold(0.0, f64::max);
    let distance = |v: &Vertex| v.position.distance(position) / extent + 0.1 * v.normal.distance(normal);
    let found = vertices.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("the case has vertices");
    assert!(distance(found) < 0.02, "no vertex at {position} that looks along {normal}");
    found
}

/// The values of the first vertices of all parts are the same, bit for bit.
pub(crate) fn assert_same(clean: &Outcome, case: &Outcome, what: &str) {
    assert!(case.scene.parts.len() >= clean.scene.parts.len(), "{what}");
    for (a, b) in clean.scene.parts.iter().zip(&case.scene.parts) {
        assert!(b.ao.len() >= a.ao.len(), "{what}");
        let differing = a.ao.iter().zip(&b.ao).filter(|(a, b)| a != b).count();
        assert_eq!(differing, 0, "{what}: of {} values of {}", a.ao.len(), a.node);
    }
}

/// The room as `kiln bake` bakes it at a quality.
pub(crate) fn clean_room(quality: Quality) -> &'static Outcome {
    static ROOMS: [OnceLock<Outcome>; 2] = [const { OnceLock::new() }; 2];
    let which = usize::from(quality == Quality::Medium);
    ROOMS[which].get_or_init(|| bake(&Level::of(&room()), &adaptive(quality, 1.0)))
}

#[test]
fn a_difference_is_found() {
    let clean = clean_room(Quality::Medium);
    assert_valid(clean);
    // The clean answer is precise enough to say something, and no constant.
    assert!(clean.summary.error.iter().all(|error| error.rmse > 0.0 && error.rmse < 0.01), "{:?}", clean.summary.error);
    let without_box = bake(&Level::of(&floor_and_wall()), &adaptive(Quality::Medium, 1.0));
    let by = Correspondence { counts: &|p| p.y == 0.0, ..Correspondence::SAME };
    assert!(!difference(clean, &without_box, &by).is_within_error());
    let another_seed = kiln_core::BakeSettings { seed: 1, ..adaptive(Quality::Medium, 1.0) };
    let again = bake(&Level::of(&room()), &another_seed);
    difference(clean, &again, &Correspondence::SAME).assert_within_error("another seed");
}
