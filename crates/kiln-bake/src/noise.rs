//! How noisy a piece's samples are: their variance about what vertex values can follow.

use glam::Vec3;
use kiln_core::{HalfMoments, MAX_CHANNELS, Mesh};
use std::{collections::BTreeMap, ops::Range};

/// Faces of a piece at one position whose normals are within this angle's cosine share a vertex: 15°, wider than in the
/// solve, because noise is pooled here and needs neighbours more than it fears creases.
const WELD_COSINE: f64 = 0.965_925_826_289_068_3;

/// Steps towards the least-squares fit from the local averages.
const STEPS: usize = 4;

/// Weight of the local averages within that fit.
const AVERAGES: f64 = 0.1;

/// How much of the noise a fit by so few steps takes into itself, against the averages alone.
const LEVERAGE: f64 = 1.5;

/// Variance that a piece is held to have before anything is known, with the weight of one degree of freedom.
const UNKNOWN_VARIANCE: f64 = 0.04;

/// Variance of a sample on each face, from one half of the moments.
#[derive(Debug)]
pub(crate) struct Noise {
    /// Variance of one sample about the fit, the greatest of the channels', from the face and those around it.
    pub(crate) variance: Vec<f64>,
    /// The part of a face that can be seen, as far as its samples and those around it tell. It falls with every hidden
    /// sample but is 0 only where the whole piece is hidden: a face whose samples have missed its visible part so far must
    /// not be given up at once.
    pub(crate) visible: Vec<f64>,
}

impl Noise {
    /// Fits vertex values to the moments of one half and takes the mean square of what is left, per degree of freedom,
    /// over the faces around each face's corners.
    pub(crate) fn new(moments: &[&HalfMoments], corners: &[[u32; 3]], areas: &[f64]) -> Self {
        let fit = Fit::new(moments, corners, areas);
        let residuals: Vec<Residual> = (0..moments.len()).map(|face| fit.residual(moments[face], face)).collect();
        let mut around = vec![Residual::default(); fit.weight.len()];
        let mut all = Residual::default();
        for (corners, residual) in corners.iter().zip(&residuals) {
            corners.iter().for_each(|vertex| around[*vertex as usize].add(residual));
            all.add(residual);
        }
        // A piece of few samples fits them all and learns nothing of its noise; it is not taken for silent.
        all.add(&Residual { squares: [UNKNOWN_VARIANCE; MAX_CHANNELS], freedom: 1.0 });
        let prior = all.variances();
        let variance = corners.iter().map(|corners| {
            let mut pooled = Residual { squares: prior, freedom: 1.0 };
            corners.iter().for_each(|vertex| pooled.add(&around[*vertex as usize]));
            pooled.variances().into_iter().fold(0.0, f64::max)
        });
        let variance = variance.collect();
        Self { variance, visible: visible(moments, corners, around.len()) }
    }
}

impl Noise {
    /// Takes faces for visible whose samples are all hidden, so that they get as many as their neighbours.
    pub(crate) fn see_hidden(&mut self, moments: &[&HalfMoments]) {
        let hidden = self.visible.iter_mut().zip(moments).filter(|(_, half)| half.valid == 0);
        hidden.for_each(|(visible, _)| *visible = 1.0);
    }
}

/// The part of each face that can be seen: of its samples, with those of the faces around it as one more, and among those
/// the whole piece as one more.
fn visible(moments: &[&HalfMoments], corners: &[[u32; 3]], vertices: usize) -> Vec<f64> {
    let mut around = vec![[0.0; 2]; vertices];
    for (corners, half) in corners.iter().zip(moments) {
        for vertex in corners {
            let [valid, taken] = &mut around[*vertex as usize];
            *valid += f64::from(half.valid);
            *taken += f64::from(half.taken);
        }
    }
    let total = |count: fn(&HalfMoments) -> u32| moments.iter().map(|half| f64::from(count(half))).sum::<f64>();
    let piece = total(|half| half.valid) / total(|half| half.taken).max(1.0);
    let of_face = |(corners, half): (&[u32; 3], &&HalfMoments)| {
        let [valid, taken] = corners
            .map(|vertex| around[vertex as usize])
            .into_iter()
            .fold([0.0; 2], |sum, of| [sum[0] + of[0], sum[1] + of[1]]);
        let surroundings = (valid + piece) / (taken + 1.0);
        (f64::from(half.valid) + surroundings) / (f64::from(half.taken) + 1.0)
    };
    corners.iter().zip(moments).map(of_face).collect()
}

/// What a fit leaves: squares for each channel, and the degrees of freedom that they have.
#[derive(Clone, Copy, Debug, Default)]
struct Residual {
    squares: [f64; MAX_CHANNELS],
    freedom: f64,
}

impl Residual {
    fn add(&mut self, other: &Self) {
        self.squares.iter_mut().zip(other.squares).for_each(|(sum, square)| *sum += square);
        self.freedom += other.freedom;
    }

    fn variances(&self) -> [f64; MAX_CHANNELS] {
        self.squares.map(|square| if self.freedom > 0.0 { square / self.freedom } else { 0.0 })
    }
}

/// Vertex values fitted to a piece's moments.
struct Fit<'a> {
    corners: &'a [[u32; 3]],
    /// Weight of one sample of each face.
    face_weight: Vec<f64>,
    /// `Σ w φ` at each vertex.
    weight: Vec<f64>,
    values: Vec<[f64; MAX_CHANNELS]>,
}

