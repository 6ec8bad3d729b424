//! What was baked, and how.

use super::{Channels, sections::Sections};
use crate::{
    Curve, PackError, Remap,
    bytes::{array_at, f32_at, f64_at, floats_at, u32_at},
    format::{MAX_CHANNELS, MAX_CURVE_POINTS, SectionKind, meta},
};

/// The value of a ray as a function of the distance t to what it hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kernel {
    /// `1 − 2^(−t/d)` for each half-distance d.
    Obscurance = 0,
    /// 0 for a hit nearer than the distance, else 1.
    Occlusion = 1,
    /// One that a newer minor version has.
    Other = u32::MAX,
}

/// What was baked, and how.
#[derive(Clone, Debug)]
pub struct Meta<'a> {
    level_digest: &'a [u8; 32],
    origin: [f64; 3],
    channels: usize,
    kernel: Kernel,
    half_distances: Channels,
    blend: Channels,
    version: &'a str,
    remap: Remap<'a>,
}

impl<'a> Meta<'a> {
    /// Digest (BLAKE3) of the level as imported.
    pub const fn level_digest(&self) -> &'a [u8; 32] {
        self.level_digest
    }

    /// Where points are relative to, metres in the level's own coordinates.
    pub const fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// A point of the level relative to its origin, as all evaluation takes it.
    pub fn local(&self, point: [f64; 3]) -> [f32; 3] {
        core::array::from_fn(|i| (point[i] - self.origin[i]) as f32)
    }

    /// Number of channels, 1 to 4.
    pub const fn channels(&self) -> usize {
        self.channels
    }

    /// What a ray is worth.
    pub const fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Half-distance of each channel, metres; of [`Kernel::Occlusion`] the one distance, which may be infinite.
    pub fn half_distances(&self) -> &[f32] {
        &self.half_distances[..self.channels]
    }

    /// Weight of each channel in the blend; their sum is 1.
    pub fn blend(&self) -> &[f32] {
        &self.blend[..self.channels]
    }

    /// Version of the Kiln that baked.
    pub const fn version(&self) -> &'a str {
        self.version
    }

    /// The curve that the level's author asked for over the blend.
    pub const fn remap(&self) -> Remap<'a> {
        self.remap
    }

    pub(super) fn parse(sections: &Sections<'a>, strings: &'a str) -> Result<Self, PackError> {
        let kind = SectionKind::Meta;
        let record = sections.get(kind).record(0).ok_or(PackError::Missing { kind })?;
        let wrong = |problem| PackError::Record { kind, index: 0, problem };
        if record.len() < meta::BYTES {
            return Err(wrong("too few fields"));
        }
        let channels = u32_at(record, meta::CHANNELS) as usize;
        if !(1..=MAX_CHANNELS).contains(&channels) {
            return Err(wrong("no channels, or more than 4"));
        }
        let kernel = match u32_at(record, meta::KERNEL) {
            0 => Kernel::Obscurance,
            1 => Kernel::Occlusion,
            _ => Kernel::Other,
        };
        let origin = core::array::from_fn(|i| f64_at(record, meta::ORIGIN + 8 * i));
        if !origin.iter().all(|x| x.is_finite()) {
            return Err(wrong("an origin that is not finite"));
        }
        let half_distances: Channels = floats_at(record, meta::HALF_DISTANCES);
        if !half_distances[..channels].iter().all(|distance| *distance > 0.0) {
            return Err(wrong("a half-distance that is not positive"));
        }
        Ok(Self {
            level_digest: array_at(record, meta::LEVEL_DIGEST).ok_or(wrong("too few fields"))?,
            origin,
            channels,
            kernel,
            half_distances,
            blend: blend(record, channels).ok_or(wrong("weights of a blend that are not positive"))?,
            version: string(strings, record, meta::VERSION).ok_or(wrong("a version that is no text"))?,
            remap: remap(sections, record)?,
        })
    }
}

/// Weights from 0 whose sum is 1.
fn blend(record: &[u8], channels: usize) -> Option<Channels> {
    let mut weights: Channels = floats_at(record, meta::BLEND);
    weights[channels..].fill(0.0);
    let sum: f32 = weights.iter().sum();
    let is_good = weights.iter().all(|weight| *weight >= 0.0) && sum > 0.0 && sum.is_finite();
    is_good.then(|| weights.map(|weight| weight / sum))
}

/// Text that a record refers to.
pub(super) fn string<'a>(strings: &'a str, record: &[u8], at: usize) -> Option<&'a str> {
    let (offset, size) = (u32_at(record, at) as usize, u32_at(record, at + 4) as usize);
    strings.get(offset..)?.get(..size)
}

fn remap<'a>(sections: &Sections<'a>, record: &[u8]) -> Result<Remap<'a>, PackError> {
    let wrong = |problem| PackError::Record { kind: SectionKind::Meta, index: 0, problem };
    match u32_at(record, meta::REMAP) {
        0 => Ok(Remap::None),
        1 => {
            let gamma = f32_at(record, meta::GAMMA);
            let is_good = gamma > 0.0 && gamma.is_finite();
            is_good.then_some(Remap::Gamma(gamma)).ok_or(wrong("a gamma that is not positive"))
        }
        2 => curve(sections).map(Remap::Curve),
        _ => Err(wrong("a remap that this version does not know")),
    }
}

fn curve<'a>(sections: &Sections<'a>) -> Result<Curve<'a>, PackError> {
    let kind = SectionKind::RemapCurve;
    let table = sections.get(kind);
    if table.count() == 0 {
        return Err(PackError::Missing { kind });
    }
    let wrong = |index, problem| PackError::Record { kind, index, problem };
    if table.stride() < kind.record_bytes(1) {
        return Err(wrong(0, "too few fields"));
    }
    if table.count() > MAX_CURVE_POINTS {
        return Err(wrong(MAX_CURVE_POINTS as u32, "a number above the limit"));
    }
    let curve = Curve::new(table.bytes(), table.stride(), table.count());
    let mut below = f32::NEG_INFINITY;
    for (index, record) in table.records() {
        let [input, output] = floats_at(record, 0);
        if !(input.is_finite() && output.is_finite() && input > below) {
            return Err(wrong(index, "an input that does not rise, or a number that is not finite"));
        }
        below = input;
    }
    Ok(curve)
}
