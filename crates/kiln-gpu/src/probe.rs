//! Parts of the gather kernel by themselves, so that tests can compare them with the CPU, and a check of the driver's loops; the host side
//! of `probe.wgsl`.

use crate::{
    GpuDevice, GpuError,
    flight::Call,
    foliage::FoliageShape,
    gather::{LANES, SampleRecord},
    kernel::Kernel,
    sampling::Cones,
    shader::{Entry, SceneShape},
};
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice, pod_read_unaligned};
use glam::Vec3;
use kiln_trace::{KernelRates, SurfaceSample};

/// Keep in sync with `ProbeParams` in `probe.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ProbeParams {
    kernel: Kernel,
    cones: Cones,
    count: u32,
    padding: [u32; 3],
}

const _: () = assert!(size_of::<ProbeParams>() == 80);

/// A ray of a sample as the device makes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbedRay {
    /// Index in the scrambled sequence.
    pub index: u32,
    /// Cell of the unit square.
    pub cell: u32,
    /// Unit direction.
    pub direction: Vec3,
}

/// No scene is read.
const NO_SCENE: SceneShape =
    SceneShape { bindings: 0, binding_shift: 0, stack_entries: 0, ray_queries: false, foliage: FoliageShape::Nothing };

/// Rounds of the check of loops: the outer ones, and those in each.
const ROUNDS: [u32; 2] = [512, 512];

impl GpuDevice {
    /// Whether loops come to their ends, however many rounds there are in all: old software drivers stop after 65,535 of a lane, and say
    /// nothing.
    pub(crate) fn check_loops(&self) -> Result<(), GpuError> {
        let [outer, inner] = ROUNDS;
        let input: [u32; 4] = [41, inner, 0, 0];
        let mut state = input[0];
        for _ in 0..outer * inner {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state ^= state >> 15;
        }
        let found =
            self.probe(Entry::Rounds, Kernel::zeroed(), Cones::new(1, 1), outer as usize, bytes_of(&input), 1)?;
        if found.first().is_some_and(|word| word[..2] == [outer * inner, state]) {
            return Ok(());
        }
        let rounds = found.first().map_or(0, |word| word[0]);
        Err(GpuError::CutsLoops { adapter: self.adapter().to_string(), found: rounds, asked: outer * inner })
    }

    /// The rays of each sample, in the order in which they are traced. At most 4 Mi rays at a time.
    pub fn probe_rays(&self, samples: &[SurfaceSample], rays_per_sample: u32) -> Result<Vec<Vec<ProbedRay>>, GpuError> {
        let cones = Cones::new(rays_per_sample, samples.len());
        let records: Vec<SampleRecord> = samples.iter().map(SampleRecord::from).collect();
        let rays = samples.len() as u64 * u64::from(rays_per_sample);
        let kernel = Kernel::zeroed();
        let results = self.probe(Entry::Directions, kernel, cones, samples.len(), cast_slice(&records), rays)?;
        let ray = |(i, word): (usize, &[u32; 4])| ProbedRay {
            index: word[3],
            cell: (i as u32 % rays_per_sample) / cones.rays_per_cell(),
            direction: Vec3::from_array([word[0], word[1], word[2]].map(f32::from_bits)),
        };
        let rays: Vec<ProbedRay> = results.iter().enumerate().map(ray).collect();
        Ok(rays.chunks(rays_per_sample as usize).map(<[_]>::to_vec).collect())
    }

    /// Fixed-point values of hits at the given distances, in each channel. At most 4 Mi distances at a time.
    pub fn probe_hit_values(&self, rates: &KernelRates, distances: &[f32]) -> Result<Vec<[u32; 4]>, GpuError> {
        let mut padded = distances.to_vec();
        padded.resize(distances.len().next_multiple_of(4), 0.0);
        let (kernel, cones) = (Kernel::new(rates), Cones::new(1, 1));
        let count = distances.len();
        self.probe(Entry::HitValues, kernel, cones, count, cast_slice(&padded), count as u64)
    }

    #[expect(clippy::cast_possible_truncation, reason = "test sizes; the dispatch would be refused")]
    fn probe(
        &self,
        entry: Entry,
        kernel: Kernel,
        cones: Cones,
        count: usize,
        input: &[u8],
        results: u64,
    ) -> Result<Vec<[u32; 4]>, GpuError> {
        let params = ProbeParams { kernel, cones, count: count as u32, padding: [0; 3] };
        let compiled = self.kernel(entry, &NO_SCENE)?;
        let call = Call {
            kernel: &compiled,
            scene: None,
            params: bytes_of(&params),
            input,
            output_bytes: 16 * results,
            workgroups: [results.div_ceil(u64::from(LANES)) as u32, 1],
        };
        let mut words = Vec::new();
        self.run(&call, |bytes| words.extend(bytes.chunks_exact(16).map(pod_read_unaligned::<[u32; 4]>)))?;
        Ok(words)
    }
}
