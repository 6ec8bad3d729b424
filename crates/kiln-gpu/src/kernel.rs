//! A kernel as the device evaluates it; the host side of `kernel.wgsl`.
//!
//! The value of a ray is the same polynomial as the CPU's, for all four channels at once. A driver may fuse or reorder
//! it, so a value may differ from the CPU's by one unit of 2⁻¹⁶.

use bytemuck::{Pod, Zeroable};
use kiln_core::MAX_CHANNELS;
use kiln_trace::{KernelRates, ONE};

/// Keep in sync with `Kernel` in `kernel.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct Kernel {
    rates: [f32; MAX_CHANNELS],
    open: [u32; MAX_CHANNELS],
    hit_mask: [u32; MAX_CHANNELS],
}

const _: () = assert!(size_of::<Kernel>() == 48 && MAX_CHANNELS == 4);

impl Kernel {
    pub(crate) fn new(rates: &KernelRates) -> Self {
        let used = |channel: usize| channel < rates.channels;
        Self {
            rates: rates.per_half_distance,
            open: std::array::from_fn(|channel| if used(channel) { ONE } else { 0 }),
            hit_mask: std::array::from_fn(|channel| if used(channel) && !rates.is_occlusion { u32::MAX } else { 0 }),
        }
    }
}
