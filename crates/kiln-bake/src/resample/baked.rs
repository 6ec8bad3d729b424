//! Finished vertex values, read where rays hit.

use crate::{samples::normal_matrix, seen_bounds};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use kiln_core::{Bounds, MAX_CHANNELS, Mesh};
use kiln_trace::{Hit, Ray};

/// One instance with values.
#[derive(Clone, Copy, Debug)]
pub struct BakedInstance<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// From object space to metres relative to the level's origin.
    pub world_from_object: DAffine3,
    /// `vertices × channels` values in [0, 1], as [`kiln_core::Solution::values`] has them.
    pub values: &'a [f32],
}

/// Values that cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BakedError {
    /// The number of channels is not one that a bake has.
    #[error("values have {channels} channels, not 1 to {MAX_CHANNELS}; bake the level again")]
    Channels {
        /// The number.
        channels: usize,
    },
    /// There is not one value for each vertex and channel.
    #[error("instance {instance} has {found} values, not {expected}; solve it again for this mesh")]
    Length {
        /// Index of the instance in the scene.
        instance: usize,
        /// Values given.
        found: usize,
        /// Vertices times channels.
        expected: usize,
    },
    /// A value is not in [0, 1].
    #[error("instance {instance} has the value {value} at vertex {vertex}, not one from 0 to 1; solve it again")]
    Value {
        /// Index of the instance in the scene.
        instance: usize,
        /// The vertex.
        vertex: usize,
        /// The value.
        value: f32,
    },
    /// A face refers to a vertex or a group that the mesh does not have.
    #[error("face {face} of instance {instance} refers to what its mesh does not have; import the level again")]
    Face {
        /// Index of the instance in the scene.
        instance: usize,
        /// The face.
        face: usize,
    },
}

/// What a ray reads where it hits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakedPoint {
    /// AO for each channel, in [0, 1]; 0 beyond the channels that there are.
    pub ao: [f64; MAX_CHANNELS],
    /// Unit normal of the face in world space, on its front. A face with two fronts has the normal of the side that was
    /// hit.
    pub normal: DVec3,
    /// Whether the ray came from the front, which both sides of a double-sided face are.
    pub is_front: bool,
}

/// A view over the values of a scene's instances.
#[derive(Clone, Debug)]
pub struct BakedSurface<'a> {
    channels: usize,
    instances: Vec<Option<Placed<'a>>>,
    bounds_m: Bounds,
}

#[derive(Clone, Copy, Debug)]
struct Placed<'a> {
    baked: BakedInstance<'a>,
    object_from_world: DAffine3,
    /// Takes object-space normals to world space, up to length, mirrored or not.
    normal_matrix: DMat3,
}

