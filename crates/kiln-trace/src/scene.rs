//! Instances in two levels: what tracers trace.

use crate::{
    BvhChild, CutoutMesh, Foliage, MeshBvh,
    boxed::Boxed,
    build::build,
    cutout::SceneCutouts,
    node::{BvhLink, WideNode},
    ray::TracedRay,
};
use glam::{DAffine3, DVec3, Mat3, Vec3};
use kiln_core::Bounds;
use std::sync::Arc;

/// Bound on the relative rounding error of a ray's way into object space and of its intersection there, in units of
/// 2⁻²⁴: matrix entries and products rounded once each, four additions, and the edge functions of the triangle.
const ROUNDINGS: f64 = 16.0;
const UNIT_ROUNDOFF: f64 = 1.0 / 16_777_216.0;

/// One placement of a mesh, as given.
#[derive(Clone, Debug)]
pub struct SceneObject {
    /// Index into the scene's meshes.
    pub mesh: usize,
    /// From object space to metres relative to the level's origin.
    pub world_from_object: DAffine3,
}

/// A place of something, as rays are taken there.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Rows of the inverse transform.
    pub object_from_world: [[f32; 4]; 3],
}

impl Place {
    #[expect(clippy::cast_possible_truncation, reason = "rays are f32; PositionError bounds what is lost")]
    pub(crate) fn of(world_from_object: &DAffine3) -> Self {
        let inverse = world_from_object.inverse();
        let (m, t) = (inverse.matrix3, inverse.translation);
        let row = |i: usize| [m.x_axis[i] as f32, m.y_axis[i] as f32, m.z_axis[i] as f32, t[i] as f32];
        Self { object_from_world: [row(0), row(1), row(2)] }
    }

    /// Whether it moves nothing.
    pub(crate) fn is_identity(&self) -> bool {
        self.object_from_world == [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    }

    /// A world-space point in object space.
    #[inline(always)]
    pub(crate) fn point(&self, p: Vec3) -> Vec3 {
        let [x, y, z] = self.object_from_world;
        let row = [x[0] * p.x + x[1] * p.y + x[2] * p.z + x[3], y[0] * p.x + y[1] * p.y + y[2] * p.z + y[3]];
        Vec3::new(row[0], row[1], z[0] * p.x + z[1] * p.y + z[2] * p.z + z[3])
    }

    /// A world-space direction in object space; its length is kept by the ray's parameter, not by the vector.
    #[inline(always)]
    pub(crate) fn direction(&self, d: Vec3) -> Vec3 {
        let [x, y, z] = self.object_from_world;
        let row = [x[0] * d.x + x[1] * d.y + x[2] * d.z, y[0] * d.x + y[1] * d.y + y[2] * d.z];
        Vec3::new(row[0], row[1], z[0] * d.x + z[1] * d.y + z[2] * d.z)
    }

    /// A world-space ray in object space.
    #[inline(always)]
    pub(crate) fn ray(&self, ray: &TracedRay) -> TracedRay {
        let [origin, direction] = [ray.origin, ray.direction].map(Vec3::from_array);
        TracedRay::new(self.point(origin), self.direction(direction))
    }
}

/// Set in the mesh of an instance whose transform moves nothing.
const UNMOVED_BIT: u32 = 1 << 31;

/// One placement of a mesh, as traced.
#[derive(Clone, Debug)]
pub struct SceneInstance {
    /// Where it is.
    pub place: Place,
    /// Index of the object, which hits name.
    pub object: u32,
    /// Index into the scene's meshes, and [`UNMOVED_BIT`].
    mesh: u32,
}

const _: () = assert!(size_of::<SceneInstance>() == 56);

impl SceneInstance {
    fn of(index: usize, object: &SceneObject) -> Self {
        let place = Place::of(&object.world_from_object);
        let unmoved = if place.is_identity() { UNMOVED_BIT } else { 0 };
        Self { place, object: index as u32, mesh: object.mesh as u32 | unmoved }
    }

