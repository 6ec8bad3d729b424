//! The points of a model that all its instances share, and local AO at them.

use super::error::{TreeError, check_channels, check_length};
use crate::instance::check_mesh;
use glam::DVec3;
use kiln_core::{Bounds, Mesh};

/// How far barycentric coordinates may be from [0, 1], and their sum from 1: they may come as f32.
const BARYCENTRIC_SLACK: f64 = 1e-4;

/// Weights below this count as 0, and none may be above its inverse, so that sums neither overflow nor vanish.
const LEAST_WEIGHT: f64 = 1e-30;

/// A point on a model's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelSample {
    /// The face of the mesh.
    pub face: u32,
    /// Barycentric coordinates within it.
    pub phi: [f64; 3],
    /// Position in object space, metres.
    pub position: DVec3,
    /// The area that it speaks for, in any unit that is the same for all samples; at least 0.
    pub weight: f64,
}

/// The samples of a model, by their parts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelSamples {
    /// The vertices of each sample's face.
    pub(crate) corners: Vec<[u32; 3]>,
    /// Barycentric coordinates.
    pub(crate) phi: Vec<[f64; 3]>,
    /// Positions in the model's box, see [`unit_position`].
    pub(crate) unit: Vec<[f64; 3]>,
    /// Weights, 0 or within 1e-30 to 1e30.
    pub(crate) weight: Vec<f64>,
    /// Number of vertices of the mesh.
    pub(crate) vertices: usize,
}

impl ModelSamples {
    /// Takes samples of a mesh.
    ///
    /// # Errors
    /// If the mesh does not fit together, or a sample has no face of it, coordinates outside of its face, a position
    /// that is not finite, or a weight that is negative, not finite or above 1e30.
    pub fn new(mesh: &Mesh, samples: &[ModelSample]) -> Result<Self, TreeError> {
        check_mesh(mesh)?;
        let bounds = mesh.bounds();
        let mut model = Self { vertices: mesh.positions.len(), ..Self::default() };
        for (index, sample) in samples.iter().enumerate() {
            let fault = |what| TreeError::Sample { sample: index, what };
            let corners = mesh.faces.get(sample.face as usize).ok_or_else(|| fault("a face that is not there"))?;
            sample.check().map_err(fault)?;
            model.corners.push(*corners);
            model.phi.push(sample.phi);
            model.unit.push(unit_position(&bounds, sample.position));
            model.weight.push(if sample.weight < LEAST_WEIGHT { 0.0 } else { sample.weight });
        }
        Ok(model)
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.weight.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.weight.is_empty()
    }

    /// The positions u of the samples in the model's box, in [−1, 1]³.
    pub fn unit_positions(&self) -> &[[f64; 3]] {
        &self.unit
    }

    /// Local AO at the samples from its values at vertices, `vertices × channels`, the channels of a vertex together.
    /// Values are clamped to [0, 1].
    ///
    /// # Errors
    /// If the number of channels or of values is another, or a value is not finite.
    pub fn local(&self, values: &[f32], channels: usize) -> Result<SampledLocal, TreeError> {
        check_channels(channels)?;
        check_length("values of local AO", values.len(), self.vertices * channels)?;
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            return Err(TreeError::Local { index });
        }
        let at = |vertex: u32, channel: usize| f64::from(values[vertex as usize * channels + channel]).clamp(0.0, 1.0);
        let of_sample = |(corners, phi): (&[u32; 3], &[f64; 3])| {
            let (corners, phi) = (*corners, *phi);
            (0..channels).map(move |channel| interpolate(&phi, corners.map(|vertex| at(vertex, channel))))
        };
        Ok(SampledLocal { channels, values: self.corners.iter().zip(&self.phi).flat_map(of_sample).collect() })
    }
}

impl ModelSample {
    fn check(&self) -> Result<(), &'static str> {
        let inside = |phi: &f64| (-BARYCENTRIC_SLACK..=1.0 + BARYCENTRIC_SLACK).contains(phi);
        if !(self.phi.iter().all(inside) && (self.phi.iter().sum::<f64>() - 1.0).abs() <= BARYCENTRIC_SLACK) {
            return Err("barycentric coordinates outside of its face");
        }
        if !self.position.is_finite() {
            return Err("a position that is not finite");
        }
        if !(0.0..=1.0 / LEAST_WEIGHT).contains(&self.weight) {
            return Err("a weight that is not within 0 to 1e30");
        }
        Ok(())
    }
}

