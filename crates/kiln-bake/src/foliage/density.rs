//! The density of fog that is as transparent as a shrub.
//!
//! Lines through a box are even if they start on its surface, evenly by area, and go inwards with a density that is
//! proportional to the cosine. Of these the part that misses every face is the shrub's transparency; the fog's is the mean of
//! `exp(−σ length)`, which falls with σ, so that the σ at which both are equal is found by halving.

use glam::{DVec3, Vec3};
use kiln_core::{Bounds, CutoutFace, Cutouts, Digest, FaceGroup, Foliage, Mesh};
use kiln_trace::{
    CpuTracer, CutoutMesh, MeshBvh, Ray, Scene, SceneObject, SobolScramble, Tracer, cosine_direction,
    orthonormal_basis, sobol_point,
};
use std::{collections::HashMap, sync::Arc};

/// Lines are traced from so far outside the box, in diagonals, to as far behind it: faces may lie on its sides.
const BEYOND: f32 = 0.01;

/// Lines by which a shrub's transparency is measured: its standard error is .008 at most.
const LINES: u32 = 4096;

/// A box is at least this thick, as a part of its diagonal: fog needs a volume.
const LEAST_THICKNESS: f64 = 0.05;

/// Fog of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelFog {
    /// The box, object space.
    pub bounds: Bounds,
    /// How dense it is.
    pub density: ModelDensity,
}

/// A density that somebody gave, or that was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ModelDensity {
    /// 1/m in world space, whatever the instance's scale.
    Given(f64),
    /// One over a length in object space.
    Derived(f64),
}

impl ModelDensity {
    /// In world space, 1/m, for an instance that is scaled by as much.
    pub fn per_m(self, scale: f64) -> f64 {
        match self {
            Self::Given(per_m) => per_m,
            Self::Derived(density) => density / scale,
        }
    }
}

/// The fog of a mesh; `None` if it has no face that stands for fog. `seed` is the mesh's digest.
pub fn model_fog(mesh: &Mesh, seed: Digest) -> Option<ModelFog> {
    let fog = |face: &usize| matches!(mesh.group(*face).foliage, Some(Foliage::Fog(_)));
    let faces: Vec<usize> = (0..mesh.faces.len()).filter(fog).collect();
    let given = faces.iter().find_map(|face| match mesh.group(*face).foliage {
        Some(Foliage::Fog(density)) => density,
        _ => None,
    });
    let mut bounds = Bounds::EMPTY;
    faces.iter().flat_map(|face| mesh.corners(*face)).for_each(|corner| bounds.add(corner.as_dvec3()));
    if bounds.is_empty() {
        return None;
    }
    let bounds = thickened(&bounds);
    let density = match given {
        Some(density) => ModelDensity::Given(density.per_m),
        None => ModelDensity::Derived(Lines::new(&bounds, seed).density(mesh, &faces)),
    };
    Some(ModelFog { bounds, density })
}

fn thickened(bounds: &Bounds) -> Bounds {
    let half = (0.5 * (bounds.max - bounds.min)).max(DVec3::splat(0.5 * LEAST_THICKNESS * bounds.diagonal()));
    Bounds { min: bounds.center() - half, max: bounds.center() + half }
}

/// Even lines through a box, scaled to a diagonal of 1.
struct Lines {
    scale: f64,
    center: DVec3,
    rays: Vec<Ray>,
}

