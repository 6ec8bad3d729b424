//! Shrubs in sixteen bytes: a box of fog in world space, rounded.
//!
//! Whether a record can stand for a shrub, and for which box it then stands, follows from that shrub alone. So what a ray loses in
//! it does not depend on what else is there. All that traces, on every backend, traces the box that is unpacked:
//!
//! - its center on a lattice of 2⁻⁸ m: off by two millimetres at most along each axis;
//! - its axes as the three smaller components of a unit quaternion, 10 bits each, by steps of `1 / 511√2`: turned by less than
//!   3 mrad, and not at all where it stands straight;
//! - half its size along each axis, and its rate, as floats of 4 bits of exponent and 8 of mantissa: off by a 512th at
//!   most. The rate is for the rounded box: its volume times its rate, which is what it takes from rays of all places and
//!   directions together where it is thin, is off by a 512th, too.
//!
//! Boxes that no record can stand for (sheared by half a milliradian and more, very small or large, 65 km from the origin, very thin or dense fog)
//! keep all their bits.

use super::{RATE_UNITS, inside::InBox};
use crate::ray::TracedRay;
use glam::{DAffine3, DMat3, DQuat, DVec3, IVec3, Mat3, Quat, Vec3};
use kiln_core::Fog;

/// Steps of the lattice in a metre.
const STEPS_PER_M: f64 = 256.0;
pub(super) const STEP_M: f32 = 1.0 / 256.0;

/// Places are less than this many steps from the origin, so that they are exact in f32.
const MOST_STEPS: f64 = 16_777_215.0;

/// Codes of a component of a quaternion, from −1/√2 to 1/√2.
const HALF_CODES: i32 = 511;
const PER_CODE: f32 = std::f32::consts::FRAC_1_SQRT_2 / HALF_CODES as f32;

/// Exponents of the least half size, metres, and of the least rate, binary logarithms per metre.
pub(super) const LEAST_HALF: u32 = 127 - 6;
const LEAST_RATE: u32 = 127 - 10;

/// Cosines between the axes of a box up to here count as right angles.
const MOST_SHEAR: f64 = 5e-4;

/// A shrub without its place's upper bits: relative to the base of its group.
///
/// Words are: x and y in 16 bits each; z, half of its size along x in 12 bits, the lowest four bits of the rate; half of its
/// size along y and z, the other eight bits of the rate; the quaternion. The first of these is always in the lowest bits. `kiln-gpu`
/// unpacks them, too (`foliage.wgsl`): keep in sync.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ShrubRecord(pub [u32; 4]);

/// A shrub that a record can stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Shrub {
    /// Of the center, in steps of the lattice.
    pub(super) place: [i32; 3],
    /// Without the place.
    rest: ShrubRecord,
}

/// A box of fog as rays see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FogBox {
    /// Metres relative to the level's origin.
    pub center: Vec3,
    /// The directions of its sides, of unit length.
    pub axes: Mat3,
    /// Half its size along each, metres.
    pub half: Vec3,
    /// Binary logarithms of what is kept, for each metre, times 2²⁴.
    pub rate: i64,
}

impl Shrub {
    /// `None` where no record can stand for it.
    #[expect(clippy::cast_possible_truncation, reason = "rounded to a record's bits, which is checked")]
    pub(super) fn of(fog: &Fog, world_from_object: &DAffine3) -> Option<Self> {
        let m = world_from_object.matrix3;
        let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
        let scale = DVec3::new(x.length(), y.length(), z.length());
        let cosines = DVec3::new(y.dot(z), z.dot(x), x.dot(y)).abs();
        let products = DVec3::new(scale.y * scale.z, scale.z * scale.x, scale.x * scale.y);
        if !cosines.cmple(MOST_SHEAR * products).all() {
            return None;
        }
        let half = 0.5 * (fog.bounds.max - fog.bounds.min) * scale;
        let codes = [half.x, half.y, half.z].map(|size| small_float(size, LEAST_HALF));
        let [Some(a), Some(b), Some(c)] = codes else { return None };
        let rounded = [a, b, c].map(|code| f64::from(large_float(code, LEAST_HALF)));
        let rate = fog.density_per_m * std::f64::consts::LOG2_E;
        let rate = small_float(rate * (half / DVec3::from_array(rounded)).element_product(), LEAST_RATE)?;
        let place = world_from_object.transform_point3(fog.bounds.center()) * STEPS_PER_M;
        if !place.abs().cmplt(DVec3::splat(MOST_STEPS)).all() {
            return None;
        }
        // A box looks the same in a mirror.
        let side = m.determinant().signum();
        let turned = DQuat::from_mat3(&DMat3::from_cols(side * x / scale.x, y / scale.y, z / scale.z));
        let rest = ShrubRecord([0, a << 16 | (rate & 15) << 28, b | c << 12 | (rate >> 4) << 24, quaternion(turned)?]);
        Some(Self { place: place.round().to_array().map(|steps| steps as i32), rest })
    }

