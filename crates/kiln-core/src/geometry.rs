//! Meshes as Kiln works on them: cleaned, with faces in Morton order, in object space.

use crate::{Cutouts, mesh_form::GroupForm};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// What a piece of geometry is to the bake.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// Ordinary geometry: occludes and receives.
    #[default]
    Opaque,
    /// Far scenery: occludes and receives, with few samples.
    Distant,
    /// Neither occludes nor receives.
    Ignored,
    /// A tree: each crossing of one of its faces keeps a part of the visibility.
    Tree,
    /// A shrub: fog in the box around it.
    Shrub,
    /// A small decorator such as grass: stops nothing.
    Decorator,
    /// A large object of which there are many: stops rays like ordinary geometry, but all its instances share one local AO.
    Instanced,
}

impl Class {
    /// Every class.
    pub const ALL: [Self; 7] =
        [Self::Opaque, Self::Distant, Self::Ignored, Self::Tree, Self::Shrub, Self::Decorator, Self::Instanced];
}

/// What faces of foliage do to rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Foliage {
    /// Each crossing keeps a part of the visibility.
    Crossing(OpticalDepth),
    /// The box around all such faces of an instance is filled with fog, of this density or of one derived from the mesh.
    Fog(Option<Density>),
}

/// How much of the visibility is lost, as the negative binary logarithm of what is kept, in units of 2⁻¹⁶: depths add up
/// exactly, in any order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct OpticalDepth(pub u32);

impl OpticalDepth {
    /// Nothing is kept, as far as a ray's 16 bits can tell.
    const MOST: f64 = 64.0;

    /// The depth that keeps a part of the visibility, 0 to 1.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 64 · 65,536")]
    pub fn of_transmittance(transmittance: f64) -> Self {
        let depth = if transmittance > 0.0 { -transmittance.log2() } else { Self::MOST };
        Self((depth.clamp(0.0, Self::MOST) * 65536.0).round() as u32)
    }

    /// Whether nothing at all is kept.
    pub fn keeps_nothing(self) -> bool {
        f64::from(self.0) >= Self::MOST * 65536.0
    }

    /// The part of the visibility that is kept, 0 to 1.
    pub fn transmittance(self) -> f64 {
        (-f64::from(self.0) / 65536.0).exp2()
    }
}

/// Density of fog, 1/m, compared by its bits.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Density {
    /// Negative natural logarithm of what is kept, for each metre.
    pub per_m: f64,
}

impl PartialEq for Density {
    fn eq(&self, other: &Self) -> bool {
        self.per_m.to_bits() == other.per_m.to_bits()
    }
}

impl Eq for Density {}

impl std::hash::Hash for Density {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.per_m.to_bits().hash(state);
    }
}

/// Fog that stands for an instance's shrub.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fog {
    /// The box, in the instance's object space.
    pub bounds: Bounds,
    /// Density in world space, 1/m, less what other fog in the same place adds.
    pub density_per_m: f64,
}

/// What faces of one primitive have in common.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(from = "GroupForm", into = "GroupForm")]
pub struct FaceGroup {
    /// The class that the rules give.
    pub class: Class,
    /// The material is double-sided: hits on either side count as front, and both sides receive.
    pub double_sided: bool,
    /// Rays are stopped by these faces.
    pub occludes: bool,
    /// What the faces do to rays that they do not stop.
    pub foliage: Option<Foliage>,
    /// The faces are there only where a mask is opaque, by its index in [`Cutouts::masks`]; what is said of stopping rays holds
    /// for what is there.
    pub cutout: Option<u16>,
    /// These faces get samples.
    pub receives: bool,
    /// A cap on the samples per face that a rule sets, of 256 rays each: adaptive sampling, whose samples have fewer rays,
    /// takes as many more.
    pub max_samples_per_face: Option<u32>,
}

impl FaceGroup {
    /// Ordinary faces: opaque, seen from the front, without a cap.
    pub const PLAIN: Self = Self {
        class: Class::Opaque,
        double_sided: false,
        occludes: true,
        foliage: None,
        cutout: None,
        receives: true,
        max_samples_per_face: None,
    };

    /// Whether rays are stopped by all of each face.
    pub fn is_solid(&self) -> bool {
        self.occludes && self.cutout.is_none()
    }

    /// Whether rays are stopped where a mask is opaque. Where foliage keeps nothing there, no guess at its holes is needed:
    /// it is geometry that has them.
    pub fn stops_where_opaque(&self) -> bool {
        let keeps_nothing = matches!(self.foliage, Some(Foliage::Crossing(depth)) if depth.keeps_nothing());
        self.cutout.is_some() && (self.occludes || keeps_nothing)
    }

    /// Whether hits on either side count as front: foliage has no back.
    pub fn is_front_from_both_sides(&self) -> bool {
        self.double_sided || self.foliage.is_some()
    }
}

/// A mesh in object space, metres before the instance's transform.
///
/// Faces are in Morton order of their centroids, so that a contiguous range is compact; vertices are in the
/// order of the source. Positions are finite, indices in range, no face is degenerate and no two faces of one
/// mesh have the same corners, facing, group and texture coordinates.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Unit shading normals, one per vertex; zero where the source has none or an invalid one.
    pub normals: Vec<[f32; 3]>,
    /// Vertex indices of each face, counter-clockwise seen from the front.
    pub faces: Vec<[u32; 3]>,
    /// Index into `groups` for each face.
    pub face_group: Vec<u16>,
    /// What faces have in common; at most 65,536.
    pub groups: Vec<FaceGroup>,
    /// The holes of the faces that have any.
    pub cutouts: Cutouts,
}

impl Mesh {
    /// The three corners of a face, object space.
    pub fn corners(&self, face: usize) -> [Vec3; 3] {
        self.faces[face].map(|vertex| Vec3::from_array(self.positions[vertex as usize]))
    }

    /// The group of a face.
    pub fn group(&self, face: usize) -> &FaceGroup {
        &self.groups[usize::from(self.face_group[face])]
    }

    /// Bounds of the positions that faces use.
    pub fn bounds(&self) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        for face in 0..self.faces.len() {
            for corner in self.corners(face) {
                bounds.add(corner.as_dvec3());
            }
        }
        bounds
    }
}

/// An axis-aligned box; empty where `min > max`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Least corner, metres.
    pub min: DVec3,
    /// Greatest corner, metres.
    pub max: DVec3,
}

impl Bounds {
    /// Contains nothing.
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// Grows the box to contain a point.
    pub fn add(&mut self, point: DVec3) {
        self.min = self.min.min(point);
        self.max = self.max.max(point);
    }

    /// Grows the box to contain another.
    pub fn merge(&mut self, other: &Self) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
    }

    /// Whether the box contains no point.
    pub fn is_empty(&self) -> bool {
        !(self.min.x <= self.max.x && self.min.y <= self.max.y && self.min.z <= self.max.z)
    }

    /// Length of the diagonal, metres; 0 for an empty box.
    pub fn diagonal(&self) -> f64 {
        if self.is_empty() { 0.0 } else { (self.max - self.min).length() }
    }

    /// Centre of the box; the origin for an empty one.
    pub fn center(&self) -> DVec3 {
        if self.is_empty() { DVec3::ZERO } else { 0.5 * (self.min + self.max) }
    }
}
