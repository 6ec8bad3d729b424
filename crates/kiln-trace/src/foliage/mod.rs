//! Trees and shrubs: what rays lose on their way, without being stopped.
//!
//! A scene has a second tree, over boxes of fog (shrubs) and meshes whose faces keep a part of the visibility each time they
//! are crossed (trees). Once the closest hit of a ray is known, all that lies before it counts, not the closest alone (Sloan
//! et al. 2013, section 2.1). [`FoliageMode`] says what the ray is worth then:
//!
//! - `Attenuate`, the paper's: its value times what is kept on the whole way. Depths are integers, which add up in any order.
//! - `Expected`: it ends wherever it is absorbed, with that probability. With the kernel ρ and the visibility T up to a
//!   distance the expected value is `∫ ρ′ T` up to the closest hit, and what is beyond the reach of a ray that hits nothing
//!   ([`through`]).
//!
//! How far a ray goes through fog is measured in world space: a ray's parameter is the same in all spaces, and its direction
//! is of unit length.
//!
//! Shrubs are what a level has most of. Those that [`shrub`] has a record for lie in [`groups`] of up to 16, each a leaf of the
//! tree; other boxes of fog, and trees, are leaves by themselves.

mod cross;
mod groups;
mod inside;
mod shrub;
mod through;
mod view;

pub(crate) use cross::{CrossBundle, FoliageMemory};
pub use groups::ShrubGroup;
pub use shrub::{FogBox, ShrubRecord};
pub(crate) use through::Lost;
pub use view::FoliageView;

use crate::{
    MeshBvh,
    boxed::Boxed,
    cutout::Holes,
    node::WideNode,
    ray::TracedRay,
    scene::{Place, tree_over, world_box},
    triangle::face_of,
};
use glam::{DAffine3, Vec3};
use groups::Groups;
use kiln_core::{Bounds, FaceGroup, Fog, Foliage as FaceFoliage, FoliageMode, Mesh};
use shrub::Shrub;
use std::sync::Arc;

/// The faces of a mesh that keep a part of the visibility; where a mask says that one is not there, all of it.
#[derive(Debug)]
pub struct CrossingMesh {
    pub(crate) bvh: MeshBvh,
    /// Depth of each face of the mesh, [`kiln_core::OpticalDepth`].
    depths: Box<[u32]>,
    /// Where faces are not there, if some have masks.
    holes: Option<Holes>,
}

impl CrossingMesh {
    /// Of a mesh; `None` if it has no such face.
    pub fn build(mesh: &Mesh) -> Option<Self> {
        let depth = |group: &FaceGroup| match group.foliage {
            Some(FaceFoliage::Crossing(depth)) if !group.stops_where_opaque() => Some(depth.0),
            _ => None,
        };
        if !mesh.groups.iter().any(|group| depth(group).is_some()) {
            return None;
        }
        let bvh = MeshBvh::build_over(mesh, |group| depth(group).is_some());
        let depths = (0..mesh.faces.len()).map(|face| depth(mesh.group(face)).unwrap_or(0)).collect();
        let has_holes = mesh.groups.iter().any(|group| group.cutout.is_some() && depth(group).is_some());
        Some(Self { bvh, depths, holes: has_holes.then(|| Holes::of(mesh)) })
    }

    /// Whether masks say where some of its faces are not there.
    pub fn has_holes(&self) -> bool {
        self.holes.is_some()
    }

    /// Memory of nodes, triangles and depths, bytes.
    pub fn memory_bytes(&self) -> usize {
        let holes = self.holes.as_ref().map_or(0, Holes::memory_bytes);
        self.bvh.memory_bytes() + size_of_val(&*self.depths) + holes
    }

    /// Whether a face is there where a ray crosses it.
    #[inline(always)]
    pub(crate) fn is_there(&self, primitive: u32, corners: [Vec3; 3], ray: &TracedRay) -> bool {
        self.holes.as_ref().is_none_or(|holes| holes.is_there(primitive, corners, ray))
    }

    #[inline(always)]
    pub(crate) fn depth(&self, primitive: u32) -> u32 {
        self.depths[face_of(primitive) as usize]
    }
}

/// Something in a level that rays go through.
#[derive(Clone, Debug)]
pub enum FoliageObject {
    /// A tree.
    Crossings {
        /// Its faces.
        mesh: Arc<CrossingMesh>,
        /// From object space to metres relative to the level's origin.
        world_from_object: DAffine3,
    },
    /// A shrub.
    Fog {
        /// Box and density.
        fog: Fog,
        /// From object space to metres relative to the level's origin.
        world_from_object: DAffine3,
    },
}

/// What rays go through, and the tree over it.
#[derive(Debug)]
pub struct Foliage {
    mode: FoliageMode,
    /// A leaf's index is a group's, or from the number of groups on an object's.
    pub(crate) nodes: Vec<WideNode>,
    groups: Groups,
    objects: Vec<Placed>,
}

/// An object as rays see it.
#[derive(Debug)]
pub(crate) struct Placed {
    place: Place,
    /// The place is the world's origin.
    is_unmoved: bool,
    what: What,
}