impl<'a> BakedSurface<'a> {
    /// A view over instances in the order of the scene that hits name; `None` for those without values. All have
    /// `channels` channels.
    pub fn new(channels: usize, instances: &[Option<BakedInstance<'a>>]) -> Result<Self, BakedError> {
        if !(1..=MAX_CHANNELS).contains(&channels) {
            return Err(BakedError::Channels { channels });
        }
        let placed = |(index, baked): (usize, &Option<BakedInstance<'a>>)| match baked {
            Some(baked) => check(index, baked, channels).map(|()| Some(Placed::new(*baked))),
            None => Ok(None),
        };
        let instances: Vec<_> = instances.iter().enumerate().map(placed).collect::<Result<_, _>>()?;
        let mut bounds_m = Bounds::EMPTY;
        for Placed { baked, .. } in instances.iter().flatten() {
            let bounds = seen_bounds(&baked.mesh.bounds(), &baked.world_from_object);
            // What a transform flattens is nowhere, since no ray meets it.
            if bounds.min.is_finite() && bounds.max.is_finite() {
                bounds_m.merge(&bounds);
            }
        }
        Ok(Self { channels, instances, bounds_m })
    }

    /// Number of channels.
    pub fn channel_count(&self) -> usize {
        self.channels
    }

    /// A box around all instances with values that rays can meet, metres relative to the level's origin.
    pub fn bounds_m(&self) -> Bounds {
        self.bounds_m
    }

    /// What is baked where a ray hits: linear between the face's vertices at the point of the face that the ray's point
    /// is at. Nothing for a miss, for an instance without values, and for a face that does not receive: its vertices'
    /// values are not its own.
    ///
    /// Of coincident opposite faces of one mesh a hit names the first, from either side; so its values are read.
    pub fn read(&self, ray: &Ray, hit: &Hit) -> Option<BakedPoint> {
        let placed = self.instances.get(hit.instance as usize)?.as_ref()?;
        let BakedInstance { mesh, values, .. } = &placed.baked;
        let face = hit.primitive as usize;
        let vertices = mesh.faces.get(face)?;
        if !mesh.group(face).receives {
            return None;
        }
        let corners = mesh.corners(face).map(Vec3::as_dvec3);
        let direction = ray.direction.as_dvec3();
        let point = ray.origin.as_dvec3() + direction * f64::from(hit.t);
        let phi = barycentric(placed.object_from_world.transform_point3(point), corners)?;
        let mut ao = [0.0; MAX_CHANNELS];
        for (channel, ao) in ao.iter_mut().enumerate().take(self.channels) {
            let [a, b, c] = vertices.map(|vertex| f64::from(values[vertex as usize * self.channels + channel]));
            // As differences to one corner, so that equal values have no rounding to suffer.
            *ao = (a + phi[1] * (b - a) + phi[2] * (c - a)).clamp(0.0, 1.0);
        }
        let [a, b, c] = corners;
        let normal = (placed.normal_matrix * (b - a).cross(c - a)).normalize_or_zero();
        let is_front = !hit.back_face;
        let normal = if is_front && normal.dot(direction) > 0.0 { -normal } else { normal };
        Some(BakedPoint { ao, normal, is_front })
    }
}

impl<'a> Placed<'a> {
    fn new(baked: BakedInstance<'a>) -> Self {
        let place = &baked.world_from_object;
        Self { baked, object_from_world: place.inverse(), normal_matrix: normal_matrix(place) }
    }
}

fn check(instance: usize, baked: &BakedInstance<'_>, channels: usize) -> Result<(), BakedError> {
    let BakedInstance { mesh, values, .. } = baked;
    let expected = mesh.positions.len() * channels;
    if values.len() != expected {
        return Err(BakedError::Length { instance, found: values.len(), expected });
    }
    if let Some((at, &value)) = values.iter().enumerate().find(|(_, value)| !(0.0..=1.0).contains(*value)) {
        return Err(BakedError::Value { instance, vertex: at / channels, value });
    }
    let is_bad = |face: &usize| {
        let group = mesh.face_group.get(*face).is_none_or(|group| usize::from(*group) >= mesh.groups.len());
        group || mesh.faces[*face].iter().any(|vertex| *vertex as usize >= mesh.positions.len())
    };
    match (0..mesh.faces.len()).find(is_bad) {
        Some(face) => Err(BakedError::Face { instance, face }),
        None => Ok(()),
    }
}

/// Barycentric coordinates of a point's projection onto the plane of a triangle, moved into the triangle: a hit is off it
/// by rounding alone. Nothing if a coordinate is not finite or the triangle has no area.
fn barycentric(point: DVec3, [a, b, c]: [DVec3; 3]) -> Option<[f64; 3]> {
    let (u, v, w) = (b - a, c - a, point - a);
    let normal = u.cross(v);
    let squared = normal.length_squared();
    let second = w.cross(v).dot(normal) / squared;
    let third = u.cross(w).dot(normal) / squared;
    let phi = [1.0 - second - third, second, third];
    if !phi.iter().all(|x| x.is_finite()) {
        return None;
    }
    let phi = phi.map(|x| x.max(0.0));
    let sum: f64 = phi.iter().sum();
    Some(phi.map(|x| x / sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0f64..1.0).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn coordinates_make_the_point(corners in [point(), point(), point()], s in 0.0f64..1.0, t in 0.0f64..1.0, off in -1.0f64..1.0) {
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a);
            prop_assume!(normal.length() > 1e-3);
            let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
            let on_face = a + (b - a) * s + (c - a) * t;
            let phi = barycentric(on_face + normal * off, corners).unwrap();
            let again = a * phi[0] + b * phi[1] + c * phi[2];
            prop_assert!((again - on_face).length() < 1e-9);
        }

        #[test]
        fn coordinates_stay_in_the_face(corners in [point(), point(), point()], p in point()) {
            if let Some(phi) = barycentric(p * 3.0, corners) {
                prop_assert!(phi.iter().all(|x| (0.0..=1.0).contains(x)));
                prop_assert!((phi.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_triangle_without_area_has_no_coordinates() {
        assert_eq!(barycentric(DVec3::ZERO, [DVec3::X; 3]), None);
    }
}
