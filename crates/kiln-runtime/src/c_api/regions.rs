//! Moving objects.

use super::{KILN_NONE, KilnPack, KilnStatus, floats, give, opened, optional, slice, status};
use crate::{MovingObject, TemporalBlend, ao_linear, ao_quadratic};

/// A visibility region.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KilnRegion {
    /// Its box's lowest corner.
    pub min: [f32; 3],
    /// Its box's highest corner.
    pub max: [f32; 3],
    /// Index of its model.
    pub model: u32,
}

/// What an engine keeps for a moving object. Begin with kiln_moving_object_new.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KilnMovingObject {
    /// Linear coefficients of AO as last shown.
    pub coefficients: [f32; 4],
    /// Region that it was in last, or KILN_NONE.
    pub region: u32,
    /// 0 before it is shown for the first time.
    pub is_shown: u32,
}

/// A region by its index.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `region` to a KilnRegion.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_region(pack: *const KilnPack, index: u32, region: *mut KilnRegion) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let found = unsafe { opened(pack) }?.region(index).ok_or(KilnStatus::NotFound)?;
        // SAFETY: the caller's promise.
        unsafe { give(region, KilnRegion { min: found.min, max: found.max, model: found.model }) }
    })
}

/// The index of the region that the level's author calls so: UTF-8, `length` bytes. Looks at all regions.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `id` to `length` bytes, `index` to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_region_with_id(
    pack: *const KilnPack,
    id: *const u8,
    length: usize,
    index: *mut u32,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let (pack, id) = unsafe { (opened(pack)?, slice(id, length)?) };
        let id = core::str::from_utf8(id).map_err(|_| KilnStatus::NotFound)?;
        // SAFETY: the caller's promise.
        unsafe { give(index, pack.region_with_id(id).ok_or(KilnStatus::NotFound)?) }
    })
}

/// The region of a point (three floats): the smallest box that contains it, else the nearest. `hint` is the region it was in
/// before, or KILN_NONE. `distance` is that from the box, 0 within; it may be null.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `point` to three floats, `region` to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_region_at(
    pack: *const KilnPack,
    point: *const f32,
    hint: u32,
    region: *mut u32,
    distance: *mut f32,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let (pack, point) = unsafe { (opened(pack)?, floats(point)?) };
        let hit = pack.region_at(point, optional(hint)).ok_or(KilnStatus::NoRegion)?;
        if !distance.is_null() {
            // SAFETY: the caller's promise.
            unsafe { give(distance, hit.distance_m) }?;
        }
        // SAFETY: the caller's promise.
        unsafe { give(region, hit.region) }
    })
}

/// Four linear coefficients of the blended AO in a region, at the point (three floats) of its box that is nearest.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `point` to three floats, `coefficients` to four.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_region_engine(
    pack: *const KilnPack,
    region: u32,
    point: *const f32,
    coefficients: *mut f32,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let (pack, point) = unsafe { (opened(pack)?, floats(point)?) };
        let found = pack.engine_at(region, point).ok_or(KilnStatus::NotFound)?;
        // SAFETY: the caller's promise.
        unsafe { give(coefficients.cast(), found) }
    })
}

/// Nine quadratic coefficients of a channel's AO in a region, at the point (three floats) of its box that is nearest.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `point` to three floats, `coefficients` to nine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_region_full(
    pack: *const KilnPack,
    region: u32,
    channel: u32,
    point: *const f32,
    coefficients: *mut f32,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let (pack, point) = unsafe { (opened(pack)?, floats(point)?) };
        let found = pack.full_at(region, point, channel as usize).ok_or(KilnStatus::NotFound)?;
        // SAFETY: the caller's promise.
        unsafe { give(coefficients.cast(), found) }
    })
}

/// AO for a unit normal (three floats) from four linear coefficients. 0 where a pointer is null.
///
/// # Safety
/// `coefficients` points to four floats, `normal` to three.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_ao_linear(coefficients: *const f32, normal: *const f32) -> f32 {
    // SAFETY: the caller's promise.
    let given = unsafe { (floats(coefficients), floats(normal)) };
    if let (Ok(coefficients), Ok(normal)) = given { ao_linear(coefficients, normal) } else { 0.0 }
}

/// AO for a unit normal (three floats) from nine quadratic coefficients. 0 where a pointer is null.
///
/// # Safety
/// `coefficients` points to nine floats, `normal` to three.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_ao_quadratic(coefficients: *const f32, normal: *const f32) -> f32 {
    // SAFETY: the caller's promise.
    let given = unsafe { (floats(coefficients), floats(normal)) };
    if let (Ok(coefficients), Ok(normal)) = given { ao_quadratic(coefficients, normal) } else { 0.0 }
}

/// Weight of the present after `dt_secs`: 1 − 2^(−dt / half-time). 0.1 s is what Kiln suggests; 0 for no blending.
#[unsafe(no_mangle)]
pub extern "C" fn kiln_temporal_weight(dt_secs: f32, half_time_secs: f32) -> f32 {
    TemporalBlend { half_time_secs }.weight(dt_secs)
}

/// Draws `count` coefficients as shown before towards those of now, in place.
///
/// # Safety
/// `shown` and `now` point to `count` floats each, which do not overlap.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_temporal_blend(
    shown: *mut f32,
    now: *const f32,
    count: usize,
    dt_secs: f32,
    half_time_secs: f32,
) -> KilnStatus {
    status(|| {
        if shown.is_null() || now.is_null() {
            return Err(KilnStatus::NullPointer);
        }
        // SAFETY: neither is null, and the caller's promise.
        let (shown, now) =
            unsafe { (core::slice::from_raw_parts_mut(shown, count), core::slice::from_raw_parts(now, count)) };
        let blend = TemporalBlend { half_time_secs };
        for (shown, now) in shown.iter_mut().zip(now) {
            [*shown] = blend.blend([*shown], [*now], dt_secs);
        }
        Ok(())
    })
}

/// An object that appears: it gets its first value at once.
#[unsafe(no_mangle)]
pub extern "C" fn kiln_moving_object_new() -> KilnMovingObject {
    KilnMovingObject { coefficients: [0.0; 4], region: KILN_NONE, is_shown: 0 }
}

/// Moves an object to a point (three floats), `dt_secs` after the last call: finds its region, evaluates the model there, and
/// blends. Its coefficients then are what to show. Nothing changes where the status is not KILN_STATUS_OK.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `object` to a KilnMovingObject, `point` to three floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_moving_object_update(
    pack: *const KilnPack,
    object: *mut KilnMovingObject,
    point: *const f32,
    dt_secs: f32,
    half_time_secs: f32,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let (pack, point) = unsafe { (opened(pack)?, floats(point)?) };
        // SAFETY: the caller's promise.
        let object = unsafe { object.as_mut() }.ok_or(KilnStatus::NullPointer)?;
        let mut moving =
            MovingObject::resume(optional(object.region), (object.is_shown != 0).then_some(object.coefficients));
        let blend = TemporalBlend { half_time_secs };
        let coefficients = moving.update(pack, point, dt_secs, blend).ok_or(KilnStatus::NoRegion)?;
        *object = KilnMovingObject { coefficients, region: moving.region().unwrap_or(KILN_NONE), is_shown: 1 };
        Ok(())
    })
}