impl Lines {
    #[expect(clippy::cast_possible_truncation, reason = "rays are f32")]
    fn new(bounds: &Bounds, seed: Digest) -> Self {
        let scale = 1.0 / bounds.diagonal().max(f64::MIN_POSITIVE);
        let half = 0.5 * scale * (bounds.max - bounds.min);
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| seed.0[4 * at + i]));
        let scrambles = [SobolScramble([word(0), word(1)]), SobolScramble([word(2), word(3)])];
        let line = |index: u32| {
            let [point, turn] = scrambles.map(|scramble| sobol_point(index, scramble));
            let (start, inwards) = on_surface(half, point.map(f64::from));
            let direction = cosine_direction(turn, inwards.as_vec3(), orthonormal_basis(inwards.as_vec3()));
            let d = direction.as_dvec3();
            // To the first plane that is reached from inside.
            let planes = (half * d.signum() - start) / d;
            let length = planes.to_array().into_iter().filter(|t| t.is_finite()).fold(f64::INFINITY, f64::min);
            Ray { origin: start.as_vec3(), direction, t_max: length.max(0.0) as f32 }
        };
        Self { scale, center: bounds.center(), rays: (0..LINES).map(line).collect() }
    }

    /// The density, in object space, at which fog is as transparent as some faces of a mesh.
    fn density(&self, mesh: &Mesh, faces: &[usize]) -> f64 {
        let blocked = self.blocked(mesh, faces);
        let missed = blocked.iter().filter(|blocked| !**blocked).count() as f64 / f64::from(LINES);
        // Where every line is stopped, as dense as the number of lines can tell.
        let transparency = missed.max(0.5 / f64::from(LINES));
        let fog = |density: f64| {
            let kept = self.rays.iter().map(|ray| (-density * f64::from(ray.t_max)).exp());
            kept.sum::<f64>() / f64::from(LINES)
        };
        let (mut low, mut high) = (0.0, 1.0);
        while fog(high) > transparency && high < 1e6 {
            (low, high) = (high, 2.0 * high);
        }
        while high - low > 1e-9 * high {
            let middle = 0.5 * (low + high);
            if fog(middle) > transparency { low = middle } else { high = middle }
        }
        low * self.scale
    }

    fn blocked(&self, mesh: &Mesh, faces: &[usize]) -> Vec<bool> {
        // Group 0 is of whole faces, the others of those with a mask each.
        let group = |cutout| FaceGroup { double_sided: true, receives: false, cutout, ..FaceGroup::PLAIN };
        let cutouts: HashMap<usize, CutoutFace> = mesh.cutout_faces().map(|cutout| (cutout.face, cutout)).collect();
        let masks = (0..mesh.cutouts.masks.len() as u16).map(Some);
        let group_of = |face: &usize| cutouts.get(face).map_or(0, |cutout| cutout.mask + 1);
        let corner = |corner: Vec3| ((corner.as_dvec3() - self.center) * self.scale).as_vec3().to_array();
        let alone = Mesh {
            positions: faces.iter().flat_map(|face| mesh.corners(*face)).map(corner).collect(),
            normals: vec![[0.0; 3]; 3 * faces.len()],
            faces: (0..faces.len() as u32).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect(),
            face_group: faces.iter().map(group_of).collect(),
            groups: std::iter::once(None).chain(masks).map(group).collect(),
            cutouts: Cutouts {
                masks: mesh.cutouts.masks.clone(),
                corners: faces.iter().filter_map(|face| Some(cutouts.get(face)?.corners)).collect(),
            },
        };
        let object = SceneObject { mesh: 0, world_from_object: glam::DAffine3::IDENTITY };
        let (whole, cut) = (Arc::new(MeshBvh::build(&alone)), CutoutMesh::build(&alone).map(Arc::new));
        let scene = Scene::build(vec![whole], std::slice::from_ref(&object)).with_cutouts(vec![cut], &[object]);
        let tracer = CpuTracer::new(Arc::new(scene));
        let longer =
            |ray: &Ray| Ray { origin: ray.origin - ray.direction * BEYOND, t_max: ray.t_max + 2.0 * BEYOND, ..*ray };
        let rays: Vec<Ray> = self.rays.iter().map(longer).collect();
        let mut blocked = vec![true; rays.len()];
        // The processor's tracer does not fail.
        tracer.any_hit(&rays, &mut blocked).map_or_else(|_| Vec::new(), |()| blocked)
    }
}