/// Local AO at a model's samples.
#[derive(Clone, Debug, PartialEq)]
pub struct SampledLocal {
    /// Number of channels, 1 to [`kiln_core::MAX_CHANNELS`].
    pub(crate) channels: usize,
    /// `samples × channels`, in [0, 1].
    pub(crate) values: Vec<f64>,
}

impl SampledLocal {
    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The values, `samples × channels`, the channels of a sample together; in [0, 1].
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}

/// A value within a face from those at its corners, kept in [0, 1] where coordinates are off by rounding.
pub(crate) fn interpolate(phi: &[f64; 3], [a, b, c]: [f64; 3]) -> f64 {
    (phi[0] * a + phi[1] * b + phi[2] * c).clamp(0.0, 1.0)
}

/// A position of object space in the model's box ([`Mesh::bounds`]), scaled to [−1, 1]³; 0 along axes without extent, and
/// never outside of [−1, 1]. An engine evaluates G at it.
pub fn unit_position(bounds: &Bounds, position: DVec3) -> [f64; 3] {
    if bounds.is_empty() {
        return [0.0; 3];
    }
    let (offset, half) = (position - bounds.center(), 0.5 * (bounds.max - bounds.min));
    std::array::from_fn(|axis| if half[axis] > 0.0 { (offset[axis] / half[axis]).clamp(-1.0, 1.0) } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::{Class, FaceGroup};

    fn triangle() -> Mesh {
        let group = FaceGroup { class: Class::Tree, double_sided: true, ..FaceGroup::PLAIN };
        Mesh {
            positions: vec![[1.0, 5.0, 0.0], [3.0, 5.0, 0.0], [1.0, 5.0, 8.0]],
            normals: vec![[0.0; 3]; 3],
            faces: vec![[0, 1, 2]],
            face_group: vec![0],
            groups: vec![group],
            ..Mesh::default()
        }
    }

    fn sample() -> ModelSample {
        ModelSample { face: 0, phi: [0.25, 0.25, 0.5], position: DVec3::new(1.5, 5.0, 4.0), weight: 2.0 }
    }

    #[test]
    fn positions_are_those_in_the_box() {
        let model = ModelSamples::new(&triangle(), &[sample()]).unwrap();
        assert_eq!(model.unit_positions(), [[-0.5, 0.0, 0.0]]);
        let bounds = triangle().bounds();
        assert_eq!(unit_position(&bounds, DVec3::new(9.0, 7.0, 8.0)), [1.0, 0.0, 1.0]);
        assert_eq!(unit_position(&Bounds::EMPTY, DVec3::ONE), [0.0; 3]);
    }

    #[test]
    fn local_values_are_interpolated_and_clamped() {
        let model = ModelSamples::new(&triangle(), &[sample()]).unwrap();
        let local = model.local(&[0.0, 1.5, 0.4, 1.0, 0.8, -1.0], 2).unwrap();
        assert!((local.values()[0] - 0.5).abs() < 1e-7 && local.values()[1] == 0.5, "{local:?}");
        assert_eq!(local.channels(), 2);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let bad = [
            ModelSample { face: 1, ..sample() },
            ModelSample { phi: [0.5, 0.5, 0.5], ..sample() },
            ModelSample { phi: [f64::NAN, 0.5, 0.5], ..sample() },
            ModelSample { position: DVec3::NAN, ..sample() },
            ModelSample { weight: -1.0, ..sample() },
            ModelSample { weight: f64::INFINITY, ..sample() },
        ];
        for sample in bad {
            let found = ModelSamples::new(&triangle(), &[self::sample(), sample]);
            assert!(matches!(found, Err(TreeError::Sample { sample: 1, .. })), "{found:?}");
        }
        let model = ModelSamples::new(&triangle(), &[sample()]).unwrap();
        assert_eq!(model.local(&[0.0; 15], 5), Err(TreeError::Channels { channels: 5 }));
        assert!(matches!(model.local(&[0.0; 2], 1), Err(TreeError::Length { found: 2, expected: 3, .. })));
        assert_eq!(model.local(&[0.0, f32::NAN, 0.0], 1), Err(TreeError::Local { index: 1 }));
        let mut mesh = triangle();
        mesh.faces[0][1] = 3;
        assert!(matches!(ModelSamples::new(&mesh, &[]), Err(TreeError::Mesh(_))));
    }
}
