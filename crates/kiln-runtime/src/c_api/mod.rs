//! Functions with C's calling convention: `include/kiln_runtime.h`, which `cargo xtask header` writes from these files.
//!
//! Nothing allocates. A pack is opened into memory of the caller's, and borrows the bytes that it was opened from: keep
//! both. Functions on an open pack may be called from several threads at once.
#![expect(unsafe_code, reason = "C hands over pointers")]

mod pack;
mod regions;
mod values;

pub use pack::*;
pub use regions::*;
pub use values::*;

use crate::{Pack, PackError};
use core::mem::MaybeUninit;

/// What became of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KilnStatus {
    /// It worked.
    Ok = 0,
    /// A pointer is null.
    NullPointer = 1,
    /// The pack was not opened, or it was closed.
    NotOpen = 2,
    /// The bytes are no pack.
    NotAPack = 3,
    /// The pack has a format that this runtime does not know.
    UnknownVersion = 4,
    /// The pack is cut off.
    CutOff = 5,
    /// The pack is damaged; kiln_pack_error says how.
    Damaged = 6,
    /// There is nothing at this index, or of this name.
    NotFound = 7,
    /// The point is not finite, or the pack has no regions.
    NoRegion = 8,
}

impl From<PackError> for KilnStatus {
    fn from(error: PackError) -> Self {
        match error {
            PackError::NotAPack => Self::NotAPack,
            PackError::Version { .. } | PackError::UnknownRequired { .. } => Self::UnknownVersion,
            PackError::CutOff { .. } => Self::CutOff,
            _ => Self::Damaged,
        }
    }
}

/// No index: of a node without instances, or no hint.
pub const KILN_NONE: u32 = u32::MAX;

/// Channels (half-distances) of a pack at most.
pub const KILN_MAX_CHANNELS: usize = 4;

/// Words of a KilnPack.
pub const KILN_PACK_WORDS: usize = 128;

/// An open pack, in memory of the caller's. It may be moved, but not copied while another thread opens it.
#[repr(C)]
#[derive(Debug)]
pub struct KilnPack {
    /// The runtime's own.
    pub opaque: [u64; KILN_PACK_WORDS],
}

/// What a [`KilnPack`] holds.
#[repr(C)]
struct Slot {
    tag: u64,
    pack: MaybeUninit<Pack<'static>>,
}

const _: () = assert!(size_of::<Slot>() <= size_of::<KilnPack>() && align_of::<Slot>() <= align_of::<KilnPack>());

/// Tag of a pack that is open.
const OPEN: u64 = 0x4b49_4c4e_4f50_454e;

fn status(call: impl FnOnce() -> Result<(), KilnStatus>) -> KilnStatus {
    call().err().unwrap_or(KilnStatus::Ok)
}

/// The pack that was opened.
///
/// # Safety
/// `pack` is null, or points to a [`KilnPack`] that is zeroed or was given to [`kiln_pack_open`].
unsafe fn opened<'a>(pack: *const KilnPack) -> Result<&'a Pack<'a>, KilnStatus> {
    // SAFETY: by this function's contract, and a slot fits into a pack.
    let slot = unsafe { pack.cast::<Slot>().as_ref() }.ok_or(KilnStatus::NullPointer)?;
    if slot.tag != OPEN {
        return Err(KilnStatus::NotOpen);
    }
    // SAFETY: the tag is set after the pack is written, and by nothing else.
    Ok(unsafe { slot.pack.assume_init_ref() })
}

/// Numbers that C gave.
///
/// # Safety
/// `from` is null, or points to `N` floats.
unsafe fn floats<const N: usize>(from: *const f32) -> Result<[f32; N], KilnStatus> {
    // SAFETY: by this function's contract; an array of floats is aligned as a float.
    unsafe { from.cast::<[f32; N]>().as_ref() }.copied().ok_or(KilnStatus::NullPointer)
}

/// Gives a value to C.
///
/// # Safety
/// `to` is null, or points to memory for a `T`.
unsafe fn give<T>(to: *mut T, value: T) -> Result<(), KilnStatus> {
    if to.is_null() {
        return Err(KilnStatus::NullPointer);
    }
    // SAFETY: by this function's contract; what was there before is C's and has no destructor.
    unsafe { to.write(value) };
    Ok(())
}

/// Bytes that C gave.
///
/// # Safety
/// `bytes` is null, or points to `length` bytes that stay and do not change.
unsafe fn slice<'a>(bytes: *const u8, length: usize) -> Result<&'a [u8], KilnStatus> {
    if bytes.is_null() {
        return Err(KilnStatus::NullPointer);
    }
    // Nothing in memory is larger.
    if isize::try_from(length).is_err() {
        return Err(KilnStatus::CutOff);
    }
    // SAFETY: by this function's contract.
    Ok(unsafe { core::slice::from_raw_parts(bytes, length) })
}

/// An index that may be [`KILN_NONE`].
const fn optional(index: u32) -> Option<u32> {
    if index == KILN_NONE { None } else { Some(index) }
}
