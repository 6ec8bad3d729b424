//! What every answer must show before it is used, whatever solver it comes from.

use crate::system::ComponentSystem;

/// The greatest `|r_i| / A_ii` that an answer may have. A norm over all unknowns would hide small components.
pub const RESIDUAL_LIMIT: f64 = 1.0 / 4096.0;

/// The facts about an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certificate {
    /// Every correction is finite.
    pub finite: bool,
    /// Greatest `|r_i| / A_ii` over unknowns and columns.
    pub residual: f64,
    /// For no column is the energy above that of the local averages, but for rounding.
    pub descends: bool,
}

impl Certificate {
    /// Checks corrections against the system that they should solve.
    ///
    /// The energy is `½ δᵀ A δ − δᵀ r0`, 0 at the averages; with the answer's own residual r it is
    /// `−½ δᵀ (r0 + r)`, which needs no difference of large numbers.
    pub fn new(system: &ComponentSystem, correction: &[f64]) -> Self {
        let columns = system.columns;
        let finite = correction.iter().all(|x| x.is_finite());
        let r = system.matrix.residual(columns, correction, &system.rhs);
        let mut residual = 0.0f64;
        let mut gain = vec![0.0; columns];
        let mut magnitude = vec![0.0; columns];
        for i in 0..system.len() {
            let diagonal = system.matrix.diagonal(i);
            for c in 0..columns {
                let at = i * columns + c;
                // Not `max`, which would drop what is not a number.
                let ratio = (r[at] / diagonal).abs();
                residual = if ratio <= residual { residual } else { ratio };
                let term = correction[at] * (system.rhs[at] + r[at]);
                gain[c] += term;
                magnitude[c] += term.abs();
            }
        }
        let rounding = 1e-12;
        let descends = gain.iter().zip(&magnitude).all(|(gain, magnitude)| *gain >= -rounding * magnitude);
        Self { finite, residual, descends }
    }

    /// Whether the answer may be used.
    pub fn holds(&self) -> bool {
        self.finite && self.residual <= RESIDUAL_LIMIT && self.descends
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::LowerCsc;

    fn system() -> ComponentSystem {
        let matrix = LowerCsc { column_start: vec![0, 2, 3], row: vec![0, 1, 1], value: vec![4.0, 2.0, 3.0] };
        ComponentSystem { matrix, anchor: vec![0.0; 2], rhs: vec![10.0, 9.0], columns: 1, hole_depth: 0 }
    }

    #[test]
    fn the_solution_holds() {
        let certificate = Certificate::new(&system(), &[1.5, 2.0]);
        assert_eq!(certificate, Certificate { finite: true, residual: 0.0, descends: true });
        assert!(certificate.holds());
    }

    #[test]
    fn the_averages_themselves_do_not_hold_but_do_not_ascend() {
        let certificate = Certificate::new(&system(), &[0.0, 0.0]);
        assert!(certificate.descends && certificate.residual == 3.0 && !certificate.holds());
    }

    #[test]
    fn overshooting_by_more_than_twice_ascends() {
        assert!(Certificate::new(&system(), &[2.9, 3.9]).descends);
        assert!(!Certificate::new(&system(), &[3.1, 4.1]).descends);
    }

    #[test]
    fn what_is_not_finite_does_not_hold() {
        for bad in [f64::NAN, f64::INFINITY] {
            let certificate = Certificate::new(&system(), &[bad, 2.0]);
            assert!(!certificate.finite && !certificate.holds(), "{certificate:?}");
        }
    }
}
