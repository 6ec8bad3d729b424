//! The two errors, never mixed: the distance from the converged solution on the same unknowns, and the distance of the
//! interpolated result from the true signal.

use super::{points::area_m2, scene::BenchScene, truth::TruePoint};
use kiln_core::FaceMoments;
use serde::Serialize;

/// Vertex values of each receiver, `vertices × channels`.
pub(super) type Values = Vec<Vec<f32>>;

/// How far a result is off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct ErrorStats {
    /// Root mean square.
    pub(super) rmse: f64,
    /// The 99th percentile of the absolute error.
    pub p99: f64,
    /// The greatest absolute error.
    pub(super) max: f64,
    /// The mean error, result minus truth.
    pub(super) bias: f64,
}

/// The converged solution that results are compared with.
pub(super) struct Reference {
    pub(super) values: Values,
    /// For each receiver and face: its area times the fraction of the reference's samples that are valid, m².
    weights: Vec<Vec<f64>>,
}

impl Reference {
    /// From the reference's values and the moments they were found from.
    pub(super) fn new(scene: &BenchScene, values: Values, moments: &[FaceMoments]) -> Self {
        let weight = |(receiver, moments): (&super::scene::Receiver, &FaceMoments)| {
            let face = |face: usize| area_m2(receiver, face) * valid_fraction(moments, face);
            (0..receiver.faces.len()).map(face).collect()
        };
        Self { values, weights: scene.receivers.iter().zip(moments).map(weight).collect() }
    }

    /// Estimation error of each channel, over the area that has valid samples: RMSE and bias by the exact integral of
    /// a linear difference over each face, p99 and max over the corners of faces.
    pub(super) fn compare(&self, scene: &BenchScene, values: &Values) -> Vec<ErrorStats> {
        (0..scene.channels()).map(|channel| self.compare_channel(scene, values, channel)).collect()
    }

    fn compare_channel(&self, scene: &BenchScene, values: &Values, channel: usize) -> ErrorStats {
        let channels = scene.channels();
        let mut sum = FaceSums::default();
        let mut corners = Vec::new();
        for (at, receiver) in scene.receivers.iter().enumerate() {
            let difference = |v: u32| {
                let i = v as usize * channels + channel;
                f64::from(values[at][i]) - f64::from(self.values[at][i])
            };
            for (face, &weight) in receiver.mesh.faces.iter().zip(&self.weights[at]).filter(|(_, w)| **w > 0.0) {
                let d = face.map(difference);
                sum.add(weight, d);
                corners.extend(d.map(|d| (d.abs(), weight)));
            }
        }
        let (p99, max) = tail(&mut corners);
        let total = sum.weight.max(f64::MIN_POSITIVE);
        ErrorStats { rmse: (sum.square / total).sqrt(), p99, max, bias: sum.mean / total }
    }
}

/// Integrals over faces of a difference that is linear on each.
#[derive(Default)]
struct FaceSums {
    weight: f64,
    mean: f64,
    square: f64,
}

impl FaceSums {
    /// The mean over a triangle of the square of a linear function is (Σ d_i² + (Σ d_i)²) / 12.
    fn add(&mut self, weight: f64, [a, b, c]: [f64; 3]) {
        let sum = a + b + c;
        self.weight += weight;
        self.mean += weight * sum / 3.0;
        self.square += weight / 12.0 * (a * a + b * b + c * c + sum * sum);
    }
}

fn valid_fraction(moments: &FaceMoments, face: usize) -> f64 {
    let halves = moments.face(face);
    let valid: u32 = halves.iter().map(|half| half.valid).sum();
    let taken: u32 = halves.iter().map(|half| half.taken).sum();
    if taken == 0 { 0.0 } else { f64::from(valid) / f64::from(taken) }
}

/// Weighted 99th percentile and maximum of (value, weight) pairs.
fn tail(pairs: &mut [(f64, f64)]) -> (f64, f64) {
    pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let wanted = 0.99 * pairs.iter().map(|pair| pair.1).sum::<f64>();
    let mut below = 0.0;
    let reached = pairs.iter().find(|pair| {
        below += pair.1;
        below >= wanted
    });
    let max = pairs.last().map_or(0.0, |pair| pair.0);
    (reached.map_or(max, |pair| pair.0), max)
}

/// Surface error of each channel: interpolated values minus the signal at the points, which count alike.
pub(super) fn surface(scene: &BenchScene, values: &Values, points: &[TruePoint]) -> Vec<ErrorStats> {
    let channels = scene.channels();
    let error = |truth: &TruePoint, channel: usize| {
        let point = &truth.point;
        let corners = scene.receivers[point.receiver].mesh.faces[point.face];
        let at = |v: u32| f64::from(values[point.receiver][v as usize * channels + channel]);
        corners.iter().zip(point.phi).map(|(&v, phi)| phi * at(v)).sum::<f64>() - truth.ao[channel]
    };
    (0..channels).map(|channel| of_points(points.iter().map(|point| error(point, channel)))).collect()
}

fn of_points(errors: impl Iterator<Item = f64>) -> ErrorStats {
    let errors: Vec<f64> = errors.collect();
    let count = (errors.len() as f64).max(1.0);
    let (p99, max) = tail(&mut errors.iter().map(|e| (e.abs(), 1.0)).collect::<Vec<_>>());
    let rmse = (errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt();
    ErrorStats { rmse, p99, max, bias: errors.iter().sum::<f64>() / count }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_difference_by_its_integral() {
        // x over the triangle (0,0), (1,0), (0,1): mean 1/3, mean square 1/6.
        let mut sum = FaceSums::default();
        sum.add(2.0, [0.0, 1.0, 0.0]);
        assert!((sum.mean / sum.weight - 1.0 / 3.0).abs() < 1e-15);
        assert!((sum.square / sum.weight - 1.0 / 6.0).abs() < 1e-15);
        // And x over the unit square in two triangles: mean 1/2, mean square 1/3.
        let mut sum = FaceSums::default();
        sum.add(0.5, [0.0, 1.0, 0.0]);
        sum.add(0.5, [1.0, 1.0, 0.0]);
        assert!((sum.mean - 0.5).abs() < 1e-15 && (sum.square - 1.0 / 3.0).abs() < 1e-15);
    }

    #[test]
    fn the_percentile_goes_by_weight() {
        let mut pairs = [(0.4, 0.1), (0.1, 90.0), (0.3, 0.4), (0.2, 9.5)];
        assert_eq!(tail(&mut pairs), (0.2, 0.4));
        assert_eq!(tail(&mut []), (0.0, 0.0));
    }

    #[test]
    fn points_count_alike() {
        let stats = of_points([0.3, -0.1, 0.1, -0.3].into_iter());
        assert!((stats.rmse - 0.05f64.sqrt()).abs() < 1e-15 && stats.bias.abs() < 1e-15 && stats.max == 0.3);
    }
}