    /// Index into the scene's meshes.
    #[inline(always)]
    pub fn mesh(&self) -> usize {
        (self.mesh & !UNMOVED_BIT) as usize
    }

    /// Whether the transform moves nothing.
    #[inline(always)]
    pub(crate) fn is_identity(&self) -> bool {
        self.mesh & UNMOVED_BIT != 0
    }

    /// A world-space ray in object space.
    #[inline(always)]
    pub(crate) fn ray(&self, ray: &TracedRay) -> TracedRay {
        if self.is_identity() { *ray } else { self.place.ray(ray) }
    }
}

/// Meshes, instances and the BVH over them.
#[derive(Debug)]
pub struct Scene {
    /// The distinct meshes.
    pub meshes: Vec<Arc<MeshBvh>>,
    /// Those placements that rays can hit, in the order of their objects; then those of which they can hit only cutouts.
    pub instances: Vec<SceneInstance>,
    /// Tree over the instances; a leaf's index is an instance's, not its object's.
    pub(crate) nodes: Vec<WideNode>,
    /// What rays go through, if there is anything.
    pub(crate) foliage: Option<Foliage>,
    /// What stops rays but for its holes, if there is anything.
    pub(crate) cutouts: Option<SceneCutouts>,
}

impl Scene {
    /// Places meshes. Instances without occluding faces, and those whose transform flattens them, stop no ray.
    pub fn build(meshes: Vec<Arc<MeshBvh>>, objects: &[SceneObject]) -> Self {
        let mut instances = Vec::new();
        let mut boxes = Vec::new();
        for (index, object) in objects.iter().enumerate() {
            let Some((min, max)) = world_box(&meshes[object.mesh].bounds, &object.world_from_object) else { continue };
            boxes.push(Boxed::new(instances.len() as u32, min, max));
            instances.push(SceneInstance::of(index, object));
        }
        instances.shrink_to_fit();
        Self { meshes, instances, nodes: tree_over(boxes), foliage: None, cutouts: None }
    }

    /// Adds faces with holes: those of each mesh, in the order of the scene's meshes, under the objects that it was built of.
    /// Rays that [`crate::CpuTracer`] traces go through the holes, whatever is asked of them.
    pub fn with_cutouts(mut self, meshes: Vec<Option<Arc<CutoutMesh>>>, objects: &[SceneObject]) -> Self {
        let whole = self.instances.len();
        let mut boxes = Vec::new();
        for (index, object) in objects.iter().enumerate() {
            let Some(Some(mesh)) = meshes.get(object.mesh) else { continue };
            let Some((min, max)) = world_box(&mesh.bvh.bounds, &object.world_from_object) else { continue };
            let known = self.instances[..whole].binary_search_by_key(&(index as u32), |instance| instance.object);
            let instance = known.unwrap_or_else(|_| {
                self.instances.push(SceneInstance::of(index, object));
                self.instances.len() - 1
            });
            boxes.push(Boxed::new(instance as u32, min, max));
        }
        self.instances.shrink_to_fit();
        let nodes = tree_over(boxes);
        self.cutouts = (!nodes.is_empty()).then_some(SceneCutouts { nodes, meshes });
        self
    }

    /// Whether some of what stops rays has holes.
    pub fn has_cutouts(&self) -> bool {
        self.cutouts.is_some()
    }

    /// Adds what rays go through, which [`crate::Tracer::gather_cosine`] takes into account; [`crate::Tracer::trace`] and
    /// [`crate::Tracer::any_hit`] see only what stops them.
    pub fn with_foliage(self, foliage: Foliage) -> Self {
        Self { foliage: Some(foliage).filter(|foliage| !foliage.is_empty()), ..self }
    }

    /// What rays go through, if there is anything.
    pub fn foliage(&self) -> Option<&Foliage> {
        self.foliage.as_ref()
    }

    /// Whether nothing in it stops a ray; rays may go through something.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty() && self.cutouts.is_none()
    }

