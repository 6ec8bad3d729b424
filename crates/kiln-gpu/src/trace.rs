//! The trace kernel: closest hits of given rays, one for each lane; the host side of `trace.wgsl`.

use crate::{
    GpuTracer,
    device::Call,
    gather::LANES,
    shader::Entry,
    traverse::{BACK_BIT, MISS_RANK, MOST_DISTANCE},
};
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice, pod_read_unaligned};
use kiln_trace::{Hit, Ray, TraceError};

/// Rays of one dispatch at most, by the size of its buffers.
const MAX_RAYS: u64 = 1 << 20;

/// Keep in sync with `TraceParams` in `trace.wgsl`; uniform bindings come in units of 16 bytes.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct TraceParams {
    ray_count: u32,
    padding: [u32; 3],
}

/// A ray, as `rays` in `trace.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct RayRecord {
    origin: [f32; 3],
    t_max: f32,
    direction: [f32; 3],
    padding: f32,
}

/// A hit, as `hits` in `trace.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct HitRecord {
    t: f32,
    rank: u32,
    primitive: u32,
    padding: u32,
}

const _: () = assert!(size_of::<RayRecord>() == 32 && size_of::<HitRecord>() == 16);

impl From<&Ray> for RayRecord {
    fn from(ray: &Ray) -> Self {
        let t_max = ray.t_max.min(MOST_DISTANCE);
        Self { origin: ray.origin.to_array(), t_max, direction: ray.direction.to_array(), padding: 0.0 }
    }
}

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
    let widest = u64::from(tracer.gpu().limits().max_compute_workgroups_per_dimension) * u64::from(LANES);
    let mut rest = (rays, hits);
    while !rest.0.is_empty() {
        let most = tracer.ray_budget().min(MAX_RAYS).min(widest);
        let count = usize::try_from(most).unwrap_or(usize::MAX).min(rest.0.len());
        let (now, later) = rest.0.split_at(count);
        let (now_hits, later_hits) = std::mem::take(&mut rest.1).split_at_mut(count);
        rest = (later, later_hits);
        dispatch(tracer, now, now_hits)?;
    }
    Ok(())
}

#[expect(clippy::cast_possible_truncation, reason = "a dispatch has at most MAX_RAYS rays")]
fn dispatch(tracer: &GpuTracer, rays: &[Ray], hits: &mut [Hit]) -> Result<(), TraceError> {
    let ray_count = rays.len() as u32;
    let records: Vec<RayRecord> = rays.iter().map(RayRecord::from).collect();
    let params = TraceParams { ray_count, padding: [0; 3] };
    let kernel = tracer.kernel(Entry::Trace)?;
    let call = Call {
        kernel: &kernel,
        scene: Some(tracer.scene_group()),
        params: bytes_of(&params),
        input: cast_slice(&records),
        output_bytes: rays.len() as u64 * size_of::<HitRecord>() as u64,
        workgroups: [ray_count.div_ceil(LANES), 1],
    };
    let elapsed = tracer.gpu().run(&call, |bytes| {
        for (hit, record) in hits.iter_mut().zip(bytes.chunks_exact(size_of::<HitRecord>())) {
            *hit = pod_read_unaligned::<HitRecord>(record).into();
        }
    })?;
    tracer.observe(rays.len() as u64, elapsed);
    Ok(())
}
