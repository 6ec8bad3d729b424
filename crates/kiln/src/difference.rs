//! Statistics of a piecewise linear difference over a surface.

use serde::Serialize;

/// Difference of one half-distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Difference {
    pub(crate) rmse: f64,
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) max: f64,
    pub(crate) bias: f64,
}

impl Difference {
    /// Over faces that have a weight, which is an area, and differences at their corners. RMSE and bias are exact
    /// integrals; quantiles give a third of each face's weight to each of its corners.
    pub(crate) fn over(faces: impl Iterator<Item = (f64, [f64; 3])>) -> Self {
        let (mut area, mut squares, mut sum) = (0.0, 0.0, 0.0);
        let mut weighted = Vec::new();
        for (face_area, d) in faces {
            let [p, q, r] = d;
            area += face_area;
            squares += face_area / 6.0 * (p * p + q * q + r * r + p * q + q * r + r * p);
            sum += face_area / 3.0 * (p + q + r);
            weighted.extend(d.map(|d| (d.abs(), face_area / 3.0)));
        }
        weighted.sort_unstable_by(|x, y| x.0.total_cmp(&y.0));
        let quantile = |fraction: f64| {
            let mut before = 0.0;
            let reached = |&&(_, weight): &&(f64, f64)| {
                before += weight;
                before >= fraction * area
            };
            weighted.iter().find(reached).or(weighted.last()).map_or(0.0, |&(d, _)| d)
        };
        let (p50, p99) = (quantile(0.5), quantile(0.99));
        let max = weighted.last().map_or(0.0, |&(d, _)| d);
        let mean = |x: f64| if area > 0.0 { x / area } else { 0.0 };
        Self { rmse: mean(squares).sqrt(), p50, p99, max, bias: mean(sum) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_known_differences() {
        // A constant.
        let constant = Difference::over([(2.0, [-0.1; 3]), (1.0, [-0.1; 3])].into_iter());
        assert!((constant.rmse - 0.1).abs() < 1e-12 && (constant.bias + 0.1).abs() < 1e-12);
        assert_eq!((constant.p50, constant.p99, constant.max), (0.1, 0.1, 0.1));
        // 1 at one corner of one face: ∫ φ² / A = 1/6.
        let hat = Difference::over([(5.0, [1.0, 0.0, 0.0])].into_iter());
        assert!((hat.rmse - (1.0f64 / 6.0).sqrt()).abs() < 1e-12 && (hat.bias - 1.0 / 3.0).abs() < 1e-12);
        // A face of no area counts for the maximum only.
        let sliver = Difference::over([(1.0, [0.0; 3]), (0.0, [1.0; 3])].into_iter());
        assert_eq!((sliver.rmse, sliver.p99, sliver.max), (0.0, 0.0, 1.0));
        assert_eq!(Difference::over(std::iter::empty()).rmse, 0.0);
    }
}
