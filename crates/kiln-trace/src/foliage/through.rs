//! What a ray loses on its way through foliage, and what it is worth.

use super::RATE_UNITS;
use crate::{
    KernelRates, ONE,
    kernel::{exp2_minus, one_minus_exp2_minus},
    rays::BUNDLE,
};
use kiln_core::FoliageMode;

/// Units of an optical depth, [`kiln_core::OpticalDepth`].
const DEPTH_UNITS: f32 = 65536.0;

/// Above this, half a unit of a ray's value is more than what is kept; a ray may end there, for whatever else it meets changes nothing.
pub(super) const ALL_LOST: u64 = 17 << 16;

/// A change on a ray's way.
#[derive(Clone, Copy, Debug)]
struct Event {
    ray: u32,
    /// Where, metres.
    t: f32,
    /// What a crossing loses.
    depth: u32,
    /// What the rate changes by, as fog begins or ends.
    rate: i64,
}

/// What the rays of a bundle lose.
#[derive(Debug)]
pub(crate) struct Lost {
    /// Nothing can be lost.
    is_off: bool,
    keeps_events: bool,
    /// Sum for each ray, where the order does not matter.
    depth: [u64; BUNDLE],
    /// What happens to each ray, where it does.
    events: Vec<Event>,
    /// Where the events of the next ray begin, once they are sorted.
    next: usize,
}

impl Lost {
    pub(crate) const NEW: Self =
        Self { is_off: true, keeps_events: false, depth: [0; BUNDLE], events: Vec::new(), next: 0 };

    /// Rays begin that go through nothing.
    pub(crate) fn start_without(&mut self) {
        self.is_off = true;
    }

    /// Rays begin that may lose something.
    pub(crate) fn start(&mut self, mode: FoliageMode) {
        self.is_off = false;
        self.keeps_events = mode == FoliageMode::Expected;
        self.depth = [0; BUNDLE];
        self.events.clear();
        self.next = 0;
    }

    /// A ray crosses a face. Returns whether it has lost all there was.
    #[inline(always)]
    pub(crate) fn cross(&mut self, ray: usize, t: f32, depth: u32) -> bool {
        if self.keeps_events {
            self.events.push(Event { ray: ray as u32, t, depth, rate: 0 });
            return false;
        }
        let sum = &mut self.depth[ray % BUNDLE];
        *sum += u64::from(depth);
        *sum > ALL_LOST
    }

    /// A ray goes through fog from one distance to another. Returns whether it has lost all there was.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a depth is positive, casts saturate")]
    #[inline(always)]
    pub(crate) fn go_through(&mut self, ray: usize, [near, far]: [f32; 2], rate: i64) -> bool {
        if self.keeps_events {
            self.events.push(Event { ray: ray as u32, t: near, depth: 0, rate });
            self.events.push(Event { ray: ray as u32, t: far, depth: 0, rate: -rate });
            return false;
        }
        let sum = &mut self.depth[ray % BUNDLE];
        *sum += ((far - near) * per_m(rate) * DEPTH_UNITS + 0.5) as u64;
        *sum > ALL_LOST
    }

    /// The sum of what a ray has lost, where the order does not matter.
    #[cfg(test)]
    pub(super) fn depth_of(&self, ray: usize) -> u64 {
        self.depth[ray]
    }

    /// Has to be called before values are asked for.
    pub(crate) fn finish(&mut self) {
        // At one distance the order of events changes nothing: whole numbers are added.
        self.events.sort_unstable_by_key(|event| (event.ray, event.t.to_bits()));
    }

    /// The value of each channel of a ray, which must be asked for in their order: `t` is the distance of its closest hit, if
    /// there is one.
    #[inline(always)]
    pub(crate) fn values(&mut self, ray: usize, kernel: &KernelRates, t: Option<f32>) -> [u32; 4] {
        let mut values = [0; 4];
        for (channel, value) in values.iter_mut().enumerate().take(kernel.channels) {
            *value = t.map_or(ONE, |t| kernel.hit_value(channel, t));
        }
        if self.is_off {
            return values;
        }
        if self.keeps_events {
            let (first, ray) = (self.next, ray as u32);
            while self.events.get(self.next).is_some_and(|event| event.ray == ray) {
                self.next += 1;
            }
            if first < self.next {
                let way = Way { events: &self.events[first..self.next], kernel, t };
                (0..kernel.channels).for_each(|channel| values[channel] = way.expected(channel));
            }
        } else if self.depth[ray % BUNDLE] > 0 {
            let kept = kept(self.depth[ray % BUNDLE] as f32 / DEPTH_UNITS);
            values.iter_mut().for_each(|value| *value = fixed(*value as f32 / ONE as f32 * kept));
        }
        values
    }
}

