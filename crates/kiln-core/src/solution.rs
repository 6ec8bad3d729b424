//! What solving brings back: a value for each vertex and channel of an instance, and how it was found.

use crate::TraceSummary;
use serde::{Deserialize, Serialize};

/// Vertex values of one instance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// Number of channels.
    pub channels: u32,
    /// `vertices × channels` values in [0, 1], in the order of the mesh's vertices.
    pub values: Vec<f32>,
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

/// Estimated error of the values, from the two halves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct ErrorEstimate {
    /// Area-weighted root mean square.
    pub rmse: f64,
    /// Area-weighted 99th percentile of the absolute error at vertices.
    pub p99: f64,
    /// Greatest absolute error at a vertex.
    pub max: f64,
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
    /// World-space area with valid samples, square metres.
    pub sampled_area_m2: f64,
    /// Estimated error for each channel.
    pub error: Vec<ErrorEstimate>,
    /// Totals of the trace tasks.
    pub trace: TraceSummary,
}
