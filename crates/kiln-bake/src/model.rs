//! Points on a model, at which its instances are compared with the volume around them (Sloan et al. 2013, section 2.2).

use crate::{
    piece::valid_ao,
    samples::{Batch, SampleMaker},
    volume::Volume,
};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use kiln_core::{MAX_CHANNELS, Mesh, Sampling};
use kiln_trace::{CosineSums, KernelRates, TraceError, Tracer};

/// Points of a model, about.
const POINTS: f64 = 2048.0;

/// Most points of one face.
const MOST_OF_FACE: f64 = 64.0;

/// A point on a model, in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelPoint {
    /// Face of the mesh.
    pub face: u32,
    /// Barycentric coordinates within it.
    pub phi: [f64; 3],
    /// Where it is, metres.
    pub position: DVec3,
    /// Unit normal that is shaded with.
    pub normal: DVec3,
    /// Both sides are seen.
    pub two_sided: bool,
    /// The area that it speaks for, square metres.
    pub area_m2: f64,
}

/// Points on the faces of a mesh that receive, by their area, at least one on each; they depend on the mesh and the seed.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 64")]
pub fn model_points(mesh: &Mesh, seed: u64) -> Vec<ModelPoint> {
    let area = |face: usize| crate::density::receiving_area_m2(mesh, &DAffine3::IDENTITY, face);
    let total: f64 = (0..mesh.faces.len()).map(area).sum();
    let maker = SampleMaker::new(mesh, &DAffine3::IDENTITY, seed, 1);
    let mut points = Vec::new();
    for face in (0..mesh.faces.len()).filter(|face| area(*face) > 0.0) {
        let count = (POINTS * area(face) / total).ceil().clamp(1.0, MOST_OF_FACE) as u32;
        let mut batch = Batch::default();
        maker.half(face, 0, 0..count, &mut batch);
        let corners = mesh.corners(face).map(Vec3::as_dvec3);
        let mut samples = batch.samples.iter();
        for position in &batch.positions {
            let Some(front) = samples.next() else { break };
            samples.by_ref().take(position.sides - 1).for_each(drop);
            let phi = position.phi;
            points.push(ModelPoint {
                face: face as u32,
                phi,
                position: corners[0] * phi[0] + corners[1] * phi[1] + corners[2] * phi[2],
                normal: front.normal.as_dvec3(),
                two_sided: position.sides > 1,
                area_m2: area(face) / f64::from(count),
            });
        }
    }
    points
}

/// AO that an instance of a model should have at its points, `points × channels`, from the volume around it; NaN outside of the
/// volume. What has two sides has the mean of both.
#[expect(clippy::cast_possible_truncation, reason = "values are f32")]
pub fn values_in_volume(volume: &Volume, points: &[ModelPoint], world_from_object: &DAffine3) -> Vec<f32> {
    let m = world_from_object.matrix3;
    let turn = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
    let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    let channels = volume.channel_count();
    let mut values = Vec::with_capacity(points.len() * channels);
    for point in points {
        let at = world_from_object.transform_point3(point.position);
        let normal = (cofactor * point.normal * turn).normalize_or(DVec3::Y);
        let front = volume.ao_at(at, normal);
        let ao = if point.two_sided {
            front
                .zip(volume.ao_at(at, -normal))
                .map(|(front, back)| std::array::from_fn(|c| 0.5 * (front[c] + back[c])))
        } else {
            front
        };
        let ao: [f64; 4] = ao.unwrap_or([f64::NAN; 4]);
        values.extend(ao[..channels].iter().map(|ao| *ao as f32));
    }
    values
}

