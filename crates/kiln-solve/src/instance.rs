//! The solve of one instance, from moments to vertex values.

use crate::{
    assemble::Assembly,
    chain::SolverParams,
    components::{Components, assembly_system},
    edges::Edges,
    estimate::Differences,
    fill::fill_unknowns,
    frame::Frame,
    parallel::solve_all,
    residual::{Residuals, face_variances},
    surface::Surface,
    system::ComponentAnswer,
    weld::Weld,
};
use glam::DAffine3;
use kiln_core::{ComponentMethod, FaceMoments, Mesh, Solution, SolveSettings, SolveSummary};
use std::collections::BTreeMap;

/// What a solve needs.
#[derive(Clone, Copy, Debug)]
pub struct SolveInput<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// The instance's transform; the translation does not matter.
    pub world_from_object: DAffine3,
    /// Moments with one entry for each face of the mesh, in order.
    pub moments: &'a FaceMoments,
    /// The settings.
    pub settings: &'a SolveSettings,
}

/// Input that does not fit together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// There is not one entry of moments for each face.
    #[error("the moments are of {moments} faces but the mesh has {faces}; trace all pieces of this mesh again")]
    FaceCount {
        /// Faces of the mesh.
        faces: usize,
        /// Entries of the moments.
        moments: usize,
    },
    /// An array of the mesh has another length than it must have.
    #[error("the mesh has {found} {what}, not {expected}; import the level again")]
    Length {
        /// The array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that goes with the rest of the mesh.
        expected: usize,
    },
    /// A face refers to something that the mesh does not have.
    #[error("face {face} refers to {what} {index} of {count}; import the level again")]
    Index {
        /// The face.
        face: usize,
        /// What it refers to.
        what: &'static str,
        /// The index.
        index: u32,
        /// How many there are.
        count: usize,
    },
    /// A position is not finite.
    #[error("vertex {vertex} has no finite position; import the level again")]
    Position {
        /// The vertex.
        vertex: usize,
    },
    /// A setting is out of its range.
    #[error("{setting} is {value}, but must be finite and at least 0; correct the setting")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// Its value.
        value: f64,
    },
    /// The mesh is beyond what 32-bit matrix indices hold.
    #[error("the mesh has {faces} faces, more than the {limit} that one solve can hold; split the mesh")]
    TooLarge {
        /// Faces of the mesh.
        faces: usize,
        /// The most faces of one mesh.
        limit: usize,
    },
}

/// Faces add at most three pairs for their edges and one and a half for opposite corners: all fit a `u32`.
const FACE_LIMIT: usize = 500_000_000;

/// Finds the vertex values of an instance from the moments of its faces.
pub fn solve(input: &SolveInput<'_>) -> Result<Solution, SolveError> {
    solve_with(input, &SolverParams::default())
}

/// [`solve`] with other solvers than the sizes of the components would choose.
pub fn solve_with(input: &SolveInput<'_>, params: &SolverParams) -> Result<Solution, SolveError> {
    input.check()?;
    let Some(frame) = Frame::new(input.mesh, &input.world_from_object) else {
        return Ok(input.unsampled(SolveSummary::default()));
    };
    let weld = Weld::new(input.mesh, &frame, input.settings.weld_degrees);
    let surface = Surface::new(input.mesh, &frame, &weld);
    let assembly = Assembly::new(&surface, &Edges::new(&surface), input.moments, input.settings);
    let components = Components::new(&surface);
    let mut solved = Solved::new(&components, &assembly, params);
    let mut summary = solved.summary(&surface, &components, &assembly, frame.unit_m);
    if !fill_unknowns(&surface.points, &solved.valid, &mut solved.values, assembly.channels) {
        return Ok(input.unsampled(summary));
    }
    let variances = face_variances(&surface, input.moments, &solved.values, input.settings.rays_per_sample);
    let (visible, channels) = (&assembly.visible, assembly.channels);
    let residuals = Residuals { surface: &surface, visible, variances: &variances, channels };
    summary.too_coarse = residuals.coarse_faces(frame.unit_m * frame.unit_m);
    Ok(input.solution(&weld, &solved.values, &residuals.at_unknowns(), summary))
}

impl SolveInput<'_> {
    fn check(&self) -> Result<(), SolveError> {
        let Self { mesh, moments, settings, .. } = self;
        let faces = mesh.faces.len();
        if moments.face_count() != faces {
            return Err(SolveError::FaceCount { faces, moments: moments.face_count() });
        }
        check_mesh(mesh)?;
        check_settings(&[
            ("regularization", settings.regularization),
            ("anchor", settings.anchor),
            ("weld_degrees", settings.weld_degrees),
        ])
    }

    /// The solution where nothing is known: fully open until the level's other instances fill it.
    fn unsampled(&self, mut summary: SolveSummary) -> Solution {
        let channels = self.moments.channel_count();
        summary.trace = self.moments.summary;
        summary.trace_lanes = self.moments.lanes.clone();
        summary.error.resize(channels, kiln_core::ErrorEstimate::default());
        let values = vec![1.0; self.mesh.positions.len() * channels];
        let residuals = vec![0.0; values.len()];
        Solution { channels: channels as u32, values, residuals, unsampled: true, summary }
    }

    fn solution(&self, weld: &Weld, values: &[f64], residuals: &[f64], mut summary: SolveSummary) -> Solution {
        let channels = self.moments.channel_count();
        summary.trace = self.moments.summary;
        summary.trace_lanes = self.moments.lanes.clone();
        let (values, residuals) = (at_vertices(weld, values, channels), at_vertices(weld, residuals, channels));
        Solution { channels: channels as u32, values, residuals, unsampled: false, summary }
    }
}

