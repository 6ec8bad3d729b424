//! Alternating least squares: local AO of a model given the y of all its instances, then y given local AO. The future
//! work of Sloan et al. 2013.
//!
//! The objective of a channel is `Σ_j Σ_i w (f − G_j L)² + c (α Σ (r·d)² + μ Σ area d²)` with `d = L − L0`: r are the
//! regulariser rows of the solve of an instance, L0 is the start and c the mean of `Σ_j G_j²` at the start, so that α and μ
//! mean what they mean there. It is the change that is kept smooth and small, not L itself: the start has no penalty,
//! so the error in the end, whatever the penalty, is at most the error at the start. And it settles the scale between
//! L and y, which the error alone leaves open (`gauge`).
//!
//! Every half-step is checked with the values as they are stored; none raises the objective.

use super::{
    channel::{ChannelState, Signal},
    error::{TreeError, check_length},
    fit::TreeFit,
    samples::ModelSamples,
    unknowns::ModelUnknowns,
};
use crate::instance::{check_mesh, check_settings};
use kiln_core::{Digest, Mesh, SolveSettings};

/// A model with its local AO.
#[derive(Clone, Copy, Debug)]
pub struct TreeModel<'a> {
    /// The mesh, object space.
    pub mesh: &'a Mesh,
    /// Its samples.
    pub samples: &'a ModelSamples,
    /// Local AO, `vertices × channels`, in [0, 1].
    pub local: &'a [f32],
    /// Number of channels, 1 to [`kiln_core::MAX_CHANNELS`].
    pub channels: usize,
}

/// The signal that one instance of a model should have.
#[derive(Clone, Copy, Debug)]
pub struct TreeInstance<'a> {
    /// What orders the instances, so that the order they are given in changes nothing. Equal keys are ordered by their
    /// values.
    pub key: Digest,
    /// f at the model's samples, `samples × channels`; not finite where it is not valid.
    pub values: &'a [f32],
}

/// How local AO is alternated with the instances' fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlternateParams {
    /// The most rounds, each of a half-step for L and one for y.
    pub rounds: usize,
    /// A round that takes no more than this part of the objective is the last.
    pub tolerance: f64,
    /// Weight α of the edge regulariser on the change of L.
    pub regularization: f64,
    /// Weight μ of the anchor to the start.
    pub anchor: f64,
    /// Vertices at one position whose normals are within this angle have one value, degrees.
    pub weld_degrees: f64,
}

impl Default for AlternateParams {
    fn default() -> Self {
        let SolveSettings { regularization, anchor, weld_degrees, .. } = SolveSettings::default();
        Self { rounds: 8, tolerance: 1e-3, regularization, anchor, weld_degrees }
    }
}

/// The objective after a half-step; the unit is that of the samples' weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfStep {
    /// With the penalty. It never rises.
    pub objective: f64,
    /// `Σ_j Σ_i w (f − G_j L)²`.
    pub squared_error: f64,
}

/// What alternation finds.
#[derive(Clone, Debug, PartialEq)]
pub struct Alternated {
    /// Number of channels.
    pub channels: usize,
    /// Local AO, `vertices × channels`, in [0, 1].
    pub local: Vec<f32>,
    /// The fits, `instances × channels`, in the order in which the instances were given.
    pub fits: Vec<TreeFit>,
    /// For each channel: the start, where y is fitted to the model's own L, then in turn after L (with its scale) and after y.
    pub steps: Vec<Vec<HalfStep>>,
}

/// Alternates between local AO and the instances' fits, channel by channel.
///
/// Welded vertices start from their mean; solved local AO has one value there. Without instances, or with none that is
/// valid, L stays as it is. The result depends neither on the number of threads nor on the order of the instances.
///
/// # Errors
/// If the mesh, the samples, the values or the settings do not fit together.
pub fn alternate(
    model: &TreeModel<'_>,
    instances: &[TreeInstance<'_>],
    params: &AlternateParams,
) -> Result<Alternated, TreeError> {
    model.check(instances)?;
    params.check()?;
    let unknowns = ModelUnknowns::new(model.mesh, model.samples, params);
    let (channels, order) = (model.channels, content_order(instances));
    let mut found = Alternated {
        channels,
        local: vec![0.0; model.local.len()],
        fits: vec![TreeFit::NONE; instances.len() * channels],
        steps: Vec::with_capacity(channels),
    };
    for channel in 0..channels {
        let signals = order.iter().map(|j| Signal { values: instances[*j].values, channels, channel }).collect();
        let start = unknowns.gather(model.local.iter().skip(channel).step_by(channels).copied());
        let mut state = ChannelState::new(model.samples, &unknowns, signals, start, params);
        found.steps.push(run(&mut state, params));
        found.take(channel, &state, &order);
    }
    Ok(found)
}

/// Rounds until one takes little.
fn run(state: &mut ChannelState<'_>, params: &AlternateParams) -> Vec<HalfStep> {
    let mut steps = vec![state.step()];
    for _ in 0..params.rounds {
        let before = state.step().objective;
        state.step_local();
        state.step_scale();
        steps.push(state.step());
        state.step_fits();
        steps.push(state.step());
        if before - state.step().objective <= params.tolerance * before {
            break;
        }
    }
    steps
}

/// The instances in the order of their keys, then of their values' bits.
pub(crate) fn content_order(instances: &[TreeInstance<'_>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..instances.len()).collect();
    order.sort_by(|a, b| {
        let [a, b] = [&instances[*a], &instances[*b]];
        let bits =
            |instance: &TreeInstance<'_>| instance.values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        a.key.cmp(&b.key).then_with(|| bits(a).cmp(&bits(b)))
    });
    order
}

impl Alternated {
    #[expect(clippy::cast_possible_truncation, reason = "the values are rounded to f32 already")]
    fn take(&mut self, channel: usize, state: &ChannelState<'_>, order: &[usize]) {
        for (vertex, unknown) in state.unknowns.of_vertex.iter().enumerate() {
            self.local[vertex * self.channels + channel] = state.local[*unknown as usize] as f32;
        }
        for (instance, fit) in order.iter().zip(&state.fits) {
            self.fits[instance * self.channels + channel] = *fit;
        }
    }
}

impl TreeModel<'_> {
    /// Whether the parts and the instances' values fit together.
    pub(crate) fn check(&self, instances: &[TreeInstance<'_>]) -> Result<(), TreeError> {
        check_mesh(self.mesh)?;
        check_length("vertices of the sampled mesh", self.samples.vertices, self.mesh.positions.len())?;
        self.samples.local(self.local, self.channels)?;
        let expected = self.samples.len() * self.channels;
        instances.iter().try_for_each(|i| check_length("values of the signal", i.values.len(), expected))
    }
}

impl AlternateParams {
    fn check(&self) -> Result<(), TreeError> {
        Ok(check_settings(&[
            ("tolerance", self.tolerance),
            ("regularization", self.regularization),
            ("anchor", self.anchor),
            ("weld_degrees", self.weld_degrees),
        ])?)
    }
}