    /// As it is told in a group, whose base is at or below its place.
    pub(super) fn record(&self, base: [i32; 3]) -> ShrubRecord {
        let [x, y, z] = [0, 1, 2].map(|axis| self.place[axis].abs_diff(base[axis]) & 0xffff);
        let mut words = self.rest.0;
        words[0] |= x | y << 16;
        words[1] |= z;
        ShrubRecord(words)
    }

    /// Its box, wherever its group is.
    pub(super) fn unpacked(&self) -> FogBox {
        self.rest.unpacked(self.place)
    }
}

impl ShrubRecord {
    /// The box that it stands for, in a group with a base.
    #[inline(always)]
    pub fn unpacked(&self, base: [i32; 3]) -> FogBox {
        let [a, b, c, turn] = self.0;
        let steps = IVec3::new((a & 0xffff).cast_signed(), (a >> 16).cast_signed(), (b & 0xffff).cast_signed());
        let (x, y) = (large_float(b >> 16 & 0xfff, LEAST_HALF), large_float(c & 0xfff, LEAST_HALF));
        let half = Vec3::new(x, y, large_float(c >> 12 & 0xfff, LEAST_HALF));
        let rate = whole_rate(large_float((b >> 28) | (c >> 24 << 4), LEAST_RATE));
        let center = (IVec3::from_array(base) + steps).as_vec3() * STEP_M;
        FogBox { center, axes: Mat3::from_quat(unpacked_quaternion(turn)), half, rate }
    }
}

impl FogBox {
    pub(super) const NOTHING: Self = Self { center: Vec3::ZERO, axes: Mat3::ZERO, half: Vec3::ZERO, rate: 0 };

    /// Least and greatest corner of the box around it, grown by what rays are rounded by. A ray comes to it only where it comes to
    /// this box, too, in the arithmetic of [`crate::ray::narrow`]: boxes of nodes are unions of these, and so keep none from it.
    #[inline(always)]
    pub(super) fn bounds(&self) -> [Vec3; 2] {
        let axes = &self.axes;
        let reach = axes.x_axis.abs() * self.half.x + axes.y_axis.abs() * self.half.y + axes.z_axis.abs() * self.half.z;
        let reach = reach + (self.center.abs() + reach) * SLACK;
        [self.center - reach, self.center + reach]
    }

    /// The part of a ray up to `t_max` that is in it; `bounds` are its own.
    #[inline(always)]
    pub(super) fn part(&self, [min, max]: [Vec3; 2], ray: &TracedRay, t_max: f32) -> Option<[f32; 2]> {
        let around = InBox { min, max, t_max };
        if !around.is_entered(ray) {
            return None;
        }
        let (origin, direction) = (Vec3::from_array(ray.origin) - self.center, Vec3::from_array(ray.direction));
        let seen = TracedRay::new(along(&self.axes, origin), along(&self.axes, direction));
        InBox { min: -self.half, max: self.half, t_max }.part(&seen)
    }
}

/// Relative rounding of a box's corners and of rays in its space.
const SLACK: f32 = 16.0 / 16_777_216.0;

/// The coordinates of a vector along axes.
#[inline(always)]
fn along(axes: &Mat3, v: Vec3) -> Vec3 {
    Vec3::new(axes.x_axis.dot(v), axes.y_axis.dot(v), axes.z_axis.dot(v))
}

/// A rate as a whole number, which it is.
#[expect(clippy::cast_possible_truncation, reason = "below 2³⁰")]
#[inline(always)]
fn whole_rate(per_m: f32) -> i64 {
    (f64::from(per_m) * RATE_UNITS) as i64
}

