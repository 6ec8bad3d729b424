//! The freedom of scale between L and y: `(s L)(y / s)` is the same for every s.
//!
//! Of all scales the one is taken at which the penalty is least, that is the one nearest to the model's own AO:
//! `s = L·K L0 / L·K L`. Errors do not change but by rounding, so the objective falls with the penalty. Alternation alone would come there
//! too, but by a narrow valley, in many rounds. Without any penalty the scale stays where alternation leaves it.

use super::{channel::ChannelState, fit::INNER_BOUND};

impl ChannelState<'_> {
    /// Takes the best scale that leaves L in [0, 1] and every y within its bound.
    #[expect(clippy::cast_possible_truncation, reason = "f32 is the precision of the values")]
    pub(crate) fn step_scale(&mut self) {
        let Some(scale) = self.best_scale() else { return };
        let local = self.local.iter().map(|local| f64::from((scale * local).min(1.0) as f32)).collect();
        let globals: Vec<_> = self.globals().iter().map(|y| y.map(|y| (f64::from(y) / scale) as f32)).collect();
        self.accept(local, &globals);
    }

    fn best_scale(&self) -> Option<f64> {
        let greatest = self.local.iter().fold(0.0, |max: f64, local| max.max(*local));
        let size = |y: &[f32; 4]| y.iter().map(|y| f64::from(y.abs())).sum::<f64>();
        let steepest = self.fits.iter().map(|fit| size(&fit.y)).fold(0.0, f64::max);
        let (least, most) = (steepest / INNER_BOUND, 1.0 / greatest);
        let best = self.penalty_product(&self.local, &self.start) / self.penalty_product(&self.local, &self.local);
        let usable = best.is_finite() && best > 0.0 && least <= most && greatest > 0.0;
        usable.then(|| best.clamp(least, most)).filter(|scale| *scale > 0.0 && *scale != 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::{
        alternate::AlternateParams,
        channel::{Signal, tests::sheet},
        unknowns::ModelUnknowns,
    };

    #[test]
    fn the_scale_goes_back_to_that_of_the_start() {
        let (mesh, samples) = sheet();
        let params = AlternateParams::default();
        let unknowns = ModelUnknowns::new(&mesh, &samples, &params);
        let values = vec![0.25; samples.len()];
        let signals = vec![Signal { values: &values, channels: 1, channel: 0 }];
        let start: Vec<f64> = (0..25).map(|v| 0.25 + 0.5 * f64::from(v % 2)).collect();
        let mut state = ChannelState::new(&samples, &unknowns, signals, start.clone(), &params);
        let (good, y) = (state.step(), state.globals());
        // Powers of two change no error, so what was left is found again to the bit.
        state.local.iter_mut().chain(&mut state.at_samples).for_each(|local| *local *= 0.5);
        state.fits.iter_mut().for_each(|fit| fit.y = fit.y.map(|y| 2.0 * y));
        assert!(state.step().objective > good.objective);
        state.step_scale();
        assert_eq!((&state.local, state.step().objective), (&start, good.objective));
        assert_eq!(state.globals(), y);
    }
}