/// Whether the arrays of a mesh fit together, its indices are in range and its positions finite.
pub(crate) fn check_mesh(mesh: &Mesh) -> Result<(), SolveError> {
    let (vertices, faces) = (mesh.positions.len(), mesh.faces.len());
    if faces > FACE_LIMIT {
        return Err(SolveError::TooLarge { faces, limit: FACE_LIMIT });
    }
    let lengths = [("normals", mesh.normals.len(), vertices), ("face groups", mesh.face_group.len(), faces)];
    if let Some((what, found, expected)) = lengths.into_iter().find(|(_, found, expected)| found != expected) {
        return Err(SolveError::Length { what, found, expected });
    }
    for (face, (corners, group)) in mesh.faces.iter().zip(&mesh.face_group).enumerate() {
        if let Some(&index) = corners.iter().find(|v| **v as usize >= vertices) {
            return Err(SolveError::Index { face, what: "vertex", index, count: vertices });
        }
        if usize::from(*group) >= mesh.groups.len() {
            let (what, count) = ("group", mesh.groups.len());
            return Err(SolveError::Index { face, what, index: u32::from(*group), count });
        }
    }
    match mesh.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        Some(vertex) => Err(SolveError::Position { vertex }),
        None => Ok(()),
    }
}

/// Whether settings are finite and not negative.
pub(crate) fn check_settings(settings: &[(&'static str, f64)]) -> Result<(), SolveError> {
    match settings.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
        Some(&(setting, value)) => Err(SolveError::Setting { setting, value }),
        None => Ok(()),
    }
}

/// What each vertex has of its unknown, clamped to [0, 1].
#[expect(clippy::cast_possible_truncation, reason = "f32 is the precision of the output")]
fn at_vertices(weld: &Weld, of_unknowns: &[f64], channels: usize) -> Vec<f32> {
    let of_unknown = |u: &u32| &of_unknowns[*u as usize * channels..(*u as usize + 1) * channels];
    weld.unknown_of_vertex.iter().flat_map(of_unknown).map(|x| x.clamp(0.0, 1.0) as f32).collect()
}

/// The answers of all components, by unknown.
struct Solved {
    /// `unknowns × channels`; meaningless where not valid.
    values: Vec<f64>,
    /// Half the difference of the two halves' values.
    half_difference: Vec<f64>,
    /// Whether an unknown belongs to a component with valid samples.
    valid: Vec<bool>,
    methods: BTreeMap<ComponentMethod, u64>,
    residual: f64,
    iterations: u64,
}

impl Solved {
    fn new(components: &Components, assembly: &Assembly, params: &SolverParams) -> Self {
        let mut solved = Self {
            values: assembly.average.clone(),
            half_difference: vec![0.0; assembly.average.len()],
            valid: vec![false; assembly.weight.len()],
            methods: BTreeMap::new(),
            residual: 0.0,
            iterations: 0,
        };
        let is_sampled = |c: &usize| components.unknowns(*c).iter().any(|u| assembly.weight[*u as usize] > 0.0);
        let (sampled, empty): (Vec<usize>, Vec<usize>) = (0..components.count()).partition(is_sampled);
        if !empty.is_empty() {
            solved.methods.insert(ComponentMethod::Filled, empty.len() as u64);
        }
        for (component, answer) in solve_all(sampled, components, &assembly_system(assembly), params) {
            solved.take(components.unknowns(component), &answer, assembly.channels);
        }
        solved
    }

    fn take(&mut self, unknowns: &[u32], answer: &ComponentAnswer, channels: usize) {
        for (unknown, correction) in unknowns.iter().zip(answer.correction.chunks_exact(2 * channels)) {
            let at = *unknown as usize;
            self.valid[at] = true;
            let (value, difference) = correction.split_at(channels);
            for c in 0..channels {
                self.values[at * channels + c] += value[c];
                self.half_difference[at * channels + c] = difference[c];
            }
        }
        *self.methods.entry(answer.method).or_default() += 1;
        self.residual = self.residual.max(answer.residual);
        self.iterations = self.iterations.max(answer.iterations);
    }

    fn summary(&self, surface: &Surface, components: &Components, assembly: &Assembly, unit_m: f64) -> SolveSummary {
        let differences = Differences {
            surface,
            visible: &assembly.visible,
            weight: &assembly.weight,
            values: &self.values,
            half_difference: &self.half_difference,
            channels: assembly.channels,
            unit_m2: unit_m * unit_m,
        };
        let unused = assembly.weight.len() - components.unknown_count();
        SolveSummary {
            unknowns: components.unknown_count() as u64,
            nnz: (assembly.matrix.entry_count() - unused) as u64,
            components: components.count() as u64,
            methods: self.methods.iter().map(|(method, count)| (*method, *count)).collect(),
            residual: self.residual,
            iterations: self.iterations,
            visible_area_m2: differences.visible_area_m2(),
            error: differences.estimates(),
            too_coarse: Default::default(),
            trace: Default::default(),
            trace_lanes: Default::default(),
        }
    }
}
