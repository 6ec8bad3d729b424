//! Curves of error against cost: what a method needs to reach an error, and what it reaches for a cost.

use serde::Serialize;

/// A cost at which an error is reached.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Crossing {
    /// The cost.
    pub(super) cost: f64,
    /// The cheapest point of the curve is already as good: the cost is an upper bound.
    pub(super) is_bound: bool,
}

/// The points that no other is both cheaper and better than, by rising cost. Points without a positive finite cost and
/// error are left out.
pub(super) fn frontier(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let is_usable = |(cost, error): &(f64, f64)| [cost, error].into_iter().all(|v| v.is_finite() && *v > 0.0);
    let mut sorted: Vec<(f64, f64)> = points.iter().copied().filter(is_usable).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut best = f64::INFINITY;
    sorted.retain(|&(_, error)| {
        let is_better = error < best;
        best = best.min(error);
        is_better
    });
    sorted
}

/// Where the frontier of the points, straight in log-log between them, reaches an error; nothing if it never does.
pub(super) fn cost_at(points: &[(f64, f64)], error: f64) -> Option<Crossing> {
    let frontier = frontier(points);
    let at = frontier.iter().position(|point| point.1 <= error)?;
    let (after, good) = frontier[at];
    if at == 0 {
        return Some(Crossing { cost: after, is_bound: good < error });
    }
    let (before, bad) = frontier[at - 1];
    let part = (bad / error).ln() / (bad / good).ln();
    Some(Crossing { cost: before * (after / before).powf(part), is_bound: false })
}

/// The least error of the points that cost at most this.
pub(super) fn best_within(points: &[(f64, f64)], cost: f64) -> Option<f64> {
    points.iter().filter(|point| point.0 <= cost).map(|point| point.1).min_by(f64::total_cmp)
}

/// The geometric mean of positive numbers; nothing of none.
pub(super) fn geometric_mean(values: &[f64]) -> Option<f64> {
    let sum: f64 = values.iter().map(|v| v.ln()).sum();
    (!values.is_empty()).then(|| (sum / values.len() as f64).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_met_exactly() {
        // error = cost^(-1/2): straight in log-log, so interpolation has no error.
        let points: Vec<(f64, f64)> = [8.0, 0.5, 2.0, 32.0].map(|cost: f64| (cost, cost.powf(-0.5))).to_vec();
        for cost in [0.6, 1.0, 5.0, 31.0f64] {
            let found = cost_at(&points, cost.powf(-0.5)).unwrap();
            assert!((found.cost / cost - 1.0).abs() < 1e-12 && !found.is_bound, "{cost}: {found:?}");
        }
        assert_eq!(cost_at(&points, 0.01), None, "the curve ends at 0.18");
        assert_eq!(cost_at(&points, 2.0), Some(Crossing { cost: 0.5, is_bound: true }));
    }

    #[test]
    fn points_that_are_dearer_and_worse_do_not_count() {
        let points = [(1.0, 0.1), (2.0, 0.2), (4.0, 0.05), (3.0, 0.1), (f64::NAN, 0.01), (0.0, 0.01)];
        assert_eq!(frontier(&points), [(1.0, 0.1), (4.0, 0.05)]);
        assert_eq!(best_within(&points[..4], 3.5), Some(0.1));
        assert_eq!(best_within(&points[..4], 0.5), None);
    }

    #[test]
    fn means_are_geometric() {
        assert!((geometric_mean(&[0.5, 2.0, 8.0]).unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(geometric_mean(&[]), None);
    }
}
