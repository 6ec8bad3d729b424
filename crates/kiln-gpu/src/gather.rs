//! The gather kernel: makes the rays of samples, traces them and brings back sums; the host side of `gather.wgsl`.
//!
//! A workgroup of 64 lanes serves a group of neighbouring samples: two cones of 32 lanes, each lane with one sample
//! for good. Step by step the cones take the cells of the unit square ([`crate::sampling`]), so that the 32 lanes of a
//! cone always look the same way; a lane adds up the values of its rays in registers, as integers, and at the end the
//! lanes of a sample add their sums: through the workgroup's memory (`reduce.wgsl`) or, where the adapter has subgroups,
//! by shuffles first (`reduce_subgroup.wgsl`). Nothing is added atomically, and since integer sums know no
//! order, neither that nor what is dispatched together changes a result. Two cones a workgroup, since some GPUs run 64 lanes at a
//! time and others limit the number of workgroups below that of their warps.
//!
//! Source of the cones: the paper's groups of 32 rays; here the samples of a group share them.
//!
//! Where a sample has many rays its cells are cut into slices, each a workgroup of its own, whose sums the host adds.

use crate::{
    GpuTracer,
    flight::{Call, Pipeline},
    kernel::Kernel,
    sampling::{CONE_LANES, Cones},
    shader::Entry,
    traverse::MOST_DISTANCE,
};
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice, pod_read_unaligned};
use kiln_trace::{CosineSums, KernelRates, SurfaceSample, TraceError};

/// Lanes of a workgroup, of every kernel.
pub(crate) const LANES: u32 = 64;
const CONES_PER_WORKGROUP: u32 = LANES / CONE_LANES;

/// The most cells of one workgroup: 32 rays for each lane.
const CELLS_PER_SLICE: u32 = 32 * CONES_PER_WORKGROUP;

/// Samples, and results, of one dispatch at most; a multiple of 32.
const MAX_SAMPLES: u64 = 1 << 18;

/// Keep in sync with `GatherParams` in `gather.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct GatherParams {
    kernel: Kernel,
    cones: Cones,
    t_max: f32,
    sample_count: u32,
    cells_per_slice: u32,
    first_slice: u32,
}

/// A sample, as `samples` in `gather.wgsl` and `values` in `probe.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct SampleRecord {
    origin: [f32; 3],
    first_index: u32,
    normal: [f32; 3],
    scramble_0: u32,
    geometric: [f32; 3],
    scramble_1: u32,
}

/// The sums of a sample over a slice, as `sums` in `gather.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct SumsRecord {
    values: [u32; 4],
    rays: u32,
    back_faces: u32,
}

const _: () = {
    assert!(size_of::<GatherParams>() == 80);
    assert!(size_of::<SampleRecord>() == 48);
    assert!(size_of::<SumsRecord>() == 24);
};

impl From<&SurfaceSample> for SampleRecord {
    fn from(sample: &SurfaceSample) -> Self {
        let [scramble_0, scramble_1] = sample.scramble.0;
        Self {
            origin: sample.origin.to_array(),
            first_index: sample.first_index,
            normal: sample.normal.to_array(),
            scramble_0,
            geometric: sample.geometric.to_array(),
            scramble_1,
        }
    }
}

/// One call of `gather_cosine`.
pub(crate) struct Gather<'a> {
    tracer: &'a GpuTracer,
    rates: &'a KernelRates,
    cones: Cones,
}

impl<'a> Gather<'a> {
    pub(crate) fn new(
        tracer: &'a GpuTracer,
        rates: &'a KernelRates,
        rays_per_sample: u32,
        sample_count: usize,
    ) -> Self {
        Self { tracer, rates, cones: Cones::new(rays_per_sample, sample_count) }
    }

    /// Sums over all samples, in as many dispatches as the budget of rays needs.
    pub(crate) fn run(&self, samples: &[SurfaceSample], sums: &mut [CosineSums]) -> Result<(), TraceError> {
        self.tracer.check_origins(samples.iter().map(|sample| sample.origin))?;
        sums.fill(CosineSums::default());
        let mut pipeline = Pipeline::new(self.tracer.gpu(), |part: Part, bytes, elapsed| {
            self.tracer.observe(part.rays, elapsed);
            part.add(bytes, sums);
        });
        let mut done = 0;
        while done < samples.len() {
            let end = samples.len().min(done + self.batch_samples());
            self.run_batch(done, &samples[done..end], |call, part| pipeline.launch(call, part))?;
            done = end;
        }
        pipeline.finish()
    }

