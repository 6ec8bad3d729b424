//! Moments of a LOD's faces, read from the finished full-detail mesh (Sloan et al. 2013, section 2.2.1).

use super::{baked::BakedSurface, near::read_near};
use crate::{
    piece::{FACES_PER_BATCH, Piece, add_sides},
    samples::{Batch, SampleMaker},
};
use kiln_core::{FaceMoments, HalfMoments, Sampling};
use kiln_trace::{SurfaceSample, TraceError, Tracer};
use rayon::prelude::*;

/// Rays of each sample's sphere.
const RAYS_PER_SAMPLE: u32 = 8;

/// Samples of a LOD's face on average: about as many as in the paper's table 1.
const SAMPLES_PER_FACE: f64 = 8.0;

/// Most samples of one face, in means: large faces must not take them from small ones, where the detail is.
const MOST_MEANS: f64 = 8.0;

/// Samples of a LOD, however few its faces are: vertex values of a few faces are means over few samples each.
const LEAST_SAMPLES: f64 = 4096.0;

/// How a LOD of so many faces is sampled in a level that is sampled so: a fixed number of samples per face, by area, that each
/// read a sphere by few rays, since the least squares average over them.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some ten thousand at most")]
pub fn lod_sampling(level: &Sampling, faces: usize) -> Sampling {
    let mean = SAMPLES_PER_FACE.max(LEAST_SAMPLES / faces.max(1) as f64);
    Sampling {
        target: None,
        rays_per_sample: RAYS_PER_SAMPLE,
        mean_samples_per_face: mean,
        density_per_m2: None,
        max_samples_per_face: (MOST_MEANS * mean) as u32,
        min_samples_per_face: 2,
        ..level.clone()
    }
}

/// Reads the moments of a run of a LOD's faces, for the ordinary solve to make vertex values of.
///
/// `tracer` traces the full-detail mesh alone, with nothing else of the level, and `baked` has its values; faces that do not
/// occlude are not met, so not read. `lod` is made
/// with [`lod_sampling`]; it has its samples at once, whatever it aims for, and its kernel and occluders have no say.
///
/// Each sample reads a sphere: its radius is twice the local distance between the LOD and the full mesh (the least that rays
/// along the sample's normal, against it and at 45° find to a face that faces the sample's way, but no less than 1/8192 of
/// the full mesh's diagonal and than rounding), and only fronts count whose normals are within 90° of the sample's. A sample that reads nothing
/// is invalid, and a position on a double-sided face has the mean of its valid sides, as in [`crate::trace_piece`].
///
/// Where this is not what the paper says, for decorators, of the same machinery: rays go through the whole sphere, not to
/// its centre only, since a LOD is as often outside the full mesh as inside, and rays that end on it there meet no front
/// (half of all samples were invalid, and least squares worse than reading at the vertices); and they come from the normal's
/// side, cosine-distributed, from where fronts are met (as good as twice as many from everywhere). The weight is still the
/// distance to the boundary.
pub fn resample_lod(tracer: &dyn Tracer, baked: &BakedSurface<'_>, lod: &Piece<'_>) -> Result<FaceMoments, TraceError> {
    let batches = batches(lod);
    let samples: Vec<SurfaceSample> = batches.iter().flat_map(|batch| &batch.samples).copied().collect();
    let found = read_near(tracer, baked, &samples, lod.sampling.rays_per_sample)?;
    let channels = baked.channel_count();
    let mut moments = FaceMoments::new(channels);
    let mut readings = found.readings.iter().map(|reading| (reading.hits > 0).then_some(reading.ao));
    for batch in &batches {
        let mut positions = batch.positions.iter();
        for counts in batch.counts.chunks_exact(2) {
            let mut halves = [HalfMoments::default(); 2];
            for (half, count) in halves.iter_mut().zip(counts) {
                for position in positions.by_ref().take(*count) {
                    let sides = readings.by_ref().take(position.sides);
                    moments.summary.invalid += add_sides(half, position, sides, channels);
                }
            }
            moments.push(&halves);
        }
    }
    moments.summary.samples = samples.len() as u64;
    moments.summary.rays = found.rays;
    Ok(moments)
}

/// The samples of a LOD's faces, both halves of each face one after the other.
fn batches(lod: &Piece<'_>) -> Vec<Batch> {
    let sampling = lod.sampling;
    let maker = SampleMaker::new(lod.mesh, lod.world_from_object, sampling.seed, sampling.rays_per_sample);
    let batch = |(index, counts): (usize, &[[u32; 2]])| {
        let mut batch = Batch::default();
        for (face, counts) in counts.iter().enumerate() {
            for (half, count) in counts.iter().enumerate() {
                let before = batch.positions.len();
                maker.half(lod.faces.start + index * FACES_PER_BATCH + face, half, 0..*count, &mut batch);
                batch.counts.push(batch.positions.len() - before);
            }
        }
        batch
    };
    lod.first_counts().par_chunks(FACES_PER_BATCH).enumerate().map(batch).collect()
}
