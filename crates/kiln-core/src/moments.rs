//! What tracing brings back: per-face moments of the sampled signal, in two independent halves.
//!
//! For one face and one half, with barycentric coordinates φ of the samples and their values f:
//! `Σ φ_i f` (3 for each channel), `Σ f²` (each channel), `Σ φ_i φ_j` (6), and counts. Sums are over valid
//! samples and carry no weights: a weight is the face's area over the count, which the solve applies. They are
//! all that the solve, the error estimate and adaptive sampling need, whatever the number of samples.

use crate::MAX_CHANNELS;
use bytemuck::{cast_slice, pod_collect_to_vec};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

const MAGIC: [u8; 8] = *b"kilnMOM4";

/// Channels, faces, totals and the length of the lanes' names, 8 bytes each.
const HEADER_BYTES: usize = 88;

/// Moments of one half of a face's samples.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct HalfMoments {
    /// `Σ φ_i f` for each channel.
    pub phi_f: [[f64; 3]; MAX_CHANNELS],
    /// `Σ f²` for each channel.
    pub f_squared: [f64; MAX_CHANNELS],
    /// `Σ φ_i φ_j`: 00, 11, 22, 01, 02, 12.
    pub phi_phi: [f64; 6],
    /// Valid samples.
    pub valid: u32,
    /// Samples taken, valid or not.
    pub taken: u32,
}

impl HalfMoments {
    /// Adds a valid sample at barycentric coordinates `phi` with one value for each channel.
    pub fn add(&mut self, phi: [f64; 3], values: &[f64]) {
        for (channel, &f) in values.iter().enumerate() {
            for (sum, p) in self.phi_f[channel].iter_mut().zip(phi) {
                *sum += p * f;
            }
            self.f_squared[channel] += f * f;
        }
        let [a, b, c] = phi;
        for (sum, product) in self.phi_phi.iter_mut().zip([a * a, b * b, c * c, a * b, a * c, b * c]) {
            *sum += product;
        }
        self.valid += 1;
        self.taken += 1;
    }

    /// Counts a sample that is not valid.
    pub fn add_invalid(&mut self) {
        self.taken += 1;
    }
}

/// Totals of a trace task, for the report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TraceSummary {
    /// Sample points gathered; a double-sided face has two at each position.
    pub samples: u64,
    /// Of these, invalid by the back-face rule or without a direction above the surface.
    pub invalid: u64,
    /// Rays traced.
    pub rays: u64,
    /// Rays not traced because nothing lies within reach of their sample.
    pub rays_skipped_empty: u64,
    /// Rays that faces found to be wholly hidden did not get, though their visible neighbours did.
    pub rays_skipped_buried: u64,
    /// Rays that the same estimated error would have cost with as many samples on every face, less those it cost.
    pub rays_saved_adaptive: u64,
    /// Of the rays traced, those of samples whose reach does not cover all that their instance's rays may come to.
    pub rays_cut: u64,
    /// Rays that faces which repeat others would have cost: as many as the faces of their instance had on average. Known
    /// once the instance is exported.
    pub rays_skipped_duplicate: u64,
}

impl TraceSummary {
    /// Adds another task's totals.
    pub fn merge(&mut self, other: &Self) {
        self.samples += other.samples;
        self.invalid += other.invalid;
        self.rays += other.rays;
        self.rays_skipped_empty += other.rays_skipped_empty;
        self.rays_skipped_buried += other.rays_skipped_buried;
        self.rays_saved_adaptive += other.rays_saved_adaptive;
        self.rays_cut += other.rays_cut;
        self.rays_skipped_duplicate += other.rays_skipped_duplicate;
    }
}

/// Moments of a run of faces, as kept in an artefact: f32 sums (each rounded once from f64, relative error 6e-8).
#[derive(Clone, Debug, PartialEq)]
pub struct FaceMoments {
    channels: usize,
    /// For each face and half: phi_f (3 × channels), f_squared (channels), phi_phi (6).
    sums: Vec<f32>,
    /// For each face: valid and taken of half 0, then of half 1.
    counts: Vec<[u32; 4]>,
    /// Totals for the report.
    pub summary: TraceSummary,
    /// The lanes that traced the run, for the report; names without line breaks.
    pub lanes: BTreeSet<String>,
}

/// Bytes that are no moments.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("these are no face moments: {reason}; the artefact is damaged or of another version")]
pub struct MomentsError {
    /// What is wrong.
    pub reason: &'static str,
}

impl FaceMoments {
    /// An empty run for the given number of channels, 1 to [`MAX_CHANNELS`].
    pub fn new(channels: usize) -> Self {
        debug_assert!((1..=MAX_CHANNELS).contains(&channels));
        Self {
            channels,
            sums: Vec::new(),
            counts: Vec::new(),
            summary: TraceSummary::default(),
            lanes: BTreeSet::new(),
        }
    }

    /// Number of channels.
    pub fn channel_count(&self) -> usize {
        self.channels
    }

    /// Number of faces.
    pub fn face_count(&self) -> usize {
        self.counts.len()
    }

    fn half_stride(&self) -> usize {
        4 * self.channels + 6
    }

    /// Appends one face.
    #[expect(clippy::cast_possible_truncation, reason = "f32 is the stored precision")]
    pub fn push(&mut self, halves: &[HalfMoments; 2]) {
        for half in halves {
            let phi_f = half.phi_f[..self.channels].iter().flatten();
            self.sums.extend(phi_f.chain(&half.f_squared[..self.channels]).chain(&half.phi_phi).map(|&v| v as f32));
        }
        self.counts.push([halves[0].valid, halves[0].taken, halves[1].valid, halves[1].taken]);
    }

