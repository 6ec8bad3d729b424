//! The consent that wgpu asks for before it opens a device with ray queries: the crate's only unsafe code.

/// Consents to experimental features of wgpu. Called only where the user has asked for ray queries.
#[expect(unsafe_code, reason = "wgpu's only way to ray queries")]
pub(crate) fn consent() -> wgpu::ExperimentalFeatures {
    // SAFETY: wgpu demands no invariant here but the knowledge that its code for these features may have bugs that are undefined
    // behaviour, and that those found are reported. `DeviceOptions::ray_queries` hands that on to the user.
    unsafe { wgpu::ExperimentalFeatures::enabled() }
}
