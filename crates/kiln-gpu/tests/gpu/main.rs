//! The GPU tracer on a software Vulkan driver: one program, since all its tests share a device.

mod alone;
mod contract;
mod faults;
mod foliage;
mod oracles;
mod probes;
mod ray_queries;
#[expect(dead_code, reason = "the benchmark uses the rest")]
mod scenes;

use kiln_gpu::{AdapterChoice, DeviceOptions, GpuDevice, GpuError};
use std::sync::{Arc, OnceLock};

/// One device for all tests. Without a driver they fail: they never pass by doing nothing.
fn device() -> Arc<GpuDevice> {
    static DEVICE: OnceLock<Arc<GpuDevice>> = OnceLock::new();
    Arc::clone(DEVICE.get_or_init(open_device))
}

/// A device whose kernels use no subgroup operations.
fn device_without_subgroups() -> Arc<GpuDevice> {
    static DEVICE: OnceLock<Arc<GpuDevice>> = OnceLock::new();
    let options = DeviceOptions { subgroups: false, ..DeviceOptions::default() };
    Arc::clone(DEVICE.get_or_init(|| open_device_with(options)))
}

/// A device that traces by ray queries. Where the driver has none, `None` and a line that says so; an error if `KILN_REQUIRE_RAY_QUERIES`
/// is 1, as tests/run sets it where it has installed a driver that has them.
fn device_with_ray_queries() -> Option<Arc<GpuDevice>> {
    static DEVICE: OnceLock<Option<Arc<GpuDevice>>> = OnceLock::new();
    DEVICE.get_or_init(open_device_with_ray_queries).clone()
}

#[expect(clippy::print_stderr, reason = "a test that tests nothing says so")]
fn open_device_with_ray_queries() -> Option<Arc<GpuDevice>> {
    let options = DeviceOptions { ray_queries: true, ..DeviceOptions::default() };
    let is_required = std::env::var("KILN_REQUIRE_RAY_QUERIES").is_ok_and(|value| value == "1");
    match GpuDevice::open_with(&AdapterChoice::Software, options) {
        Err(error @ GpuError::NoRayQueries { .. }) if !is_required => {
            eprintln!("NOT TESTED, no ray queries: {error}");
            None
        }
        opened => Some(opened.expect("ray queries are ready").expect("there is a software driver")),
    }
}

/// A device of one's own.
fn open_device() -> Arc<GpuDevice> {
    open_device_with(DeviceOptions::default())
}

fn open_device_with(options: DeviceOptions) -> Arc<GpuDevice> {
    let device = GpuDevice::open_with(&AdapterChoice::Software, options).expect("the software adapter opens");
    device.expect(
        "these tests need a software Vulkan driver, Mesa's of 2025 or newer: tests/run installs one on Debian and its kin",
    )
}
