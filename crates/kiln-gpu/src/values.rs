//! What given rays are worth, foliage and all; the host side of `values.wgsl`. Spheres in scenes with foliage are made of it.

use crate::{GpuTracer, gather::LANES, kernel::Kernel, rays, shader::Entry, triangle::BACK_BIT};
use bytemuck::pod_read_unaligned;
use kiln_trace::{KernelRates, Ray, RayValue, TraceError};

/// Bytes of a ray's values.
const RECORD_BYTES: usize = 16;

/// Finds the values. Directions are of unit length.
pub(crate) fn run(
    tracer: &GpuTracer,
    rates: &KernelRates,
    rays: &[Ray],
    values: &mut [RayValue],
) -> Result<(), TraceError> {
    let kind = rays::Kind {
        entry: Entry::Values,
        kernel: Kernel::new(rates),
        group_bytes: u64::from(LANES) * RECORD_BYTES as u64,
    };
    rays::run(tracer, &kind, rays, |range, bytes| {
        for (value, record) in values[range].iter_mut().zip(bytes.chunks_exact(RECORD_BYTES)) {
            *value = of_record(pod_read_unaligned(record));
        }
    })
}

fn of_record(record: [u32; 4]) -> RayValue {
    let [first, second, third, fourth] = record;
    RayValue { values: [first & !BACK_BIT, second, third, fourth], back_face: first & BACK_BIT != 0 }
}