/// AO of an instance of a model at its points, `points × channels`, traced there by some rays a side, a power of two;
/// NaN where no side of a point is valid. What has two sides has the mean of those that are.
///
/// # Errors
/// Those of the tracer.
#[expect(clippy::cast_possible_truncation, reason = "values are f32")]
pub fn values_traced(
    tracer: &dyn Tracer,
    mesh: &Mesh,
    points: &[ModelPoint],
    world_from_object: &DAffine3,
    (sampling, rays): (&Sampling, u32),
) -> Result<Vec<f32>, TraceError> {
    let kernel = KernelRates::of(sampling);
    let maker = SampleMaker::new(mesh, world_from_object, sampling.seed, rays);
    let mut batch = Batch::default();
    let mut sides = Vec::with_capacity(points.len());
    let (mut last, mut index) = (u32::MAX, 0);
    for point in points {
        index = if point.face == last { index + 1 } else { 0 };
        last = point.face;
        let before = batch.samples.len();
        maker.position(point.face as usize, point.phi, index, &mut batch);
        sides.push(batch.samples.len() - before);
    }
    let mut sums = vec![CosineSums::default(); batch.samples.len()];
    tracer.gather_cosine(&batch.samples, &kernel, rays, &mut sums)?;
    let mut sums = sums.iter();
    let mut values = Vec::with_capacity(points.len() * kernel.channels);
    for sides in sides {
        let valid: Vec<[f64; MAX_CHANNELS]> =
            sums.by_ref().take(sides).filter_map(|sums| valid_ao(sums, sampling)).collect();
        // 0 / 0 is NaN.
        let mean = |channel: usize| valid.iter().map(|ao| ao[channel]).sum::<f64>() / valid.len() as f64;
        values.extend((0..kernel.channels).map(|channel| mean(channel) as f32));
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{GatherSettings, Layout, LayoutSettings, gather_batch};
    use kiln_core::{Bounds, FaceGroup, Kernel};
    use kiln_trace::{CpuTracer, KernelRates, MeshBvh, Scene, SceneObject};
    use std::sync::Arc;

    fn card(double_sided: bool) -> Mesh {
        let group = FaceGroup { double_sided, ..FaceGroup::PLAIN };
        Mesh {
            positions: vec![[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]],
            normals: vec![[0.0; 3]; 4],
            faces: vec![[0, 1, 2], [0, 2, 3]],
            face_group: vec![0, 0],
            groups: vec![group],
            ..Mesh::default()
        }
    }

    fn sampling() -> Sampling {
        Sampling {
            kernel: Kernel::Obscurance { half_distances_m: vec![2.0] },
            rays_per_sample: 16,
            target: None,
            mean_samples_per_face: 4.0,
            density_per_m2: None,
            min_samples_per_face: 2,
            max_samples_per_face: 64,
            back_face_limit: 0.25,
            seed: 1,
            foliage: kiln_core::FoliageMode::default(),
            ground_plane_y_m: None,
            no_skip: std::collections::BTreeSet::new(),
        }
    }

    #[test]
    fn points_speak_for_the_whole_area() {
        let points = model_points(&card(false), 3);
        assert!((points.iter().map(|point| point.area_m2).sum::<f64>() - 4.0).abs() < 1e-9);
        for point in &points {
            assert!(point.position.y == 0.0 && point.position.abs().max_element() <= 1.0);
            assert!((point.normal - DVec3::Y).length() < 1e-6 && !point.two_sided);
            assert!((point.phi.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
        assert_eq!(points, model_points(&card(false), 3));
    }

    #[test]
    fn an_instance_sees_what_is_around_it() {
        // A large floor; a card three metres above it sees the sky above and the floor below.
        let floor = SceneObject { mesh: 0, world_from_object: DAffine3::from_scale(DVec3::splat(500.0)) };
        let tracer = CpuTracer::new(Arc::new(Scene::build(vec![Arc::new(MeshBvh::build(&card(true)))], &[floor])));
        let place = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.5, 1.0, 0.5),
            glam::DQuat::IDENTITY,
            DVec3::new(10.0, 3.0, -4.0),
        );
        let bounds = Bounds { min: DVec3::new(9.0, 2.5, -5.0), max: DVec3::new(11.0, 3.5, -3.0) };
        let layout = Layout::new(&[bounds], &LayoutSettings::default()).unwrap();
        let settings = GatherSettings {
            kernel: KernelRates::new(&Kernel::Obscurance { half_distances_m: vec![2.0] }),
            rays_per_voxel: 1024,
            back_face_limit: 0.25,
            seed: 1,
        };
        let batch = gather_batch(&tracer, &layout, 0..layout.bricks().len(), &settings).unwrap();
        let volume = Volume::assemble(layout, 1, &[batch]).unwrap();
        let mean = |double_sided| {
            let values = values_in_volume(&volume, &model_points(&card(double_sided), 1), &place);
            assert!(values.iter().all(|ao| ao.is_finite()));
            values.iter().map(|ao| f64::from(*ao)).sum::<f64>() / values.len() as f64
        };
        let below = 1.0 - 2.0 * 0.103_962_9; // 1 − 2 E3(3 ln 2 / 2)
        assert!((mean(false) - 1.0).abs() < 0.02, "{}", mean(false));
        assert!((mean(true) - 0.5 * (1.0 + below)).abs() < 0.02, "{} {below}", mean(true));
        // The same by rays from the points themselves.
        let sampling = sampling();
        let traced = |double_sided| {
            let mesh = card(double_sided);
            let values = values_traced(&tracer, &mesh, &model_points(&mesh, 1), &place, (&sampling, 128)).unwrap();
            values.iter().map(|ao| f64::from(*ao)).sum::<f64>() / values.len() as f64
        };
        assert!((traced(false) - 1.0).abs() < 1e-6, "{}", traced(false));
        assert!((traced(true) - 0.5 * (1.0 + below)).abs() < 2e-3, "{} {below}", traced(true));
        let outside = DAffine3::from_translation(DVec3::new(0.0, 50.0, 0.0));
        assert!(values_in_volume(&volume, &model_points(&card(false), 1), &outside).iter().all(|ao| ao.is_nan()));
    }
}