    /// The children of a node of the tree over the instances; a leaf is one instance. There is no node in an empty scene;
    /// else the root is node 0.
    pub fn children(&self, node: u32) -> impl Iterator<Item = BvhChild> {
        self.nodes[node as usize].slots()
    }

    /// Memory of all nodes, triangles and instances, bytes.
    pub fn memory_bytes(&self) -> usize {
        let meshes: usize = self.meshes.iter().map(|mesh| mesh.memory_bytes()).sum();
        let foliage = self.foliage.as_ref().map_or(0, Foliage::memory_bytes);
        let cutouts = self.cutouts.as_ref().map_or(0, SceneCutouts::memory_bytes);
        meshes + size_of_val(self.nodes.as_slice()) + size_of_val(self.instances.as_slice()) + foliage + cutouts
    }
}

/// The tree over boxes, each a leaf of its own that has a tree to go down; a leaf's index is the box's.
pub(crate) fn tree_over(boxes: Vec<Boxed>) -> Vec<WideNode> {
    let tree = build(boxes, 1);
    let mut nodes = tree.nodes;
    for reference in nodes.iter_mut().flat_map(|node| &mut node.children).filter(|child| **child != u32::MAX) {
        if let BvhLink::Leaf { first, count } = BvhLink::of_reference(*reference) {
            let first = tree.order[first as usize];
            *reference = BvhLink::Leaf { first, count }.to_reference();
        }
    }
    nodes
}

/// Bounds the distance between a point of an instance's surface and where a ray that starts there sees that surface,
/// due to rounding alone: to f32, on the ray's way into object space, and in the triangle test.
#[derive(Clone, Copy, Debug)]
pub struct PositionError {
    world_from_object: glam::DMat3,
    object_from_world: glam::DMat3,
    translation: DVec3,
}

impl PositionError {
    /// For surfaces under a transform, which need not be invertible (the bound is then not finite).
    pub fn new(world_from_object: &DAffine3) -> Self {
        let inverse = world_from_object.inverse();
        Self {
            world_from_object: abs(world_from_object.matrix3),
            object_from_world: abs(inverse.matrix3),
            translation: inverse.translation.abs(),
        }
    }

    /// Bound along each world axis, metres, at a world-space point of a face whose longest edge is `face_extent` in
    /// object space.
    pub fn bound(&self, point: DVec3, face_extent: f64) -> DVec3 {
        let there = self.object_from_world * point.abs() + self.translation + DVec3::splat(face_extent);
        (self.world_from_object * there + point.abs()) * (ROUNDINGS * UNIT_ROUNDOFF)
    }
}

fn abs(m: glam::DMat3) -> glam::DMat3 {
    glam::DMat3::from_cols(m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs())
}

/// Least and greatest corner of the world-space box, grown by the rounding error of rays on their way into object space. `None` for an instance that
/// no ray can hit.
pub(crate) fn world_box(bounds: &Bounds, transform: &DAffine3) -> Option<(Vec3, Vec3)> {
    let inverse = transform.inverse();
    let fits = |v: DVec3| v.is_finite() && v.abs().max_element() < f64::from(f32::MAX);
    let m = inverse.matrix3;
    let is_usable = transform.is_finite() && [m.x_axis, m.y_axis, m.z_axis, inverse.translation].into_iter().all(fits);
    if bounds.is_empty() || !is_usable {
        return None;
    }
    let (center, half) = (bounds.center(), 0.5 * (bounds.max - bounds.min));
    let center = transform.transform_point3(center);
    let half = abs(transform.matrix3) * half;
    let extent = bounds.min.abs().max(bounds.max.abs());
    let slack = PositionError::new(transform).bound(center.abs() + half, extent.max_element());
    let (min, max) = (center - half - slack, center + half + slack);
    (fits(min) && fits(max)).then(|| (min.as_vec3(), max.as_vec3()))
}

/// The linear part of a transform in f32, for callers that move directions.
pub(crate) fn linear(transform: &Place) -> Mat3 {
    let [x, y, z] = transform.object_from_world;
    Mat3::from_cols_array(&[x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]])
}
