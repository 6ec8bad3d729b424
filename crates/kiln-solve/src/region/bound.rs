//! Models never overshoot: in the boxes of its regions, a model's AO for normals along the axes leaves the range of its points' by
//! [`OVERSHOOT`] at most.
//!
//! The paper's fit does, by up to 0.67 where a diagonal wall splits a box. The model is a sum of functions of one coordinate, each
//! of two straight pieces, so that its greatest value in a box is the sum of theirs, at an end or at the centre: the bound holds in the
//! whole box, of which the corners are a part. The range is that of the same normal and channel.

use super::{
    grid::{Range, Scale},
    harmonics::{NORMALS, at_axes},
    points::RegionPoints,
};
use kiln_core::REGION_HARMONICS;

/// By how much AO may leave the range of the points' AO.
pub(crate) const OVERSHOOT: f64 = 0.1;

/// Where a model is evaluated, and between what it must stay there.
#[derive(Clone, Debug)]
pub(crate) struct Limits {
    /// The boxes of the regions as offsets from the model's centre, scaled: for each axis the least and the greatest.
    boxes: Vec<[[f64; 2]; 3]>,
    /// For each channel.
    allowed: Vec<Range>,
}

impl Limits {
    /// Those of a model about a centre in the box of `scale`.
    pub(crate) fn new(points: &RegionPoints, scale: &Scale, center: [f64; 3]) -> Self {
        let ends = |bounds: &kiln_core::Bounds, axis: usize| {
            [bounds.min[axis], bounds.max[axis]].map(|end| scale.coordinate(axis, end) - center[axis])
        };
        let boxes = points.grids.iter().map(|grid| [0, 1, 2].map(|axis| ends(&grid.bounds, axis))).collect();
        let grown = |[low, high]: [f64; 2]| [low - OVERSHOOT, high + OVERSHOOT];
        // Where there is no point nothing is known that could be left.
        let open = [[f64::NEG_INFINITY, f64::INFINITY]; NORMALS];
        let allowed = |range: &Range| if points.is_empty() { open } else { range.map(grown) };
        Self { boxes, allowed: points.ranges.iter().map(allowed).collect() }
    }

    /// The range of AO in the boxes, of the nine harmonics of one channel.
    pub(crate) fn reached(&self, parameters: &[[f64; 7]]) -> Range {
        let by_parameter: [_; 7] = std::array::from_fn(|p| at_axes(|k| parameters[k][p]));
        std::array::from_fn(|normal| {
            let [constant, slopes @ ..] = by_parameter.map(|values| values[normal]);
            let mut range = [f64::INFINITY, f64::NEG_INFINITY];
            for ends in &self.boxes {
                let [mut low, mut high] = [constant; 2];
                for axis in 0..3 {
                    let [least, greatest] = along(ends[axis], slopes[2 * axis], slopes[2 * axis + 1]);
                    (low, high) = (low + least, high + greatest);
                }
                range = [range[0].min(low), range[1].max(high)];
            }
            range
        })
    }

    /// The greatest part t ≤ 1 of a change that is allowed: `base + t change`, where `base` is within. Base and change are
    /// for each channel the nine harmonics' parameters.
    pub(crate) fn part_of_slopes(&self, base: &[f64], change: &[[f64; 7]]) -> f64 {
        let channels = self.allowed.iter().zip(base.chunks(REGION_HARMONICS)).zip(change.chunks(REGION_HARMONICS));
        let of_channel = |((allowed, base), change): ((&Range, &[f64]), &[[f64; 7]])| {
            let from = at_axes(|k| base[k]).map(|ao| [ao, ao]);
            let to = self.reached(change);
            let to = std::array::from_fn(|n| [0, 1].map(|side| from[n][side] + to[n][side]));
            least_part(allowed, &from, &to)
        };
        channels.map(of_channel).fold(1.0, f64::min)
    }

    /// The part t ≤ 1 of the way from one model to another, of one channel, on which nothing overshoots, where the first
    /// does not. What is reached is convex in t, so that a chord bounds it: t may be less than the greatest.
    pub(crate) fn part_of_way(&self, channel: usize, from: &[[f64; 7]], to: &[[f64; 7]]) -> f64 {
        let to = self.reached(to);
        if is_within(&self.allowed[channel], &to) {
            return 1.0;
        }
        least_part(&self.allowed[channel], &self.reached(from), &to)
    }
}

/// The least and the greatest of two straight pieces that meet in 0 at 0, from end to end.
fn along([start, end]: [f64; 2], plus: f64, minus: f64) -> [f64; 2] {
    let value = |offset: f64| if offset >= 0.0 { plus * offset } else { minus * offset };
    let [a, b] = [value(start), value(end)];
    let (low, high) = (a.min(b), a.max(b));
    if start < 0.0 && end > 0.0 { [low.min(0.0), high.max(0.0)] } else { [low, high] }
}

fn is_within(allowed: &Range, range: &Range) -> bool {
    allowed.iter().zip(range).all(|(allowed, range)| allowed[0] <= range[0] && range[1] <= allowed[1])
}

/// The greatest t in [0, 1] with `from + t (to − from)` allowed at both ends of each range.
fn least_part(allowed: &Range, from: &Range, to: &Range) -> f64 {
    let mut part = 1.0f64;
    for ((allowed, from), to) in allowed.iter().zip(from).zip(to) {
        // Both ends as upper bounds, the lower one with its sign turned.
        for (sign, side) in [(-1.0, 0), (1.0, 1)] {
            let (room, growth) = (sign * (allowed[side] - from[side]), sign * (to[side] - from[side]));
            if growth > room {
                part = part.min((room / growth).max(0.0));
            }
        }
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_pieces_are_extreme_at_ends_or_between() {
        assert_eq!(along([-1.0, 2.0], -0.5, 0.25), [-1.0, 0.0]);
        assert_eq!(along([-1.0, 2.0], 0.5, 0.25), [-0.25, 1.0]);
        assert_eq!(along([1.0, 2.0], 0.5, 9.0), [0.5, 1.0]);
        assert_eq!(along([-2.0, -1.0], 9.0, -0.5), [0.5, 1.0]);
        assert_eq!(along([0.0, 0.0], 3.0, 4.0), [0.0, 0.0]);
    }

    #[test]
    fn the_part_is_the_greatest_that_is_allowed() {
        let range = |low: f64, high: f64| [[low, high]; NORMALS];
        let allowed = range(0.0, 1.0);
        assert_eq!(least_part(&allowed, &range(0.5, 0.5), &range(0.0, 1.0)), 1.0);
        assert_eq!(least_part(&allowed, &range(0.5, 0.5), &range(-0.5, 1.0)), 0.5);
        assert_eq!(least_part(&allowed, &range(0.5, 0.5), &range(0.4, 2.5)), 0.25);
        assert_eq!(least_part(&allowed, &range(0.0, 1.1), &range(0.0, 1.2)), 0.0);
        assert_eq!(least_part(&allowed, &range(0.0, 1.1), &range(0.0, 1.0)), 1.0);
        assert_eq!(
            least_part(&[[f64::NEG_INFINITY, f64::INFINITY]; NORMALS], &range(0.5, 0.5), &range(-9.0, 9.0)),
            1.0
        );
    }
}
