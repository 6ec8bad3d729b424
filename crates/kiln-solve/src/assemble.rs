//! The linear system of an instance: `A = M + α R + κ L + μ W`, and the residual of the local averages.
//!
//! With S = Σ w φ φᵀ and m = Σ w φ f over the valid samples, `M = θ M̂ + (1 − θ) S`, where M̂ is the analytic mass
//! matrix of the faces, each times the visible part of its area. The analytic part enters as a control variate,
//! `b = M x0 + m − S x0`, so the residual of x0 is `b − A x0 = m − S x0 − α R x0`: M and the anchor drop out.
//!
//! Deviations from the paper and from its control variate, θ = 1, measured in docs/benchmarks/least-squares.md. What
//! the control variate leaves, (S − M)(f − g_x0), is noise as large as the sampling's own where samples are few; a tenth
//! of it goes as far towards a well-conditioned matrix as is needed. And where a surface is hidden in other geometry,
//! a membrane takes the place of the missing samples, `κ Σ (x_i − x_j)²` over the edges of each face by its hidden part:
//! the regulariser alone, blind to linear functions, would extrapolate whatever noise there is at the rim.

use crate::{edges::Edges, hole, hole::HoleUnknown, matrix::LowerCsc, samples::FaceSamples, surface::Surface};
use kiln_core::{FaceMoments, SolveSettings};

/// Weight θ of the analytic mass matrix in M.
const ANALYTIC_PART: f64 = 0.1;

/// Weight κ of the membrane over what is hidden, relative to the weight of samples in the same place.
const MEMBRANE: f64 = 0.01;

/// Weight of the anchor of unknowns without samples, as a fraction of the area around them: far below the membrane's, it
/// matters only to patches that hang on nothing else.
const HOLE_ANCHOR: f64 = 1e-5;

/// The system of a whole instance. Vectors over unknowns with several values have those of one unknown together.
#[derive(Clone, Debug)]
pub struct Assembly {
    /// A, lower triangle, over all unknowns; those that no face of the surface uses have an empty row.
    pub matrix: LowerCsc,
    /// `W_i = Σ w φ_i` over valid samples: the area that speaks for each unknown.
    pub weight: Vec<f64>,
    /// The diagonal of the anchor.
    pub anchor: Vec<f64>,
    /// How many edges each unknown is from the rim of its hole; 0 outside holes.
    pub hole_ring: Vec<u32>,
    /// The local averages x0, `unknowns × channels`.
    pub average: Vec<f64>,
    /// `unknowns × 2 channels`: residuals of x0, then half the difference of the two halves' right-hand sides.
    pub rhs: Vec<f64>,
    /// Number of channels.
    pub channels: usize,
    /// The part of each face's area that its valid samples speak for, 0 to 1.
    pub visible: Vec<f64>,
}

impl Assembly {
    /// Assembles the system of a surface from its moments, which have an entry for each face of the mesh.
    pub fn new(surface: &Surface, edges: &Edges, moments: &FaceMoments, settings: &SolveSettings) -> Self {
        let n = surface.unknown_count();
        let channels = moments.channel_count();
        let mut assembly = Self {
            matrix: pattern(n, edges),
            weight: vec![0.0; n],
            anchor: vec![0.0; n],
            hole_ring: vec![0; n],
            average: vec![0.0; n * channels],
            rhs: vec![0.0; n * 2 * channels],
            channels,
            visible: Vec::with_capacity(surface.corners.len()),
        };
        assembly.average_samples(surface, moments);
        let holes = hole::fill_averages(surface, &assembly.weight, &mut assembly.average, channels);
        assembly.add_samples(surface, moments);
        assembly.add_membrane(surface);
        assembly.add_regulariser(surface, edges, settings.regularization);
        assembly.add_anchor(settings.anchor, &holes);
        assembly
    }

    /// Number of right-hand sides.
    pub fn columns(&self) -> usize {
        2 * self.channels
    }

    /// First pass: W and x0.
    fn average_samples(&mut self, surface: &Surface, moments: &FaceMoments) {
        let channels = self.channels;
        for (face, corners) in surface.corners.iter().enumerate() {
            let samples = face_samples(surface, moments, face);
            let phi = samples.map_or([0.0; 3], |samples| samples.mean.phi());
            self.visible.push((phi.iter().sum::<f64>() / surface.areas[face]).min(1.0));
            let Some(FaceSamples { mean, .. }) = &samples else { continue };
            for (i, unknown) in corners.map(|u| u as usize).into_iter().enumerate() {
                self.weight[unknown] += phi[i];
                for (sum, phi_f) in self.average[unknown * channels..].iter_mut().zip(&mean.phi_f[..channels]) {
                    *sum += phi_f[i];
                }
            }
        }
        for (sums, weight) in self.average.chunks_exact_mut(channels).zip(&self.weight) {
            if *weight > 0.0 {
                sums.iter_mut().for_each(|sum| *sum /= weight);
            }
        }
    }