/// Nearest float of 12 bits, from an exponent on; `None` where it has none.
#[expect(clippy::cast_possible_truncation, reason = "floats beyond f32 have no code")]
fn small_float(x: f64, least_exponent: u32) -> Option<u32> {
    let least = f64::from(f32::from_bits(least_exponent << 23));
    if !(least..65536.0 * least).contains(&x) {
        return None;
    }
    let bits = (x as f32).to_bits() + (1 << 14);
    Some((bits >> 15) - (least_exponent << 8)).filter(|code| *code < 1 << 12)
}

/// A float of 12 bits.
#[inline(always)]
pub(super) fn large_float(code: u32, least_exponent: u32) -> f32 {
    f32::from_bits((code << 15) + (least_exponent << 23))
}

/// The greatest component's index in the upper two bits, and the others, in their order: of all ways to round them the one that
/// turns least.
fn quaternion(turn: DQuat) -> Option<u32> {
    let turn = turn.normalize();
    let parts = turn.to_array();
    if !parts.iter().all(|part| part.is_finite()) {
        return None;
    }
    let greatest = (0..4).max_by(|&a, &b| parts[a].abs().total_cmp(&parts[b].abs())).unwrap_or(3);
    let codes = |up: u32| {
        let others = (0..4).filter(|&i| i != greatest).zip(0..3);
        others.fold((greatest as u32) << 30, |word, (i, at)| {
            let code = code(parts[i] * parts[greatest].signum(), up >> at & 1 == 1);
            word | code << (10 * at)
        })
    };
    let off = |word: &u32| 1.0 - unpacked_quaternion(*word).as_dquat().dot(turn).abs();
    (0..8).map(codes).min_by(|a, b| off(a).total_cmp(&off(b)))
}

/// Code of a component of a quaternion at or above it, or below.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to codes")]
fn code(part: f64, up: bool) -> u32 {
    let steps = part / f64::from(PER_CODE);
    let steps = if up { steps.ceil() } else { steps.floor() } as i32;
    (steps.clamp(-HALF_CODES, HALF_CODES) + HALF_CODES) as u32
}

