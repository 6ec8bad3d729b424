//! Dispatches of kernels over given rays, one for each lane; the host side of `rays.wgsl`.

use crate::{
    GpuTracer,
    flight::{Call, Pipeline},
    gather::LANES,
    kernel::Kernel,
    shader::Entry,
    traverse::MOST_DISTANCE,
};
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice};
use kiln_trace::{Ray, TraceError};
use std::ops::Range;

/// Rays of one dispatch at most, by the size of its buffers.
const MAX_RAYS: u64 = 1 << 20;

/// Keep in sync with `RayParams` in `rays.wgsl`, which has only the number, and in `values.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct RayParams {
    ray_count: u32,
    padding: [u32; 3],
    kernel: Kernel,
}

/// What is done with rays.
pub(crate) struct Kind {
    pub(crate) entry: Entry,
    /// Of those that value rays.
    pub(crate) kernel: Kernel,
    /// Bytes of output for each 64 rays or part of them.
    pub(crate) group_bytes: u64,
}

impl Kind {
    /// Of a kernel that finds hits.
    pub(crate) fn of_hits(entry: Entry, group_bytes: u64) -> Self {
        Self { entry, kernel: Kernel::zeroed(), group_bytes }
    }
}

/// A ray, as `rays` in `rays.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct RayRecord {
    origin: [f32; 3],
    t_max: f32,
    direction: [f32; 3],
    padding: f32,
}

const _: () = assert!(size_of::<RayRecord>() == 32 && size_of::<RayParams>() == 64);

impl From<&Ray> for RayRecord {
    fn from(ray: &Ray) -> Self {
        let t_max = ray.t_max.min(MOST_DISTANCE);
        Self { origin: ray.origin.to_array(), t_max, direction: ray.direction.to_array(), padding: 0.0 }
    }
}

/// Runs a kernel over rays. `read` gets each range of rays, in order, with its output.
pub(crate) fn run(
    tracer: &GpuTracer,
    kind: &Kind,
    rays: &[Ray],
    mut read: impl FnMut(Range<usize>, &[u8]),
) -> Result<(), TraceError> {
    let widest = u64::from(tracer.gpu().limits().max_compute_workgroups_per_dimension) * u64::from(LANES);
    tracer.check_origins(rays.iter().map(|ray| ray.origin))?;
    let kernel = tracer.kernel(kind.entry)?;
    let mut pipeline = Pipeline::new(tracer.gpu(), |range: Range<usize>, bytes, elapsed| {
        tracer.observe(range.len() as u64, elapsed);
        read(range, bytes);
    });
    let mut done = 0;
    while done < rays.len() {
        let most = tracer.ray_budget().min(MAX_RAYS).min(widest);
        let end = rays.len().min(done + usize::try_from(most).unwrap_or(usize::MAX));
        let records: Vec<RayRecord> = rays[done..end].iter().map(RayRecord::from).collect();
        let ray_count = u32::try_from(records.len()).unwrap_or(u32::MAX);
        let params = RayParams { ray_count, padding: [0; 3], kernel: kind.kernel };
        let workgroups = ray_count.div_ceil(LANES);
        let call = Call {
            kernel: &kernel,
            scene: Some(tracer.scene_group()),
            params: bytes_of(&params),
            input: cast_slice(&records),
            output_bytes: u64::from(workgroups) * kind.group_bytes,
            workgroups: [workgroups, 1],
        };
        pipeline.launch(&call, done..end)?;
        done = end;
    }
    pipeline.finish()
}
