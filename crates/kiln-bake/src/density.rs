//! How many samples each face gets: by area up to a cap, so that large distant faces do not eat the budget
//! (Sloan et al. 2013, section 2.1).

use glam::{DAffine3, Vec3};
use kiln_core::{Mesh, Sampling};

/// Most samples of one face that adaptive sampling begins with.
const FIRST_CAP: u32 = 16;

/// World-space areas of an instance's receiving faces.
pub struct FaceAreas {
    /// Square metres for each face; 0 for faces that do not receive.
    pub area_m2: Vec<f64>,
    caps: Vec<Option<u32>>,
}

impl FaceAreas {
    /// Areas under a transform.
    pub fn new(mesh: &Mesh, world_from_object: &DAffine3) -> Self {
        let face = |i: usize| (receiving_area_m2(mesh, world_from_object, i), mesh.group(i).max_samples_per_face);
        let (area_m2, caps) = (0..mesh.faces.len()).map(face).unzip();
        Self { area_m2, caps }
    }

    /// Samples of a face at a density.
    pub fn samples(&self, face: usize, density_per_m2: f64, sampling: &Sampling) -> u32 {
        sample_count(self.area_m2[face], self.caps[face], density_per_m2, sampling)
    }

    fn total(&self, density_per_m2: f64, sampling: &Sampling) -> f64 {
        (0..self.area_m2.len()).map(|face| f64::from(self.samples(face, density_per_m2, sampling))).sum()
    }
}

/// World-space area of a face, square metres; 0 if it does not receive or has no finite area.
pub(crate) fn receiving_area_m2(mesh: &Mesh, world_from_object: &DAffine3, face: usize) -> f64 {
    let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
    let (u, v) = (world_from_object.matrix3 * (b - a), world_from_object.matrix3 * (c - a));
    let area = 0.5 * u.cross(v).length();
    if mesh.group(face).receives && area.is_finite() { area } else { 0.0 }
}

/// Samples of a face: `area · density`, rounded up to an even number for the two halves, between the least and the
/// most that settings and the face's class permit; none for a face without area. The least wins over a class's cap.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded by the cap")]
pub fn sample_count(area_m2: f64, class_cap: Option<u32>, density_per_m2: f64, sampling: &Sampling) -> u32 {
    if area_m2 <= 0.0 {
        return 0;
    }
    // Adaptive sampling finds out by itself which faces want more.
    let most = sampling.target.map_or(sampling.max_samples_per_face, |_| FIRST_CAP.min(sampling.max_samples_per_face));
    let cap = class_cap.map_or(most, |cap| cap.min(most));
    let wanted = (area_m2 * density_per_m2).ceil().min(f64::from(cap));
    let wanted = (wanted as u32).next_multiple_of(2).min(cap & !1);
    wanted.max(sampling.min_samples_per_face)
}

/// The density, samples per square metre, at which an instance's faces get the wanted number of samples on average;
/// the fixed one if the settings have it.
pub fn density(areas: &FaceAreas, sampling: &Sampling) -> f64 {
    if let Some(fixed) = sampling.density_per_m2 {
        return fixed;
    }
    let receiving = areas.area_m2.iter().filter(|&&area| area > 0.0).count();
    let wanted = sampling.mean_samples_per_face * receiving as f64;
    if receiving == 0 || areas.total(0.0, sampling) >= wanted {
        return 0.0;
    }
    let least = areas.area_m2.iter().copied().filter(|&area| area > 0.0).fold(f64::INFINITY, f64::min);
    // At the upper end even the smallest face has its cap.
    let (mut low, mut high) = (0.0, f64::from(sampling.max_samples_per_face) / least);
    if areas.total(high, sampling) < wanted {
        return high;
    }
    // The count is a step function of the density: halving in f64 ends where the two ends meet to nine digits.
    while high - low > 1e-9 * high {
        let middle = 0.5 * (low + high);
        if areas.total(middle, sampling) < wanted { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::Kernel;
    use proptest::prelude::*;

    fn sampling(mean: f64, min: u32, max: u32) -> Sampling {
        Sampling {
            target: None,
            kernel: Kernel::Obscurance { half_distances_m: vec![2.0] },
            rays_per_sample: 32,
            mean_samples_per_face: mean,
            density_per_m2: None,
            min_samples_per_face: min,
            max_samples_per_face: max,
            back_face_limit: 0.25,
            seed: 0,
            foliage: kiln_core::FoliageMode::default(),
            ground_plane_y_m: None,
            no_skip: std::collections::BTreeSet::new(),
        }
    }

    proptest! {
        #[test]
        fn the_mean_is_met(areas in prop::collection::vec(1e-9f64..1e6, 1..200), mean in 2.0f64..40.0) {
            let sampling = sampling(mean, 2, 64);
            let areas = FaceAreas { caps: vec![None; areas.len()], area_m2: areas };
            let faces = areas.area_m2.len() as f64;
            let total = areas.total(density(&areas, &sampling), &sampling);
            // One step of the largest group of equal faces may be more than wanted; random areas have none.
            prop_assert!(total >= mean * faces && total <= mean * faces + 2.0, "{total} {}", mean * faces);
        }
    }

    #[test]
    fn caps_and_minima() {
        assert_eq!(sample_count(0.0, None, 1e9, &sampling(4.0, 2, 64)), 0);
        assert_eq!(sample_count(1.0, None, 0.1, &sampling(4.0, 2, 64)), 2);
        assert_eq!(sample_count(1.0, None, 5.0, &sampling(4.0, 2, 64)), 6);
        assert_eq!(sample_count(1e9, None, 5.0, &sampling(4.0, 2, 64)), 64);
        assert_eq!(sample_count(1e9, Some(4), 5.0, &sampling(4.0, 2, 64)), 4);
        assert_eq!(sample_count(1e9, Some(4), 5.0, &sampling(64.0, 64, 256)), 64);
    }
}