#[inline(always)]
fn unpacked_quaternion(word: u32) -> Quat {
    let codes = IVec3::new(
        (word & 0x3ff).cast_signed(),
        (word >> 10 & 0x3ff).cast_signed(),
        (word >> 20 & 0x3ff).cast_signed(),
    );
    let (a, b, c) = ((codes - HALF_CODES).as_vec3() * PER_CODE).into();
    let rest = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
    match word >> 30 {
        0 => Quat::from_xyzw(rest, a, b, c),
        1 => Quat::from_xyzw(a, rest, b, c),
        2 => Quat::from_xyzw(a, b, rest, c),
        _ => Quat::from_xyzw(a, b, c, rest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::Bounds;
    use proptest::prelude::*;

    fn fog(center: DVec3, half: DVec3, density_per_m: f64) -> Fog {
        Fog { bounds: Bounds { min: center - half, max: center + half }, density_per_m }
    }

    fn three(range: std::ops::Range<f64>) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(range).prop_map(DVec3::from_array)
    }

    fn turn() -> impl Strategy<Value = DQuat> {
        prop::array::uniform4(-1.0f64..1.0)
            .prop_map(DQuat::from_array)
            .prop_filter("no direction", |q| q.length() > 0.1)
            .prop_map(DQuat::normalize)
    }

    proptest! {
        /// What is said at the head of the file.
        #[test]
        fn boxes_are_off_by_little(
            center in three(-2.0..2.0), half in three(0.05..5.0), density in 0.01f64..4.0,
            scale in prop::array::uniform3(prop_oneof![0.4f64..3.0, -3.0..-0.4]), turn in turn(), translation in three(-5000.0..5000.0),
        ) {
            let scale = DVec3::from_array(scale);
            let place = DAffine3::from_scale_rotation_translation(scale, turn, translation);
            let shrub = Shrub::of(&fog(center, half, density), &place).expect("a record has room");
            let found = shrub.unpacked();
            let expected = place.transform_point3(center);
            prop_assert!((found.center.as_dvec3() - expected).abs().max_element() <= 0.5 / STEPS_PER_M + 1e-9);
            let sizes = half * scale.abs();
            prop_assert!(((found.half.as_dvec3() - sizes) / sizes).abs().max_element() <= 1.0 / 512.0 + 1e-6);
            for (axis, side) in [DVec3::X, DVec3::Y, DVec3::Z].iter().enumerate() {
                let sine = (turn * *side).cross(found.axes.col(axis).as_dvec3()).length();
                prop_assert!(sine < 3e-3, "{sine}");
                prop_assert!((found.axes.col(axis).length() - 1.0).abs() < 1e-6);
            }
            let rate = density * std::f64::consts::LOG2_E * RATE_UNITS * sizes.element_product();
            let mass = found.rate as f64 * found.half.as_dvec3().element_product();
            prop_assert!((mass / rate - 1.0).abs() <= 1.0 / 512.0 + 1e-6);

            let base = shrub.place.map(|steps| steps - 12_345);
            prop_assert_eq!(shrub.record(base).unpacked(base), found);
        }

        /// The box around it keeps no ray from it.
        #[test]
        fn what_comes_to_a_box_comes_to_the_box_around_it(
            half in three(0.02..3.0), turn in turn(), origin in three(-1.0..1.0), direction in turn(), t in 0.0f64..50.0,
        ) {
            let place = DAffine3::from_rotation_translation(turn, DVec3::new(300.0, -20.0, 40.0));
            let shrub = Shrub::of(&fog(DVec3::ZERO, half, 1.0), &place).expect("a record has room").unpacked();
            let direction = direction * DVec3::X;
            let inside = shrub.center.as_dvec3() + shrub.axes.as_dmat3() * (0.99 * origin * shrub.half.as_dvec3());
            let ray = TracedRay::new((inside - t * direction).as_vec3(), direction.as_vec3());
            let part = shrub.part(shrub.bounds(), &ray, f32::MAX);
            prop_assert!(part.is_some_and(|[near, far]| f64::from(near) < t + 1e-3 && f64::from(far) > t - 1e-3));
        }
    }

    #[test]
    fn what_stands_straight_is_not_turned() {
        for quarters in 0..4 {
            let turn = DQuat::from_rotation_y(f64::from(quarters) * std::f64::consts::FRAC_PI_2);
            let place = DAffine3::from_rotation_translation(turn, DVec3::new(2.0, 0.5, -1.0));
            let found =
                Shrub::of(&fog(DVec3::ZERO, DVec3::new(1.0, 2.0, 0.5), 0.5), &place).expect("a record").unpacked();
            let expected = Mat3::from_quat(turn.as_quat());
            assert!((0..3).all(|i| found.axes.col(i).abs_diff_eq(expected.col(i), 1e-6)), "{found:?}");
            assert_eq!((found.half, found.center), (Vec3::new(1.0, 2.0, 0.5), Vec3::new(2.0, 0.5, -1.0)));
        }
    }

    #[test]
    fn what_no_record_can_stand_for_has_none() {
        let is_packed =
            |half: DVec3, density: f64, place: DAffine3| Shrub::of(&fog(DVec3::ZERO, half, density), &place).is_some();
        let still = DAffine3::IDENTITY;
        assert!(is_packed(DVec3::ONE, 0.5, still));
        for (half, density) in [
            (DVec3::new(1.0, 0.01, 1.0), 0.5),
            (DVec3::new(1024.0, 1.0, 1.0), 0.5),
            // Rounded up to what is no more there.
            (DVec3::new(1023.999, 1.0, 1.0), 0.5),
            (DVec3::new(1.0, 0.0, 1.0), 0.5),
            (DVec3::new(1.0, f64::NAN, 1.0), 0.5),
            (DVec3::ONE, 0.0),
            (DVec3::ONE, -1.0),
            (DVec3::ONE, 1e-4),
            (DVec3::ONE, 64.0),
            (DVec3::ONE, f64::INFINITY),
            (DVec3::ONE, f64::NAN),
        ] {
            assert!(!is_packed(half, density, still), "{half} {density}");
        }
        let sheared = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.1, 1.0, 0.0), DVec3::Z));
        let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
        let nowhere = DVec3::AXES
            .map(|axis| DAffine3::from_translation(DVec3::select(axis.cmpgt(DVec3::ZERO), DVec3::NAN, DVec3::ZERO)));
        let far = [DVec3::X * 66e3, DVec3::NEG_Z * 1e300, DVec3::new(f64::INFINITY, 0.0, 0.0)]
            .map(DAffine3::from_translation);
        for place in [sheared, flat].into_iter().chain(nowhere).chain(far) {
            assert!(!is_packed(DVec3::ONE, 0.5, place), "{place:?}");
        }
        assert!(is_packed(DVec3::ONE, 0.5, DAffine3::from_translation(DVec3::X * 65e3)));
    }
}
