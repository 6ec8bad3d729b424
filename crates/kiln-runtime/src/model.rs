//! Models of what moving objects see in a region (Sloan et al. 2013, equation 4).
//!
//! About a centre c, a coefficient at a point p is `mean + Σ over the axes (p − c)_i · slope_{2i + s_i}`, with s_i = 0
//! where (p − c)_i ≥ 0, else 1: a vector difference and three multiply-adds. Parameters come row by row (the mean, then
//! the slopes per metre to +x, −x, +y, −y, +z and −z), so that a row's coefficients stand side by side and four of the
//! seven rows are read. `shaders/kiln_runtime.wgsl` does the same; keep them in sync.
//!
//! Nothing bounds what a model says outside the box that it was fitted in: give it points that are clamped to it
//! ([`crate::Region::clamp`]), as [`crate::Pack::engine_at`] and [`crate::Pack::full_at`] do.

use crate::{
    bytes::{array_at, f32_at, floats_at, u32_at},
    format::{HARMONICS, PARAMETERS, model_engine, model_full},
    half,
};

/// Rows of the slopes that hold on this side of the centre, and the distances from it.
#[inline]
fn sides(center: [f32; 3], point: [f32; 3]) -> ([usize; 3], [f32; 3]) {
    let offset: [f32; 3] = core::array::from_fn(|i| point[i] - center[i]);
    (core::array::from_fn(|i| 1 + 2 * i + usize::from(offset[i] < 0.0)), offset)
}

/// A coefficient from its parameters in four rows.
#[inline]
fn along(mean: f32, slopes: [f32; 3], offset: [f32; 3]) -> f32 {
    mean + offset[0] * slopes[0] + offset[1] * slopes[1] + offset[2] * slopes[2]
}

/// A model in the engine's form, in a pack: linear harmonics of one function (the blend of the channels), half floats.
#[derive(Clone, Copy, Debug)]
pub struct EngineModel<'a> {
    bytes: &'a [u8; model_engine::BYTES],
}

impl<'a> EngineModel<'a> {
    /// From a record of [`crate::SectionKind::ModelsEngine`]: 12 bytes of centre and 56 of parameters.
    pub(crate) fn new(record: &'a [u8]) -> Option<Self> {
        Some(Self { bytes: array_at(record, 0)? })
    }

    /// c, metres relative to the level's origin.
    pub fn center(&self) -> [f32; 3] {
        floats_at(self.bytes, model_engine::CENTER)
    }

    #[inline]
    fn row(&self, row: usize) -> [f32; 4] {
        let bytes: &[u8; 8] = array_at(self.bytes, model_engine::PARAMETERS + 8 * row).unwrap_or(&[0; 8]);
        let halves: [u32; 4] =
            core::array::from_fn(|i| u32::from(u16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]])));
        half::finite_to_f32(halves)
    }

    /// Coefficients of AO at a point, in linear harmonics. Metres relative to the level's origin.
    #[inline]
    pub fn at(&self, point: [f32; 3]) -> [f32; 4] {
        let (rows, offset) = sides(self.center(), point);
        let (mean, slopes) = (self.row(0), rows.map(|row| self.row(row)));
        core::array::from_fn(|k| along(mean[k], slopes.map(|slope| slope[k]), offset))
    }

    /// The same as floats, for an engine that keeps the models it is near to.
    pub fn decode(&self) -> LinearModel {
        LinearModel { center: self.center(), parameters: core::array::from_fn(|row| self.row(row)) }
    }

    /// The record's bytes, for an engine that uploads them: `shaders/kiln_runtime.wgsl` takes them as 17 words.
    pub const fn bytes(&self) -> &'a [u8; model_engine::BYTES] {
        self.bytes
    }
}

/// A model in the engine's form as floats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearModel {
    /// c, metres relative to the level's origin.
    pub center: [f32; 3],
    /// Linear coefficients: the mean, then the slopes per metre to +x, −x, +y, −y, +z and −z.
    pub parameters: [[f32; 4]; PARAMETERS],
}

impl LinearModel {
    /// Coefficients of AO at a point, in linear harmonics. Metres relative to the level's origin.
    #[inline]
    pub fn at(&self, point: [f32; 3]) -> [f32; 4] {
        let (rows, offset) = sides(self.center, point);
        let (mean, slopes) = (self.parameters[0], rows.map(|row| self.parameters[row]));
        core::array::from_fn(|k| along(mean[k], slopes.map(|slope| slope[k]), offset))
    }
}