impl<'a> Fit<'a> {
    fn new(moments: &[&HalfMoments], corners: &'a [[u32; 3]], areas: &[f64]) -> Self {
        let vertices = corners.iter().flatten().max().map_or(0, |last| *last as usize + 1);
        let weigh = |(half, area): (&&HalfMoments, &f64)| area / f64::from(half.taken.max(1));
        let mut fit = Self {
            corners,
            face_weight: moments.iter().zip(areas).map(weigh).collect(),
            weight: vec![0.0; vertices],
            values: vec![[0.0; MAX_CHANNELS]; vertices],
        };
        for (face, half) in moments.iter().enumerate() {
            let phi = row_sums(&half.phi_phi);
            for (i, vertex) in corners[face].iter().enumerate() {
                fit.weight[*vertex as usize] += fit.face_weight[face] * phi[i];
            }
        }
        let averages = fit.divided(fit.misfits(moments));
        fit.values.clone_from(&averages);
        for _ in 0..STEPS {
            let step = fit.divided(fit.misfits(moments));
            for ((value, step), average) in fit.values.iter_mut().zip(step).zip(&averages) {
                for c in 0..MAX_CHANNELS {
                    value[c] += (step[c] + AVERAGES * (average[c] - value[c])) / (1.0 + AVERAGES);
                }
            }
        }
        fit
    }

    /// `Σ w φ (f − g)` at each vertex.
    fn misfits(&self, moments: &[&HalfMoments]) -> Vec<[f64; MAX_CHANNELS]> {
        let mut sums = vec![[0.0; MAX_CHANNELS]; self.values.len()];
        for (face, half) in moments.iter().enumerate().filter(|(_, half)| half.valid > 0) {
            for (c, phi_f) in half.phi_f.iter().enumerate() {
                let product = times(&half.phi_phi, self.at(face, c));
                for i in 0..3 {
                    let sum = &mut sums[self.corners[face][i] as usize][c];
                    *sum += self.face_weight[face] * (phi_f[i] - product[i]);
                }
            }
        }
        sums
    }

    fn divided(&self, mut sums: Vec<[f64; MAX_CHANNELS]>) -> Vec<[f64; MAX_CHANNELS]> {
        for (sum, weight) in sums.iter_mut().zip(&self.weight) {
            sum.iter_mut().for_each(|sum| *sum = if *weight > 0.0 { *sum / weight } else { 0.0 });
        }
        sums
    }

    fn at(&self, face: usize, channel: usize) -> [f64; 3] {
        self.corners[face].map(|vertex| self.values[vertex as usize][channel])
    }

    fn residual(&self, half: &HalfMoments, face: usize) -> Residual {
        if half.valid == 0 {
            return Residual::default();
        }
        let squares = std::array::from_fn(|c| {
            let x = self.at(face, c);
            let product = times(&half.phi_phi, x);
            let cross: f64 = (0..3).map(|i| x[i] * (product[i] - 2.0 * half.phi_f[c][i])).sum();
            (half.f_squared[c] + cross).max(0.0)
        });
        let taken_in = (0..3).map(|i| {
            let weight = self.weight[self.corners[face][i] as usize];
            if weight > 0.0 { self.face_weight[face] * half.phi_phi[i] / weight } else { 0.0 }
        });
        let samples = f64::from(half.valid);
        let freedom = (samples - LEVERAGE * taken_in.sum::<f64>()).max(0.05 * samples);
        Residual { squares, freedom }
    }
}

/// `Σ φ_i φ_j` times the corners' values.
fn times([xx, yy, zz, xy, xz, yz]: &[f64; 6], [x, y, z]: [f64; 3]) -> [f64; 3] {
    [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z]
}

/// `Σ φ_i`: coordinates add up to 1.
fn row_sums(phi_phi: &[f64; 6]) -> [f64; 3] {
    times(phi_phi, [1.0; 3])
}

/// The corners of a run of faces as vertices of their own: corners at one position share one where their normals are
/// similar. Vertices are numbered as they come.
pub(crate) fn piece_vertices(mesh: &Mesh, faces: Range<usize>) -> Vec<[u32; 3]> {
    let mut found: BTreeMap<[u32; 3], Vec<([f64; 3], u32)>> = BTreeMap::new();
    let mut count = 0;
    let mut vertex = |position: [f32; 3], normal: [f64; 3]| {
        let at = found.entry(position.map(|x| (x + 0.0).to_bits())).or_default();
        let similar = |(other, _): &&([f64; 3], u32)| dot(*other, normal) >= WELD_COSINE;
        if let Some((_, vertex)) = at.iter().find(similar) {
            return *vertex;
        }
        at.push((normal, count));
        count += 1;
        count - 1
    };
    faces
        .map(|face| {
            let positions = mesh.faces[face].map(|v| mesh.positions[v as usize]);
            let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
            let flat = (b - a).cross(c - a).normalize_or_zero().to_array();
            let corner_normal = |v: u32| {
                let normal = mesh.normals[v as usize].map(f64::from);
                if normal == [0.0; 3] { flat } else { normal }
            };
            let normals = mesh.faces[face].map(corner_normal);
            std::array::from_fn(|i| vertex(positions[i], normals[i]))
        })
        .collect()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