/// A point on the surface of a box around the origin, even by area, and the direction inwards.
fn on_surface(half: DVec3, [u, v]: [f64; 2]) -> (DVec3, DVec3) {
    let areas = DVec3::new(half.y * half.z, half.z * half.x, half.x * half.y);
    let mut at = u * 2.0 * areas.element_sum();
    for side in 0..6 {
        let axis = side / 2;
        if at >= areas[axis] && side < 5 {
            at -= areas[axis];
            continue;
        }
        let sign = if side % 2 == 0 { 1.0 } else { -1.0 };
        let (mut point, mut inwards) = (DVec3::ZERO, DVec3::ZERO);
        point[axis] = sign * half[axis];
        point[(axis + 1) % 3] = (2.0 * (at / areas[axis].max(f64::MIN_POSITIVE)).min(1.0) - 1.0) * half[(axis + 1) % 3];
        point[(axis + 2) % 3] = (2.0 * v - 1.0) * half[(axis + 2) % 3];
        inwards[axis] = -sign;
        return (point, inwards);
    }
    (DVec3::ZERO, DVec3::X)
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::{Class, Density};

    fn mesh(triangles: &[[DVec3; 3]], given: Option<f64>) -> Mesh {
        let group = FaceGroup {
            class: Class::Shrub,
            double_sided: true,
            occludes: false,
            foliage: Some(Foliage::Fog(given.map(|per_m| Density { per_m }))),
            cutout: None,
            receives: true,
            max_samples_per_face: None,
        };
        Mesh {
            positions: triangles.iter().flatten().map(|corner| corner.as_vec3().to_array()).collect(),
            normals: vec![[0.0; 3]; 3 * triangles.len()],
            faces: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            face_group: vec![0; triangles.len()],
            groups: vec![group],
            ..Mesh::default()
        }
    }

    /// Small triangles at random places in a box, as many as have a given area in all.
    fn leaves(size: DVec3, count: u32, side: f64) -> Mesh {
        let mut state = 7u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut unit = || loop {
            let v = DVec3::new(next(), next(), next()) * 2.0 - 1.0;
            if (0.01..1.0).contains(&v.length()) {
                return (v.normalize(), DVec3::new(next(), next(), next()));
            }
        };
        let triangle = |_| {
            let (normal, at) = unit();
            let (u, v) = normal.any_orthonormal_pair();
            let center = (at - 0.5) * (size - side * 1.2);
            [0.0f64, 2.0, 4.0].map(|k| {
                let angle = k * std::f64::consts::FRAC_PI_3;
                center + (u * angle.cos() + v * angle.sin()) * side / 3f64.sqrt()
            })
        };
        mesh(&(0..count).map(triangle).collect::<Vec<_>>(), None)
    }

    #[test]
    fn random_leaves_have_the_density_of_half_their_area() {
        // Beer's law: faces of area A per volume in random directions block A / 2 for each metre.
        let (size, count, side) = (DVec3::new(2.0, 1.0, 1.5), 4000, 0.05);
        let fog = model_fog(&leaves(size, count, side), Digest::of(b"a")).unwrap();
        let volume = (fog.bounds.max - fog.bounds.min).element_product();
        let expected = 0.5 * f64::from(count) * 3f64.sqrt() / 4.0 * side * side / volume;
        let ModelDensity::Derived(found) = fog.density else { panic!("derived") };
        assert!((found / expected - 1.0).abs() < 0.06, "{found} {expected}");
        assert!((fog.density.per_m(2.0) - found / 2.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_given_is_taken() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1.0, 1.0)];
        let fog = model_fog(&mesh(&[corners], Some(0.7)), Digest::default()).unwrap();
        assert_eq!((fog.density, fog.density.per_m(9.0)), (ModelDensity::Given(0.7), 0.7));
        assert!(model_fog(&Mesh::default(), Digest::default()).is_none());
    }

    #[test]
    fn a_flat_shrub_gets_a_box_with_a_volume() {
        let card = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let fog = model_fog(&mesh(&[card], None), Digest::default()).unwrap();
        let size = fog.bounds.max - fog.bounds.min;
        assert!((size.z - LEAST_THICKNESS * 2f64.sqrt()).abs() < 1e-6 && size.x == 1.0);
        let ModelDensity::Derived(found) = fog.density else { panic!("derived") };
        assert!(found > 0.1 && found < 100.0, "{found}");
    }

    #[test]
    fn holes_are_seen() {
        use kiln_core::{Mask, Wrap};
        // A card whose texture is opaque in half of its columns, and one that is half as large: lines see as much of both.
        let card = |width: f64, is_opaque: fn(u32) -> bool| {
            let at = |x: f64, y: f64| DVec3::new(x * width, y, 0.0);
            let triangles = [[at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)], [at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]];
            // So that both have the box of the larger one.
            let speck = [DVec3::new(1.0, 1.0, 0.0), DVec3::new(1.0, 0.999_999, 0.0), DVec3::new(0.999_999, 1.0, 0.0)];
            let mut mesh = mesh(&[triangles[0], triangles[1], speck], None);
            mesh.groups[0].cutout = Some(0);
            let mask = Mask::new([16, 1], [Wrap::Clamp; 2], |[x, _]| is_opaque(x));
            let uv = [[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]], [[0.0; 2]; 3]];
            mesh.cutouts = Cutouts { masks: vec![mask.into()], corners: uv.to_vec() };
            let fog = model_fog(&mesh, Digest::of(b"b")).unwrap();
            let ModelDensity::Derived(found) = fog.density else { panic!("derived") };
            found
        };
        let (all, half, narrow) = (card(1.0, |_| true), card(1.0, |x| x < 8), card(0.5, |_| true));
        assert!((half / narrow - 1.0).abs() < 1e-3, "{half} {narrow}");
        assert!(half < 0.6 * all && card(1.0, |_| false) == 0.0, "{half} {all}");
    }

    #[test]
    fn a_closed_box_is_as_dense_as_lines_can_tell() {
        let corner = |i: usize| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64);
        let sides = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
        let shrunk = |i: usize| (corner(i) - 0.5) * 0.999;
        let triangles: Vec<_> =
            sides.iter().flat_map(|s| [[s[0], s[1], s[2]], [s[0], s[2], s[3]]]).map(|t| t.map(shrunk)).collect();
        let ModelDensity::Derived(found) = model_fog(&mesh(&triangles, None), Digest::default()).unwrap().density
        else {
            panic!()
        };
        assert!(found > 10.0 && found.is_finite(), "{found}");
    }
}
