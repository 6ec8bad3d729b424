//! The boundary between the mesh and the solvers: one component's linear system and its answer.

use crate::matrix::LowerCsc;
use kiln_core::ComponentMethod;

/// One connected component: `A δ = r0` for several right-hand sides.
///
/// The unknown is the correction δ to the local averages x0, and the right-hand side their residual
/// `r0 = b − A x0`. A is symmetric and positive definite.
#[derive(Clone, Debug)]
pub struct ComponentSystem {
    /// `A = M + α R + μ W`, lower triangle.
    pub matrix: LowerCsc,
    /// The diagonal of the anchor within A: what a stronger anchor multiplies.
    pub anchor: Vec<f64>,
    /// `unknowns × columns`, the columns of one unknown together.
    pub rhs: Vec<f64>,
    /// Number of right-hand sides, 1 to [`MAX_COLUMNS`].
    pub columns: usize,
    /// The greatest distance, in edges, of an unknown that no sample reaches from one that some sample reaches:
    /// the condition of A grows with it.
    pub hole_depth: u32,
}

/// The most right-hand sides of one system: a value and a half difference for each channel.
pub const MAX_COLUMNS: usize = 2 * kiln_core::MAX_CHANNELS;

impl ComponentSystem {
    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.matrix.len()
    }

    /// Whether there is no unknown.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The same system with its anchor `factor` times as strong. The right-hand side stays: the anchor pulls δ
    /// towards 0.
    pub fn with_anchor(&self, factor: f64) -> Self {
        let mut stronger = self.clone();
        for (i, anchor) in stronger.anchor.iter_mut().enumerate() {
            stronger.matrix.add_diagonal(i, *anchor * (factor - 1.0));
            *anchor *= factor;
        }
        stronger
    }
}

/// What a solver found for one component, checked by its certificate.
#[derive(Clone, Debug, PartialEq)]
pub struct ComponentAnswer {
    /// The corrections, shaped as [`ComponentSystem::rhs`].
    pub correction: Vec<f64>,
    /// What found them in the end.
    pub method: ComponentMethod,
    /// Greatest `|r_i| / A_ii` over unknowns and columns.
    pub residual: f64,
    /// Iterations of conjugate gradients, 0 where none were tried.
    pub iterations: u64,
}
