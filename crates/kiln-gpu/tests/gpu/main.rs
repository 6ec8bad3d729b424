//! The GPU tracer on a software Vulkan driver: one program, since all its tests share a device.

mod alone;
mod contract;
mod faults;
mod oracles;
mod probes;
#[expect(dead_code, reason = "the benchmark uses the rest")]
mod scenes;

use kiln_gpu::{AdapterChoice, GpuDevice};
use std::sync::{Arc, OnceLock};

/// One device for all tests. Without a driver they fail: they never pass by doing nothing.
fn device() -> Arc<GpuDevice> {
    static DEVICE: OnceLock<Arc<GpuDevice>> = OnceLock::new();
    Arc::clone(DEVICE.get_or_init(open_device))
}

/// A device whose kernels use no subgroup operations.
fn device_without_subgroups() -> Arc<GpuDevice> {
    static DEVICE: OnceLock<Arc<GpuDevice>> = OnceLock::new();
    Arc::clone(DEVICE.get_or_init(|| open_device_with(false)))
}

/// A device of one's own.
fn open_device() -> Arc<GpuDevice> {
    open_device_with(true)
}

fn open_device_with(subgroups: bool) -> Arc<GpuDevice> {
    let device = GpuDevice::open_with(&AdapterChoice::Software, subgroups).expect("the software adapter opens");
    device.expect(
        "these tests need a software Vulkan driver; on Debian or Ubuntu: \
         apt-get install -y mesa-vulkan-drivers libvulkan1",
    )
}
