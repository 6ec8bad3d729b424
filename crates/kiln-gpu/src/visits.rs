//! Counts what rays visit, for the model of rates; the host side of `visits.wgsl`.

use crate::{GpuTracer, gather::LANES, rays, shader::Entry};
use bytemuck::pod_read_unaligned;
use kiln_trace::{Ray, TraceError};

/// What the closest hits of rays cost, in sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Visits {
    /// Rays.
    pub rays: u64,
    /// Rays that hit.
    pub hits: u64,
    /// Nodes that were read, of both levels.
    pub nodes: u64,
    /// Triangles that were tested.
    pub triangles: u64,
    /// Instances that were entered.
    pub instances: u64,
}

/// Traces rays and counts.
pub(crate) fn run(tracer: &GpuTracer, rays: &[Ray]) -> Result<Visits, TraceError> {
    let mut sum = Visits { rays: rays.len() as u64, ..Visits::default() };
    let kind = rays::Kind::of_hits(Entry::Visits, 16 * u64::from(LANES));
    rays::run(tracer, &kind, rays, |range, bytes| {
        for record in bytes.chunks_exact(16).take(range.len()) {
            let [nodes, triangles, instances, hit] = pod_read_unaligned::<[u32; 4]>(record).map(u64::from);
            sum.nodes += nodes;
            sum.triangles += triangles;
            sum.instances += instances;
            sum.hits += hit;
        }
    })?;
    Ok(sum)
}
