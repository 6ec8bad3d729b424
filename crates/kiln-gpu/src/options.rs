//! What a device is opened with.

/// Options of [`crate::GpuDevice::open_with`]. Results are the same whatever they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceOptions {
    /// Permits kernels to use subgroup operations where the adapter has them.
    pub subgroups: bool,
    /// Demands that the card's own ray queries find the boxes that a ray meets; an adapter without them is not opened. They are experimental in
    /// wgpu: its code for them may have bugs that are undefined behaviour.
    pub ray_queries: bool,
}

impl Default for DeviceOptions {
    fn default() -> Self {
        Self { subgroups: true, ray_queries: false }
    }
}