    /// The two halves of a face.
    pub fn face(&self, face: usize) -> [HalfMoments; 2] {
        let stride = self.half_stride();
        let counts = self.counts[face];
        std::array::from_fn(|half| {
            let sums = &self.sums[(2 * face + half) * stride..][..stride];
            let mut moments =
                HalfMoments { valid: counts[2 * half], taken: counts[2 * half + 1], ..Default::default() };
            for channel in 0..self.channels {
                moments.phi_f[channel] = std::array::from_fn(|i| f64::from(sums[3 * channel + i]));
                moments.f_squared[channel] = f64::from(sums[3 * self.channels + channel]);
            }
            moments.phi_phi = std::array::from_fn(|i| f64::from(sums[4 * self.channels + i]));
            moments
        })
    }

    /// Appends the faces of another run and adds its totals.
    pub fn append(&mut self, other: &Self) {
        debug_assert_eq!(self.channels, other.channels);
        self.sums.extend_from_slice(&other.sums);
        self.counts.extend_from_slice(&other.counts);
        self.summary.merge(&other.summary);
        self.lanes.extend(other.lanes.iter().cloned());
    }

    /// The artefact's bytes: magic, channels, faces, totals, length of the names, counts, sums; little-endian; then
    /// the lanes' names, a line each.
    pub fn to_bytes(&self) -> Vec<u8> {
        let s = &self.summary;
        let saved = [s.rays_skipped_empty, s.rays_skipped_buried, s.rays_saved_adaptive, s.rays_skipped_duplicate];
        let counts = [self.channels as u64, self.counts.len() as u64, s.samples, s.invalid];
        let names: String = self.lanes.iter().flat_map(|lane| [lane.as_str(), "\n"]).collect();
        let header = [&counts[..], &[s.rays, s.rays_cut], &saved, &[names.len() as u64]].concat();
        let mut bytes = MAGIC.to_vec();
        bytes.extend(header.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend_from_slice(cast_slice(&self.counts));
        bytes.extend_from_slice(cast_slice(&self.sums));
        bytes.extend_from_slice(names.as_bytes());
        bytes
    }

    /// Reads an artefact; every size is checked before anything is allocated.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MomentsError> {
        let error = |reason| MomentsError { reason };
        let body = bytes.strip_prefix(&MAGIC).ok_or(error("the magic number is missing"))?;
        let (header, body) = body.split_at_checked(HEADER_BYTES).ok_or(error("the header is cut short"))?;
        let mut fields = [0u64; HEADER_BYTES / 8];
        for (field, chunk) in fields.iter_mut().zip(header.chunks_exact(8)) {
            *field = u64::from_le_bytes(chunk.try_into().map_err(|_| error("the header is cut short"))?);
        }
        let [channels, faces, samples, invalid, rays, rays_cut, rest @ ..] = fields;
        let [rays_skipped_empty, rays_skipped_buried, rays_saved_adaptive, rays_skipped_duplicate, name_bytes] = rest;
        if !(1..=MAX_CHANNELS as u64).contains(&channels) {
            return Err(error("the number of channels is out of range"));
        }
        let face_bytes = 16 + 2 * (4 * channels + 6) * 4;
        if faces.checked_mul(face_bytes).and_then(|size| size.checked_add(name_bytes)) != Some(body.len() as u64) {
            return Err(error("the size does not match the number of faces"));
        }
        let (body, names) = body.split_at(body.len() - name_bytes as usize);
        let names = std::str::from_utf8(names).map_err(|_| error("a lane's name is no UTF-8"))?;
        let (counts, sums) = body.split_at(faces as usize * 16);
        let counts: Vec<[u32; 4]> = pod_collect_to_vec(counts);
        if counts.iter().any(|[a, of_a, b, of_b]| a > of_a || b > of_b) {
            return Err(error("a face has more valid samples than samples"));
        }
        let sums: Vec<f32> = pod_collect_to_vec(sums);
        if !sums.iter().all(|v| v.is_finite()) {
            return Err(error("a sum is not finite"));
        }
        let summary = TraceSummary {
            samples,
            invalid,
            rays,
            rays_skipped_empty,
            rays_skipped_buried,
            rays_saved_adaptive,
            rays_cut,
            rays_skipped_duplicate,
        };
        let lanes = names.lines().map(str::to_owned).collect();
        Ok(Self { channels: channels as usize, sums, counts, summary, lanes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_and_back() {
        let mut half = HalfMoments::default();
        half.add([0.25, 0.25, 0.5], &[0.5, 1.0]);
        half.add_invalid();
        let mut moments = FaceMoments::new(2);
        moments.push(&[half, HalfMoments::default()]);
        moments.summary.rays = 7;
        moments.lanes = ["cpu", "gpu:Card:d+1"].map(str::to_owned).into();
        let bytes = moments.to_bytes();
        let back = FaceMoments::from_bytes(&bytes).unwrap();
        assert_eq!(back, moments);
        assert_eq!(back.face(0), [half, HalfMoments::default()]);
        for cut in 0..bytes.len() {
            assert!(FaceMoments::from_bytes(&bytes[..cut]).is_err());
        }
    }
}
