//! A logarithmic axis: its range and its ticks.

/// Ticks are at most a factor of 2.5 apart: a range of 1.6² has one.
const HALF_WIDTH: f64 = 1.6;

/// A range of positive numbers on a logarithmic axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axis {
    low: f64,
    high: f64,
}

impl Axis {
    /// Holds all the values, with a little room; wide enough for a tick.
    pub(crate) fn around(values: impl Iterator<Item = f64>) -> Option<Self> {
        let usable = values.filter(|v| v.is_finite() && *v > 0.0);
        let (low, high) = usable.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), v| (low.min(v), high.max(v)));
        if high == 0.0 {
            return None;
        }
        let room = (high / low).powf(0.06).max(1.1);
        let middle = (low * high).sqrt();
        Some(Self { low: (low / room).min(middle / HALF_WIDTH), high: (high * room).max(middle * HALF_WIDTH) })
    }

    /// Where a value lies, from 0 to 1.
    pub(crate) fn place(&self, value: f64) -> f64 {
        (value / self.low).ln() / (self.high / self.low).ln()
    }

    /// Values to mark: 1, 2 and 5 in each decade, or the decades alone where those would be too many.
    pub(crate) fn ticks(&self) -> Vec<f64> {
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let all = |steps: &[f64]| -> Vec<f64> {
            let decades = (first..=last).flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
            decades.filter(|value| (self.low..=self.high).contains(value)).collect()
        };
        let fine = all(&[1.0, 2.0, 5.0]);
        if fine.len() > 7 { all(&[1.0]) } else { fine }
    }
}

/// A tick's label: as many decimals as it needs.
pub(crate) fn label(value: f64) -> String {
    let decimals = (-value.log10().floor()).max(0.0) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        let axis = Axis::around([0.004, 0.07].into_iter()).unwrap();
        let labels: Vec<String> = axis.ticks().into_iter().map(label).collect();
        assert_eq!(labels, ["0.005", "0.01", "0.02", "0.05"]);
        let wide = Axis::around([1e-3, 1e3].into_iter()).unwrap();
        assert_eq!(wide.ticks().len(), 7);
        assert!(axis.place(0.004) > 0.0 && axis.place(0.07) < 1.0);
        assert_eq!(Axis::around([0.0, f64::NAN].into_iter()), None);
    }

    #[test]
    fn one_value_still_has_an_axis() {
        let axis = Axis::around([3.0].into_iter()).unwrap();
        assert!((axis.place(3.0) - 0.5).abs() < 1e-9 && !axis.ticks().is_empty());
    }
}
