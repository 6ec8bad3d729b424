//! The any-hit kernel: whether given rays hit anything; the host side of `any_hit.wgsl`.
//!
//! The traversal is left at the first triangle that counts as a hit, by the same rule as for the closest one: in front of
//! the ray's end, or there from the front. One bit a ray comes back.

use crate::{GpuTracer, gather::LANES, rays, shader::Entry};
use kiln_trace::{Ray, TraceError};

/// Finds which rays are blocked.
pub(crate) fn run(tracer: &GpuTracer, rays: &[Ray], blocked: &mut [bool]) -> Result<(), TraceError> {
    let kind = rays::Kind::of_hits(Entry::AnyHit, u64::from(LANES / 8));
    rays::run(tracer, &kind, rays, |range, bytes| {
        for (i, blocked) in blocked[range].iter_mut().enumerate() {
            *blocked = bytes[i / 8] & (1 << (i % 8)) != 0;
        }
    })
}
