//! The boundary between the mesh and the solvers: one component's linear system and its answer.

use crate::matrix::LowerCsc;
use kiln_core::ComponentMethod;
use std::borrow::Cow;

/// One connected component: `A δ = r0` for several right-hand sides. (Or all components of an instance together,
/// before they are parted.)
///
/// The unknown is the correction δ to the local averages x0, and the right-hand side their residual
/// `r0 = b − A x0`. A is symmetric and positive definite. A component that is the whole of its instance borrows.
#[derive(Clone, Debug, Default)]
pub struct ComponentSystem<'a> {
    /// `A = M + α R + μ W`, lower triangle.
    pub matrix: Cow<'a, LowerCsc>,
    /// The diagonal of the anchor within A: what a stronger anchor multiplies.
    pub anchor: Cow<'a, [f64]>,
    /// `unknowns × columns`, the columns of one unknown together.
    pub rhs: Cow<'a, [f64]>,
    /// Number of right-hand sides, 1 to [`MAX_COLUMNS`].
    pub columns: usize,
    /// How many edges each unknown that no sample reaches is from one that some sample reaches, 0 outside such
    /// holes: the condition of A grows with it.
    pub hole_ring: Cow<'a, [u32]>,
}

/// The most right-hand sides of one system: a value and a half difference for each channel.
pub const MAX_COLUMNS: usize = 2 * kiln_core::MAX_CHANNELS;

impl ComponentSystem<'_> {
    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.matrix.len()
    }

    /// Whether there is no unknown.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The greatest depth of a hole in edges.
    pub fn hole_depth(&self) -> u32 {
        self.hole_ring.iter().copied().max().unwrap_or(0)
    }

    /// The same system, borrowed.
    pub fn borrowed(&self) -> ComponentSystem<'_> {
        ComponentSystem {
            matrix: Cow::Borrowed(&*self.matrix),
            anchor: Cow::Borrowed(&*self.anchor),
            rhs: Cow::Borrowed(&*self.rhs),
            columns: self.columns,
            hole_ring: Cow::Borrowed(&*self.hole_ring),
        }
    }

    /// The same system, borrowing nothing.
    pub fn into_owned(self) -> ComponentSystem<'static> {
        ComponentSystem {
            matrix: Cow::Owned(self.matrix.into_owned()),
            anchor: Cow::Owned(self.anchor.into_owned()),
            rhs: Cow::Owned(self.rhs.into_owned()),
            columns: self.columns,
            hole_ring: Cow::Owned(self.hole_ring.into_owned()),
        }
    }

    /// The same system with its anchor `factor` times as strong. The right-hand side stays: the anchor pulls δ
    /// towards 0.
    pub fn with_anchor(&self, factor: f64) -> ComponentSystem<'_> {
        let mut stronger = self.borrowed();
        let matrix = stronger.matrix.to_mut();
        for (i, anchor) in stronger.anchor.to_mut().iter_mut().enumerate() {
            matrix.add_diagonal(i, *anchor * (factor - 1.0));
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