    /// Second pass: M, and `m − S x0` of the mean and of the half difference.
    fn add_samples(&mut self, surface: &Surface, moments: &FaceMoments) {
        let (channels, columns) = (self.channels, self.columns());
        for (face, &[a, b, c]) in surface.corners.iter().enumerate() {
            let samples = face_samples(surface, moments, face);
            let Some(FaceSamples { mean, half_difference }) = &samples else { continue };
            let at = [a, b, c].map(|u| u as usize);
            let mass = mass(&mean.phi_phi, surface.areas[face] * self.visible[face]);
            at.into_iter().zip(&mass).for_each(|(u, m)| self.matrix.add_diagonal(u, *m));
            [[a, b], [a, c], [b, c]].into_iter().zip(&mass[3..]).for_each(|([i, j], m)| self.matrix.add(i, j, *m));
            for channel in 0..channels {
                let x0 = at.map(|u| self.average[u * channels + channel]);
                let misfit = mean.misfit(channel, x0);
                let difference = half_difference.misfit(channel, x0);
                for i in 0..3 {
                    self.rhs[at[i] * columns + channel] += misfit[i];
                    self.rhs[at[i] * columns + channels + channel] += difference[i];
                }
            }
        }
    }

    /// `κ L` of the hidden parts, and `−κ L x0`.
    fn add_membrane(&mut self, surface: &Surface) {
        let (channels, columns) = (self.channels, self.columns());
        for (face, &[a, b, c]) in surface.corners.iter().enumerate() {
            let weight = MEMBRANE * surface.areas[face] * (1.0 - self.visible[face]) / 3.0;
            if weight <= 0.0 {
                continue;
            }
            for [i, j] in [[a, b], [a, c], [b, c]] {
                self.matrix.add(i, j, -weight);
                let [i, j] = [i, j].map(|u| u as usize);
                self.matrix.add_diagonal(i, weight);
                self.matrix.add_diagonal(j, weight);
                for channel in 0..channels {
                    let pull = weight * (self.average[i * channels + channel] - self.average[j * channels + channel]);
                    self.rhs[i * columns + channel] -= pull;
                    self.rhs[j * columns + channel] += pull;
                }
            }
        }
    }

    /// `α R`, and `−α R x0`.
    fn add_regulariser(&mut self, surface: &Surface, edges: &Edges, regularization: f64) {
        let (channels, columns) = (self.channels, self.columns());
        for edge in &edges.interior {
            let Some(row) = edge.row(surface) else { continue };
            let unknowns = edge.unknowns();
            for i in 0..4 {
                let scaled = regularization * row[i];
                for j in 0..=i {
                    self.matrix.add(unknowns[i], unknowns[j], scaled * row[j]);
                }
            }
            let at = unknowns.map(|u| u as usize);
            for c in 0..channels {
                let jump: f64 = (0..4).map(|i| row[i] * self.average[at[i] * channels + c]).sum();
                for i in 0..4 {
                    self.rhs[at[i] * columns + c] -= regularization * row[i] * jump;
                }
            }
        }
    }

    fn add_anchor(&mut self, anchor: f64, holes: &[HoleUnknown]) {
        for (anchored, weight) in self.anchor.iter_mut().zip(&self.weight) {
            *anchored = anchor * weight;
        }
        for hole in holes {
            self.anchor[hole.unknown as usize] = HOLE_ANCHOR * hole.area;
            self.hole_ring[hole.unknown as usize] = hole.ring;
        }
        for (unknown, anchor) in self.anchor.iter().enumerate() {
            self.matrix.add_diagonal(unknown, *anchor);
        }
    }
}

/// A face's part of M, in the order of `phi_phi`, from its samples and the visible part of its area.
fn mass(phi_phi: &[f64; 6], visible_area: f64) -> [f64; 6] {
    let analytic = |i: usize| visible_area / if i < 3 { 6.0 } else { 12.0 };
    std::array::from_fn(|i| ANALYTIC_PART * analytic(i) + (1.0 - ANALYTIC_PART) * phi_phi[i])
}

/// A face's weighted samples.
fn face_samples(surface: &Surface, moments: &FaceMoments, face: usize) -> Option<FaceSamples> {
    let halves = moments.face(surface.mesh_face[face] as usize);
    FaceSamples::new(&halves, moments.channel_count(), surface.areas[face])
}

/// Room for M (the edges) and R (also the opposite corners). Edges of faces without samples are there too: the
/// matrix's graph is then the surface's, and its components are the surface's.
fn pattern(n: usize, edges: &Edges) -> LowerCsc {
    let opposite = || edges.interior.iter().map(|edge| edge.opposite);
    LowerCsc::with_pattern(n, || edges.all.iter().copied().chain(opposite()))
}
