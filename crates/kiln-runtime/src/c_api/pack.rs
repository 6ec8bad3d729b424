//! Opening a pack, and what it is of.

use super::{KILN_MAX_CHANNELS, KilnPack, KilnStatus, OPEN, Slot, give, opened, slice, status};
use crate::{
    Pack, Remap, SectionKind,
    format::{MAJOR, MINOR},
};
use core::{
    ffi::{CStr, c_char},
    fmt::{self, Write},
    mem::MaybeUninit,
};

/// What was baked, and how much of it there is.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KilnPackInfo {
    /// Where points are relative to, metres in the level's own coordinates.
    pub origin: [f64; 3],
    /// Digest of the level.
    pub level_digest: [u8; 32],
    /// Half-distance of each channel, metres.
    pub half_distances: [f32; KILN_MAX_CHANNELS],
    /// Weight of each channel in the blend; their sum is 1.
    pub blend: [f32; KILN_MAX_CHANNELS],
    /// Number of channels.
    pub channels: u32,
    /// 0 obscurance, 1 occlusion, other numbers what this version does not know.
    pub kernel: u32,
    /// Number of vertex sets.
    pub vertex_sets: u32,
    /// Number of models of trees.
    pub tree_models: u32,
    /// Number of instances of them.
    pub tree_instances: u32,
    /// Number of shrubs and decorators.
    pub scalars: u32,
    /// Number of visibility regions.
    pub regions: u32,
    /// Number of their models.
    pub models: u32,
}

/// Version of the pack format that this runtime reads: major × 65,536 + minor.
#[unsafe(no_mangle)]
pub extern "C" fn kiln_format_version() -> u32 {
    u32::from(MAJOR) << 16 | u32::from(MINOR)
}

/// A status in words. The text stays.
#[unsafe(no_mangle)]
pub extern "C" fn kiln_status_text(status: u32) -> *const c_char {
    let texts: [(KilnStatus, &'static CStr); 9] = [
        (KilnStatus::Ok, c"it worked"),
        (KilnStatus::NullPointer, c"a pointer is null"),
        (KilnStatus::NotOpen, c"the pack is not open"),
        (KilnStatus::NotAPack, c"this is no Kiln pack"),
        (KilnStatus::UnknownVersion, c"the pack has a format that this runtime does not know"),
        (KilnStatus::CutOff, c"the pack is cut off"),
        (KilnStatus::Damaged, c"the pack is damaged"),
        (KilnStatus::NotFound, c"there is nothing of this index or name"),
        (KilnStatus::NoRegion, c"the point is not finite, or the pack has no regions"),
    ];
    let text = texts.iter().find(|(known, _)| *known as u32 == status);
    text.map_or(c"this is no status", |(_, text)| text).as_ptr()
}

/// Checks the bytes of a pack and opens it into `pack`. Bytes may be a memory-mapped file; they need no alignment.
///
/// # Safety
/// `bytes` points to `length` bytes that stay and do not change while the pack is open; `pack` to a KilnPack.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_pack_open(bytes: *const u8, length: usize, pack: *mut KilnPack) -> KilnStatus {
    status(|| {
        let closed = Slot { tag: 0, pack: MaybeUninit::uninit() };
        // SAFETY: `pack` is null or has room for a slot.
        unsafe { give(pack.cast::<Slot>(), closed) }?;
        // SAFETY: the caller's promise.
        let opened = Pack::new(unsafe { slice(bytes, length) }?)?;
        // SAFETY: `pack` is not null, as was found above.
        unsafe { give(pack.cast::<Slot>(), Slot { tag: OPEN, pack: MaybeUninit::new(opened) }) }
    })
}

/// Closes a pack: calls then give KILN_STATUS_NOT_OPEN. There is nothing to free.
///
/// # Safety
/// `pack` is null or points to a KilnPack.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_pack_close(pack: *mut KilnPack) {
    // SAFETY: the caller's promise. A null pointer is nothing to close.
    let _ = unsafe { give(pack.cast::<Slot>(), Slot { tag: 0, pack: MaybeUninit::uninit() }) };
}