/// A ray that something happens to.
struct Way<'a> {
    /// By distance.
    events: &'a [Event],
    kernel: &'a KernelRates,
    /// The closest hit.
    t: Option<f32>,
}

impl Way<'_> {
    /// The expected value: `∫ ρ′ T dt` up to the closest hit; without one, up to the reach, and what a ray is worth that comes
    /// so far. All logarithms are binary: with ρ = 1 − 2^−λt and T = 2^−(D + s (t − a)) from a on, a stretch from a to b
    /// gives `λ / (λ + s) · 2^−(D + λ a) · (1 − 2^−(λ + s) (b − a))`.
    fn expected(&self, channel: usize) -> u32 {
        let rate_of_kernel = if self.kernel.is_occlusion { 0.0 } else { self.kernel.per_half_distance[channel] };
        let (mut sum, mut from, mut crossed, mut in_fog, mut rate) = (0.0f32, 0.0f32, 0u64, 0.0f32, 0i64);
        let end = self.t.unwrap_or(self.kernel.t_max);
        let ends = self.events.iter().map(|event| (event.t, event.depth, event.rate)).chain([(end, 0, 0)]);
        for (to, depth, change) in ends {
            let (length, per_m) = (to - from, per_m(rate));
            if length > 0.0 {
                let lost = crossed as f32 / DEPTH_UNITS + in_fog;
                let both = rate_of_kernel + per_m;
                if rate_of_kernel > 0.0 {
                    let absorbed = one_minus_exp2_minus(both * length);
                    sum += rate_of_kernel / both * kept(lost + rate_of_kernel * from) * absorbed;
                }
                in_fog += per_m * length;
                from = to;
            }
            crossed += u64::from(depth);
            rate += change;
        }
        if self.t.is_none() {
            sum += kept(crossed as f32 / DEPTH_UNITS + in_fog + rate_of_kernel * end);
        }
        fixed(sum)
    }
}

/// A rate of fog, binary logarithms for each metre.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "the ray path is f32")]
fn per_m(rate: i64) -> f32 {
    (rate as f64 / RATE_UNITS) as f32
}