#[derive(Debug)]
pub(crate) enum What {
    Crossings(Arc<CrossingMesh>),
    Fog { min: Vec3, max: Vec3, rate: i64 },
}

/// Units of rates of fog: binary logarithms of what is kept, for each metre, times 2²⁴. Whole numbers, so that what is
/// added where a ray comes in is taken away where it goes out.
pub(crate) const RATE_UNITS: f64 = 16_777_216.0;

/// Above this nothing is left after a tenth of a millimetre.
const MOST_RATE: f64 = 1e5;

impl Foliage {
    /// Places objects. Those whose transform flattens them, boxes without volume and fog without density are left out. In mode
    /// [`FoliageMode::Geometry`] there are none, since the faces themselves stop rays.
    pub fn build(objects: &[FoliageObject], mode: FoliageMode) -> Self {
        let (mut shrubs, mut placed) = (Vec::new(), Vec::new());
        for object in objects.iter().filter(|_| mode != FoliageMode::Geometry) {
            match packed(object) {
                Some(shrub) => shrubs.push(shrub),
                None => placed.extend(self::placed(object)),
            }
        }
        let (groups, boxes) = Groups::of(shrubs);
        let boxes = boxes.into_iter().chain(placed.iter().map(|(_, bounds)| *bounds));
        let boxed = |(index, [min, max]): (u32, [Vec3; 2])| Boxed::new(index, min, max);
        let nodes = tree_over((0..).zip(boxes).map(boxed).collect());
        Self { mode, nodes, groups, objects: placed.into_iter().map(|(placed, _)| placed).collect() }
    }

    /// The box around each shrub of a leaf that is a group.
    pub(crate) fn group_bounds(&self, leaf: u32) -> Option<impl Iterator<Item = [Vec3; 2]>> {
        let group = leaf as usize;
        (group < self.groups.len()).then(|| self.groups.boxes(group).map(|fog| fog.bounds()))
    }

    /// Whether there is nothing to go through.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Shrubs that take sixteen bytes each, in groups.
    pub fn packed_shrubs(&self) -> usize {
        self.groups.shrubs()
    }

    /// Memory of the tree and all objects, each mesh counted once, bytes.
    pub fn memory_bytes(&self) -> usize {
        let mut meshes: Vec<*const CrossingMesh> = Vec::new();
        let mut bytes = size_of_val(self.nodes.as_slice()) + size_of_val(self.objects.as_slice());
        bytes += self.groups.memory_bytes();
        for mesh in self.objects.iter().filter_map(|object| object.crossings()) {
            if !meshes.contains(&Arc::as_ptr(mesh)) {
                meshes.push(Arc::as_ptr(mesh));
                bytes += mesh.memory_bytes();
            }
        }
        bytes
    }
}

impl Placed {
    /// A world-space ray in the object's space.
    #[inline(always)]
    fn ray(&self, ray: &TracedRay) -> TracedRay {
        if self.is_unmoved { *ray } else { self.place.ray(ray) }
    }

    fn crossings(&self) -> Option<&Arc<CrossingMesh>> {
        match &self.what {
            What::Crossings(mesh) => Some(mesh),
            What::Fog { .. } => None,
        }
    }
}

/// The box around fog as it is traced, metres relative to the level's origin; `None` where it is not there for rays.
pub fn fog_bounds(fog: &Fog, world_from_object: &DAffine3) -> Option<Bounds> {
    let (min, max) = match Shrub::of(fog, world_from_object) {
        Some(shrub) => shrub.unpacked().bounds().into(),
        None => world_box(&fog.bounds, world_from_object)?,
    };
    Some(Bounds { min: min.as_dvec3(), max: max.as_dvec3() })
}

/// A shrub that has a record.
fn packed(object: &FoliageObject) -> Option<Shrub> {
    match object {
        FoliageObject::Fog { fog, world_from_object } => Shrub::of(fog, world_from_object),
        FoliageObject::Crossings { .. } => None,
    }
}

/// An object, and the corners of its box in world space.
fn placed(object: &FoliageObject) -> Option<(Placed, [Vec3; 2])> {
    let (what, bounds, world_from_object) = match object {
        FoliageObject::Crossings { mesh, world_from_object } => {
            (What::Crossings(Arc::clone(mesh)), mesh.bvh.bounds, world_from_object)
        }
        FoliageObject::Fog { fog, world_from_object } => (fog_box(fog)?, fog.bounds, world_from_object),
    };
    let (min, max) = world_box(&bounds, world_from_object)?;
    let place = Place::of(world_from_object);
    Some((Placed { is_unmoved: place.is_identity(), place, what }, [min, max]))
}

#[expect(clippy::cast_possible_truncation, reason = "rays are f32, and the rate is limited")]
fn fog_box(fog: &Fog) -> Option<What> {
    let Bounds { min, max } = fog.bounds;
    let rate = fog.density_per_m * std::f64::consts::LOG2_E;
    let is_there = rate > 0.0 && min.cmplt(max).all();
    let rate = (rate.min(MOST_RATE) * RATE_UNITS).round() as i64;
    is_there.then(|| What::Fog { min: min.as_vec3(), max: max.as_vec3(), rate })
}
