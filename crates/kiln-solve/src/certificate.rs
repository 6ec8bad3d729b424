//! What every answer must show before it is used, whatever solver it comes from.

use crate::{
    columns::{ForColumns, for_columns},
    system::ComponentSystem,
};

/// The greatest `|r_i| / A_ii` that an answer may have. A norm over all unknowns would hide small components.
pub const RESIDUAL_LIMIT: f64 = 1.0 / 4096.0;

/// What rounding may take from the descent, as a fraction of the sum of its terms without their signs.
const ROUNDING: f64 = 1e-12;

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
    pub fn new(system: &ComponentSystem<'_>, correction: &[f64]) -> Self {
        Self::with_room(system, correction, &mut Vec::new())
    }

    /// [`Self::new`] with room for the residual that can be used again.
    pub(crate) fn with_room(system: &ComponentSystem<'_>, correction: &[f64], room: &mut Vec<f64>) -> Self {
        room.clear();
        room.extend_from_slice(&system.rhs);
        system.matrix.subtract_product(system.columns, correction, room);
        Self::of_residual(system, correction, room)
    }

    /// The certificate of corrections whose residual `r0 − A δ`, formed in f64 from the matrix, is known.
    pub(crate) fn of_residual(system: &ComponentSystem<'_>, correction: &[f64], r: &[f64]) -> Self {
        let work = Facts { system, correction, r };
        for_columns(system.columns, work).unwrap_or(Self { finite: false, residual: f64::NAN, descends: false })
    }

    /// Whether the answer may be used.
    pub fn holds(&self) -> bool {
        self.finite && self.residual <= RESIDUAL_LIMIT && self.descends
    }
}

struct Facts<'a> {
    system: &'a ComponentSystem<'a>,
    correction: &'a [f64],
    r: &'a [f64],
}

impl ForColumns for Facts<'_> {
    type Output = Certificate;

    fn run<const K: usize>(self) -> Certificate {
        let matrix = &*self.system.matrix;
        let (x, b, r) =
            (self.correction.as_chunks::<K>().0, self.system.rhs.as_chunks::<K>().0, self.r.as_chunks::<K>().0);
        let mut residual = 0.0f64;
        let (mut gain, mut magnitude) = ([0.0; K], [0.0; K]);
        for (i, ((x, b), r)) in x.iter().zip(b).zip(r).enumerate() {
            let diagonal = matrix.diagonal(i);
            for c in 0..K {
                // Not `max`, which would drop what is not a number.
                let ratio = (r[c] / diagonal).abs();
                residual = if ratio > residual || ratio.is_nan() { ratio } else { residual };
                let term = x[c] * (b[c] + r[c]);
                gain[c] += term;
                magnitude[c] += term.abs();
            }
        }
        let finite = self.correction.iter().all(|x| x.is_finite());
        let descends = gain.iter().zip(&magnitude).all(|(gain, magnitude)| *gain >= -ROUNDING * magnitude);
        Certificate { finite, residual, descends }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::LowerCsc;
    use std::borrow::Cow;

    fn system() -> ComponentSystem<'static> {
        let matrix = LowerCsc { column_start: vec![0, 2, 3], row: vec![0, 1, 1], value: vec![4.0, 2.0, 3.0] };
        ComponentSystem {
            matrix: Cow::Owned(matrix),
            anchor: Cow::Owned(vec![0.0; 2]),
            rhs: Cow::Owned(vec![10.0, 9.0]),
            columns: 1,
            hole_ring: Cow::Owned(vec![0; 2]),
        }
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
    fn what_is_not_finite_in_the_system_does_not_hold() {
        let mut bad = system();
        bad.rhs.to_mut()[0] = f64::NAN;
        let certificate = Certificate::new(&bad, &[1.5, 2.0]);
        assert!(certificate.residual.is_nan() && !certificate.holds(), "{certificate:?}");
    }

    #[test]
    fn what_is_not_finite_does_not_hold() {
        for bad in [f64::NAN, f64::INFINITY] {
            let certificate = Certificate::new(&system(), &[bad, 2.0]);
            assert!(!certificate.finite && !certificate.holds(), "{certificate:?}");
        }
    }
}