/// 2 to the power of minus a depth.
#[inline(always)]
fn kept(depth: f32) -> f32 {
    exp2_minus(depth)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to [0, 65536]")]
#[inline(always)]
fn fixed(value: f32) -> u32 {
    (value * 65536.0 + 0.5).clamp(0.0, 65536.0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::Kernel;
    use proptest::prelude::*;

    fn rates(half_distances_m: &[f64]) -> KernelRates {
        KernelRates::new(&Kernel::Obscurance { half_distances_m: half_distances_m.to_vec() })
    }

    fn rate(per_m: f64) -> i64 {
        (per_m * std::f64::consts::LOG2_E * RATE_UNITS).round() as i64
    }

    /// By small steps, with the definition: each step absorbs its part.
    fn stepped(crossings: &[(f64, f64)], fog: &[(f64, f64, f64)], d: f64, hit: Option<f64>, reach: f64) -> f64 {
        let (end, steps) = (hit.unwrap_or(reach), 100_000);
        let rho = |t: f64| 1.0 - (-t / d).exp2();
        let (mut kept, mut value) = (1.0, 0.0);
        for step in 0..steps {
            let (a, b) = (end * f64::from(step) / f64::from(steps), end * f64::from(step + 1) / f64::from(steps));
            let here = |t: f64| t >= a && t < b;
            let depth: f64 = fog.iter().map(|(near, far, per_m)| (b.min(*far) - a.max(*near)).max(0.0) * per_m).sum();
            let crossed: f64 = crossings.iter().filter(|(t, _)| here(*t)).map(|(_, keep)| keep).product();
            let after = kept * (-depth).exp() * crossed;
            value += (kept - after) * rho(0.5 * (a + b));
            kept = after;
        }
        value + kept * hit.map_or(1.0, rho)
    }

    proptest! {
        #[test]
        fn the_expected_value_is_that_of_small_steps(
            crossings in prop::collection::vec((0.01f64..20.0, 0.0f64..1.0), 0..5),
            fog in prop::collection::vec((0.0f64..15.0, 0.01f64..5.0, 0.0f64..2.0), 0..4),
            hit in prop::option::of(0.5f64..20.0), d in 0.5f64..3.0,
        ) {
            let kernel = rates(&[d]);
            let end = hit.unwrap_or(f64::from(kernel.t_max));
            let mut lost = Lost::NEW;
            lost.start(FoliageMode::Expected);
            let crossings: Vec<_> = crossings.into_iter().filter(|(t, _)| *t < end).collect();
            let fog: Vec<_> = fog.into_iter().map(|(near, length, per_m)| (near, (near + length).min(end), per_m)).filter(|(near, far, _)| near < far).collect();
            for (t, keep) in &crossings {
                lost.cross(5, *t as f32, kiln_core::OpticalDepth::of_transmittance(*keep).0);
            }
            for (near, far, per_m) in &fog {
                lost.go_through(5, [*near as f32, *far as f32], rate(*per_m));
            }
            lost.finish();
            let value = lost.values(5, &kernel, hit.map(|t| t as f32))[0];
            let expected = stepped(&crossings, &fog, d, hit, end);
            prop_assert!((f64::from(value) / 65536.0 - expected).abs() < 3e-4, "{} {expected}", f64::from(value) / 65536.0);
        }

        /// Whatever order things are found in.
        #[test]
        fn order_changes_nothing(
            things in prop::collection::vec((0usize..4, 0.0f32..9.0, 0u32..200_000, 0i64..20_000_000), 1..20),
            swaps in prop::collection::vec(any::<prop::sample::Index>(), 20), expects in any::<bool>(),
        ) {
            let mode = if expects { FoliageMode::Expected } else { FoliageMode::Attenuate };
            let mut other = things.clone();
            for (at, with) in swaps.iter().enumerate() {
                let (a, b) = (at % things.len(), with.index(things.len()));
                other.swap(a, b);
            }
            let values = |things: &[(usize, f32, u32, i64)]| {
                let mut lost = Lost::NEW;
                lost.start(mode);
                for &(ray, t, depth, rate) in things {
                    if depth % 2 == 0 { lost.cross(ray, t, depth); } else { lost.go_through(ray, [t, t + 1.0], rate); }
                }
                lost.finish();
                [0, 1, 2, 3].map(|ray| lost.values(ray, &rates(&[2.0, 30.0]), Some(10.0)))
            };
            prop_assert_eq!(values(&things), values(&other));
        }
    }

    #[test]
    fn layers_keep_their_part() {
        for mode in [FoliageMode::Attenuate, FoliageMode::Expected] {
            let kernel = KernelRates::new(&Kernel::Occlusion { ray_distance_m: 100.0 });
            let mut lost = Lost::NEW;
            lost.start(mode);
            (0..3).for_each(|layer| {
                lost.cross(0, 1.0 + layer as f32, kiln_core::OpticalDepth::of_transmittance(0.5).0);
            });
            lost.finish();
            assert_eq!(lost.values(0, &kernel, None)[0], ONE / 8, "{mode:?}");
            lost.start_without();
            assert_eq!(lost.values(0, &kernel, None)[0], ONE);
        }
    }

    #[test]
    fn what_is_far_is_forgotten_where_rays_may_end() {
        // Behind a screen that keeps nothing, ten half-distances away.
        let value = |mode| {
            let mut lost = Lost::NEW;
            lost.start(mode);
            lost.cross(0, 9.9, kiln_core::OpticalDepth::of_transmittance(0.0).0);
            lost.finish();
            lost.values(0, &rates(&[1.0]), None)[0]
        };
        assert_eq!(value(FoliageMode::Attenuate), 0);
        assert!(value(FoliageMode::Expected) > 65_000);
    }
}
