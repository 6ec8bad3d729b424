//! Where voxels are: a lattice that is fixed in the level.

use super::VolumeError;
use glam::DVec3;
use kiln_core::Bounds;

/// Voxel (0, 0, 0) lies this far from the level's origin along each axis, in units of the spacing: the smaller part of the
/// golden section. Levels are built to round numbers; a lattice that has floors and walls among its points would start
/// rays in surfaces, which see both sides or neither.
pub const LATTICE_OFFSET: f64 = 0.381_966_011_250_105_1;

/// The greatest coordinate of a voxel, and less its sign the least: there, f32 moves a ray's origin by at most 1/32 of the spacing.
pub const MAX_COORDINATE: i32 = 1 << 20;

/// A lattice with a voxel at `(coordinates + LATTICE_OFFSET) · spacing`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lattice {
    /// Metres, above 0.
    pub(crate) spacing_m: f64,
}

/// The eight voxels that a point is interpolated from: those from `base` to `base + 1` along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stencil {
    base: [i32; 3],
    /// Where the point is between them, each in [0, 1).
    fraction: DVec3,
}

impl Lattice {
    pub(crate) fn new(spacing_m: f64) -> Result<Self, VolumeError> {
        // What is left of an overflow or underflow would not be a lattice.
        let is_length = spacing_m.is_normal() && spacing_m > 0.0 && (spacing_m * f64::from(MAX_COORDINATE)).is_finite();
        if is_length { Ok(Self { spacing_m }) } else { Err(VolumeError::Spacing { spacing_m }) }
    }

    /// Metres relative to the level's origin.
    pub(crate) fn position(self, voxel: [i32; 3]) -> DVec3 {
        (DVec3::from_array(voxel.map(f64::from)) + LATTICE_OFFSET) * self.spacing_m
    }

    /// In units of the lattice. Division, subtraction and rounding are monotonic: a point between two others does not lie
    /// outside of their voxels.
    fn coordinates(self, point: DVec3) -> DVec3 {
        point / self.spacing_m - LATTICE_OFFSET
    }

    /// `None` for a point so far away that it has none, or that is not finite.
    pub(crate) fn stencil(self, point: DVec3) -> Option<Stencil> {
        let at = self.coordinates(point);
        let base = at.floor();
        is_in_range(base).then(|| Stencil { base: integers(base), fraction: at - base })
    }

    /// Least and greatest coordinates of the voxels that the stencils of a box's points have; `None` for an empty box.
    pub(crate) fn span(self, bounds: &Bounds) -> Result<Option<[[i32; 3]; 2]>, VolumeError> {
        if bounds.is_empty() {
            return Ok(None);
        }
        let [min, max] = [bounds.min, bounds.max].map(|corner| self.coordinates(corner).floor());
        if !(is_in_range(min) && is_in_range(max)) {
            let limit_m = self.spacing_m * f64::from(MAX_COORDINATE);
            let (min_m, max_m, spacing_m) = (bounds.min, bounds.max, self.spacing_m);
            return Err(VolumeError::OutOfRange { min_m, max_m, spacing_m, limit_m });
        }
        Ok(Some([integers(min), integers(max).map(|x| x + 1)]))
    }
}

impl Stencil {
    /// The voxels and their weights, which sum to 1, in a fixed order.
    pub(crate) fn corners(&self) -> impl Iterator<Item = ([i32; 3], f64)> {
        let Self { base, fraction } = *self;
        (0..8).map(move |corner| {
            let is_upper = [0, 1, 2].map(|axis| corner >> axis & 1 == 1);
            let voxel = std::array::from_fn(|axis| base[axis] + i32::from(is_upper[axis]));
            let along = |axis: usize| if is_upper[axis] { fraction[axis] } else { 1.0 - fraction[axis] };
            (voxel, along(0) * along(1) * along(2))
        })
    }
}

/// Whether both voxels along each axis are in range. Not for NaN.
fn is_in_range(base: DVec3) -> bool {
    let limit = f64::from(MAX_COORDINATE);
    base.cmpge(DVec3::splat(-limit)).all() && base.cmplt(DVec3::splat(limit)).all()
}

#[expect(clippy::cast_possible_truncation, reason = "the caller has seen to the range")]
fn integers(at: DVec3) -> [i32; 3] {
    at.to_array().map(|x| x as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn weights_find_the_point_again(point in prop::array::uniform3(-500f64..500.0), spacing in 0.1f64..5.0) {
            let (point, lattice) = (DVec3::from_array(point), Lattice::new(spacing).unwrap());
            let corners: Vec<_> = lattice.stencil(point).unwrap().corners().collect();
            let total: f64 = corners.iter().map(|(_, weight)| weight).sum();
            let mean: DVec3 = corners.iter().map(|(voxel, weight)| lattice.position(*voxel) * *weight).sum();
            prop_assert!((total - 1.0).abs() < 1e-12 && (mean - point).length() < 1e-9, "{total} {mean}");
            prop_assert!(corners.iter().all(|(_, weight)| (0.0..=1.0).contains(weight)));
        }
    }

    #[test]
    fn lengths_and_places_are_checked() {
        for spacing in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-310, 1e305] {
            assert!(matches!(Lattice::new(spacing), Err(VolumeError::Spacing { .. })), "{spacing}");
        }
        let lattice = Lattice::new(2.0).unwrap();
        let far = DVec3::new(0.0, 3.0 * f64::from(MAX_COORDINATE), 0.0);
        for point in [far, -far, DVec3::NAN, DVec3::INFINITY] {
            assert_eq!(lattice.stencil(point), None);
        }
        assert_eq!(lattice.span(&Bounds::EMPTY).unwrap(), None);
        let bounds = Bounds { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY };
        assert!(matches!(lattice.span(&bounds), Err(VolumeError::OutOfRange { .. })));
    }
}