/// Why bytes are no pack, as text that ends in 0 and is cut to `capacity` bytes; empty if they are one.
///
/// # Safety
/// `bytes` points to `length` bytes, `text` to `capacity` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_pack_error(
    bytes: *const u8,
    length: usize,
    text: *mut c_char,
    capacity: usize,
) -> KilnStatus {
    status(|| {
        if text.is_null() || capacity == 0 {
            return Err(KilnStatus::NullPointer);
        }
        // SAFETY: `text` has so many bytes, and zeroing them makes them readable.
        unsafe { text.write_bytes(0, capacity) };
        // SAFETY: likewise; nobody else has them.
        let room = unsafe { core::slice::from_raw_parts_mut(text.cast::<u8>(), capacity) };
        // SAFETY: the caller's promise.
        if let Err(error) = Pack::new(unsafe { slice(bytes, length) }?) {
            // The last byte stays 0. What does not fit is cut off, and is no error.
            let _ = write!(Cut { room: &mut room[..capacity - 1] }, "{error}");
        }
        Ok(())
    })
}

/// Text into a buffer, as far as it goes.
struct Cut<'a> {
    room: &'a mut [u8],
}

impl Write for Cut<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let mut size = text.len().min(self.room.len());
        while !text.is_char_boundary(size) {
            size -= 1;
        }
        let (own, rest) = core::mem::take(&mut self.room).split_at_mut(size);
        own.copy_from_slice(&text.as_bytes()[..size]);
        self.room = if size == text.len() { rest } else { &mut [] };
        Ok(())
    }
}

/// What was baked, and how much of it there is.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, `info` to a KilnPackInfo.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_pack_info(pack: *const KilnPack, info: *mut KilnPackInfo) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let pack = unsafe { opened(pack) }?;
        let meta = pack.meta();
        let padded = |list: &[f32]| core::array::from_fn(|i| list.get(i).copied().unwrap_or(0.0));
        let count = |kind| pack.count(kind) as u32;
        let value = KilnPackInfo {
            origin: meta.origin(),
            level_digest: *meta.level_digest(),
            half_distances: padded(meta.half_distances()),
            blend: padded(meta.blend()),
            channels: meta.channels() as u32,
            kernel: meta.kernel() as u32,
            vertex_sets: count(SectionKind::VertexSets),
            tree_models: count(SectionKind::TreeModels),
            tree_instances: count(SectionKind::TreeInstances),
            scalars: count(SectionKind::Scalars),
            regions: pack.region_count(),
            models: pack.model_count(),
        };
        // SAFETY: the caller's promise.
        unsafe { give(info, value) }
    })
}

/// All records of a kind of section (docs/pack-format.md), for an upload as they are: where they begin, the size of each,
/// and how many there are. They stay as long as the pack's bytes.
///
/// # Safety
/// `pack` points to a KilnPack that was opened, the others to what they are to hold.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_pack_records(
    pack: *const KilnPack,
    kind: u32,
    records: *mut *const u8,
    stride: *mut usize,
    count: *mut usize,
) -> KilnStatus {
    status(|| {
        // SAFETY: the caller's promise.
        let pack = unsafe { opened(pack) }?;
        let kind = SectionKind::of(kind).ok_or(KilnStatus::NotFound)?;
        let (bytes, size) = pack.records(kind);
        // SAFETY: the caller's promise.
        unsafe {
            give(records, bytes.as_ptr())?;
            give(stride, size)?;
            give(count, pack.count(kind))
        }
    })
}

/// The curve that the level's author asked for over the blend. AO as it is where the pack is not open.
///
/// # Safety
/// `pack` points to a KilnPack that was opened.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn kiln_pack_remap(pack: *const KilnPack, ao: f32) -> f32 {
    // SAFETY: the caller's promise.
    unsafe { opened(pack) }.map_or(Remap::None, |pack| pack.meta().remap()).apply(ao)
}
