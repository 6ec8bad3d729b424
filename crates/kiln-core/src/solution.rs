//! What solving brings back: a value for each vertex and channel of an instance, and how it was found.

use crate::TraceSummary;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Vertex values of one instance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// Number of channels.
    pub channels: u32,
    /// `vertices × channels` values in [0, 1], in the order of the mesh's vertices.
    pub values: Vec<f32>,
    /// `vertices × channels` deviations in [0, 1]: how far the signal strays from the values around each vertex, as the
    /// area-weighted root mean square of what the faces there leave.
    pub residuals: Vec<f32>,
    /// No face of the instance had a valid sample: the values are to be taken from the nearest other surface.
    pub unsampled: bool,
    /// How the values were found.
    pub summary: SolveSummary,
}

/// How a component was solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ComponentMethod {
    /// Dense Cholesky.
    Dense,
    /// Sparse Cholesky (faer LLT).
    Sparse,
    /// Preconditioned conjugate gradients.
    Pcg,
    /// Sparse Cholesky after conjugate gradients missed the certificate.
    SparseFallback,
    /// Sparse Cholesky with ten times the anchor.
    StrongAnchor,
    /// The local averages, because no solve met the certificate.
    Average,
    /// No valid sample: taken from the nearest valid surface.
    Filled,
}

/// Estimated error of the values, from the two halves. Areas are of what can be seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct ErrorEstimate {
    /// Area-weighted root mean square.
    pub rmse: f64,
    /// Area-weighted 99th percentile of the absolute error at vertices.
    pub p99: f64,
    /// Greatest absolute error at a vertex.
    pub max: f64,
    /// Area by absolute error, of which p99 is read off; those of several instances add up.
    pub histogram: ErrorHistogram,
}

impl ErrorEstimate {
    /// The estimate for a level, from those of its instances and the area of each that can be seen.
    pub fn of_level<'a>(instances: impl Iterator<Item = (f64, &'a Self)>) -> Self {
        let mut total = Self::default();
        let mut area = 0.0;
        for (area_m2, error) in instances {
            area += area_m2;
            total.rmse += area_m2 * error.rmse * error.rmse;
            total.max = total.max.max(error.max);
            total.histogram.merge(&error.histogram);
        }
        total.rmse = if area > 0.0 { (total.rmse / area).sqrt() } else { 0.0 };
        total.p99 = total.histogram.quantile(0.99).min(total.max);
        total
    }
}

/// Area by absolute error, in bins of an eighth of an octave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct ErrorHistogram {
    /// Number of the bin and its area, square metres; rising, none empty.
    bins: Vec<(u8, f64)>,
}

impl ErrorHistogram {
    const BINS_PER_OCTAVE: f64 = 8.0;
    const LAST: u8 = 160;

    /// Adds an area with an absolute error; errors below 2⁻²⁰ share a bin.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the bins")]
    pub fn add(&mut self, error: f64, area_m2: f64) {
        let bin = f64::from(Self::LAST) + (error.log2() * Self::BINS_PER_OCTAVE).ceil();
        self.add_bin(bin.clamp(0.0, f64::from(Self::LAST)) as u8, area_m2);
    }

    /// Adds another histogram.
    pub fn merge(&mut self, other: &Self) {
        other.bins.iter().for_each(|&(bin, area)| self.add_bin(bin, area));
    }

    /// The upper end of the bin that holds the quantile; 0 of an empty histogram and in the lowest bin.
    pub fn quantile(&self, fraction: f64) -> f64 {
        let wanted = fraction * self.bins.iter().map(|(_, area)| area).sum::<f64>();
        let mut below = 0.0;
        let reached = self.bins.iter().find(|(_, area)| {
            below += area;
            below >= wanted
        });
        match reached.or(self.bins.last()) {
            None | Some((0, _)) => 0.0,
            Some((bin, _)) => ((f64::from(*bin) - f64::from(Self::LAST)) / Self::BINS_PER_OCTAVE).exp2(),
        }
    }

    fn add_bin(&mut self, bin: u8, area_m2: f64) {
        match self.bins.binary_search_by_key(&bin, |(bin, _)| *bin) {
            Ok(at) => self.bins[at].1 += area_m2,
            Err(at) => self.bins.insert(at, (bin, area_m2)),
        }
    }
}

/// Faces that are too coarse for what lies on them: their samples stray from any linear function.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct CoarseFaces {
    /// How many.
    pub count: u64,
    /// Their world-space area that can be seen, square metres.
    pub visible_area_m2: f64,
    /// The worst few, the worst first.
    pub worst: Vec<CoarseFace>,
}

impl CoarseFaces {
    /// Deviation from which on a face counts: that of a step by 0.2 half-way across it. A tenth of the range of AO is seen
    /// at a glance, and no face of 16 rays per sample is named for the noise of their directions, which is below .063 and
    /// taken off (`kiln_solve::residual`).
    pub const LEAST_DEVIATION: f64 = 0.1;

    /// Adds those of another instance, but for the list of the worst.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.visible_area_m2 += other.visible_area_m2;
    }
}

/// A face that is too coarse.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoarseFace {
    /// Index in [`crate::Mesh::faces`].
    pub face: u32,
    /// Standard deviation of the signal about the values, 0 to 1, in the channel where it is greatest; what the noise of
    /// a sample's directions explains is not in it.
    pub deviation: f64,
}

/// How an instance was solved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct SolveSummary {
    /// Unknowns after welding.
    pub unknowns: u64,
    /// Non-zeros of the lower triangle of the matrix.
    pub nnz: u64,
    /// Connected components.
    pub components: u64,
    /// Components by method.
    pub methods: Vec<(ComponentMethod, u64)>,
    /// Greatest `|r_i| / A_ii` over unknowns and channels.
    pub residual: f64,
    /// Most iterations of conjugate gradients in a component.
    pub iterations: u64,
    /// World-space area that can be seen, by the fraction of samples that are valid, square metres.
    pub visible_area_m2: f64,
    /// Estimated error for each channel.
    pub error: Vec<ErrorEstimate>,
    /// Faces whose signal no linear function can hold.
    pub too_coarse: CoarseFaces,
    /// Totals of the trace tasks.
    pub trace: TraceSummary,
    /// The lanes that they ran in.
    pub trace_lanes: BTreeSet<String>,
}
