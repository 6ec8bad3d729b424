//! What voxels see: a batch of bricks is traced into an artefact.

use super::{ArtefactError, Brick, Layout, VolumeError, lattice::Lattice, layout::check_bricks};
use crate::scramble::LatticeKey;
use kiln_core::MAX_CHANNELS;
use kiln_trace::{HARMONICS, KernelRates, MAX_RAYS_PER_SAMPLE, SpherePoint, SphereSums, Tracer};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Voxels whose sums are in memory at once.
const VOXELS_PER_CALL: usize = 8192;

/// No estimate of a coefficient is greater: 4π times the greatest value of a basis function, 0.631.
pub(crate) const MAX_COEFFICIENT: f32 = 8.0;

/// How voxels are traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatherSettings {
    /// The value of a ray.
    pub kernel: KernelRates,
    /// Directions over the sphere, a power of two up to [`MAX_RAYS_PER_SAMPLE`]; 1,024 in the paper.
    pub rays_per_voxel: u32,
    /// A voxel is invalid if more of its rays than this fraction see the back of a face.
    pub back_face_limit: f64,
    /// Of all directions.
    pub seed: u64,
}

/// What the voxels of some bricks see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StoredBatch", into = "StoredBatch")]
pub struct VolumeBatch {
    spacing_m: f64,
    channels: usize,
    /// In the order of their coordinates.
    bricks: Vec<Brick>,
    /// [`HARMONICS`] for each channel of each needed voxel.
    coefficients: Vec<f32>,
    /// For each needed voxel.
    is_valid: Vec<bool>,
    /// Rays traced.
    rays: u64,
}

/// A batch as it is stored.
#[derive(Serialize, Deserialize)]
struct StoredBatch {
    spacing_m: f64,
    channels: u8,
    bricks: Vec<Brick>,
    coefficients: Vec<f32>,
    is_valid: Vec<bool>,
    rays: u64,
}

impl VolumeBatch {
    /// Distance of neighbouring voxels, metres.
    pub fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Channels of each voxel.
    pub fn channel_count(&self) -> usize {
        self.channels
    }

    /// The bricks, in the order of their coordinates.
    pub fn bricks(&self) -> &[Brick] {
        &self.bricks
    }

    /// For each channel of each needed voxel, in the order of bricks and bits, its [`HARMONICS`] coefficients.
    pub fn coefficients(&self) -> &[f32] {
        &self.coefficients
    }

    /// For each needed voxel, whether it saw few enough back faces.
    pub fn validity(&self) -> &[bool] {
        &self.is_valid
    }

    /// Rays traced.
    pub fn ray_count(&self) -> u64 {
        self.rays
    }
}

/// Traces the needed voxels of a run of a layout's bricks. A voxel's coefficients depend on nothing but where it is, the
/// settings and what the tracer's scene has there.
pub fn gather_batch(
    tracer: &dyn Tracer,
    layout: &Layout,
    bricks: Range<usize>,
    settings: &GatherSettings,
) -> Result<VolumeBatch, VolumeError> {
    let (rays, limit) = (settings.rays_per_voxel, MAX_RAYS_PER_SAMPLE);
    if !rays.is_power_of_two() || rays > limit {
        return Err(VolumeError::Rays { rays, limit });
    }
    let bricks = layout.bricks().get(bricks.clone()).ok_or(VolumeError::NoSuchBricks {
        start: bricks.start,
        end: bricks.end,
        count: layout.bricks().len(),
    })?;
    let key = LatticeKey::new(layout.spacing_m(), settings.seed);
    let point = |voxel: [i32; 3]| {
        let origin = layout.lattice().position(voxel).as_vec3();
        SpherePoint { origin, scramble: key.voxel(voxel) }
    };
    let points: Vec<SpherePoint> = bricks.iter().flat_map(Brick::voxels).map(point).collect();
    let mut batch = VolumeBatch {
        spacing_m: layout.spacing_m(),
        channels: settings.kernel.channels.clamp(1, MAX_CHANNELS),
        bricks: bricks.to_vec(),
        coefficients: Vec::with_capacity(points.len() * settings.kernel.channels * HARMONICS),
        is_valid: Vec::with_capacity(points.len()),
        rays: 0,
    };
    for points in points.chunks(VOXELS_PER_CALL) {
        let mut sums = vec![SphereSums::default(); points.len()];
        tracer.gather_sphere(points, &settings.kernel, rays, &mut sums)?;
        sums.iter().for_each(|sum| batch.push(sum, settings.back_face_limit));
    }
    Ok(batch)
}

impl VolumeBatch {
    #[expect(clippy::cast_possible_truncation, reason = "f32 is the stored precision")]
    fn push(&mut self, sum: &SphereSums, back_face_limit: f64) {
        for channel in 0..self.channels {
            self.coefficients.extend(sum.coefficients(channel).map(|c| c as f32));
        }
        self.is_valid.push(sum.back_face_fraction() <= back_face_limit);
        self.rays += u64::from(sum.rays);
    }
}

impl TryFrom<StoredBatch> for VolumeBatch {
    type Error = ArtefactError;

    fn try_from(stored: StoredBatch) -> Result<Self, ArtefactError> {
        let error = |reason| ArtefactError { what: "batch of a volume", reason };
        let StoredBatch { spacing_m, channels, bricks, coefficients, is_valid, rays } = stored;
        let channels = usize::from(channels);
        Lattice::new(spacing_m).map_err(|_| error("its spacing is no length"))?;
        check_bricks(&bricks).map_err(error)?;
        let voxels = bricks.iter().map(Brick::voxel_count).sum::<usize>();
        check_coefficients(&coefficients, channels, voxels).map_err(error)?;
        if is_valid.len() != voxels {
            return Err(error("it has validity for other voxels than its bricks need"));
        }
        Ok(Self { spacing_m, channels, bricks, coefficients, is_valid, rays })
    }
}

impl From<VolumeBatch> for StoredBatch {
    fn from(batch: VolumeBatch) -> Self {
        let VolumeBatch { spacing_m, channels, bricks, coefficients, is_valid, rays } = batch;
        Self { spacing_m, channels: channels as u8, bricks, coefficients, is_valid, rays }
    }
}

/// Checks coefficients that were read.
pub(crate) fn check_coefficients(coefficients: &[f32], channels: usize, voxels: usize) -> Result<(), &'static str> {
    if !(1..=MAX_CHANNELS).contains(&channels) {
        return Err("it has no channel, or too many");
    }
    if coefficients.len() != voxels * channels * HARMONICS {
        return Err("it has coefficients for other voxels than its bricks need");
    }
    // Not for NaN either.
    if !coefficients.iter().all(|c| c.abs() <= MAX_COEFFICIENT) {
        return Err("a coefficient is out of bounds");
    }
    Ok(())
}