    /// As many whole groups as the budget, the workgroups and the buffers of one dispatch have room for; at least one.
    fn batch_samples(&self) -> usize {
        let group = u64::from(self.cones.samples_per_cone());
        let workgroups = u64::from(self.tracer.gpu().limits().max_compute_workgroups_per_dimension);
        let rays_per_sample = u64::from(self.cones.cell_count() * self.cones.rays_per_cell());
        let fitting = (workgroups * group).min(MAX_SAMPLES).min(self.tracer.ray_budget() / rays_per_sample);
        usize::try_from((fitting / group).max(1) * group).unwrap_or(usize::MAX)
    }

    /// One dispatch, or several where not even one group has all its slices within the budget. `first` is the index of
    /// the first sample.
    fn run_batch(
        &self,
        first: usize,
        samples: &[SurfaceSample],
        mut launch: impl FnMut(&Call<'_>, Part) -> Result<(), TraceError>,
    ) -> Result<(), TraceError> {
        let records: Vec<SampleRecord> = samples.iter().map(SampleRecord::from).collect();
        let kernel = self.tracer.kernel(Entry::Gather)?;
        let slices = self.cones.cell_count().div_ceil(CELLS_PER_SLICE);
        let mut first_slice = 0;
        while first_slice < slices {
            let results = MAX_SAMPLES / samples.len() as u64;
            let fitting = results.min(self.tracer.ray_budget() / (samples.len() as u64 * self.rays_per_slice()));
            let slice_count = u32::try_from(fitting.max(1)).unwrap_or(u32::MAX).min(slices - first_slice);
            let params = self.params(records.len(), first_slice);
            let call = Call {
                kernel: &kernel,
                scene: Some(self.tracer.scene_group()),
                params: bytes_of(&params),
                input: cast_slice(&records),
                output_bytes: u64::from(slice_count) * (records.len() * size_of::<SumsRecord>()) as u64,
                workgroups: [params.sample_count.div_ceil(self.cones.samples_per_cone()), slice_count],
            };
            let rays = self.rays_per_slice() * u64::from(slice_count) * records.len() as u64;
            launch(&call, Part { first, samples: records.len(), rays })?;
            first_slice += slice_count;
        }
        Ok(())
    }

    /// Rays of one sample in one slice.
    fn rays_per_slice(&self) -> u64 {
        u64::from(self.cones.cell_count().min(CELLS_PER_SLICE) * self.cones.rays_per_cell())
    }

    #[expect(clippy::cast_possible_truncation, reason = "a dispatch has at most MAX_SAMPLES samples")]
    fn params(&self, samples: usize, first_slice: u32) -> GatherParams {
        GatherParams {
            kernel: Kernel::new(self.rates),
            cones: self.cones,
            t_max: self.rates.t_max.min(MOST_DISTANCE),
            sample_count: samples as u32,
            cells_per_slice: CELLS_PER_SLICE,
            first_slice,
        }
    }
}

/// What a dispatch was about.
struct Part {
    /// Index of the first sample.
    first: usize,
    samples: usize,
    rays: u64,
}

impl Part {
    /// Adds the sums of each slice.
    fn add(&self, bytes: &[u8], sums: &mut [CosineSums]) {
        let sums = &mut sums[self.first..self.first + self.samples];
        for slice in bytes.chunks_exact(self.samples * size_of::<SumsRecord>()) {
            for (sum, record) in sums.iter_mut().zip(slice.chunks_exact(size_of::<SumsRecord>())) {
                add(sum, &pod_read_unaligned(record));
            }
        }
    }
}

fn add(sum: &mut CosineSums, record: &SumsRecord) {
    for (total, value) in sum.values.iter_mut().zip(record.values) {
        *total += value;
    }
    sum.rays += record.rays;
    sum.back_faces += record.back_faces;
}
