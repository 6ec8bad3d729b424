//! The trace kernel: closest hits of given rays; the host side of `trace.wgsl`.

use crate::{
    GpuTracer,
    gather::LANES,
    rays,
    shader::Entry,
    triangle::{BACK_BIT, MISS_RANK},
};
use bytemuck::{Pod, Zeroable, pod_read_unaligned};
use kiln_trace::{Hit, Ray, TraceError};

/// A hit, as `hits` in `trace.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct HitRecord {
    t: f32,
    rank: u32,
    primitive: u32,
    padding: u32,
}

const _: () = assert!(size_of::<HitRecord>() == 16);

impl From<HitRecord> for Hit {
    fn from(record: HitRecord) -> Self {
        if record.rank == MISS_RANK {
            return Self::MISS;
        }
        let (instance, back_face) = (record.rank & !BACK_BIT, record.rank & BACK_BIT != 0);
        Self { t: record.t, instance, primitive: record.primitive, back_face }
    }
}

/// Finds the closest hits.
pub(crate) fn run(tracer: &GpuTracer, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError> {
    let group_bytes = u64::from(LANES) * size_of::<HitRecord>() as u64;
    rays::run(tracer, &rays::Kind::of_hits(Entry::Trace, group_bytes), rays, |range, bytes| {
        for (hit, record) in hits[range].iter_mut().zip(bytes.chunks_exact(size_of::<HitRecord>())) {
            *hit = pod_read_unaligned::<HitRecord>(record).into();
        }
    })
}