/// A full model, in a pack: quadratic harmonics of all channels, floats.
#[derive(Clone, Copy, Debug)]
pub struct FullModel<'a> {
    /// A whole record.
    bytes: &'a [u8],
    channels: usize,
}

impl<'a> FullModel<'a> {
    /// From a record of [`crate::SectionKind::ModelsFull`].
    pub(crate) const fn new(bytes: &'a [u8], channels: usize) -> Self {
        Self { bytes, channels }
    }

    /// c, metres relative to the level's origin.
    pub fn center(&self) -> [f32; 3] {
        floats_at(self.bytes, model_full::CENTER)
    }

    /// Index of the region that it was fitted to; others may have been absorbed by it.
    pub fn region(&self) -> u32 {
        u32_at(self.bytes, model_full::REGION)
    }

    /// A parameter (0 to 6) of a channel's harmonic (0 to 8): 0 is the mean, then the slopes to +x, −x, +y, −y, +z and −z.
    /// What is not there is 0.
    pub fn parameter(&self, parameter: usize, channel: usize, harmonic: usize) -> f32 {
        let is_there = parameter < PARAMETERS && channel < self.channels && harmonic < HARMONICS;
        let index = if is_there { (parameter * self.channels + channel) * HARMONICS + harmonic } else { return 0.0 };
        f32_at(self.bytes, model_full::PARAMETERS + 4 * index)
    }

    /// Quadratic coefficients of a channel's AO at a point; none where there is no such channel. Metres relative to the
    /// level's origin.
    #[inline]
    pub fn at(&self, point: [f32; 3], channel: usize) -> Option<[f32; HARMONICS]> {
        if channel >= self.channels {
            return None;
        }
        let (rows, offset) = sides(self.center(), point);
        let mean = self.row(0, channel)?;
        let slopes = [self.row(rows[0], channel)?, self.row(rows[1], channel)?, self.row(rows[2], channel)?];
        Some(core::array::from_fn(|k| along(float(mean, k), slopes.map(|slope| float(slope, k)), offset)))
    }

    #[inline]
    fn row(&self, row: usize, channel: usize) -> Option<&'a [u8; 4 * HARMONICS]> {
        array_at(self.bytes, model_full::PARAMETERS + 4 * HARMONICS * (row * self.channels + channel))
    }
}

#[inline]
fn float(row: &[u8; 4 * HARMONICS], index: usize) -> f32 {
    f32_at(row, 4 * index)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_side_of_the_centre_has_its_slope() {
        let mut model = LinearModel { center: [1.0, 2.0, 3.0], parameters: [[0.0; 4]; PARAMETERS] };
        model.parameters[0] = [0.5, 1.0, 2.0, 4.0];
        for (row, slope) in [0.1, -0.2, 0.0, 0.0, 0.3, 0.4].into_iter().enumerate() {
            model.parameters[row + 1] = [slope, 0.0, 0.0, 0.0];
        }
        let near = |point: [f32; 3], expected: f32| {
            let coefficients = model.at(point);
            assert!(
                (coefficients[0] - expected).abs() < 1e-6 && coefficients[1..] == [1.0, 2.0, 4.0],
                "{coefficients:?}"
            );
        };
        near([1.0, 2.0, 3.0], 0.5);
        near([3.0, 9.0, 3.0], 0.7);
        near([0.0, 2.0, 2.0], 0.5 + 0.2 - 0.4);
        near([1.0, 0.0, 4.0], 0.8);
    }

    /// A record by hand, by the layout of docs/pack-format.md.
    #[test]
    fn a_record_of_halves_is_its_model() {
        let mut record = [0u8; model_engine::BYTES + 4];
        for (i, c) in [1.5f32, -2.0, 8.0].into_iter().enumerate() {
            record[4 * i..4 * i + 4].copy_from_slice(&c.to_le_bytes());
        }
        for i in 0..4 * PARAMETERS {
            let value = half::from_f32(i as f32 / 8.0 - 1.0);
            record[12 + 2 * i..14 + 2 * i].copy_from_slice(&value.to_le_bytes());
        }
        let model = EngineModel::new(&record).unwrap();
        assert_eq!(model.decode().center, [1.5, -2.0, 8.0]);
        assert_eq!(model.decode().parameters[3], [0.5, 0.625, 0.75, 0.875]);
        for point in [[1.5, -2.0, 8.0], [2.0, -3.0, 7.0], [-4.0, 5.0, 9.0]] {
            assert_eq!(model.at(point), model.decode().at(point));
        }
        assert!(EngineModel::new(&record[..model_engine::BYTES - 1]).is_none());
    }
}
